"""What a loop did, counted in the loop with a few stores per tick and summed up outside it."""

from __future__ import annotations

import time
from array import array
from collections.abc import Mapping

import numpy as np
from numpy.typing import NDArray

RING = 1024
"""Ticks that percentiles are taken over: the last second at 1 kHz, and cheap enough to sort beside the loop."""
PLAUSIBLE_AGE_NS = 10_000_000_000


def missed_percent(plant: Mapping[str, str]) -> float:
    """Ticks at which the plant had to hold an old command, or that it overslept, per hundred; from its diagnostics."""
    skipped, late = float(plant.get("skipped", 0)), float(plant.get("late", 0))
    ticks = float(plant.get("ticks", 0)) + skipped
    return 100.0 * (late + skipped) / ticks if ticks else 0.0


class LoopStatistics:
    """Counters and a ring of tick times of one loop.

    The loop calls `tick`; any other thread may call `summary`. A torn reading of the ring costs one sample of a
    percentile, never a wrong counter.
    """

    def __init__(self, dt_ns: int) -> None:
        self.dt_ns = dt_ns
        self.ticks = self.missed = self.incomplete = self.late = self.foreign = 0
        self.last_tick: int | None = None
        self.max_age_ns = 0
        self._times = array("q", bytes(8 * RING))
        self._busy = array("q", bytes(8 * RING))
        self._answers = array("q", bytes(8 * RING))
        self._answer_count = 0

    def answer(self, waited_ns: int) -> None:
        """Notes how long after its sample the complete command of a tick was there (plant only)."""
        self._answers[self._answer_count % RING] = waited_ns
        self._answer_count += 1

    def tick(self, tick: int, started_ns: int, finished_ns: int) -> None:
        """Counts one tick; a step of more than one in the tick number is a gap and counts as missed ticks."""
        if self.last_tick is not None and tick > self.last_tick + 1:
            self.missed += tick - self.last_tick - 1
        self.last_tick = tick
        slot = self.ticks % RING
        self._times[slot] = started_ns
        self._busy[slot] = finished_ns - started_ns
        self.ticks += 1

    def age(self, stamp_ns: int) -> None:
        """Notes how long after its scheduled time a sample was used; lock-step stamps are no wall time and left out."""
        age = time.time_ns() - stamp_ns
        if self.max_age_ns < age < PLAUSIBLE_AGE_NS:
            self.max_age_ns = age

    def summary(self) -> dict[str, float]:
        """Counters, and period and busy time of the last ticks as p50, p99 and maximum, in µs."""
        counters = ("ticks", "missed", "incomplete", "late", "foreign")
        found: dict[str, float] = {name: getattr(self, name) for name in counters}
        found["max_age_us"] = self.max_age_ns / 1000.0
        count = min(self.ticks, RING)
        if count > 2:
            start = self.ticks % RING if self.ticks > RING else 0
            times = np.roll(np.array(self._times, dtype=np.int64), -start)[:count]
            _spread(found, "period", np.diff(times))
            _spread(found, "busy", np.array(self._busy, dtype=np.int64)[:count])
        if self._answer_count:
            _spread(found, "answer", np.array(self._answers, dtype=np.int64)[: min(self._answer_count, RING)])
        self.max_age_ns = 0
        return found


def _spread(found: dict[str, float], name: str, values: NDArray[np.int64]) -> None:
    """Adds p50, p99 and maximum in µs; by one sort, because this runs beside the loop."""
    ordered = np.sort(values)
    last = len(ordered) - 1
    for label, share in (("p50", 0.5), ("p99", 0.99), ("max", 1.0)):
        found[f"{name}_{label}_us"] = float(ordered[round(share * last)]) / 1000.0
