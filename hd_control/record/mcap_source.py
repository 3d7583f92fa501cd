"""One MCAP file, opened read-only: everything whole in it, and a list of what is not.

The file is walked once from the front, so an unfinished or cut file gives its whole prefix. If the walk meets damage
and the index at the end is intact, the chunks behind the damage are read through the index.
"""

from __future__ import annotations

import mmap
import zlib
from collections import Counter
from collections.abc import Collection, Iterator
from dataclasses import dataclass
from io import BytesIO
from pathlib import Path
from typing import Any

import mcap.records as records
import numpy as np
from mcap.data_stream import ReadDataStream
from mcap.opcode import Opcode

from hd_control import _records
from hd_control.core.errors import BagError
from hd_control.record.chunks import ChunkError, ChunkPlace, chunk_data, chunk_place
from hd_control.record.fixed_cdr import Buffer, IntArray
from hd_control.record.mcap_file import MAGIC
from hd_control.record.problems import RECORD_CAP, Problem

BLOCK_MESSAGES = 1 << 16


@dataclass(frozen=True)
class Block:
    """Messages found in one buffer: parallel arrays (n,); `offset` and `length` are those of the payloads."""

    buffer: Buffer
    channel: IntArray
    sequence: IntArray
    log_time_ns: IntArray
    publish_time_ns: IntArray
    offset: IntArray
    length: IntArray

    def select(self, where: Any) -> Block:
        """The messages at an index or mask."""
        return Block(
            self.buffer,
            self.channel[where],
            self.sequence[where],
            self.log_time_ns[where],
            self.publish_time_ns[where],
            self.offset[where],
            self.length[where],
        )

    def payloads(self) -> Iterator[bytes]:
        """The bytes of each message."""
        for at, length in zip(self.offset.tolist(), self.length.tolist(), strict=True):
            yield bytes(self.buffer[at : at + length])


def _block(buffer: Buffer, found: dict[str, Any]) -> Block:
    return Block(
        buffer,
        found["channel"],
        found["sequence"],
        found["log_time"],
        found["publish_time"],
        found["offset"],
        found["length"],
    )


