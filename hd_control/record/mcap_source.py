"""One MCAP file, opened read-only: everything whole in it, and a list of what is not.

The file is walked once from the front, so an unfinished or cut file gives its whole prefix. Behind damage the walk goes
on where a chain of records begins again; chunks that the index at the end names and the walk did not meet are read too.
"""

from __future__ import annotations

import zlib
from collections import Counter
from collections.abc import Collection, Iterator
from pathlib import Path
from typing import Any

import mcap.records as records
import numpy as np
from mcap.opcode import Opcode

from hd_control.core.arrays import IntArray
from hd_control.core.errors import BagError
from hd_control.record.block import Block, scan_some, scanned_block, scans
from hd_control.record.chunks import ChunkError, ChunkPlace, chunk_data, chunk_place
from hd_control.record.fixed_cdr import Buffer
from hd_control.record.mapped_file import MappedFile
from hd_control.record.mcap_end import parse_record, read_end
from hd_control.record.mcap_file import MAGIC
from hd_control.record.problems import Problem
from hd_control.record.resync import Resync

MAX_PROBLEMS = 100
"""So many are told one by one; a file with more of them is told as a number."""
MAX_DESCRIPTIONS = 20_000
"""Schemas, channels, metadata and attachments of one file; no recording has so many, a made file may."""
_DESCRIPTIONS = {Opcode.SCHEMA, Opcode.CHANNEL, Opcode.ATTACHMENT, Opcode.METADATA}


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
        self._chunks_met: set[int] = set()
        self._sure = len(MAGIC)  # up to here no length can have been wrong
        self._descriptions = 0
        self._told: set[Problem] = set()
        self._untold = 0
        self._data_end: tuple[int, int] | None = None
        self._file = MappedFile(path)
        self._buffer = self._file.buffer
        if bytes(self._buffer[:8]) != MAGIC:
            raise BagError(f"{path}: does not begin like an MCAP file; give a bag folder, an .mcap or a .db3 file")
        self._end = read_end(self._buffer)
        self._walk()

    def definition(self, channel: int) -> str:
        """The message definition text of a channel; empty if the file has none."""
        known = self._channels.get(channel)
        schema = self._schemas.get(known.schema_id) if known else None
        return schema.data.decode("utf-8", "replace") if schema else ""

    def description(self, channel: int) -> tuple[str, bytes, dict[str, str], str]:
        """(schema encoding, definition, channel metadata, message encoding), for copying."""
        known = self._channels[channel]
        schema = self._schemas.get(known.schema_id)
        encoding, data = (schema.encoding, schema.data) if schema else ("", b"")
        return encoding, data, dict(known.metadata), known.message_encoding

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
            parts = self._chunk_blocks(piece) if isinstance(piece, ChunkPlace) else [self._plain_block(piece)]
            for block in parts:
                yield block if present <= wanted else block.select(np.isin(block.channel, list(wanted)))
            self._file.release()

    def _plain_block(self, at: int) -> Block:
        return scanned_block(self._buffer, scan_some(self._buffer, at))

    def _chunk_blocks(self, place: ChunkPlace) -> Iterator[Block]:
        """The messages of a chunk, which was found whole before."""
        try:
            data = chunk_data(self._buffer, place)
        except ChunkError as error:
            self._problem(str(error), place.record_offset)
            return
        yield from (scanned_block(data, found) for found in scans(data))

    def _walk(self) -> None:
        """Takes every record in order; behind damage it goes on where records begin again."""
        end = self._end
        self.expected = end.counts
        at: int | None = len(MAGIC)
        resync = Resync(self._buffer)
        while at is not None:
            found = self._walk_from(at)
            stop = found["stop"]
            if found["footer"]:
                self._check_end(stop)
                break
            again = resync.next_record(self._sure, self.topics.keys()) if found["reason"] else None
            missing = max(0, (len(self._buffer) if again is None else again) - stop)
            reason = found["reason"] or "no footer: the recording was not closed"
            self._problem(f"{reason}; {missing} of {len(self._buffer)} bytes from here on are not readable", stop)
            at = again
        if end.damaged_at >= 0:
            self._problem("the index at the end is damaged (checksum)", end.damaged_at, loses_data=False)
        self._add_indexed([index.chunk_start_offset for index in end.chunks])
        self._compare_counts()
        if self._untold:
            self.problems.append(Problem(f"{self._untold} more of such problems", self.path.name))

    def _walk_from(self, at: int) -> dict[str, Any]:
        """Takes the records from one place on up to the first one that cannot be read, or the footer."""
        while True:
            found = scan_some(self._buffer, at)
            self._take_others(found, self._buffer)
            if len(found["channel"]):
                self.checksums = False
                self._add_messages(at, _count(found["channel"]), at)
                self._sure = max(self._sure, int(found["offset"][-1]))
            self._file.release()
            at = found["stop"]
            if not found["limit"]:
                return found

    def _check_end(self, at: int) -> None:
        self.closed = bytes(self._buffer[at : at + 8]) == MAGIC
        if not self.closed:
            self._problem("the closing magic is damaged", at)
        self._check_data()

    def _take_others(self, found: dict[str, Any], buffer: Buffer) -> None:
        for opcode, offset, length in zip(
            found["other_opcode"].tolist(), found["other_offset"].tolist(), found["other_length"].tolist(), strict=True
        ):
            if opcode in _DESCRIPTIONS and not self._has_room():
                continue
            if opcode == Opcode.SCHEMA:
                schema = self._parse(records.Schema, offset, length, buffer)
                if schema is not None and (schema.id not in self._schemas or self._end.verified):
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

    def _has_room(self) -> bool:
        """Counts one more description; False beyond the cap, which is said."""
        self._descriptions += 1
        if self._descriptions > MAX_DESCRIPTIONS:
            self._problem(f"more than {MAX_DESCRIPTIONS} descriptions; the rest is not read")
        return self._descriptions <= MAX_DESCRIPTIONS

    def _add_channel(self, channel: records.Channel | None) -> None:
        if channel is None or (channel.id in self._channels and not self._end.verified):
            return  # the copy at the end counts only if its checksum is right
        if channel.message_encoding != "cdr":
            self._problem(f"{channel.topic}: encoding {channel.message_encoding!r} is not read, only cdr")
        schema = self._schemas.get(channel.schema_id)
        self.topics[channel.id] = channel.topic
        self.types[channel.id] = schema.name if schema else ""
        self._channels[channel.id] = channel

    def _add_chunk(self, offset: int, length: int) -> None:
        if offset - 9 in self._chunks_met:
            return
        self._chunks_met.add(offset - 9)
        try:
            place = chunk_place(self._buffer, offset, length)
            data = chunk_data(self._buffer, place)
        except ChunkError as error:
            self._problem(f"{error}; {length} bytes skipped", offset)
            return
        self._sure = max(self._sure, offset + length)
        messages: Counter[int] = Counter()
        for found in scans(data):
            self._take_others(found, data)
            messages.update(_count(found["channel"]))
            if found["reason"]:
                self._problem(f"inside a chunk: {found['reason']}", offset)
        if not place.crc:
            self.checksums = False
        self._add_messages(place, messages, offset)
        self._file.release()

    def _add_messages(self, piece: int | ChunkPlace, messages: Counter[int], offset: int) -> None:
        self.counts.update(messages)
        self._pieces.append((piece, frozenset(messages)))
        for number, count in sorted(messages.items()):
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

    def _check_data(self) -> None:
        if self._data_end is None:
            self._problem("the data section has no end record")
        elif self._data_end[1]:
            end, crc = self._data_end
            if self._file.crc32(end) == crc:
                self.checksums = True
            else:
                self._problem("the checksum of the data section is wrong: some values may be damaged")

    def _add_indexed(self, starts: Collection[int]) -> None:
        """Chunks that the index names and the walk did not meet."""
        for start in sorted(set(starts) - self._chunks_met):
            if 0 < start < len(self._buffer) - 9 and self._buffer[start] == Opcode.CHUNK:
                length = int.from_bytes(self._buffer[start + 1 : start + 9], "little")
                if length <= len(self._buffer) - start - 9:
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
            return parse_record(kind, buffer, offset, length)
        except ValueError as error:
            self._problem(str(error), offset)
            return None

    def _problem(self, text: str, offset: int = -1, loses_data: bool = True) -> None:
        problem = Problem(text, self.path.name, offset, loses_data)
        if problem in self._told:
            return
        if len(self._told) >= MAX_PROBLEMS:
            self._untold += 1
            return
        self._told.add(problem)
        self.problems.append(problem)


def _count(channels: IntArray) -> Counter[int]:
    """Messages by channel."""
    numbers, counts = np.unique(channels, return_counts=True)
    return Counter(dict(zip(numbers.tolist(), counts.tolist(), strict=True)))
