"""Candidates: effects with a shape and free curves as groups of columns, each added or dropped as one.

A free curve is a cubic spline of one variable without a law, the net for what no library entry explains.
"""

from __future__ import annotations

from collections.abc import Callable, Collection, Iterable, Iterator, Mapping
from dataclasses import dataclass, field

import numpy as np

from hd_control.core.arrays import FloatArray, IntArray
from hd_control.drive.effect import GAUGE, LINK, MOTOR, TRANSMISSION, Columns, DriveStates, Effect, Shape

# ---- Free curves -----------------------------------------------------------------------------------


ORDERS = (1, 2, 3, 4, 6)


@dataclass(frozen=True)
class Curve:
    """A free curve: the variables that it depends on, in words, and its columns by channel, made when asked for.

    `knots` (K,) of the variable, `kind` plain | with direction | with speed | with torque (what the curve multiplies).
    """

    name: str
    variables: tuple[str, ...]
    columns_at: Callable[[DriveStates], Columns]
    knots: FloatArray
    variable: str
    kind: str = "plain"
    reads: str = ""


def splines(x: FloatArray, knots: FloatArray) -> FloatArray:
    """Cubic B-splines (n, K + 2) that add up to one; constant beyond the outer knots."""
    from scipy.interpolate import BSpline

    inside = np.clip(x, knots[0], knots[-1])
    full = np.concatenate([np.repeat(knots[0], 3), knots, np.repeat(knots[-1], 3)])
    return np.asarray(BSpline.design_matrix(inside, full, 3).toarray(order="F"))


def quantile_knots(x: FloatArray, count: int) -> FloatArray:
    """Knots at even quantiles over the whole range, duplicates removed: no law is better at the ends only."""
    knots = np.unique(np.quantile(x, np.linspace(0.0, 1.0, count)))
    return np.asarray(knots)


def even_knots(x: FloatArray, count: int) -> FloatArray:
    """Knots at even distances over the range of x."""
    return np.linspace(x.min(), x.max(), count)


def _usable(x: FloatArray, least: float) -> bool:
    return bool(np.isfinite(x).all() and np.ptp(np.quantile(x, [0.01, 0.99])) > least)


Factor = Callable[[DriveStates], FloatArray]
FACTORS: dict[str, Factor] = {
    "with direction": lambda s: s.motor_direction,
    "with speed": lambda s: s.motor_velocity,
    "with torque": lambda s: s.joint_torque,
}


def curves(states: DriveStates, channels: set[str], time_too: bool = True) -> list[Curve]:
    """All free curves that this recording's signals and motion allow."""
    found: list[Curve] = []
    if MOTOR in channels:
        found += _motor_curves(states, time_too)
    if TRANSMISSION in channels:
        found += _transmission_curves(states, time_too)
    if LINK in channels:
        found += _link_curves(states, time_too)
    if MOTOR in channels and LINK in channels:
        found += _gauge_curves(states, time_too)
    return found


def more_curves(s: DriveStates, channels: Collection[str]) -> list[Curve]:
    """Curves beyond these that only the innovations separate from what the balances hold: viscous friction of a place,
    friction of the link that depends on the place or comes and goes."""
    found: list[Curve] = []
    place = _usable(s.joint_position, 0.02)
    if MOTOR in channels and place:
        found += _make(MOTOR, s, "joint_position", s.joint_position, even_knots(s.joint_position, 12), "with speed")
    if LINK in channels and place:
        found += _make(LINK, s, "joint_position", s.joint_position, even_knots(s.joint_position, 16), "with direction")
    if LINK in channels:
        found += _make(LINK, s, "time", s.time, even_knots(s.time, 24), "with direction")
    return found


def _make(
    channel: str, states: DriveStates, variable: str, x: FloatArray, knots: FloatArray, kind: str = "plain"
) -> list[Curve]:
    if knots.size < 3:
        return []

    def columns_at(states: DriveStates) -> Columns:
        columns = splines(x, knots)
        if kind != "plain":
            columns *= FACTORS[kind](states)[:, None]
        elif channel == TRANSMISSION:  # a constant belongs to the assembly zero
            columns -= columns.mean(axis=0)
        return {channel: columns}

    variables = (variable,) if kind == "plain" else (variable, kind.removeprefix("with "))
    return [Curve(f"{channel}: {variable} {kind}", variables, columns_at, knots, variable, kind)]


