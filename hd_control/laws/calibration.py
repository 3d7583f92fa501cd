"""Gauge bridge and sensors: what they indicate, the way back, and the bridge's parameters from a slow turn.

    indicated = gain tau + offset + drift (T - T_0) + sum_{n = 2, 4} a_n cos n beta + b_n sin n beta + f sgn(q')

beta is the angle from the long axis of the wave generator to the gauge, rad; `GaugeModel` is the same model without f,
as the fusion law inverts it. `fit_gauge`: linear least squares on a slow turn whose joint torque is known; errors by
leaving out one block of time after the other, so that slow residuals count. f, the friction of the link's bearing, is
no parameter of the bridge: it only keeps the offset clean, where the joint turns in both directions.
"""

from __future__ import annotations

import math
from collections.abc import Collection, Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np

from hd_control.core.arrays import FloatArray
from hd_control.core.errors import BagError

# ---- The bridge on the flexspline. Hashimoto (3)-(13) ----------------------------------------------
#
# The second harmonic comes from the angle error between two gauge pairs that should stand at 90 degrees; the fourth is
# not cancelled by such pairs at all.


@dataclass(frozen=True)
class GaugeModel:
    """Parameters of one bridge. Torques N m, temperature degC, `offset_drift` N m/K, `gain` without unit."""

    gain: float = 1.0
    offset: float = 0.0
    cosine_2: float = 0.0
    sine_2: float = 0.0
    cosine_4: float = 0.0
    sine_4: float = 0.0
    offset_drift: float = 0.0
    reference_temperature: float = 20.0


def ripple(model: GaugeModel, gauge_angle: Any) -> Any:
    """The part of the indicated torque that follows the wave generator, N m; floats or arrays."""
    return (
        model.cosine_2 * np.cos(2.0 * gauge_angle)
        + model.sine_2 * np.sin(2.0 * gauge_angle)
        + model.cosine_4 * np.cos(4.0 * gauge_angle)
        + model.sine_4 * np.sin(4.0 * gauge_angle)
    )


def indicate(model: GaugeModel, torque: Any, gauge_angle: Any, temperature: float = math.nan) -> Any:
    """What the bridge indicates for a joint torque, N m. An unknown temperature (not a number) means no drift."""
    return model.gain * torque + _zero(model, temperature) + ripple(model, gauge_angle)


def correct(model: GaugeModel, indicated: Any, gauge_angle: Any, temperature: float = math.nan) -> Any:
    """The joint torque behind an indicated one, N m; the exact inverse of `indicate`."""
    return (indicated - _zero(model, temperature) - ripple(model, gauge_angle)) / model.gain


def _zero(model: GaugeModel, temperature: float) -> float:
    warm = temperature - model.reference_temperature
    return model.offset + (model.offset_drift * warm if math.isfinite(warm) else 0.0)


def misalignment_ripple(
    misalignment: float, modulation_strain: float, rated_strain: float, rated_torque: float
) -> tuple[float, float]:
    """(cos 2 beta, sin 2 beta) coefficients in N m of two pairs at 90 degrees + `misalignment` rad. Hashimoto (9)-(13).

    `modulation_strain` is Psi_0 of one pair, `rated_strain` the torsional strain at `rated_torque` N m. The ripple is
    E_R rated_torque sin(2 beta + gamma) with E_R = Psi_0 |sin m| / (2 rated_strain) and
    gamma = atan2(sin 2m, 1 - cos 2m).
    """
    size = rated_torque * modulation_strain * abs(math.sin(misalignment)) / (2.0 * rated_strain)
    phase = math.atan2(math.sin(2.0 * misalignment), 1.0 - math.cos(2.0 * misalignment))
    return size * math.sin(phase), size * math.cos(phase)


def bridge_gain(
    gauge_factor: float, supply_voltage: float, thickness: float, inner_radius: float, outer_radius: float, shear: float
) -> float:
    """Output of the bridge per joint torque, V/(N m). Hashimoto (8); lengths m, shear modulus Pa, supply V."""
    both = inner_radius + outer_radius
    return gauge_factor * supply_voltage * both / (8.0 * math.pi * thickness * shear * inner_radius**2 * outer_radius)


# ---- Counters and angles: resolution, quantisation, unwrapping; readable forms, the fusion law has them compiled ----


def motor_count(counts_per_turn: float, gear_ratio: float) -> float:
    """One motor-encoder count as an angle at the joint, rad: 2 pi / (counts N)."""
    return 2.0 * math.pi / (counts_per_turn * gear_ratio)


def joint_count(bits: int) -> float:
    """One count of a joint sensor, rad: 2 pi / 2^bits."""
    return 2.0 * math.pi / 2.0**bits


def quantise(angle: Any, count: float) -> Any:
    """The reading of a sensor with resolution `count`: count floor(angle / count + 1/2). Floats or arrays, rad."""
    return count * np.floor(np.asarray(angle) / count + 0.5)


