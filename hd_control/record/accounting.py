"""What arrived, what was written, what is missing: counted per topic, by compiled code (`cpp/accounts.hpp`)."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

from hd_control._pump import Account, Head, head_of
from hd_control.core.topics import HEADER_FIRST
from hd_control.record.cdr import CLOCK, Buffer


def head_kind(type_name: str) -> Head:
    """What a message of this type begins with."""
    return Head.HEADER if type_name in HEADER_FIRST else Head.CLOCK if type_name == CLOCK else Head.NONE


def header_of(type_name: str, payload: Buffer) -> tuple[int | None, bytes]:
    """(stamp_ns, frame_id) of a message that begins with a std_msgs/Header; (None, b"") for other types."""
    return head_of(head_kind(type_name), payload)


@dataclass(frozen=True)
class Drops:
    """Samples that were published but are not in the bag, by where they were lost.

    `size`: refused, because no reader would take a record as long as that.
    """

    transport: int = 0
    queue: int = 0
    disk: int = 0
    size: int = 0

    @property
    def total(self) -> int:
        """All of them."""
        return self.transport + self.queue + self.disk + self.size


class TopicAccount(Account):
    """Counts of one topic. `period_ns` is the tick of its stamps; 0 means that gaps cannot be seen.

    Streams on one topic are kept apart by `frame_id` (run id of the publisher, joint of a temperature); a stream that
    begins is not a gap, one that jumps by n ticks has n - 1 missing samples. `never_published`: ticks that are missing
    although no message of their publisher is.
    """

    @property
    def drops(self) -> Drops:
        """What is not in the bag although it was published."""
        return Drops(**self.counts()["drops"])

    def as_dict(self) -> dict[str, Any]:
        """Plain numbers, for metadata and JSON; `run_ids` are the streams that were seen."""
        run_ids = sorted(frame.decode("utf-8", "replace") for frame in self.frames())
        return {"period_ns": self.period_ns, **self.counts(), "run_ids": run_ids}