class McapSource:
    """Channels, counts, attachments, metadata and message blocks of one file; `problems` says what is not readable."""

    def __init__(self, path: Path) -> None:
        """Raises BagError if there is no such file, it is empty, or it is no MCAP file at all."""
        self.path = path
        self.problems: list[Problem] = []
        self.topics: dict[int, str] = {}
        self.types: dict[int, str] = {}
        self.counts: Counter[int] = Counter()
        self.metadata: dict[str, dict[str, str]] = {}
        self.closed, self.checksums = False, True
        self.expected: dict[int, int] | None = None
        self._schemas: dict[int, records.Schema] = {}
        self._channels: dict[int, records.Channel] = {}
        self._attachments: dict[str, tuple[int, int]] = {}
        self._pieces: list[tuple[int | ChunkPlace, frozenset[int]]] = []
        self._chunk_indexes: list[records.ChunkIndex] = []
        self._data_end: tuple[int, int] | None = None
        self._buffer = _open(path)
        self._walk()

    def definition(self, channel: int) -> str:
        """The message definition text of a channel; empty if the file has none."""
        known = self._channels.get(channel)
        schema = self._schemas.get(known.schema_id) if known else None
        return schema.data.decode("utf-8", "replace") if schema else ""

    def schema_records(self) -> list[records.Schema]:
        """The schemas by number."""
        return [self._schemas[number] for number in sorted(self._schemas)]

    def channel_records(self) -> list[records.Channel]:
        """The channels by number."""
        return [self._channels[number] for number in sorted(self._channels)]

    def attachment_records(self) -> dict[str, records.Attachment]:
        """The attached files by name; read from the file now."""
        return {
            name: self._parse(records.Attachment, offset, length, self._buffer)
            for name, (offset, length) in self._attachments.items()
        }

    def close(self) -> None:
        """Nothing to do: the mapping goes with the last array that needs it."""

    def blocks(self, channels: Collection[int]) -> Iterator[Block]:
        """The messages of some channels, in file order, a bounded number at a time."""
        wanted = set(channels)
        for piece, present in self._pieces:
            if not wanted & present:
                continue
            if isinstance(piece, ChunkPlace):
                block = self._chunk_block(piece)
            else:
                block = _block(self._buffer, _records.scan(self._buffer, piece, RECORD_CAP, BLOCK_MESSAGES))
            if block is not None:
                yield block if present <= wanted else block.select(np.isin(block.channel, list(wanted)))

    def _chunk_block(self, place: ChunkPlace) -> Block | None:
        try:
            data = chunk_data(self._buffer, place)
        except ChunkError as error:
            self._problem(str(error), place.record_offset)
            return None
        return _block(data, _records.scan(data, 0, RECORD_CAP, 1 << 30))

    def _walk(self) -> None:
        size, at = len(self._buffer), len(MAGIC)
        while True:
            found = _records.scan(self._buffer, at, RECORD_CAP, BLOCK_MESSAGES)
            self._take_others(found, self._buffer)
            if len(found["channel"]):
                self.checksums = False
                self._add_messages(at, found["channel"], at)
            at = found["stop"]
            if not found["limit"]:
                break
        self._read_end(size)
        if found["footer"]:
            self.closed = bytes(self._buffer[at : at + 8]) == MAGIC
            if not self.closed:
                self._problem("the closing magic is damaged", at)
            self._check_data()
        else:
            reason = found["reason"] or "no footer: the recording was not closed"
            self._problem(f"{reason}; the last {size - at} of {size} bytes are not readable in order", at)
            self._continue_behind(at)
        self._compare_counts()

    def _take_others(self, found: dict[str, Any], buffer: Buffer) -> None:
        for opcode, offset, length in zip(
            found["other_opcode"].tolist(), found["other_offset"].tolist(), found["other_length"].tolist(), strict=True
        ):
            if opcode == Opcode.SCHEMA:
                if (schema := self._parse(records.Schema, offset, length, buffer)) is not None:
                    self._schemas[schema.id] = schema
            elif opcode == Opcode.CHANNEL:
                self._add_channel(self._parse(records.Channel, offset, length, buffer))
            elif opcode == Opcode.CHUNK and buffer is self._buffer:
                self._add_chunk(offset, length)
            elif opcode == Opcode.ATTACHMENT and buffer is self._buffer:
                self._add_attachment(offset, length)
            elif opcode == Opcode.METADATA:
                if (metadata := self._parse(records.Metadata, offset, length, buffer)) is not None:
                    self.metadata[metadata.name] = dict(metadata.metadata)
            elif opcode == Opcode.DATA_END and length == 4:
                self._data_end = (offset - 9, int.from_bytes(buffer[offset : offset + 4], "little"))

    def _add_channel(self, channel: records.Channel | None) -> None:
        if channel is None:
            return
        if channel.message_encoding != "cdr":
            self._problem(f"{channel.topic}: encoding {channel.message_encoding!r} is not read, only cdr")
        schema = self._schemas.get(channel.schema_id)
        self.topics[channel.id] = channel.topic
        self.types[channel.id] = schema.name if schema else ""
        self._channels[channel.id] = channel

    def _add_chunk(self, offset: int, length: int) -> None:
        try:
            place = chunk_place(self._buffer, offset, length)
            data = chunk_data(self._buffer, place)
        except ChunkError as error:
            self._problem(f"{error}; {length} bytes skipped", offset)
            return
        found = _records.scan(data, 0, RECORD_CAP, 1 << 30)
        if found["reason"]:
            self._problem(f"inside a chunk: {found['reason']}", offset)
        if not place.crc:
            self.checksums = False
        self._take_others(found, data)
        self._add_messages(place, found["channel"], offset)

    def _add_messages(self, piece: int | ChunkPlace, channels: IntArray, offset: int) -> None:
        numbers, counts = np.unique(channels, return_counts=True)
        self.counts.update(dict(zip(numbers.tolist(), counts.tolist(), strict=True)))
        self._pieces.append((piece, frozenset(numbers.tolist())))
        for number, count in zip(numbers.tolist(), counts.tolist(), strict=True):
            if number not in self.topics:
                self._problem(f"{count} messages of channel {number}, which the file does not describe", offset)

    def _add_attachment(self, offset: int, length: int) -> None:
        content = bytes(self._buffer[offset : offset + length])
        crc = int.from_bytes(content[-4:], "little")
        record = self._parse(records.Attachment, offset, length, self._buffer)
        if record is None:
            return
        if crc and zlib.crc32(content[:-4]) != crc:
            self._problem(f"attachment {record.name!r}: checksum is wrong", offset)
            return
        self._attachments[record.name] = (offset, length)

    def _read_end(self, size: int) -> None:
        """Statistics and chunk index from the summary, if the footer at the very end is whole."""
        if size < 45 or bytes(self._buffer[size - 8 : size]) != MAGIC or self._buffer[size - 37] != Opcode.FOOTER:
            return
        start = int.from_bytes(self._buffer[size - 28 : size - 20], "little")
        crc = int.from_bytes(self._buffer[size - 12 : size - 8], "little")
        if not len(MAGIC) <= start <= size - 37:
            return
        if crc and zlib.crc32(self._buffer[start : size - 12]) != crc:
            self._problem("the index at the end is damaged (checksum)", start, loses_data=False)
            return
        found = _records.scan(self._buffer, start, RECORD_CAP, 1)
        for opcode, offset, length in zip(
            found["other_opcode"].tolist(), found["other_offset"].tolist(), found["other_length"].tolist(), strict=True
        ):
            if opcode == Opcode.STATISTICS and (s := self._parse(records.Statistics, offset, length, self._buffer)):
                self.expected = dict(s.channel_message_counts)
            elif opcode == Opcode.CHUNK_INDEX and (c := self._parse(records.ChunkIndex, offset, length, self._buffer)):
                self._chunk_indexes.append(c)

    def _check_data(self) -> None:
        if self._data_end is None:
            self._problem("the data section has no end record")
        elif self._data_end[1]:
            end, crc = self._data_end
            if zlib.crc32(self._buffer[:end]) == crc:
                self.checksums = True
            else:
                self._problem("the checksum of the data section is wrong: some values may be damaged")

    def _continue_behind(self, at: int) -> None:
        for index in self._chunk_indexes:
            start = index.chunk_start_offset
            if at < start <= len(self._buffer) - index.chunk_length and self._buffer[start] == Opcode.CHUNK:
                length = int.from_bytes(self._buffer[start + 1 : start + 9], "little")
                if length == index.chunk_length - 9:
                    self._add_chunk(start + 9, length)

    def _compare_counts(self) -> None:
        if self.expected is None:
            return
        for channel in sorted(set(self.expected) | set(self.counts)):
            want, have = self.expected.get(channel, 0), self.counts.get(channel, 0)
            if want != have:
                name = self.topics.get(channel, f"channel {channel}")
                self._problem(f"{name}: {have} of {want} messages are readable")

    def _parse(self, kind: Any, offset: int, length: int, buffer: Buffer) -> Any:
        try:
            return kind.read(ReadDataStream(BytesIO(bytes(buffer[offset : offset + length]))))
        except Exception as error:  # the library leaks struct.error, UnicodeDecodeError, EndOfFile, …
            self._problem(f"{kind.__name__} record is not readable ({type(error).__name__})", offset)
            return None

    def _problem(self, text: str, offset: int = -1, loses_data: bool = True) -> None:
        problem = Problem(text, self.path.name, offset, loses_data)
        if problem not in self.problems:
            self.problems.append(problem)


def _open(path: Path) -> memoryview:
    try:
        with path.open("rb") as file:
            if file.seek(0, 2) == 0:
                raise BagError(f"{path}: the file is empty; nothing was recorded, record again")
            buffer = memoryview(mmap.mmap(file.fileno(), 0, access=mmap.ACCESS_READ))
    except (OSError, ValueError) as error:
        why = getattr(error, "strerror", None) or error
        raise BagError(f"{path}: cannot be opened ({why}); check path and permission") from None
    if bytes(buffer[:8]) != MAGIC:
        raise BagError(f"{path}: does not begin like an MCAP file; give a bag folder, an .mcap or a .db3 file")
    return buffer