def unwrap_step(reading: float, period: float, last: float, turns: float) -> tuple[float, float]:
    """(continuous angle, new turns) of one reading, rad. The modular difference to `last` is below half a period.

    The number of periods is kept, not a running sum, so no rounding piles up. A period of 0 leaves the reading alone.
    """
    if period > 0.0:
        turns -= math.floor((reading - last) / period + 0.5)
    return reading + turns * period, turns


def unwrap(readings: FloatArray, period: float) -> FloatArray:
    """A whole record (ticks,) made continuous; correct for steps below half a period. Starts at the first reading."""
    readings = np.asarray(readings, dtype=float)
    jumps = np.floor(np.diff(readings, prepend=readings[:1]) / period + 0.5)
    return np.asarray(readings - np.cumsum(jumps) * period)


# ---- The slow turn ---------------------------------------------------------------------------------


PARTS = ("ripple", "offset", "gain")
RIPPLE = ("cosine_2", "sine_2", "cosine_4", "sine_4")
MOVING, SLOW = 2e-3, 60.0
"""rad/s of the joint below which its direction is not known; rad/s of the rotor above which a turn is not slow."""
TURNS, BLOCKS, GAIN_ERROR, WARM = 2.0, 20, 0.01, 5.0
"""Needed turns of the wave generator; blocks of time; largest error of the gain; K from which a drift is fitted."""


@dataclass(frozen=True)
class SlowTurn:
    """One joint's slow turn, columns (n,) without gaps: N m, rad, rad/s of the joint and of the rotor, degC.

    `temperature` None: not recorded. `torque` is the joint torque that the link needs, from the model.
    """

    joint: str
    indicated: FloatArray
    torque: FloatArray
    gauge_angle: FloatArray
    joint_velocity: FloatArray
    rotor_velocity: FloatArray
    temperature: FloatArray | None = None

    def taken(self) -> SlowTurn:
        """The rows where the joint moves, and slowly."""
        keep = (np.abs(self.joint_velocity) > MOVING) & (np.abs(self.rotor_velocity) <= SLOW)
        warm = None if self.temperature is None else self.temperature[keep]
        return SlowTurn(
            self.joint, self.indicated[keep], self.torque[keep], self.gauge_angle[keep], self.joint_velocity[keep],
            self.rotor_velocity[keep], warm,
        )  # fmt: skip

    @property
    def turns(self) -> float:
        """Turns of the wave generator under the gauges that the rows cover, each angle counted once."""
        return float(np.unique(np.floor(self.gauge_angle / (0.05 * math.pi))).size) / 40.0


@dataclass(frozen=True)
class GaugeFit:
    """Estimated parameters of one bridge by the names of GaugeModel, their standard errors, and how well they fit.

    `before` and `after`: RMS of indicated minus expected torque with the old and the new parameters, N m.
    """

    model: GaugeModel
    errors: Mapping[str, float]
    before: float
    after: float
    rows: int
    turns: float
    torque_span: float
    notes: tuple[str, ...]


def fit_gauge(turn: SlowTurn, old: GaugeModel, parts: Collection[str] = PARTS) -> GaugeFit:
    """Estimates `parts`; the others stay as in `old`. Raises BagError if the turn does not determine them."""
    rows = turn.taken()
    _check_motion(rows, parts)
    columns, known = _columns(rows, old, parts)
    values, errors = _solve(np.column_stack(list(columns.values())), rows.indicated - known)
    found = dict(zip(columns, values.tolist(), strict=True))
    spread = dict(zip(columns, errors.tolist(), strict=True))
    names = [name for name in columns if name in GaugeModel.__dataclass_fields__]
    new = GaugeModel(**{**old.__dict__, **{name: found[name] for name in names}})
    after = _rms(rows.indicated - _expected(rows, new) - found.get("friction", 0.0) * np.sign(rows.joint_velocity))
    fit = GaugeFit(
        new, {name: spread[name] for name in names}, _rms(rows.indicated - _expected(rows, old)), after,
        rows.indicated.size, rows.turns, float(np.ptp(rows.torque)), _notes(rows, columns, parts),
    )  # fmt: skip
    _check_errors(turn.joint, fit)
    return fit


def _expected(rows: SlowTurn, model: GaugeModel) -> FloatArray:
    drift = np.zeros_like(rows.torque)
    if rows.temperature is not None:
        warm = rows.temperature - model.reference_temperature
        drift = np.where(np.isfinite(warm), model.offset_drift * warm, 0.0)
    return np.asarray(model.gain * rows.torque + model.offset + drift + ripple(model, rows.gauge_angle))


def _both_ways(rows: SlowTurn) -> bool:
    share = float(np.mean(rows.joint_velocity > 0.0))
    return 0.2 < share < 0.8


