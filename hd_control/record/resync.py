"""Finds the place behind damage in an MCAP file from which records can be read again.

A record has no mark at its beginning, so a place counts only if a chain of `CHAIN` records starts there, each inside
the file and of a kind and size that is possible; the first is a message of a known channel, a chunk, or the end.
"""

from __future__ import annotations

import re
import struct
from collections.abc import Collection

from mcap.opcode import Opcode

from hd_control.record.fixed_cdr import Buffer
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
