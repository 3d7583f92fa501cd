"""Names of order lines, and whether a line is bound to the angle or to time.

A line is bound to the angle only if its order stays put while the speed changes; a line fixed in hertz is a resonance
or a disturbance. Orders closer than the resolution 1 / turns are not told apart: all their names are listed.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from hd_control.analysis.orders import BACKWARD, FORWARD, OrderSpectrum, Part, Peak, Stretch

ANGLE, HERTZ, ONE_SPEED, OPEN = "angle", "hertz", "one speed", "open"
SPEED_RATIO = 1.25
"""Mean speed of the fast over that of the slow stretches from which on angle and time are told apart."""
SPEED_LIKE = 1.1
"""Speeds that differ by less count as the same."""
PRESENT = 3.0
"""Times the floor at which a line that was found counts as seen in a part of the recording."""
NEAR = 0.15
"""Orders by which a line may miss its name, however coarse the resolution is."""
HARMONIC = "kinematic error or gauge ripple"
COGGING = "cogging (poles or slots)"
TURNING_GAUGE = "gauge that turns with the joint"
ECCENTRICITY = "eccentricity"


@dataclass(frozen=True)
class OrderLine:
    """A line: `order` per turn of the spectrum's axis; `amplitude` and `floor` of the direction where it is largest;
    `directions` in which it stands out; `names`, nearest first, all that the resolution allows; `bound` to angle,
    hertz, or not decided (one speed, open)."""

    order: float
    amplitude: float
    floor: float
    resolution: float
    directions: tuple[int, ...]
    names: tuple[str, ...]
    bound: str

    @property
    def ratio(self) -> float:
        """Amplitude over floor."""
        return self.amplitude / self.floor


def lines_of(spectrum: OrderSpectrum) -> tuple[OrderLine, ...]:
    """The lines of both directions, those at the same order joined, largest over its floor first."""
    left = sorted(spectrum.peaks, key=lambda peak: -peak.amplitude / peak.floor)
    found = []
    while left:
        first = left[0]
        same = [peak for peak in left if abs(peak.order - first.order) <= max(first.resolution, peak.resolution)]
        left = [peak for peak in left if peak not in same]
        directions = tuple(sorted({peak.direction for peak in same}))
        bound = binding(first, spectrum.parts)
        names = names_of(first.order, first.resolution, spectrum.gear_ratio) if bound != HERTZ else ()
        found.append(OrderLine(first.order, first.amplitude, first.floor, first.resolution, directions, names, bound))
    return tuple(found)


def binding(peak: Peak, parts: Sequence[Part]) -> str:
    """`angle`: the order is the same at low and at high speed; `hertz`: the frequency is; else why it is not known."""
    mine = sorted((s for s in peak.part.stretches if s.direction == peak.direction), key=lambda s: s.speed)
    slow, fast = _split(mine)
    if not slow or not fast:
        return ONE_SPEED
    low, high = (float(np.mean([s.speed for s in group])) for group in (slow, fast))
    if high < SPEED_RATIO * low:
        return ONE_SPEED
    seen = [_present(peak.part, group, peak.order) for group in (slow, fast)]
    if all(seen):
        return ANGLE
    for here, there, order in ((0, fast, peak.order * low / high), (1, slow, peak.order * high / low)):
        if seen[here] and any(_present(part, _like(part, there), order) for part in parts if part.holds(order)):
            return HERTZ
    return OPEN


def _like(part: Part, group: Sequence[Stretch]) -> list[Stretch]:
    """The stretches of another part that have the direction and the speeds of a group."""
    speeds = [s.speed for s in group]
    low, high = min(speeds) / SPEED_LIKE, max(speeds) * SPEED_LIKE
    return [s for s in part.stretches if s.direction == group[0].direction and low <= s.speed <= high]


def _split(stretches: Sequence[Stretch]) -> tuple[Sequence[Stretch], Sequence[Stretch]]:
    """Slow and fast, at the widest step between neighbouring speeds in the middle half."""
    if len(stretches) < 2:
        return (), ()
    speeds = np.array([s.speed for s in stretches])
    first, last = (len(stretches) - 1) // 4, len(stretches) - 1 - (len(stretches) - 1) // 4
    cut = first + 1 + int(np.argmax(np.diff(np.log(speeds))[first:last]))
    return stretches[:cut], stretches[cut:]


def _present(part: Part, stretches: Sequence[Stretch], order: float) -> bool:
    """Does a part of the recording show a line at this order, within the resolution?"""
    amplitude = part.amplitude(stretches)
    floor = part.floor(amplitude)
    near = np.abs(part.orders - order) <= part.resolution
    with np.errstate(invalid="ignore"):
        return bool(np.any(amplitude[near] > PRESENT * floor[near]))


def names_of(order: float, resolution: float, gear_ratio: float | None) -> tuple[str, ...]:
    """Names of an order per wave-generator turn (per joint turn if the ratio is None), nearest first."""
    if gear_ratio is None:
        low, high = 0.5 * (order - resolution), 0.5 * (order + resolution)
        return (f"if it is 2 per wave-generator turn, the gear ratio is {low:.0f} to {high:.0f}",)
    found = [(n / gear_ratio, f"{n} per joint turn: {ECCENTRICITY}") for n in (1, 2)]
    whole = round(order)
    if whole >= 1:
        cause = HARMONIC if whole in (1, 2, 4) else COGGING
        found.append((float(whole), f"{whole} per wave-generator turn: {cause}"))
    if whole >= 2 and whole % 2 == 0:
        for sign in (-1, 1):
            turns = whole * (gear_ratio + sign)
            found.append((turns / gear_ratio, f"{whole}(N{sign:+d}) = {turns:g} per joint turn: {TURNING_GAUGE}"))
    near = [(abs(order - place), name) for place, name in found if abs(order - place) <= min(resolution, NEAR)]
    return tuple(name for _, name in sorted(near))


def describe(line: OrderLine, spectrum: OrderSpectrum, unit: str, factor: float = 1.0) -> str:
    """A line in one sentence; `unit` is that of the amplitude times `factor`."""
    where = f"{line.order:.4g} per {spectrum.turn}"
    if spectrum.gear_ratio is not None:
        joint = line.order * spectrum.gear_ratio
        where += f" ({joint:.4g} +- {0.5 * line.resolution * spectrum.gear_ratio:.2g} per joint turn)"
    both = {(BACKWARD, FORWARD): "in both directions", (FORWARD,): "forward only", (BACKWARD,): "backward only"}
    text = f"{where}: {factor * line.amplitude:.3g} {unit}, {line.ratio:.0f} times the floor, {both[line.directions]}"
    why = {
        ANGLE: "stays at its order while the speed changes",
        HERTZ: "stays at its frequency in hertz: a resonance or disturbance, not bound to the angle",
        ONE_SPEED: "seen at one speed only, so angle and time are not told apart",
        OPEN: "not seen at every speed",
    }
    names = "; or ".join(line.names) or ("" if line.bound == HERTZ else "no known order")
    return f"{text}; {why[line.bound]}" + (f"; {names}" if names else "")
