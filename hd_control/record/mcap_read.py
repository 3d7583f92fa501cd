"""One MCAP file, opened read-only: everything whole in it, and a list of what is not.

The file is walked once from the front, so an unfinished or cut file gives its whole prefix. Behind damage the walk goes
on where a chain of records begins again; chunks that the index at the end names and the walk did not meet are read too.
Parts first, then `McapSource`, which puts them together.
"""

from __future__ import annotations

import contextlib
import mmap
import re
import struct
import zlib
from collections import Counter
from collections.abc import Collection, Iterator
from dataclasses import dataclass, field
from io import BytesIO
from pathlib import Path
from typing import Any

import mcap.records as records
import numpy as np
from mcap.data_stream import ReadDataStream
from mcap.opcode import Opcode

from hd_control import _records
from hd_control.core.arrays import IntArray
from hd_control.core.errors import BagError
from hd_control.core.faults import FaultCode
from hd_control.record.block import EXPANSION_CAP, RECORD_CAP, Block, Problem, scan_some, scanned_block, scans
from hd_control.record.cdr import Buffer
from hd_control.record.mcap_write import MAGIC

# ---- A chunk: uncompressed with every length checked and its CRC compared --------------------------


_CHUNK_HEAD = struct.Struct("<QQQII")


class ChunkError(Exception):
    """A chunk that cannot be trusted; the text says why, `code` whether it is damaged or too large."""

    def __init__(self, text: str, code: FaultCode = FaultCode.BAG_DAMAGED) -> None:
        super().__init__(text)
        self.code = code


@dataclass(frozen=True)
class ChunkPlace:
    """Where the compressed bytes of a chunk lie in the file, and what they must become."""

    record_offset: int
    data_offset: int
    data_length: int
    compression: str
    size: int
    crc: int


def chunk_place(buffer: Buffer, offset: int, length: int) -> ChunkPlace:
    """Reads the head of a chunk record, whose content is `length` bytes at `offset`. Raises ChunkError."""
    if length < _CHUNK_HEAD.size + 8:
        raise ChunkError("chunk record shorter than its head")
    _, _, size, crc, name_length = _CHUNK_HEAD.unpack_from(buffer, offset)
    rest = length - _CHUNK_HEAD.size - 8 - name_length
    if rest < 0 or name_length > 32:
        raise ChunkError("chunk record with an impossible compression name")
    at = offset + _CHUNK_HEAD.size
    name = bytes(buffer[at : at + name_length]).decode("ascii", "replace")
    (data_length,) = struct.unpack_from("<Q", buffer, at + name_length)
    if data_length > rest:
        raise ChunkError("chunk data longer than its record")
    if size > RECORD_CAP:
        raise ChunkError(f"chunk of {size} bytes is above the cap of {RECORD_CAP}", FaultCode.BAG_HUGE)
    if size > EXPANSION_CAP * max(data_length, 1):
        raise ChunkError(f"chunk expands more than {EXPANSION_CAP} times", FaultCode.BAG_HUGE)
    return ChunkPlace(offset, at + name_length + 8, data_length, name, size, crc)


def chunk_data(buffer: Buffer, place: ChunkPlace) -> bytes:
    """The uncompressed records of a chunk. Raises ChunkError for anything but exactly what the head promises."""
    packed = bytes(buffer[place.data_offset : place.data_offset + place.data_length])
    try:
        data = _uncompress(packed, place.compression, place.size)
    except ChunkError:
        raise
    except Exception as error:  # the compressors have error families of their own
        raise ChunkError(f"chunk cannot be uncompressed ({type(error).__name__}: {error})") from None
    if len(data) != place.size:
        raise ChunkError(f"chunk has {len(data)} bytes instead of {place.size}")
    if place.crc and zlib.crc32(data) != place.crc:
        raise ChunkError("chunk checksum is wrong")
    return data


