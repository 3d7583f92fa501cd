"""A .db3 file (or another rosbag2 storage that rosbags reads), with the same face as an MCAP file."""

from __future__ import annotations

from collections import Counter
from collections.abc import Collection, Iterator
from contextlib import closing
from pathlib import Path
from typing import Any

import numpy as np

from hd_control.core.errors import BagError
from hd_control.core.faults import FaultCode
from hd_control.record.block import Block, Problem

BLOCK_MESSAGES = 1 << 14


class Db3Source:
    """Topics, counts and message blocks of a .db3 file; it carries neither attachments nor checksums."""

    def __init__(self, path: Path) -> None:
        """Raises BagError if rosbags cannot open it."""
        from rosbags.rosbag2 import Reader

        if not path.exists():
            raise BagError(f"{path}: no such file; check the path")
        self.path, self.problems = path, list[Problem]()
        self.closed, self.checksums = True, False
        self.expected: dict[int, int] | None = None
        self.metadata: dict[str, dict[str, str]] = {}
        try:
            self._reader = Reader(path)
            self._reader.open()
            connections = list(self._reader.connections)
        except Exception as error:  # the library leaks errors of sqlite, yaml and its own
            raise BagError(f"{path}: cannot be read as a bag ({_text(error)}); copy it anew") from None
        described = [c for c in connections if isinstance(c.topic, str) and isinstance(c.msgtype, str)]
        if len(described) < len(connections):
            text = f"{len(connections) - len(described)} topics have no name or type"
            self.problems.append(Problem(text, path.name, code=FaultCode.BAG_FOREIGN))
        self._connections = {connection.id: connection for connection in described}
        self.topics = {number: connection.topic for number, connection in self._connections.items()}
        self.types = {number: connection.msgtype for number, connection in self._connections.items()}
        self._check_pages()
        self.counts = Counter({number: int(c.msgcount) for number, c in self._connections.items()})

    def _check_pages(self) -> None:
        """The database's own check: tables and indexes must hold the same rows. Values have no checksum here."""
        import sqlite3

        try:
            with closing(sqlite3.connect(f"{self.path.resolve().as_uri()}?immutable=1", uri=True)) as database:
                (word,) = database.execute("PRAGMA integrity_check(1)").fetchone()
        except Exception as error:  # a damaged text in the answer raises UnicodeDecodeError
            word = _text(error)
        if word != "ok":
            self.problems.append(Problem(f"the database is damaged ({' '.join(str(word).split())})", self.path.name))

    def definition(self, channel: int) -> str:
        """The message definition text of a topic; empty if the file has none."""
        connection = self._connections.get(channel)
        return str(connection.msgdef.data) if connection else ""

    def description(self, channel: int) -> tuple[str, bytes, dict[str, str], str]:
        """(schema encoding, definition, channel metadata, message encoding), for copying."""
        connection = self._connections[channel]
        text = connection.msgdef.data
        form = connection.msgdef.format.name.lower()
        metadata = {"topic_type_hash": str(connection.digest or "")}
        return ("ros2idl" if form == "idl" else "ros2msg"), text.encode("utf-8"), metadata, "cdr"

    def attachment_records(self) -> dict[str, Any]:
        """None in this format."""
        return {}

    def close(self) -> None:
        """Closes the database."""
        self._reader.close()

    def blocks(self, channels: Collection[int]) -> Iterator[Block]:
        """The messages of some topics, a bounded number at a time."""
        wanted = [self._connections[number] for number in channels if number in self._connections]
        batch: list[tuple[int, int, bytes]] = []
        time_ns: Any
        data: Any  # whatever a damaged database holds
        try:
            for connection, time_ns, data in self._reader.messages(wanted) if wanted else ():
                if not isinstance(time_ns, int) or not isinstance(data, (bytes, bytearray, memoryview)):
                    self._problem(f"{connection.topic}: a row whose time or data is of another kind is skipped")
                    continue
                batch.append((connection.id, time_ns, bytes(data)))
                if len(batch) == BLOCK_MESSAGES:
                    yield _block(batch)
                    batch = []
        except Exception as error:  # as above
            self._problem(f"reading stopped ({_text(error)})")
        if batch:
            yield _block(batch)

    def _problem(self, text: str) -> None:
        problem = Problem(text, self.path.name)
        if problem not in self.problems:
            self.problems.append(problem)


def _text(error: Exception) -> str:
    """The words of a library on one line."""
    return " ".join(f"{type(error).__name__}: {error}".split())


def _block(batch: list[tuple[int, int, bytes]]) -> Block:
    lengths = np.array([len(data) for _, _, data in batch], np.int64)
    times = np.array([time_ns for _, time_ns, _ in batch], np.int64)
    offsets = np.concatenate([[0], np.cumsum(lengths)[:-1]]).astype(np.int64)
    channel = np.array([number for number, _, _ in batch], np.int64)
    data = b"".join(payload for _, _, payload in batch)
    return Block(data, channel, np.zeros_like(channel), times, times, offsets, lengths)