def _waves(states: DriveStates) -> FloatArray:
    angle = states.motor_shaft_position[:, None] * np.array(ORDERS)
    return np.concatenate([np.cos(angle), np.sin(angle)], axis=1)


def _orders(channel: str, kind: str = "plain") -> Curve:
    def columns_at(states: DriveStates) -> Columns:
        columns = _waves(states)
        return {channel: columns if kind == "plain" else columns * FACTORS[kind](states)[:, None]}

    variables = ("motor_shaft_position",) if kind == "plain" else ("motor_shaft_position", kind.removeprefix("with "))
    name, knots = f"{channel}: motor_shaft_position {kind}", np.array(ORDERS, dtype=float)
    return Curve(name, variables, columns_at, knots, "motor_shaft_position", kind)


def _turned(states: DriveStates) -> bool:
    return bool(np.ptp(states.motor_shaft_position) > 2.0 * np.pi)


def _motor_curves(s: DriveStates, time_too: bool) -> list[Curve]:
    found: list[Curve] = []
    if _usable(s.motor_velocity, 1e-3):
        found += _make(MOTOR, s, "motor_velocity", s.motor_velocity, quantile_knots(s.motor_velocity, 15))
    if _usable(s.joint_position, 0.02):
        knots = even_knots(s.joint_position, 24)
        found += _make(MOTOR, s, "joint_position", s.joint_position, knots)
        found += _make(MOTOR, s, "joint_position", s.joint_position, knots, "with direction")
    if np.isfinite(s.joint_torque).all() and _usable(s.joint_torque, 1e-6):
        load = np.abs(s.joint_torque)
        found += _make(MOTOR, s, "joint_torque", s.joint_torque, quantile_knots(s.joint_torque, 9))
        found += _make(MOTOR, s, "joint_torque", load, quantile_knots(load, 7), "with direction")
        found += _make(MOTOR, s, "joint_torque", load, quantile_knots(load, 7), "with speed")
        found += [_orders(MOTOR, "with torque")] if _turned(s) else []
    if time_too:
        for kind, count in (("plain", 12), ("with direction", 24), ("with speed", 12)):
            found += _make(MOTOR, s, "time", s.time, even_knots(s.time, count), kind)
    if _usable(s.temperature, 1.0):
        knots = even_knots(s.temperature, 6)
        for kind in ("plain", "with direction"):
            found += _make(MOTOR, s, "temperature", s.temperature, knots, kind)
    if np.isfinite(s.motor_torque).all() and _usable(s.motor_torque, 1e-6):
        found += _make(MOTOR, s, "motor_torque", s.motor_torque, quantile_knots(s.motor_torque, 9))
    if _turned(s):
        found += [_orders(MOTOR), _orders(MOTOR, "with direction")]
    return found


def _transmission_curves(s: DriveStates, time_too: bool) -> list[Curve]:
    found: list[Curve] = []
    if _usable(s.joint_torque, 1e-6):
        found += _make(TRANSMISSION, s, "joint_torque", s.joint_torque, quantile_knots(s.joint_torque, 15))
    if _usable(s.joint_position, 0.02):
        found += _make(TRANSMISSION, s, "joint_position", s.joint_position, even_knots(s.joint_position, 120))
    if time_too:
        found += _make(TRANSMISSION, s, "time", s.time, even_knots(s.time, 12))
    if _usable(s.motor_velocity, 1e-3):
        found += _make(TRANSMISSION, s, "motor_velocity", s.motor_velocity, quantile_knots(s.motor_velocity, 11))
    if _usable(s.temperature, 1.0):
        found += _make(TRANSMISSION, s, "temperature", s.temperature, even_knots(s.temperature, 6))
    if _turned(s):
        found += [_orders(TRANSMISSION), _orders(TRANSMISSION, "with torque")]
    return found