def _uncompress(packed: bytes, compression: str, size: int) -> bytes:
    if compression == "":
        return packed
    if compression == "zstd":
        import zstandard

        stated = zstandard.frame_content_size(packed)
        if stated not in (-1, size):
            raise ChunkError(f"chunk states {stated} bytes inside and {size} outside")
        return bytes(zstandard.ZstdDecompressor().decompress(packed, max_output_size=size)) if size else b""
    if compression == "lz4":
        import lz4.frame

        return bytes(lz4.frame.LZ4FrameDecompressor().decompress(packed, max_length=size + 1))
    raise ChunkError(f"unknown compression {compression!r}")


# ---- The file mapped into memory, for reading only; pages are given back while it is walked through ----


_STEP = 16 << 20


class MappedFile:
    """`buffer` is the whole file. Raises BagError if the file cannot be opened or is empty."""

    def __init__(self, path: Path) -> None:
        try:
            with path.open("rb") as file:
                if file.seek(0, 2) == 0:
                    raise BagError(f"{path}: the file is empty; nothing was recorded, record again")
                self._map = mmap.mmap(file.fileno(), 0, access=mmap.ACCESS_READ)
        except (OSError, ValueError) as error:
            why = getattr(error, "strerror", None) or error
            raise BagError(f"{path}: cannot be opened ({why}); check path and permission") from None
        self.buffer: Buffer = memoryview(self._map)

    def release(self) -> None:
        """Gives the pages that were read back to the system; they come again when they are needed."""
        if hasattr(mmap, "MADV_DONTNEED"):
            with contextlib.suppress(OSError):  # pages of a process that has locked its memory stay
                self._map.madvise(mmap.MADV_DONTNEED)

    def crc32(self, end: int) -> int:
        """CRC of the bytes before `end`."""
        crc = 0
        for start in range(0, end, _STEP):
            crc = zlib.crc32(self.buffer[start : min(end, start + _STEP)], crc)
            self.release()
        return crc


# ---- The summary at the end of a closed file: how many messages there must be, and where the chunks lie ----


_FOOTER_BYTES = 37  # footer record and closing magic


@dataclass
class End:
    """Messages by channel (None: not stated), chunk places, and where the summary begins if its checksum is wrong.

    `verified`: the summary has a checksum, and it is right.
    """

    counts: dict[int, int] | None = None
    chunks: list[records.ChunkIndex] = field(default_factory=list)
    damaged_at: int = -1
    verified: bool = False


def parse_record(kind: Any, buffer: Buffer, offset: int, length: int) -> Any:
    """One record by the `mcap` library, whose many kinds of exception become ValueError."""
    try:
        return kind.read(ReadDataStream(BytesIO(bytes(buffer[offset : offset + length]))))
    except Exception as error:  # struct.error, UnicodeDecodeError, EndOfFile, OverflowError, …
        raise ValueError(f"{kind.__name__} record is not readable ({type(error).__name__})") from None


def read_end(buffer: Buffer) -> End:
    """What the summary says; nothing if the footer at the very end is not whole."""
    size, end = len(buffer), End()
    footer = size - _FOOTER_BYTES
    if footer < len(MAGIC) or bytes(buffer[size - 8 : size]) != MAGIC or buffer[footer] != Opcode.FOOTER:
        return end
    start = int.from_bytes(buffer[footer + 9 : footer + 17], "little")
    crc = int.from_bytes(buffer[size - 12 : size - 8], "little")
    if not len(MAGIC) <= start <= footer:
        return end
    if crc and zlib.crc32(buffer[start : size - 12]) != crc:
        end.damaged_at = start
        return end
    end.verified = crc != 0
    found = _records.scan(buffer, start, RECORD_CAP, 1)
    for opcode, offset, length in zip(
        found["other_opcode"].tolist(), found["other_offset"].tolist(), found["other_length"].tolist(), strict=True
    ):
        try:
            if opcode == Opcode.STATISTICS:
                end.counts = dict(parse_record(records.Statistics, buffer, offset, length).channel_message_counts)
            elif opcode == Opcode.CHUNK_INDEX:
                end.chunks.append(parse_record(records.ChunkIndex, buffer, offset, length))
        except ValueError:  # only without a checksum, or written wrong: the file is then read without this entry
            end.damaged_at = start
    return end


# ---- The place behind damage from which records can be read again ----------------------------------
#
# A record has no mark at its beginning, so a place counts only if a chain of `CHAIN` records starts there, each inside
# the file and of a kind and size that is possible; the first is a message of a known channel, a chunk, or the end.


