"""What arrived, what was written, what is missing: counted per topic, from the stamps."""

from __future__ import annotations

import struct
from dataclasses import asdict, dataclass, field
from typing import Any

import numpy as np

from hd_control.core.arrays import IntArray
from hd_control.core.topics import HEADER_FIRST
from hd_control.record.cdr import CLOCK, Buffer

_HEADER = struct.Struct("<iII")
MAX_FRAME_ID = 1024


def header_of(type_name: str, payload: Buffer) -> tuple[int | None, bytes]:
    """(stamp_ns, frame_id) of a message that begins with a std_msgs/Header; (None, b"") for other types."""
    if type_name == CLOCK and len(payload) >= 12:
        seconds, nanoseconds = struct.unpack_from("<iI", payload, 4)
        return seconds * 1_000_000_000 + nanoseconds, b""
    if type_name not in HEADER_FIRST or len(payload) < 16:
        return None, b""
    seconds, nanoseconds, length = _HEADER.unpack_from(payload, 4)
    frame_id = bytes(payload[16 : 15 + length]) if 0 < length <= MAX_FRAME_ID else b""
    return seconds * 1_000_000_000 + nanoseconds, frame_id


@dataclass
class Drops:
    """Samples that were published but are not in the bag, by where they were lost."""

    transport: int = 0
    queue: int = 0
    disk: int = 0

    @property
    def total(self) -> int:
        """All of them."""
        return self.transport + self.queue + self.disk


@dataclass
class TopicAccount:
    """Counts of one topic. `period_ns` is the tick of its stamps; 0 means that gaps cannot be seen.

    Streams on one topic are kept apart by `frame_id` (run id of the publisher, joint of a temperature); a stream that
    begins is not a gap, one that jumps by n ticks has n - 1 missing samples.
    """

    period_ns: int = 0
    received: int = 0
    written: int = 0
    gaps: int = 0
    missing: int = 0
    duplicates: int = 0
    out_of_order: int = 0
    drops: Drops = field(default_factory=Drops)
    last: dict[bytes, int] = field(default_factory=dict)

    def see(self, stamp_ns: int | None, frame_id: bytes = b"") -> None:
        """Counts one sample that arrived."""
        self.received += 1
        if stamp_ns is None or not self.period_ns:
            return
        before = self.last.get(frame_id)
        if before is None or stamp_ns > before:
            self.last[frame_id] = stamp_ns
        if before is None:
            return
        ticks = (2 * (stamp_ns - before) + self.period_ns) // (2 * self.period_ns)
        if ticks > 1:
            self.gaps += 1
            self.missing += ticks - 1
        elif stamp_ns == before:
            self.duplicates += 1
        elif stamp_ns < before:
            self.out_of_order += 1

    def see_many(self, stamps_ns: IntArray, frame_id: bytes = b"") -> None:
        """Like `see` for each of many stamps of one stream."""
        if self.period_ns and len(stamps_ns) and bool((np.diff(stamps_ns) <= 0).any()):
            for stamp in stamps_ns:
                self.see(int(stamp), frame_id)
            return
        if len(stamps_ns) == 0:
            return
        self.see(int(stamps_ns[0]), frame_id)
        self.received += len(stamps_ns) - 1
        if self.period_ns:
            ticks = (2 * np.diff(stamps_ns) + self.period_ns) // (2 * self.period_ns)
            self.gaps += int((ticks > 1).sum())
            self.missing += int(np.maximum(ticks - 1, 0).sum())
            self.last[frame_id] = int(stamps_ns[-1])

    def as_dict(self) -> dict[str, Any]:
        """Plain numbers, for metadata and JSON; `run_ids` are the streams that were seen."""
        table = asdict(self)
        table["run_ids"] = sorted(key.decode("utf-8", "replace") for key in table.pop("last"))
        return table
