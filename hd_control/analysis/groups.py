"""Groups: what is added or dropped as one, the columns of one effect with one shape or of one free curve."""

from __future__ import annotations

from collections.abc import Collection, Iterable, Iterator
from dataclasses import dataclass, field

import numpy as np

from hd_control.analysis.curves import Curve
from hd_control.core.arrays import IntArray
from hd_control.drive.effect import Columns, DriveStates, Effect, Shape


@dataclass(frozen=True)
class Group:
    """What is added or dropped as one. `index`: its coefficients in the dictionary."""

    name: str
    index: IntArray
    channels: tuple[str, ...]
    effect: type[Effect] | None = None
    shape: Shape = field(default_factory=dict)
    curve: Curve | None = None

    @property
    def is_curve(self) -> bool:
        """True for a free curve."""
        return self.curve is not None


@dataclass(frozen=True)
class Candidate:
    """A group before it is in the dictionary: raw columns (n, k) by channel at the rate of the recording."""

    name: str
    columns: Columns
    effect: type[Effect] | None = None
    shape: Shape = field(default_factory=dict)
    curve: Curve | None = None


def library_candidates(
    effects: Iterable[type[Effect]], states: DriveStates, channels: Collection[str]
) -> Iterator[Candidate]:
    """Every shape of every effect that acts on one of the channels and whose columns are finite on this recording.

    One at a time: the columns of all of them together would not fit a small computer.
    """
    for effect in effects:
        for shape in effect.shapes(states):
            columns = {n: c for n, c in effect.columns(states, shape).items() if n in channels}
            finite = all(np.isfinite(c).all() for c in columns.values())
            if columns and finite and any(c.any() for c in columns.values()):
                yield Candidate(effect.name, columns, effect, shape)


def curve_candidates(found: Iterable[Curve], states: DriveStates, channels: Collection[str]) -> Iterator[Candidate]:
    """Free curves as candidates, one at a time."""
    for curve in found:
        columns = {n: c for n, c in curve.columns_at(states).items() if n in channels}
        yield Candidate(curve.name, columns, curve=curve)


def group_of(candidate: Candidate, start: int) -> Group:
    """The group of a candidate whose first coefficient is `start`."""
    width = next(iter(candidate.columns.values())).shape[1]
    index = np.arange(start, start + width)
    return Group(candidate.name, index, tuple(candidate.columns), candidate.effect, candidate.shape, candidate.curve)
