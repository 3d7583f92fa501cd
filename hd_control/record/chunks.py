"""Uncompresses one MCAP chunk with every length checked and its CRC compared."""

from __future__ import annotations

import struct
import zlib
from dataclasses import dataclass

from hd_control.record.fixed_cdr import Buffer
from hd_control.record.problems import EXPANSION_CAP, RECORD_CAP

_HEAD = struct.Struct("<QQQII")


class ChunkError(Exception):
    """A chunk that cannot be trusted; the text says why."""


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
    if length < _HEAD.size + 8:
        raise ChunkError("chunk record shorter than its head")
    _, _, size, crc, name_length = _HEAD.unpack_from(buffer, offset)
    rest = length - _HEAD.size - 8 - name_length
    if rest < 0 or name_length > 32:
        raise ChunkError("chunk record with an impossible compression name")
    at = offset + _HEAD.size
    name = bytes(buffer[at : at + name_length]).decode("ascii", "replace")
    (data_length,) = struct.unpack_from("<Q", buffer, at + name_length)
    if data_length > rest:
        raise ChunkError("chunk data longer than its record")
    if size > RECORD_CAP:
        raise ChunkError(f"chunk of {size} bytes is above the cap of {RECORD_CAP}")
    if size > EXPANSION_CAP * max(data_length, 1):
        raise ChunkError(f"chunk expands more than {EXPANSION_CAP} times")
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
