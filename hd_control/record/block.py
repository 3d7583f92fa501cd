"""Messages of a recording as parallel arrays over one buffer: what every storage format hands out."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any

from hd_control import _records
from hd_control.core.arrays import IntArray
from hd_control.record.fixed_cdr import Buffer
from hd_control.record.problems import RECORD_CAP

BLOCK_MESSAGES = 1 << 16
"""A block has at most so many messages, whatever the file says."""


WINDOW, RECORD_HEAD = 16 << 20, 9


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


def scanned_block(buffer: Buffer, found: dict[str, Any]) -> Block:
    """The messages that a walk over MCAP records found."""
    return Block(
        buffer,
        found["channel"],
        found["sequence"],
        found["log_time"],
        found["publish_time"],
        found["offset"],
        found["length"],
    )


def scans(data: Buffer) -> Iterator[dict[str, Any]]:
    """The records of an uncompressed chunk, a bounded number of messages at a time."""
    at, more = 0, True
    while more:
        found = _records.scan(data, at, RECORD_CAP, BLOCK_MESSAGES)
        at, more = found["stop"], found["limit"]
        yield found


def scan_some(buffer: Buffer, at: int) -> dict[str, Any]:
    """The records of a file from byte `at` on, some of them: `limit` is True if there may be more.

    Only a window of the file is touched at a time, so that a mapped file does not come into memory as a whole.
    """
    for window in (WINDOW, RECORD_CAP + RECORD_HEAD):
        end = min(len(buffer), at + window)
        found: dict[str, Any] = _records.scan(buffer[:end], at, RECORD_CAP, BLOCK_MESSAGES)
        if end == len(buffer) or not found["reason"]:
            break
        if found["stop"] > at:  # the window's end, or damage that the next window meets at its beginning
            found["reason"], found["limit"] = "", True
            break
    found["limit"] = found["limit"] or (end < len(buffer) and not found["reason"] and not found["footer"])
    return found
