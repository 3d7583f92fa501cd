"""Reads bags: a rosbag2 directory, a bare .mcap or a .db3 file; whole, cut or damaged.

    bag = BagReader(path)
    bag.topics, bag.counts, bag.problems
    encoder = bag.columns("encoder")          # encoder.position is (n, joints)

The original is opened read-only. Only BagError leaves this module; what cannot be read is said in `problems`.
"""

from __future__ import annotations

import json
from collections.abc import Iterator, Sequence
from dataclasses import replace
from functools import lru_cache
from pathlib import Path
from typing import Any

from hd_control.core.errors import BagError, ConfigError
from hd_control.core.faults import FaultCode
from hd_control.core.topics import base_name
from hd_control.record import bag_folder
from hd_control.record.block import Block, Gap, Problem, find_gaps, streams_of
from hd_control.record.cdr import typestore
from hd_control.record.columns import Columns, decode
from hd_control.record.db3_source import Db3Source
from hd_control.record.mcap_read import McapSource
from hd_control.record.writer import ACCOUNTING, RECOVERY

Source = McapSource | Db3Source


class BagReader:
    """An open recording. `problems` lists what is missing; `complete` is False if any of it loses data.

    `damage` are the problems of the files themselves, found at opening: without what a recovered recording says that
    its original had lost.
    """

    def __init__(self, path: str | Path) -> None:
        """Opens and walks the whole recording once. Raises BagError if there is nothing that can be read."""
        self.path = Path(path)
        self.problems: list[Problem] = []
        files, self._index = _files_of(self.path, self.problems)
        self._sources: list[Source] = [_open_source(file) for file in files]
        self.topics: dict[str, str] = {}
        self.counts: dict[str, int] = {}
        self.metadata: dict[str, dict[str, str]] = {}
        for source in self._sources:
            self._add(source)
        self._compare_with_index()
        self.damage = tuple(self.problems)
        self._note_recovery()

    def _add(self, source: Source) -> None:
        self.problems.extend(source.problems)
        for channel, topic in source.topics.items():
            type_name = source.types[channel]
            if self.topics.setdefault(topic, type_name) != type_name:
                text = f"{topic}: has two types, {self.topics[topic]} and {type_name}; the second is not read"
                self.problems.append(Problem(text, code=FaultCode.BAG_FOREIGN))
                continue
            self.counts[topic] = self.counts.get(topic, 0) + source.counts.get(channel, 0)
        self.metadata.update(source.metadata)
        if not source.checksums:
            self.problems.append(Problem("not protected by checksums", source.path.name, loses_data=False))

    def _compare_with_index(self) -> None:
        if self._index is None:
            return
        for topic in sorted(set(self._index.counts) | set(self.counts)):
            want, have = self._index.counts.get(topic, 0), self.counts.get(topic, 0)
            if want != have:
                self.problems.append(Problem(f"{topic}: metadata.yaml states {want} messages, {have} are readable"))

    def _note_recovery(self) -> None:
        """A recovered recording is whole as a file, and still without what could not be recovered."""
        recovery = self.metadata.get(RECOVERY)
        if recovery is None:
            return
        try:
            lost = [str(text) for text in json.loads(recovery.get("lost", "[]"))]
        except (ValueError, TypeError, RecursionError):
            lost = ["what was lost is not readable"]
        name = recovery.get("source", "another recording")
        self.problems.append(Problem(f"recovered from {name}", loses_data=False))
        self.problems.extend(Problem(f"lost before the recovery: {text}") for text in lost)

    @property
    def complete(self) -> bool:
        """True if nothing is known to be missing."""
        return not any(problem.loses_data for problem in self.problems)

    @property
    def expected(self) -> dict[str, int]:
        """Messages by topic that the file's statistics or metadata.yaml promise; empty if it was never closed."""
        found = dict(self._index.counts) if self._index else {}
        for topic in self.topics:
            stated = [s.expected.get(c, 0) for s in self._sources if s.expected for c in _channels(s, topic)]
            found[topic] = max(sum(stated), found.get(topic, 0))
        return {topic: count for topic, count in found.items() if count}

    @property
    def sources(self) -> Sequence[Source]:
        """The storage files, in order."""
        return tuple(self._sources)

    @property
    def attachments(self) -> dict[str, bytes]:
        """The files carried inside the recording."""
        return {
            name: bytes(record.data)
            for source in self._sources
            for name, record in source.attachment_records().items()
            if record is not None
        }

    @property
    def accounting(self) -> dict[str, dict[str, Any]]:
        """The recorder's counts by topic (received, written, gaps, drops …); empty if it did not store any."""
        found = {}
        for topic, text in self.metadata.get(ACCOUNTING, {}).items():
            try:
                found[topic] = dict(json.loads(text))
            except (ValueError, TypeError):
                continue
        return found

    def resolve(self, topic: str) -> str:
        """The recorded name of a topic: itself, with a slash, or the only one of that name in a namespace.

        Raises BagError if there is none or more than one.
        """
        for name in (topic, "/" + topic.strip("/")):
            if name in self.topics:
                return name
        found = [name for name in self.topics if base_name(name) == topic.strip("/")]
        if len(found) == 1:
            return found[0]
        known = ", ".join(sorted(self.topics)) or "no topic"
        what = f"is ambiguous ({', '.join(sorted(found))})" if found else "is not recorded"
        raise BagError(f"{self.path}: topic {topic!r} {what}; there is {known}")

    def has(self, topic: str) -> bool:
        """True if the topic is recorded with at least one message."""
        try:
            return self.counts[self.resolve(topic)] > 0
        except BagError:
            return False

    def columns(self, topic: str) -> Columns:
        """All messages of a topic as arrays. Raises BagError if its type has no numbers of fixed layout."""
        name = self.resolve(topic)
        found = decode(name, self.topics[name], self._blocks(name))
        if found is None:
            raise BagError(f"{name}: {self.topics[name]} has no columns; use messages()")
        if found.undecodable:
            self._note(Problem(f"{name}: {found.undecodable} messages do not fit {self.topics[name]}"))
        return replace(found, names=self._value_names(name, found.names))

    def column_blocks(self, topic: str) -> Iterator[Columns]:
        """Like `columns`, some ten thousand messages at a time: for topics that are too long for the memory."""
        name = self.resolve(topic)
        undecodable = 0
        for block in self._blocks(name):
            found = decode(name, self.topics[name], [block])
            if found is None:
                raise BagError(f"{name}: {self.topics[name]} has no columns; use messages()")
            undecodable += found.undecodable
            yield found
        if undecodable:
            self._note(Problem(f"{name}: {undecodable} messages do not fit {self.topics[name]}"))

    def _value_names(self, topic: str, names: tuple[str, ...]) -> tuple[str, ...]:
        """The names of introspection values, from the topic beside them; the numbers if they do not fit."""
        beside = topic.removesuffix("/values") + "/names"
        if not topic.endswith("/introspection/values") or not self.has(beside):
            return names
        texts = [str(message.data).split("\n") for _, message in self.messages(beside)]
        return next((tuple(text) for text in reversed(texts) if len(text) == len(names)), names)

    def raw(self, topic: str) -> Iterator[tuple[int, bytes]]:
        """(log_time_ns, CDR bytes) of each message, in recorded order."""
        for block in self._blocks(self.resolve(topic)):
            yield from zip(block.log_time_ns.tolist(), block.payloads(), strict=True)

    def messages(self, topic: str) -> Iterator[tuple[int, Any]]:
        """(log_time_ns, message object) of each message, decoded by rosbags. Bytes that do not fit become a problem.

        Raises BagError for a type that neither ROS 2 Jazzy nor the bag itself defines.
        """
        name = self.resolve(topic)
        deserialize = self._deserializer(name)
        for time_ns, payload in self.raw(name):
            try:
                message = deserialize(payload)
            except Exception as error:  # the library leaks struct.error, UnicodeDecodeError, …
                self._note(Problem(f"{name}: a message does not fit {self.topics[name]} ({type(error).__name__})"))
                continue
            yield time_ns, message

    def gaps(self, topic: str, period_ns: int) -> list[Gap]:
        """The holes in the stamps of a topic whose samples are `period_ns` apart."""
        columns = self.columns(topic)
        return find_gaps(columns.stamps_ns, streams_of(columns.frame_ids), period_ns)

    def close(self) -> None:
        """Releases the files."""
        for source in self._sources:
            source.close()

    def __enter__(self) -> BagReader:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def _blocks(self, name: str) -> Iterator[Block]:
        for source in self._sources:
            numbers = [c for c in _channels(source, name) if source.types[c] == self.topics[name]]
            yield from source.blocks(numbers)
            self.take_problems(source)

    def take_problems(self, source: Source) -> None:
        """Adds what a source met while its blocks were read."""
        for problem in source.problems:
            self._note(problem)

    def _deserializer(self, name: str) -> Any:
        type_name = self.topics[name]
        texts = [s.definition(c) for s in self._sources for c, topic in s.topics.items() if topic == name]
        try:
            store = typestore() if type_name in typestore().types else _foreign_store(type_name, texts[0])
            store.types[type_name]
        except Exception as error:  # the parser of definitions leaks its own errors
            why = f"type {type_name!r} is not known ({type(error).__name__})"
            raise BagError(FaultCode.BAG_FOREIGN.line(f"{why}; its messages are skipped", name)) from None
        return lambda payload: store.deserialize_cdr(payload, type_name)

    def _note(self, problem: Problem) -> None:
        if problem not in self.problems:
            self.problems.append(problem)


