"""Rewrites what is readable of a cut or damaged recording as a new, whole one, and says what is lost.

    report = recover("bags/killed", "bags/killed_recovered")
    report.lost, report.problems

The original is only read. The new bag is re-read and compared before it appears; it lists what is missing.
"""

from __future__ import annotations

import hashlib
import json
import os
from collections.abc import Callable, Collection
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

from hd_control.core.errors import BagError
from hd_control.core.topics import topic_info
from hd_control.record import bag_folder
from hd_control.record.bag_folder import whole_bag, write_error
from hd_control.record.block import Block
from hd_control.record.mcap_write import McapFile, block_records, parts
from hd_control.record.reader import BagReader, Source
from hd_control.record.schema import message_definition, type_hash
from hd_control.record.writer import ACCOUNTING, CHUNK_BYTES, RECOVERY

Step = Callable[[float], None]


@dataclass
class TopicReport:
    """One topic: messages copied, messages that must have been there (None: not known), last log time [ns]."""

    type_name: str
    kept: int = 0
    expected: int | None = None
    last_ns: int = 0

    @property
    def lost(self) -> int | None:
        """Messages known to be missing; None if nothing says how many there were."""
        return None if self.expected is None else max(0, self.expected - self.kept)


@dataclass
class RecoveryReport:
    """What was copied and what was not. `problems` that lose data are the words of the reader."""

    source: str
    target: str
    topics: dict[str, TopicReport] = field(default_factory=dict)
    problems: list[str] = field(default_factory=list)
    notices: list[str] = field(default_factory=list)

    @property
    def complete(self) -> bool:
        """True if nothing is known to be missing."""
        return not self.problems

    def document(self) -> dict[str, Any]:
        """Plain data: the report, each topic with its `lost`."""
        topics = {name: {**asdict(row), "lost": row.lost} for name, row in self.topics.items()}
        return {**asdict(self), "topics": topics, "complete": self.complete}


class _Copy:
    """The new file: channels by topic, chunks of one topic each, a digest of what was written."""

    def __init__(self, file: McapFile) -> None:
        self.file = file
        self.numbers: dict[str, int] = {}
        self.digests: dict[str, Any] = {}
        self._schemas: dict[tuple[str, str, bytes], int] = {}

    def channel(self, source: Source, number: int) -> int:
        """The channel of the new file for one of the source, made when it is first seen."""
        topic, type_name = source.topics[number], source.types[number]
        if topic not in self.numbers:
            encoding, definition, metadata, form = source.description(number)
            if not definition and type_name:
                encoding, definition = "ros2msg", _definition(type_name)
            key = (type_name, encoding, definition)
            if type_name and key not in self._schemas:
                self._schemas[key] = self.file.add_schema(type_name, definition, encoding)
            self.numbers[topic] = self.file.add_channel(topic, self._schemas.get(key, 0), metadata, form)
            self.digests[topic] = hashlib.sha256()
        return self.numbers[topic]

    def add(self, topic: str, block: Block) -> None:
        """Messages of one topic, in chunks of bounded size."""
        for part in parts(block, CHUNK_BYTES):
            data, places = block_records(part, self.numbers[topic])
            self.digests[topic].update(data)
            self.file.add_chunk(self.numbers[topic], data, part.log_time_ns, places)


def recover(
    path: str | Path, target: str | Path, force: bool = False, step: Step = lambda share: None
) -> RecoveryReport:
    """Copies every whole message of `path` into a new bag at `target`; `step` is called with the share done.

    Raises BagError if nothing can be read, if `target` exists (with `force`: if what is there is no bag or is the
    original), if the disk refuses, or if the new bag, read again, differs from what was copied.
    """
    path, target = Path(path), Path(target)
    _keep_apart(path, target)
    with BagReader(path) as bag, whole_bag(target, force) as place:
        place.mkdir()
        file_path = place / f"{target.name}_0.mcap"
        report = RecoveryReport(str(path), str(target))
        try:
            with file_path.open("xb", buffering=0) as raw:
                copy = _Copy(McapFile(raw))
                _copy_messages(bag, copy, report, step)
                _finish(bag, copy, report)
                os.fsync(raw.fileno())
            _write_yaml(place, file_path, bag, copy, report)
        except OSError as error:
            raise write_error(target, error) from None
        _compare(place, copy, target, {problem.text for problem in bag.damage})
    return report