def _warms(rows: SlowTurn) -> bool:
    warm = rows.temperature
    return warm is not None and bool(np.isfinite(warm).all()) and float(np.ptp(warm)) >= WARM


def _columns(rows: SlowTurn, old: GaugeModel, parts: Collection[str]) -> tuple[dict[str, FloatArray], FloatArray]:
    """Regressors by parameter name, and what is known already, (n,)."""
    columns: dict[str, FloatArray] = {}
    fixed = dict(old.__dict__)
    if "gain" in parts:
        columns["gain"], fixed["gain"] = rows.torque, 0.0
    if "offset" in parts:
        columns["offset"], fixed["offset"] = np.ones_like(rows.torque), 0.0
        if _warms(rows) and rows.temperature is not None:
            columns["offset_drift"], fixed["offset_drift"] = rows.temperature - old.reference_temperature, 0.0
        if _both_ways(rows):
            columns["friction"] = np.sign(rows.joint_velocity)
    if "ripple" in parts:
        for name in RIPPLE:
            columns[name] = np.asarray(ripple(GaugeModel(**{name: 1.0}), rows.gauge_angle))
            fixed[name] = 0.0
        if "offset" not in parts:
            columns["rest"] = np.ones_like(rows.torque)
    return columns, _expected(rows, GaugeModel(**fixed))


def _solve(table: FloatArray, wanted: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Least squares and its standard errors by the jackknife over blocks of time. Infinite where it has no answer."""
    parts = np.array_split(np.arange(len(wanted)), BLOCKS)
    squares = np.array([table[part].T @ table[part] for part in parts])
    sides = np.array([table[part].T @ wanted[part] for part in parts])
    scale = np.sqrt(np.diag(squares.sum(axis=0)))
    if not np.all(scale > 0.0):
        return np.full(len(scale), math.nan), np.full(len(scale), math.inf)
    normal, side = squares.sum(axis=0) / np.outer(scale, scale), sides.sum(axis=0) / scale
    if np.linalg.cond(normal) > 1e8:
        return np.full(len(scale), math.nan), np.full(len(scale), math.inf)
    best = np.linalg.solve(normal, side) / scale
    left = [
        np.linalg.lstsq(squares.sum(axis=0) - a, sides.sum(axis=0) - b)[0] for a, b in zip(squares, sides, strict=True)
    ]
    spread = np.array(left) - np.mean(left, axis=0)
    return best, np.sqrt((BLOCKS - 1) / BLOCKS * np.sum(spread**2, axis=0))


def _rms(values: FloatArray) -> float:
    return float(np.sqrt(np.mean(values**2)))


def _check_motion(rows: SlowTurn, parts: Collection[str]) -> None:
    finite = bool(np.isfinite(rows.indicated).all() and np.isfinite(rows.torque).all())
    if not finite:
        raise BagError(f"{rows.joint}: gauge or link torque is not finite in the slow turn")
    if rows.indicated.size < 50 * BLOCKS or rows.turns < TURNS:
        raise BagError(
            f"{rows.joint}: the wave generator turns {rows.turns:.1f} times slowly (rotor below {SLOW:g} rad/s, "
            f"{rows.indicated.size} samples); a calibration needs {TURNS:g} turns and {50 * BLOCKS} samples: record "
            "one slow turn of this joint there and back"
        )


def _check_errors(joint: str, fit: GaugeFit) -> None:
    """Refuses what the recording does not determine."""
    errors = fit.errors
    if "gain" in errors and not errors["gain"] <= GAIN_ERROR * abs(fit.model.gain):
        raise BagError(
            f"{joint}: the gain is not determined by this turn (standard error {errors['gain']:.2g}, allowed "
            f"{GAIN_ERROR:g} of it; the link's torque spans {fit.torque_span:.3g} N m): turn through a wider range of "
            "load, or leave it out with --only ripple offset"
        )
    for name in ("offset", *RIPPLE):
        if name in errors and not errors[name] <= fit.after:
            raise BagError(
                f"{joint}: {name} is not determined by this turn (standard error {errors[name]:.2g} N m, residual "
                f"{fit.after:.2g} N m): record a longer turn, or choose with --only"
            )
    if not 0.1 <= fit.model.gain <= 10.0:
        raise BagError(
            f"{joint}: a gain of {fit.model.gain:.3g} is outside [0.1, 10]: check model and sign of the gauge"
        )


def _notes(rows: SlowTurn, columns: Mapping[str, FloatArray], parts: Collection[str]) -> tuple[str, ...]:
    found = []
    if "offset" in parts and not _both_ways(rows):
        found.append("turned in one direction: friction of the link's bearing, if any, stands in the offset")
    if "offset" in parts and "offset_drift" not in columns:
        found.append(f"temperature drift kept: the recording does not span {WARM:g} K")
    return tuple(found)
