"""An MCAP file being written: records of the `mcap` library, messages laid out here because they are many.

Messages are either appended one after the other (a killed process leaves every whole record readable) or handed over as
chunks, zstd with CRC, one channel each. A running CRC of the data section protects both forms once the file is closed.
"""

from __future__ import annotations

import io
import struct
import zlib
from collections.abc import Iterator
from dataclasses import dataclass, field
from typing import Protocol

import mcap.records as records
import numpy as np
from mcap.data_stream import RecordBuilder
from mcap.opcode import Opcode

from hd_control import _records
from hd_control._pump import RecordFile
from hd_control.core.arrays import ByteArray, IntArray
from hd_control.record.accounting import TopicAccount
from hd_control.record.bag_folder import TopicEntry
from hd_control.record.block import RECORD_CAP, Block
from hd_control.record.cdr import Buffer

MAGIC = b"\x89MCAP0\r\n"
MESSAGE = struct.Struct("<BQHIQQ")
_HEAD = np.dtype(
    [
        ("opcode", "u1"),
        ("length", "<u8"),
        ("channel", "<u2"),
        ("sequence", "<u4"),
        ("log_time", "<i8"),
        ("publish_time", "<i8"),
    ]
)
_INDEX = struct.Struct("<BQHI")
ZSTD_LEVEL = 1
LONGEST_RECORD = RECORD_CAP - (2 << 20)
"""Bytes of a message record that the reader takes, also in a chunk with others that zstd does not make any shorter."""


class Stream(Protocol):
    """What is needed of a file: `write` may write less than asked, like an unbuffered file."""

    def write(self, data: memoryview, /) -> int | None: ...


def message_record(channel: int, sequence: int, log_time_ns: int, publish_time_ns: int, payload: Buffer) -> bytes:
    """One message as a record."""
    return MESSAGE.pack(Opcode.MESSAGE, 22 + len(payload), channel, sequence, log_time_ns, publish_time_ns) + payload


def message_records(
    channel: int, sequences: IntArray, log_times_ns: IntArray, publish_times_ns: IntArray, rows: ByteArray
) -> tuple[bytes, IntArray]:
    """Many messages of equal length, rows of (n, size), as records; also where each record begins."""
    count, size = rows.shape
    heads = np.zeros(count, _HEAD)
    heads["opcode"], heads["length"], heads["channel"] = Opcode.MESSAGE, 22 + size, channel
    heads["sequence"] = sequences & 0xFFFFFFFF
    heads["log_time"], heads["publish_time"] = log_times_ns, np.maximum(publish_times_ns, 0)
    records = np.concatenate([heads.view(np.uint8).reshape(count, MESSAGE.size), rows], axis=1)
    return records.tobytes(), np.arange(count, dtype=np.int64) * (MESSAGE.size + size)