def _keep_apart(path: Path, target: Path) -> None:
    """The new bag is never the old one, in it or around it, by whatever name."""
    old, new = path.resolve(), target.resolve()
    if old == new or old in new.parents or new in old.parents:
        raise BagError(f"{target}: is the recording itself; the original is never changed, choose another name")


def _copy_messages(bag: BagReader, copy: _Copy, report: RecoveryReport, step: Step) -> None:
    total, done = max(1, sum(bag.counts.values())), 0
    for source in bag.sources:
        numbers = [number for number, topic in source.topics.items() if bag.topics[topic] == source.types[number]]
        for number in numbers:
            copy.channel(source, number)
        for block in source.blocks(numbers):
            for number in np.unique(block.channel).tolist():
                topic, part = source.topics[number], block.select(block.channel == number)
                copy.add(topic, part)
                row = report.topics.setdefault(topic, TopicReport(source.types[number]))
                row.kept += len(part.channel)
                row.last_ns = max(row.last_ns, int(part.log_time_ns.max()))
            done += len(block.channel)
            step(min(1.0, done / total))
        bag.take_problems(source)


def _finish(bag: BagReader, copy: _Copy, report: RecoveryReport) -> None:
    """Texts, files and what is lost, carried inside the new file."""
    for topic, count in bag.expected.items():
        row = report.topics.setdefault(topic, TopicReport(bag.topics.get(topic, "")))
        row.expected = count
    report.problems = [str(problem) for problem in bag.problems if problem.loses_data]
    report.notices = [str(problem) for problem in bag.problems if not problem.loses_data]
    for name, values in bag.metadata.items():
        copy.file.add_metadata(name, dict(values))
    for source in bag.sources:
        for name, record in source.attachment_records().items():
            if record is not None:
                copy.file.add_attachment(name, record.media_type, record.data, record.log_time)
    lost = [problem.finding for problem in bag.problems if problem.loses_data]
    copy.file.add_metadata(RECOVERY, {"source": bag.path.name, "lost": json.dumps(lost)})
    copy.file.finish()


def _write_yaml(place: Path, file_path: Path, bag: BagReader, copy: _Copy, report: RecoveryReport) -> None:
    entries = []
    for topic in copy.numbers:
        known, type_name = topic_info(topic), bag.topics[topic]
        kept = report.topics[topic].kept if topic in report.topics else 0
        entries.append(
            bag_folder.TopicEntry(topic, type_name, type_hash(type_name), kept, bool(known and known.latched))
        )
    custom = {"close_reason": "recovered", ACCOUNTING: json.dumps(bag.accounting)}
    info = bag_folder.document(file_path.name, entries, copy.file.first_ns, copy.file.last_ns, custom)
    bag_folder.save(place, info)


def _compare(place: Path, copy: _Copy, target: Path, known: Collection[str]) -> None:
    """Reads the new bag; raises BagError unless it holds exactly what was copied and has no problem of its own."""
    with BagReader(place) as bag:
        found = {topic: hashlib.sha256() for topic in bag.topics}
        for source in bag.sources:
            for block in source.blocks(list(source.topics)):
                for number in np.unique(block.channel).tolist():
                    for part in parts(block.select(block.channel == number), CHUNK_BYTES):
                        found[source.topics[number]].update(block_records(part, number)[0])
        new = [problem for problem in bag.damage if problem.loses_data and problem.text not in known]
        same = {t: d.hexdigest() for t, d in found.items()} == {t: d.hexdigest() for t, d in copy.digests.items()}
        if new or not same:
            why = new[0] if new else "its messages are not those that were copied"
            raise BagError(f"{target}: the new bag is not right ({why}) and was removed; the original is as it was")


def _definition(type_name: str) -> bytes:
    try:
        return message_definition(type_name).encode("utf-8")
    except BagError:  # a foreign type without definition: copied as it is, without one
        return b""
