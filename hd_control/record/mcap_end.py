"""The summary at the end of a closed MCAP file: how many messages there must be, and where the chunks lie."""

from __future__ import annotations

import zlib
from dataclasses import dataclass, field
from io import BytesIO
from typing import Any

import mcap.records as records
from mcap.data_stream import ReadDataStream
from mcap.opcode import Opcode

from hd_control import _records
from hd_control.record.fixed_cdr import Buffer
from hd_control.record.mcap_file import MAGIC
from hd_control.record.problems import RECORD_CAP

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
