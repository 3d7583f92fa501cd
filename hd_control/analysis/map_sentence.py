"""One plain sentence that says where the error of a channel sits, from its condition maps."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from hd_control.analysis.condition_maps import SPEEDS, ChannelMaps, ConditionMap

NAMES = {
    "motor_velocity": "motor speed",
    "joint_velocity": "joint speed",
    "joint_torque": "joint torque",
    "motor_shaft_position": "motor angle",
    "joint_position": "joint angle",
    "direction": "direction",
    "reversal_travel": "travel since the last reversal",
    "reversal_time": "time since the last reversal",
    "temperature": "temperature",
    "time": "time",
}
FOLLOWS = 0.25
"""Share of the error that the means over a variable must explain to be called a dependence."""
CONCENTRATED = 0.12
"""Nats per sample by which the error's place must differ from the time's to be called concentrated."""
SIMPLER = 0.03
"""A variable with fewer bins is named if it explains nearly as much."""
INDIRECT = 0.6
"""Weight of ranges of time and temperature, and of times after a reversal that do not begin at it: with a motion that
changes over time they follow from speed and load."""
AT_FLOOR = 1.1
"""Error over noise floor up to which there is nothing to explain."""


@dataclass(frozen=True)
class Range:
    """Neighbouring bins of a variable: limits, share of the error and of the time, nats per sample by which the two
    differ."""

    variable: str
    low: float
    high: float
    share: float
    time_share: float
    nats: float
    from_start: bool
    to_end: bool


def sentence(maps: ChannelMaps, noise_floor: float = 0.0) -> str:
    """Where the error sits, in one sentence. `noise_floor` in the unit of the channel, 0 if not known."""
    if not maps.maps:
        return "There are no rows to judge."
    if maps.rms <= AT_FLOOR * noise_floor:
        return "The error is at the noise floor: nothing is left to explain here."
    follows, where = dependence(maps), concentration(maps)
    parts = []
    if where is not None and where.nats >= CONCENTRATED:
        share, time_share = 100.0 * where.share, 100.0 * where.time_share
        parts.append(f"{share:.0f} % of the error is {place(where)}, in {time_share:.0f} % of the time")
    if follows is not None:
        also = ", split by direction," if follows.variable != "direction" and _split_matters(follows) else ""
        parts.append(
            f"the mean over {NAMES[follows.variable]}{also} explains {100.0 * follows.explained:.0f} % of the error"
        )
    text = "; ".join(parts) or "the error is spread evenly over speed, load, angle and time"
    return text[0].upper() + text[1:] + "."


def dependence(maps: ChannelMaps) -> ConditionMap | None:
    """The map whose means explain most of the error; None if none explains enough. Nearly equal: the coarsest."""
    best = max((item.explained for item in maps.maps.values()), default=0.0)
    if best < FOLLOWS:
        return None
    near = [item for item in maps.maps.values() if item.explained >= best - SIMPLER]
    return min(near, key=lambda item: item.edges.size)


def concentration(maps: ChannelMaps) -> Range | None:
    """The neighbouring bins of any one variable in which the error is most concentrated."""
    found = [_densest(item) for item in maps.maps.values() if item.variable != "direction"]
    return max((item for item in found if item is not None), key=_weight, default=None)


def _weight(item: Range) -> float:
    indirect = item.variable in ("time", "temperature")
    indirect = indirect or (item.variable.startswith("reversal") and not item.from_start)
    return INDIRECT * item.nats if indirect else item.nats


def _densest(item: ConditionMap) -> Range | None:
    share = item.bins.share.sum(axis=0)
    count = item.bins.count.sum(axis=0)
    bins = share.size
    error = np.concatenate([[0.0], np.cumsum(share / max(share.sum(), 1e-300))])
    time = np.concatenate([[0.0], np.cumsum(count / count.sum())])
    low, high = np.triu_indices(bins + 1, 1)
    s, p = error[high] - error[low], time[high] - time[low]
    s, p = np.clip(s, 1e-12, 1.0 - 1e-12), np.clip(p, 1e-12, 1.0 - 1e-12)
    nats = s * np.log(s / p) + (1.0 - s) * np.log((1.0 - s) / (1.0 - p))
    nats[s <= p] = 0.0
    best = int(np.argmax(nats))
    i, j = int(low[best]), int(high[best])
    if nats[best] <= 0.0:
        return None
    return Range(
        item.variable,
        float(item.edges[i]),
        float(item.edges[j]),
        float(s[best]),
        float(p[best]),
        float(nats[best]),
        i == 0,
        j == bins,
    )


def _split_matters(item: ConditionMap) -> bool:
    """True if the means of the two directions differ by more than they share."""
    count, mean = item.bins.count[[0, 2]], np.nan_to_num(item.bins.mean[[0, 2]])
    both = np.all(count > 0, axis=0)
    odd, even = mean[1, both] - mean[0, both], mean[1, both] + mean[0, both]
    weight = count[:, both].min(axis=0)
    return bool(np.sum(weight * odd**2) > np.sum(weight * even**2))


def place(where: Range) -> str:
    """A range in words: `within 10 ms after a reversal`, `at motor speeds below 0.1 rad/s`."""
    low, high, name = where.low, where.high, where.variable
    if name == "reversal_time":
        return _after(low, high, where, 1e3, "ms") if high < 1.0 else _after(low, high, where, 1.0, "s")
    if name == "reversal_travel":
        return _after(low, high, where, 1e3, "mrad")
    if name in ("joint_position", "motor_shaft_position"):
        return f"at {NAMES[name]}s from {np.degrees(low):.0f} to {np.degrees(high):.0f} degrees"
    if name == "time":
        return f"between {low:.1f} and {high:.1f} s"
    unit = "degrees Celsius" if name == "temperature" else "rad/s" if name in SPEEDS else "N m"
    if where.from_start and where.to_end or not (where.from_start or where.to_end):
        return f"at {NAMES[name]}s from {low:.3g} to {high:.3g} {unit}"
    return f"at {NAMES[name]}s " + (f"below {high:.3g} {unit}" if where.from_start else f"above {low:.3g} {unit}")


def _after(low: float, high: float, where: Range, factor: float, unit: str) -> str:
    if where.from_start:
        return f"within {factor * high:.3g} {unit} after a reversal"
    if where.to_end:
        return f"more than {factor * low:.3g} {unit} after a reversal"
    return f"from {factor * low:.3g} to {factor * high:.3g} {unit} after a reversal"
