"""Finds the place behind damage in an MCAP file from which records can be read again.

A record has no mark at its beginning, so a place counts only if a chain of `CHAIN` records starts there, each inside
the file and of a kind and size that is possible; the first is a message of a known channel, a chunk, or the end.
"""

from __future__ import annotations

import re
import struct
from collections.abc import Collection
from typing import Any

from mcap.opcode import Opcode

from hd_control.record.fixed_cdr import Buffer
from hd_control.record.mcap_file import MESSAGE
from hd_control.record.problems import RECORD_CAP

CHAIN = 4
MAX_CANDIDATES = 100_000
"""Places tried in one file; more than this is no damage but a file made to take long."""
_HEAD = struct.Struct("<BQ")
_CONTENT = struct.Struct("<HIQQ")
# opcode of a message, a chunk or the end of the data, then a length below 2^32
_CANDIDATE = re.compile(rb"[\x05\x06\x0f].{4}\x00{4}", re.DOTALL)


class Resync:
    """The search in one file; its total effort is bounded."""

    def __init__(self, buffer: Buffer) -> None:
        self._buffer, self._left = buffer, MAX_CANDIDATES

    def next_record(self, found: dict[str, Any], bad_chunk: int | None, channels: Collection[int]) -> int | None:
        """Where a chain of records begins behind the place at which a walk stopped; None if there is none.

        `found` is what the walk found last, `bad_chunk` the beginning of a chunk that failed, if no whole one followed.
        """
        at = _doubtful_place(self._buffer, found, bad_chunk) + 1
        while self._left > 0:
            self._left -= 1
            place = _CANDIDATE.search(self._buffer, at)
            if place is None:
                return None
            if _is_chain(self._buffer, place.start(), channels):
                return place.start()
            at = place.start() + 1
        return None


def _doubtful_place(buffer: Buffer, found: dict[str, Any], bad_chunk: int | None) -> int:
    """The beginning of the last record that may have a wrong length, so that the next whole one lies inside of it."""
    message = int(found["offset"][-1]) - MESSAGE.size if len(found["offset"]) else -1
    other = int(found["other_offset"][-1]) - _HEAD.size if len(found["other_offset"]) else -1
    last: int = max(message, other)
    place: int = found["stop"] if last < 0 or buffer[last] == Opcode.CHUNK else last
    return place if bad_chunk is None or bad_chunk < message else min(place, bad_chunk)


def _is_chain(buffer: Buffer, at: int, channels: Collection[int]) -> bool:
    """True if `CHAIN` possible records follow each other, or fewer up to the very end of the file behind a footer."""
    for _ in range(CHAIN):
        if at + _HEAD.size > len(buffer):
            return False
        opcode, length = _HEAD.unpack_from(buffer, at)
        content = at + _HEAD.size
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