def _channels(source: Source, topic: str) -> list[int]:
    return [channel for channel, name in source.topics.items() if name == topic]


@lru_cache(maxsize=16)
def _foreign_store(type_name: str, definition: str) -> Any:
    from rosbags.typesys import Stores, get_types_from_idl, get_types_from_msg, get_typestore

    store = get_typestore(Stores.ROS2_JAZZY)
    parse = get_types_from_idl if definition.startswith("=" * 80 + "\nIDL:") else None
    store.register(parse(definition) if parse else get_types_from_msg(definition, type_name))
    return store


def _open_source(path: Path) -> Source:
    return Db3Source(path) if path.suffix == ".db3" else McapSource(path)


def _files_of(path: Path, problems: list[Problem]) -> tuple[list[Path], bag_folder.BagIndex | None]:
    """The storage files of a bag and what its metadata.yaml says."""
    if not path.exists():
        raise BagError(f"{path}: no such bag; check the path")
    if not path.is_dir():
        return [path], None
    present = sorted(p for pattern in ("*.mcap", "*.db3") for p in path.glob(pattern) if p.is_file())
    if not present:
        raise BagError(f"{path}: no .mcap or .db3 file in this folder; give the folder of a bag")
    try:
        index = bag_folder.load(path / bag_folder.FILE_NAME)
    except ConfigError as error:
        problems.append(Problem(f"no usable metadata.yaml, the files are read directly ({error})"))
        return present, None
    files = []
    for name in index.files:
        if (path / name).is_file():
            files.append(path / name)
        else:
            problems.append(Problem(f"{name}: named in metadata.yaml but missing"))
    for extra in present:
        if extra not in files:
            problems.append(Problem(f"{extra.name}: not named in metadata.yaml, not read", loses_data=bool(not files)))
    return (files, index) if files else (present, None)