CHAIN = 4
MAX_CANDIDATES = 100_000
"""Places tried in one file; more than this is no damage but a file made to take long."""
_RECORD_HEAD = struct.Struct("<BQ")
_CONTENT = struct.Struct("<HIQQ")
# opcode of a message, a chunk or the end of the data, then a length below 2^32
_CANDIDATE = re.compile(rb"[\x05\x06\x0f].{4}\x00{4}", re.DOTALL)


class Resync:
    """The search in one file; its total effort is bounded."""

    def __init__(self, buffer: Buffer) -> None:
        self._buffer, self._left, self._next = buffer, MAX_CANDIDATES, 0

    def next_record(self, sure: int, channels: Collection[int]) -> int | None:
        """The first byte at or behind `sure` where a chain of records begins, later each time; None if there is none.

        `sure`: up to here there is no doubt. A record behind it may have had a wrong length, so that the next whole one
        lies inside of what was taken for it.
        """
        self._next = max(self._next, sure)
        while self._left > 0:
            self._left -= 1
            place = _CANDIDATE.search(self._buffer, self._next)
            if place is None:
                return None
            self._next = place.start() + 1
            if _is_chain(self._buffer, place.start(), channels):
                return place.start()
        return None


def _is_chain(buffer: Buffer, at: int, channels: Collection[int]) -> bool:
    """True if `CHAIN` possible records follow each other, or fewer up to the very end of the file behind a footer."""
    for _ in range(CHAIN):
        if at + _RECORD_HEAD.size > len(buffer):
            return False
        opcode, length = _RECORD_HEAD.unpack_from(buffer, at)
        content = at + _RECORD_HEAD.size
        if not 1 <= opcode <= Opcode.DATA_END or length > min(RECORD_CAP, len(buffer) - content):
            return False
        if opcode == Opcode.MESSAGE and not _is_message(buffer, content, length, channels):
            return False
        at = content + length
        if opcode == Opcode.FOOTER:
            return at + 8 == len(buffer)
    return True


def _is_message(buffer: Buffer, content: int, length: int, channels: Collection[int]) -> bool:
    if length < _CONTENT.size:
        return False
    channel, _, log_time, publish_time = _CONTENT.unpack_from(buffer, content)
    return channel in channels and log_time < 1 << 63 and publish_time < 1 << 63


# ---- The file --------------------------------------------------------------------------------------


MAX_PROBLEMS = 100
"""So many are listed one by one; of a file with more of them the rest is a number."""
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
        self._listed: set[Problem] = set()
        self._unlisted = 0
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
            self._problem(str(error), place.record_offset, code=error.code)
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
        if self._unlisted:
            self.problems.append(Problem(f"{self._unlisted} more of such problems", self.path.name))

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
            text = f"more than {MAX_DESCRIPTIONS} descriptions; the rest is not read"
            self._problem(text, code=FaultCode.BAG_HUGE)
        return self._descriptions <= MAX_DESCRIPTIONS

    def _add_channel(self, channel: records.Channel | None) -> None:
        if channel is None or (channel.id in self._channels and not self._end.verified):
            return  # the copy at the end counts only if its checksum is right
        if channel.message_encoding != "cdr":
            text = f"{channel.topic}: encoding {channel.message_encoding!r} is not read, only cdr"
            self._problem(text, code=FaultCode.BAG_FOREIGN)
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
            self._problem(f"{error}; {length} bytes skipped", offset, code=error.code)
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

    def _problem(
        self, text: str, offset: int = -1, loses_data: bool = True, code: FaultCode = FaultCode.BAG_DAMAGED
    ) -> None:
        problem = Problem(text, self.path.name, offset, loses_data, code)
        if problem in self._listed:
            return
        if len(self._listed) >= MAX_PROBLEMS:
            self._unlisted += 1
            return
        self._listed.add(problem)
        self.problems.append(problem)


def _count(channels: IntArray) -> Counter[int]:
    """Messages by channel."""
    numbers, counts = np.unique(channels, return_counts=True)
    return Counter(dict(zip(numbers.tolist(), counts.tolist(), strict=True)))