def _link_curves(s: DriveStates, time_too: bool) -> list[Curve]:
    found: list[Curve] = []
    if _usable(s.joint_position, 0.02):
        found += _make(LINK, s, "joint_position", s.joint_position, even_knots(s.joint_position, 24))
    if _usable(s.joint_velocity, 1e-3):
        found += _make(LINK, s, "joint_velocity", s.joint_velocity, quantile_knots(s.joint_velocity, 15))
    if time_too:
        found += _make(LINK, s, "time", s.time, even_knots(s.time, 12))
    if _usable(s.temperature, 1.0):
        found += _make(LINK, s, "temperature", s.temperature, even_knots(s.temperature, 6))
    if _usable(s.joint_torque, 1e-6):
        found += _make(LINK, s, "joint_torque", s.joint_torque, quantile_knots(s.joint_torque, 9))
    if _turned(s):
        found += [_orders(LINK)]
    return found


def _gauge_curves(s: DriveStates, time_too: bool) -> list[Curve]:
    """The gauge reads wrong, in all balances at once, one curve."""
    sources: list[tuple[str, FloatArray, FloatArray]] = []
    if time_too:
        sources.append(("time", s.time, even_knots(s.time, 12)))
    if _usable(s.temperature, 1.0):
        sources.append(("temperature", s.temperature, even_knots(s.temperature, 6)))
    if _usable(s.joint_torque, 1e-6):
        sources.append(("joint_torque", s.joint_torque, quantile_knots(s.joint_torque, 9)))
    found = [_gauge_curve(variable, x, knots) for variable, x, knots in sources if knots.size >= 3]
    if _turned(s):
        name, knots = "motor_shaft_position", np.array(ORDERS, dtype=float)
        found.append(
            Curve(
                f"gauge: {name} plain",
                (name,),
                lambda states: misread(states, _waves(states)),
                knots,
                name,
                reads=GAUGE,
            )
        )
    return found


def _gauge_curve(variable: str, x: FloatArray, knots: FloatArray) -> Curve:
    name = f"gauge: {variable} plain"
    columns = lambda states: misread(states, splines(x, knots))  # noqa: E731
    return Curve(name, (variable,), columns, knots, variable, reads=GAUGE)


def misread(states: DriveStates, columns: FloatArray) -> Columns:
    """Effect of a gauge bias on the three balances: -1 on the rotor, +1 on the link, a torsion that is not there."""
    found = {MOTOR: -columns, LINK: columns}
    if states.torsional_compliance > 0.0:
        torsion = _behind_damper(columns, states.damping_time / states.period)
        found[TRANSMISSION] = states.torsional_compliance * (torsion - torsion.mean(axis=0))
    return found


def _behind_damper(columns: FloatArray, steps: float) -> FloatArray:
    """Columns (n, k) after 1 / (1 + d s), `steps` = d over the sample period, at rest in the first row."""
    from scipy.signal import lfilter

    if not steps > 0.0:
        return columns
    gain, pole = 1.0 / (1.0 + 2.0 * steps), (2.0 * steps - 1.0) / (2.0 * steps + 1.0)
    start = (pole + gain) * columns[:1]  # the memory that gives the first row out for the first row in, for ever
    return np.asarray(lfilter([gain, gain], [1.0, -pole], columns, axis=0, zi=start)[0])


# ---- Groups and candidates -------------------------------------------------------------------------


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


@dataclass(frozen=True, eq=False)
class Candidate:
    """A group before it is in the dictionary: raw columns (n, k) by channel at the rate of the recording.

    `rows`: what the equations make of them, if that is known already.
    """

    name: str
    columns: Columns
    effect: type[Effect] | None = None
    shape: Shape = field(default_factory=dict)
    curve: Curve | None = None
    rows: Mapping[str, FloatArray] | None = None

    @property
    def reads(self) -> str:
        """The signal that is only read wrong; empty for what acts on the drive."""
        if self.curve is not None:
            return self.curve.reads
        return "" if self.effect is None else self.effect.reads


def library_candidates(
    effects: Iterable[type[Effect]], states: DriveStates, channels: Collection[str], more: bool = False
) -> Iterator[Candidate]:
    """Every shape of every effect that acts on one of the channels and whose columns are finite on this recording;
    `more`: also those that only the innovations can separate.

    One at a time: the columns of all of them together would not fit a small computer.
    """
    for effect in effects:
        for shape in (*effect.shapes(states), *(effect.more_shapes(states) if more else ())):
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