class McapFile:
    """Writes one file from start to end. Every OSError of the stream passes through; nothing is retried."""

    def __init__(self, stream: Stream) -> None:
        self.growing = RecordFile(_target(stream))
        self.growing.append(MAGIC)
        self._schemas: list[records.Schema] = []
        self._channels: list[records.Channel] = []
        self._chunks: list[records.ChunkIndex] = []
        self._attachments: list[records.AttachmentIndex] = []
        self._metadata: list[records.MetadataIndex] = []
        self._append(records.Header(profile="ros2", library="hd_control"))

    def redirect(self, stream: Stream) -> None:
        """Sends everything from now on to another stream: one that fails, in tests."""
        self.growing.set_sink(_target(stream))

    def add_schema(self, name: str, definition: str | bytes, encoding: str = "ros2msg") -> int:
        """A new schema id for a message definition."""
        data = definition.encode("utf-8") if isinstance(definition, str) else definition
        schema = records.Schema(id=len(self._schemas) + 1, data=data, encoding=encoding, name=name)
        self._schemas.append(schema)
        self._append(schema)
        return schema.id

    def add_channel(self, topic: str, schema_id: int, metadata: dict[str, str], encoding: str = "cdr") -> int:
        """A new channel id."""
        channel = records.Channel(
            id=len(self._channels) + 1, topic=topic, message_encoding=encoding, metadata=metadata, schema_id=schema_id
        )
        self._channels.append(channel)
        self._append(channel)
        return channel.id

    def add_message(self, channel: int, sequence: int, log_time_ns: int, publish_time_ns: int, payload: Buffer) -> None:
        """Appends one message; it reaches the system with the next `flush`."""
        self.growing.message(channel, sequence, log_time_ns, publish_time_ns, payload)

    def add_chunk(self, channel: int, data: bytes, log_times_ns: IntArray, offsets: IntArray) -> None:
        """Writes message records of one channel as a compressed chunk; `offsets` are their places in `data`."""
        import zstandard

        first, last = int(log_times_ns.min()), int(log_times_ns.max())
        packed = zstandard.ZstdCompressor(level=ZSTD_LEVEL).compress(data)
        start, length = self._append(
            records.Chunk(
                compression="zstd",
                data=packed,
                message_start_time=first,
                message_end_time=last,
                uncompressed_crc=zlib.crc32(data),
                uncompressed_size=len(data),
            )
        )
        entries = np.stack([log_times_ns.astype("<u8"), offsets.astype("<u8")], axis=1).tobytes()
        index = _INDEX.pack(Opcode.MESSAGE_INDEX, 6 + len(entries), channel, len(entries)) + entries
        index_at = self.growing.append(index)
        self._chunks.append(
            records.ChunkIndex(
                chunk_start_offset=start,
                chunk_length=length,
                compression="zstd",
                compressed_size=len(packed),
                uncompressed_size=len(data),
                message_start_time=first,
                message_end_time=last,
                message_index_offsets={channel: index_at},
                message_index_length=len(index),
            )
        )
        self.growing.count(channel, len(log_times_ns), first, last)
        self.flush()

    def add_attachment(self, name: str, media_type: str, data: bytes, time_ns: int) -> None:
        """A file carried inside the recording."""
        start, length = self._append(records.Attachment(time_ns, time_ns, name, media_type, data))
        self._attachments.append(
            records.AttachmentIndex(
                offset=start,
                length=length,
                create_time=time_ns,
                log_time=time_ns,
                data_size=len(data),
                name=name,
                media_type=media_type,
            )
        )

    def add_metadata(self, name: str, values: dict[str, str]) -> None:
        """Named texts carried inside the recording."""
        start, length = self._append(records.Metadata(name=name, metadata=values))
        self._metadata.append(records.MetadataIndex(length=length, name=name, offset=start))

    def flush(self) -> None:
        """Hands everything to the operating system."""
        self.growing.flush()

    @property
    def position(self) -> int:
        """Bytes that the operating system has."""
        return self.growing.position

    @property
    def end(self) -> int:
        """Length of the file once everything is flushed."""
        return self.growing.end

    @property
    def pending_bytes(self) -> int:
        """Bytes that a kill would lose now."""
        return self.growing.pending

    @property
    def first_ns(self) -> int:
        """Log time of the first message; 0 without one."""
        return self.growing.first_ns

    @property
    def last_ns(self) -> int:
        """Log time of the last message; 0 without one."""
        return self.growing.last_ns

    def finish(self) -> None:
        """Writes data end, summary, index, statistics and footer; the file is then complete."""
        self.flush()
        self._append(records.DataEnd(self.growing.crc))
        start = self.end
        summary, groups = RecordBuilder(), []
        for opcode, group in self._summary():
            begin = summary.count
            for record in group:
                record.write(summary)
            if summary.count > begin:
                groups.append(
                    records.SummaryOffset(
                        group_opcode=opcode, group_start=start + begin, group_length=summary.count - begin
                    )
                )
        offsets_at = start + summary.count
        for offset in groups:
            offset.write(summary)
        data: bytes = summary.end()  # type: ignore[no-untyped-call]
        footer = struct.pack("<BQQQ", Opcode.FOOTER, 20, start, offsets_at)
        self.growing.append(data + footer + struct.pack("<I", zlib.crc32(footer, zlib.crc32(data))) + MAGIC)
        self.flush()

    def _summary(self) -> list[tuple[Opcode, list[records.McapRecord]]]:
        counts = self.growing.counts
        statistics = records.Statistics(
            attachment_count=len(self._attachments),
            channel_count=len(self._channels),
            channel_message_counts=counts,
            chunk_count=len(self._chunks),
            message_count=sum(counts.values()),
            message_end_time=self.last_ns,
            message_start_time=self.first_ns,
            metadata_count=len(self._metadata),
            schema_count=len(self._schemas),
        )
        return [
            (Opcode.SCHEMA, [*self._schemas]),
            (Opcode.CHANNEL, [*self._channels]),
            (Opcode.STATISTICS, [statistics]),
            (Opcode.CHUNK_INDEX, [*self._chunks]),
            (Opcode.ATTACHMENT_INDEX, [*self._attachments]),
            (Opcode.METADATA_INDEX, [*self._metadata]),
        ]

    def _append(self, record: records.McapRecord) -> tuple[int, int]:
        """Returns the place of the record in the file and its length."""
        builder = RecordBuilder()
        record.write(builder)
        data: bytes = builder.end()  # type: ignore[no-untyped-call]
        return self.growing.append(data), len(data)


def _target(stream: Stream) -> int | Stream:
    """An unbuffered file is written to without the interpreter."""
    return stream.fileno() if isinstance(stream, io.FileIO) else stream


# ---- One topic of a file being written -------------------------------------------------------------


@dataclass
class Channel:
    """One topic of the file, with what is not written yet when chunks are used."""

    topic: str
    type_name: str
    type_hash: str
    number: int
    latched: bool
    account: TopicAccount
    records: bytearray = field(default_factory=bytearray)
    times: list[int] = field(default_factory=list)
    offsets: list[int] = field(default_factory=list)

    def entry(self) -> TopicEntry:
        """The topic as metadata.yaml lists it."""
        return TopicEntry(self.topic, self.type_name, self.type_hash, self.account.written, self.latched)


# ---- Messages of a block as the bytes of MCAP records, for copying a recording ---------------------


def block_records(block: Block, channel: int) -> tuple[bytes, IntArray]:
    """The messages under a channel number, in order, and where each record begins, (n,)."""
    if len(block.length) and bool((block.length == block.length[0]).all()):
        rows = _records.take(block.buffer, block.offset, 0, int(block.length[0]))
        return message_records(channel, block.sequence, block.log_time_ns, block.publish_time_ns, rows)
    heads = (block.sequence.tolist(), block.log_time_ns.tolist(), block.publish_time_ns.tolist())
    data = b"".join(
        message_record(channel, sequence, log, publish, payload)
        for sequence, log, publish, payload in zip(*heads, block.payloads(), strict=True)
    )
    places = np.concatenate([[0], np.cumsum(block.length + MESSAGE.size)[:-1]]).astype(np.int64)
    return data, places


def parts(block: Block, most: int) -> Iterator[Block]:
    """Runs of messages whose records have at most `most` bytes together, at least one message each."""
    ends = np.cumsum(block.length + MESSAGE.size)
    begin, count = 0, len(ends)
    while begin < count:
        taken = int(ends[begin - 1]) if begin else 0
        end = max(begin + 1, int(np.searchsorted(ends, taken + most, side="right")))
        yield block.select(slice(begin, end))
        begin = end
