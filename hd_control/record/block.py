"""Messages of a recording as parallel arrays over one buffer: what every storage format hands out; what is missing."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from hd_control import _records
from hd_control.core.arrays import IntArray
from hd_control.core.faults import FaultCode
from hd_control.record.cdr import Buffer

# ---- What is missing or doubtful, as values --------------------------------------------------------


RECORD_CAP = 64 << 20
EXPANSION_CAP = 1000


@dataclass(frozen=True)
class Problem:
    """One finding. `loses_data` is False for notices: nothing is known to be missing because of it.

    `code` is the fault that it is unless it is a notice.
    """

    text: str
    file: str = ""
    offset: int = -1
    loses_data: bool = True
    code: FaultCode = FaultCode.BAG_DAMAGED

    @property
    def place(self) -> str:
        """File and byte; empty if it belongs to no file."""
        return f"{self.file} at byte {self.offset}" if self.file and self.offset >= 0 else self.file

    @property
    def finding(self) -> str:
        """Place and text."""
        return f"{self.place}: {self.text}" if self.place else self.text

    def __str__(self) -> str:
        return self.code.line(self.text, self.place) if self.loses_data else self.finding


# ---- Holes in the stamps of a topic, stream by stream ----------------------------------------------


@dataclass(frozen=True)
class Gap:
    """Missing samples of a topic: the stamps around them [ns] and how many are missing."""

    from_ns: int
    to_ns: int
    missing: int


def streams_of(frame_ids: NDArray[Any] | None) -> list[Any]:
    """Indexes of each stream: one per frame_id if several are mixed (temperatures, two runs), else all messages.

    `frame_ids` are (n,), texts or numbers that stand for them.
    """
    if frame_ids is None:
        return [slice(None)]
    keys, inverse = np.unique(frame_ids, return_inverse=True)
    return [slice(None)] if len(keys) < 2 else [np.flatnonzero(inverse == k) for k in range(len(keys))]


def find_gaps(stamps_ns: IntArray, streams: Sequence[Any], period_ns: int) -> list[Gap]:
    """The holes in stamps (n,) whose samples are `period_ns` apart within each stream, in order of time."""
    found = []
    for stream in streams:
        stamps = stamps_ns[stream]
        for i in np.flatnonzero(np.diff(stamps) >= (3 * period_ns + 1) // 2):  # nearest number of periods: 2 or more
            start, end = int(stamps[i]), int(stamps[i + 1])
            found.append(Gap(start, end, (2 * (end - start) + period_ns) // (2 * period_ns) - 1))
    return sorted(found, key=lambda gap: gap.from_ns)


# ---- Blocks of messages ----------------------------------------------------------------------------


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
