"""Holes in the stamps of a topic, stream by stream."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from hd_control.core.arrays import IntArray


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
