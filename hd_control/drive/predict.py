"""Free run: what the model predicts from a measured start when only the recorded motor torque drives it.

All windows of a recording run at once, as vectors. One step holds the motor torque; the spring is implicit (midpoint),
Coulomb friction is set-valued (soft threshold), effects follow through `Effect.advance`:

    I* dv = T (u - tau - R) - T G s,  M dw = T (tau - rest - L),  tau = tau_mid + c (dv - dw),  c = T k_t / 4 + k d / 2

with R + G s the motor columns, L the link columns, k_t the tangent stiffness of spring and transmission columns.
Source: docs/equations/prediction.md (W1), (W2), (W3).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np

from hd_control.core.arrays import BoolArray, FloatArray, IntArray
from hd_control.core.errors import ConfigError
from hd_control.drive.effect import GAUGE, LINK, MOTOR, TRANSMISSION, DriveStates, Effect, Shape
from hd_control.drive.link import OwnLink
from hd_control.drive.model import JointModel

# ---- What is stepped: the numbers of the base, the terms of the other effects, the recording behind them ----


BASE = ("rotor_inertia", "torsional_stiffness", "coulomb_friction", "viscous_friction", "link_dynamics")


@dataclass(frozen=True)
class Term:
    """One effect of the model beyond the base, and what its columns depend on."""

    effect: type[Effect]
    shape: Shape
    coefficients: FloatArray
    on_direction: bool
    on_transmission: bool
    on_torque: bool

    def value(self, states: DriveStates, memory: FloatArray) -> tuple[dict[str, FloatArray], FloatArray]:
        """What the effect adds to each channel, (runs,), and its new memory."""
        columns, memory = self.effect.advance(states, self.shape, memory)
        return {channel: column @ self.coefficients for channel, column in columns.items()}, memory


@dataclass(frozen=True)
class Plant:
    """Numbers of the base, terms, and the recording with the torque corrected for what the gauge is known to add."""

    states: DriveStates
    link: OwnLink
    terms: tuple[Term, ...]
    inertia: float
    stiffness: float
    damping_time: float
    coulomb: float
    viscous: float
    zero: float

    @classmethod
    def of(cls, joint: JointModel, states: DriveStates, link: OwnLink, usable: BoolArray) -> Plant:
        stiffness = joint.number("torsional_stiffness", "torsional_stiffness")
        inertia = joint.number("rotor_inertia", "rotor_inertia")
        if stiffness <= 0.0 or inertia <= 0.0:
            raise ConfigError("a prediction needs torsional_stiffness and rotor_inertia in the model")
        known = [term for term in joint.terms(states.torque_scale) if term[0].name not in BASE]
        gauge = [term for term in known if term[0].reads == GAUGE]
        added = sum((e.columns(states, s)[LINK] @ c for e, s, c in gauge), np.zeros(states.time.size))
        states = replace(states, joint_torque=states.gauge_torque - added)
        terms = tuple(_term(e, s, c, states) for e, s, c in known if e.reads != GAUGE)
        torsion = [t.effect.columns(states, t.shape).get(TRANSMISSION) for t in terms]
        wave = sum((c @ t.coefficients for c, t in zip(torsion, terms, strict=True) if c is not None), 0.0)
        zero = states.joint_position - states.motor_position + states.joint_torque / stiffness - wave
        return cls(
            states=states,
            link=link,
            terms=terms,
            inertia=inertia,
            stiffness=stiffness,
            damping_time=joint.number("torsional_stiffness", "damping_time"),
            coulomb=joint.number("coulomb_friction", "coulomb_torque"),
            viscous=joint.number("viscous_friction", "viscous"),
            zero=_median(zero[usable]),
        )

    def measured(self, starts: IntArray, steps: int) -> tuple[FloatArray, FloatArray, FloatArray]:
        """Motor position, joint position and joint torque, each (steps + 1, windows)."""
        index = starts + np.arange(steps + 1)[:, None]
        s = self.states
        return s.motor_position[index], s.joint_position[index], s.joint_torque[index]


def _median(values: FloatArray) -> float:
    """Of the real ones; 0 if there are none."""
    real = values[np.isfinite(values)]
    return float(np.median(real)) if real.size else 0.0


def _term(effect: type[Effect], shape: Shape, coefficients: FloatArray, states: DriveStates) -> Term:
    """Probes on some rows of the recording whether the columns know direction and torque."""
    rows = np.flatnonzero(np.isfinite(states.joint_torque))[:: max(1, states.time.size // 50)]
    some = rows_of(states, rows)

    def depends(a: DriveStates, b: DriveStates, channels: Sequence[str]) -> bool:
        first, second = (effect.columns(x, shape) for x in (a, b))
        return any(c in first and not np.allclose(first[c], second[c], equal_nan=True) for c in channels)

    ones = np.ones(rows.size)
    direction = depends(replace(some, motor_direction=ones), replace(some, motor_direction=-ones), (MOTOR,))
    moved = replace(some, joint_torque=1.1 * some.joint_torque + 0.01 * states.torque_scale)
    follows = depends(some, moved, (TRANSMISSION,))
    return Term(effect, shape, coefficients, direction, TRANSMISSION in effect.columns(some, shape), follows)


def rows_of(states: DriveStates, rows: IntArray) -> DriveStates:
    """The states at some rows."""
    size = states.time.size
    arrays = {name: value for name, value in vars(states).items() if isinstance(value, np.ndarray)}
    some: dict[str, Any] = {name: value[rows] for name, value in arrays.items() if len(value) == size}
    return replace(states, **some)


# ---- One step for all windows at once --------------------------------------------------------------
#
# Source: docs/equations/prediction.md (W1), (W2).


NEWTON_ROUNDS = 2
SOFTEST = 0.02
"""Least tangent stiffness over the linear one that a transmission may have, e.g. inside a backlash gap."""


class Stepper:
    """Runs (windows,) of one plant. `phi`, `v`, `q`, `w`: motor and joint position and velocity; `tau` joint torque."""

    def __init__(self, plant: Plant, starts: IntArray) -> None:
        self.plant, self.starts = plant, starts
        s = plant.states
        self.phi, self.v, self.w = (x[starts].copy() for x in (s.motor_position, s.motor_velocity, s.joint_velocity))
        self.q = s.joint_position[starts].copy()
        self.tau = s.joint_torque[starts].copy()
        self.wave: FloatArray | None = None
        self.rate, self.acceleration, self.link_acceleration = (np.zeros(starts.size) for _ in range(3))
        self.steady = [n for n, t in enumerate(plant.terms) if t.on_transmission and not t.on_torque]
        self.follow = [n for n, t in enumerate(plant.terms) if t.on_transmission and t.on_torque]
        self.memory = [t.effect.memory_along(s, t.shape, starts) for t in plant.terms]
        # torque / k is the torsion a damping time ahead
        self._start_on_torsion(
            *(np.interp(s.time[starts] - plant.damping_time, s.time, x) for x in (s.joint_torque, s.joint_torque_rate))
        )

    def _start_on_torsion(self, tau: FloatArray, rate: FloatArray) -> None:
        """The start lies on the model's own torsion, and so does its rate where the torque rate is known: the joint
        sensor is too coarse to give the torque, and its velocity too slow at reversals."""
        k, dt = self.plant.stiffness, self.plant.states.period
        wave = self._waves(self._state(0, self.phi, self.q, self.tau))
        later = self._state(0, self.phi + dt * self.v, self.q + dt * self.w, self.tau + dt * rate)
        w = self.v - rate / k + (self._waves(later) - wave) / dt
        self.q = self.phi - tau / k + self.plant.zero + wave
        self.w = np.where(np.isfinite(w), w, self.w)

    def step(self, i: int) -> FloatArray:
        """One step from sample i; returns the mean joint torque over it."""
        plant, rows, T = self.plant, self.starts + i, self.plant.states.period
        phi, q = self.phi + 0.5 * T * self.v, self.q + 0.5 * T * self.w
        damping = plant.stiffness * plant.damping_time
        tau, tangent, waves = self._torsion(i, phi, q, damping * (self.v - self.w))
        state = self._state(i, phi, q, tau)
        resist, threshold, load = self._columns(state, waves)
        c = 0.25 * T * tangent + 0.5 * damping
        link = plant.link
        rest = 0.5 * (link.rest[rows] + link.rest[rows + 1]) + load
        rest += link.slope[rows] * (
            q - 0.5 * (plant.states.joint_position[rows] + plant.states.joint_position[rows + 1])
        )
        ease = T / (link.inertia[rows] + T * c)
        free = tau - c * ease * (tau - rest)
        push = state.motor_torque - resist - plant.viscous * self.v - free
        heavy = plant.inertia + T * (c * (1.0 - c * ease) + 0.5 * plant.viscous)
        drive = heavy * self.v + T * push
        v = np.sign(drive) * np.maximum(np.abs(drive) - T * (plant.coulomb + threshold), 0.0) / heavy
        change = v - self.v
        link_change = ease * (tau - rest + c * change)
        self.phi = self.phi + 0.5 * T * (self.v + v)
        self.q = self.q + T * (self.w + 0.5 * link_change)
        mean: FloatArray = tau + c * (change - link_change)
        self.rate, self.tau = (mean - self.tau) / T, mean
        self.v, self.w = v, self.w + link_change
        self.acceleration, self.link_acceleration = change / T, link_change / T
        return mean

    def _torsion(
        self, i: int, phi: FloatArray, q: FloatArray, damping: FloatArray
    ) -> tuple[FloatArray, FloatArray, dict[int, dict[str, FloatArray]]]:
        """Joint torque at the midpoint, tangent stiffness, and the terms that were evaluated on the way."""
        plant = self.plant
        k, known = plant.stiffness, {}
        torsion = phi - q + plant.zero
        if self.steady:
            wave = np.zeros(phi.shape)
            state = self._state(i, phi, q, self.tau)
            for n in self.steady:
                known[n], self.memory[n] = plant.terms[n].value(state, self.memory[n])
                wave = wave + known[n].get(TRANSMISSION, 0.0)
            torsion = torsion + wave
            if self.wave is not None:  # the damper also feels the waves that the motor runs over
                damping = damping + k * plant.damping_time * (wave - self.wave) / plant.states.period
            self.wave = wave
        tau, tangent = k * torsion, np.full(phi.shape, k)
        if self.follow:
            state = self._state(i, phi, q, self.tau - damping)
            tau, tangent = self._implicit(state, torsion)
            state.joint_torque[:] = tau + damping
            for n in self.follow:
                known[n], self.memory[n] = plant.terms[n].value(state, self.memory[n])
        return tau + damping, tangent, known

    def _implicit(self, state: DriveStates, torsion: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Torque of the spring and tangent stiffness where the transmission itself follows the torque, by Newton."""
        k, nudge = self.plant.stiffness, 1e-3 * self.plant.states.torque_scale
        tau, tangent = state.joint_torque.copy(), np.full(torsion.shape, k)
        for _ in range(NEWTON_ROUNDS):
            here, near = (self._following(state, tau + step) for step in (0.0, nudge))
            tangent = k / np.maximum(1.0 - k * (near - here) / nudge, 1e-3)
            tangent = np.maximum(tangent, SOFTEST * k)
            tau = tau + tangent * (torsion + here - tau / k)
        return tau, tangent

    def _following(self, state: DriveStates, tau: FloatArray) -> FloatArray:
        """What the terms that depend on torque add to the joint position at this torque."""
        state.joint_torque[:] = tau
        found = np.zeros(tau.shape)
        for n in self.follow:
            found += self.plant.terms[n].value(state, self.memory[n])[0].get(TRANSMISSION, 0.0)
        return found

    def _columns(
        self, state: DriveStates, known: dict[int, dict[str, FloatArray]]
    ) -> tuple[FloatArray, FloatArray, FloatArray]:
        """Resisting motor torque without direction, half its jump between the directions, resisting link torque."""
        resist, jump, load = (np.zeros(self.phi.shape) for _ in range(3))
        for n, term in enumerate(self.plant.terms):
            if n in known:
                values = known[n]
            elif term.on_direction:
                values, resist, jump = self._both(n, term, state, resist, jump)
            else:
                values, self.memory[n] = term.value(state, self.memory[n])
            if n in known or not term.on_direction:
                resist = resist + values.get(MOTOR, 0.0)
            load = load + values.get(LINK, 0.0)
        return resist, jump, load

    def _both(
        self, n: int, term: Term, state: DriveStates, resist: FloatArray, jump: FloatArray
    ) -> tuple[dict[str, FloatArray], FloatArray, FloatArray]:
        """A term whose motor column changes with the direction: both directions, one memory."""
        state.motor_direction[:] = -1.0
        back, _ = term.value(state, self.memory[n])
        state.motor_direction[:] = 1.0
        ahead, self.memory[n] = term.value(state, self.memory[n])
        state.motor_direction[:] = 0.0
        return ahead, resist + 0.5 * (ahead[MOTOR] + back[MOTOR]), jump + 0.5 * (ahead[MOTOR] - back[MOTOR])

    def _waves(self, state: DriveStates) -> FloatArray:
        """What all terms add to the joint position; memory stays."""
        found = np.zeros(self.phi.shape)
        for term, memory in zip(self.plant.terms, self.memory, strict=True):
            found = found + term.value(state, memory)[0].get(TRANSMISSION, 0.0)
        return found

    def _state(self, i: int, phi: FloatArray, q: FloatArray, tau: FloatArray) -> DriveStates:
        """The states of all runs at step i."""
        s, rows = self.plant.states, self.starts + i
        link = self.plant.link
        return DriveStates(
            period=s.period,
            gear_ratio=s.gear_ratio,
            torque_scale=s.torque_scale,
            time=s.time[rows],
            motor_position=phi,
            motor_velocity=self.v,
            motor_acceleration=self.acceleration,
            motor_direction=np.zeros(phi.shape),
            joint_position=q,
            joint_velocity=self.w,
            joint_acceleration=self.link_acceleration,
            gauge_torque=tau,
            joint_torque=tau,
            joint_torque_rate=self.rate,
            motor_torque=s.motor_torque[rows],
            temperature=s.temperature[rows],
            link_inertia_torque=link.inertia[rows] * self.link_acceleration,
            link_bias_torque=s.link_bias_torque[rows],
            link_regressor=None if s.link_regressor is None else s.link_regressor[rows],
            tool_regressor=None if s.tool_regressor is None else s.tool_regressor[rows],
            torsional_compliance=1.0 / self.plant.stiffness,
        )


# ---- The run ---------------------------------------------------------------------------------------


HORIZONS = ((0.5, 0.25), (5.0, 2.5))
"""s: length of a window and distance of starts, in which predictions are compared."""
LONGEST_STEP = 2e-3
"""s: a long window takes steps of this length if the samples are closer; the spring's mode lies below 60 Hz."""
LONG_WINDOW = 1.0
CLIP = 10.0
"""Errors above this many times the spread of the measurement at the end of the window are clipped and counted."""
LEAST_SPREAD = (1e-3, 1e-3, 0.1)
"""The spread of a recording at rest, so that slipping is an error and not clipped: rad, rad, share of torque scale."""
REPLAY_S = 2.0
"""s before the first start, so that effects with memory have a past."""
FEWEST_WINDOWS = 2


@dataclass(frozen=True)
class FreeRun:
    """RMS over all windows against horizon time, (h,): motor and joint position rad, joint torque N m.

    `hold_...`: the same for the prediction that everything keeps its start value. `clipped_share` of the windows ran
    away and count with the limit. `final_motor_position` (windows,): error at the end of each window, rad.
    """

    horizon: FloatArray
    rms_motor_position: FloatArray
    rms_joint_position: FloatArray
    rms_joint_torque: FloatArray
    hold_motor_position: FloatArray
    hold_joint_position: FloatArray
    hold_joint_torque: FloatArray
    clipped_share: float
    windows: int
    final_motor_position: FloatArray = field(repr=False)


def free_run(
    joint: JointModel,
    states: DriveStates,
    horizon_s: float,
    every_s: float,
    link: OwnLink | None = None,
    command: FloatArray | None = None,
    usable: BoolArray | None = None,
) -> FreeRun:
    """Predicts every window of `horizon_s`, one start per `every_s`, of a recording's states (n,).

    `states` are smoothed; windows with NaN rows or rows that are not `usable` (n,) are left out. `link`: see
    `drive.link.own_link`; without it inertia is read off the states and gravity keeps its measured course. `command`
    (n,) N m: the recorded motor torque, held from each sample to the next; without it `states.motor_torque`. Raises
    ConfigError if the model has no stiffness or rotor inertia, or no window is whole.
    """
    good = np.ones(states.time.size, dtype=bool) if usable is None else np.asarray(usable, dtype=bool)
    if command is not None:
        states = replace(states, motor_torque=np.asarray(command, dtype=float))
    if link is None:
        link = _link_of(states)
    whole = int(LONGEST_STEP / states.period + 1e-9)
    if horizon_s > LONG_WINDOW and whole > 1:
        states, link, good = _thinned(states, link, good, whole)
    good = np.asarray(good & np.isfinite(link.inertia + link.rest + link.slope), dtype=bool)
    plant = Plant.of(joint, states, link, good)
    steps = max(2, round(horizon_s / states.period))
    starts = _starts(plant.states, good, steps, every_s)
    predicted = _run(plant, starts, steps)
    measured = plant.measured(starts, steps)
    return _summary(predicted, measured, states)


def _link_of(states: DriveStates) -> OwnLink:
    """Constant inertia by least squares of M q'' on q''; the rest as measured."""
    good = np.isfinite(states.link_inertia_torque) & np.isfinite(states.joint_acceleration)
    a, torque = states.joint_acceleration[good], states.link_inertia_torque[good]
    inertia = float(a @ torque / max(float(a @ a), 1e-300))
    if not inertia > 0.0:
        raise ConfigError("a prediction needs the link inertia; the model's link dynamics gives none")
    rest = states.link_inertia_torque - inertia * states.joint_acceleration + states.link_bias_torque
    return OwnLink(np.full(states.time.size, inertia), rest, np.zeros(states.time.size))


def _thinned(
    states: DriveStates, link: OwnLink, usable: BoolArray, step: int
) -> tuple[DriveStates, OwnLink, BoolArray]:
    """Every `step`-th row; the motor torque is the mean over the step, all rows of a step are usable or it is not."""
    n = states.time.size // step
    rows = np.arange(n) * step
    thin = replace(rows_of(states, rows), period=step * states.period)
    thin = replace(thin, motor_torque=states.motor_torque[: n * step].reshape(n, step).mean(axis=1))
    good = np.asarray(usable[: n * step].reshape(n, step).all(axis=1), dtype=bool)
    return thin, OwnLink(link.inertia[rows], link.rest[rows], link.slope[rows]), good


def _starts(states: DriveStates, usable: BoolArray, steps: int, every_s: float) -> IntArray:
    """Rows at which whole windows start."""
    needed = (states.motor_position, states.motor_velocity, states.joint_position, states.joint_velocity)
    good = np.logical_and.reduce([np.isfinite(x) for x in (*needed, states.joint_torque, states.motor_torque)]) & usable
    bad = np.concatenate([[0], np.cumsum(~good)])
    first = min(round(REPLAY_S / states.period), max(0, states.time.size - FEWEST_WINDOWS * steps - 1))
    starts = np.arange(first, states.time.size - steps, max(1, round(every_s / states.period)))
    starts = starts[bad[starts + steps + 1] == bad[starts]] if starts.size else starts
    if starts.size == 0:
        raise ConfigError("no whole window for a prediction: the recording is too short or has too many gaps")
    return starts.astype(np.int64)


def _run(plant: Plant, starts: IntArray, steps: int) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Predicted motor position, joint position and joint torque, each (steps + 1, windows)."""
    stepper = Stepper(plant, starts)
    found = np.empty((3, steps + 1, starts.size))
    mean = np.empty((steps + 1, starts.size))
    found[:, 0] = stepper.phi, stepper.q, stepper.tau
    with np.errstate(all="ignore"):
        for i in range(steps):
            mean[i] = stepper.step(i)
            found[0, i + 1], found[1, i + 1] = stepper.phi, stepper.q
        mean[steps] = 2.0 * mean[steps - 1] - mean[steps - 2]
        found[2, 1:] = 0.5 * (mean[:-1] + mean[1:])  # torques are means over a step, samples lie between two
    return found[0], found[1], found[2]


def _summary(
    predicted: tuple[FloatArray, FloatArray, FloatArray],
    measured: tuple[FloatArray, FloatArray, FloatArray],
    states: DriveStates,
) -> FreeRun:
    least = (*LEAST_SPREAD[:2], LEAST_SPREAD[2] * states.torque_scale)
    limits: list[float] = []
    rms: list[FloatArray] = []
    hold: list[FloatArray] = []
    clipped = np.zeros(predicted[0].shape[1], dtype=bool)
    for model, truth, spread in zip(predicted, measured, least, strict=True):
        still = truth - truth[0]
        hold.append(_rms(still))
        limit = CLIP * max(float(hold[-1].max()), spread)
        limits.append(limit)
        error = np.nan_to_num(np.abs(model - truth), nan=np.inf, posinf=np.inf)
        clipped |= (error > limit).any(axis=0)
        rms.append(_rms(np.minimum(error, limit)))
    final: FloatArray = predicted[0][-1] - measured[0][-1]
    final = np.clip(np.nan_to_num(final, nan=limits[0]), -limits[0], limits[0])
    horizon = np.arange(predicted[0].shape[0], dtype=np.float64) * states.period
    share, windows = float(clipped.mean()), int(clipped.size)
    return FreeRun(horizon, rms[0], rms[1], rms[2], hold[0], hold[1], hold[2], share, windows, final)


def _rms(errors: FloatArray) -> FloatArray:
    """Over the windows, (steps + 1,)."""
    return np.asarray(np.sqrt(np.mean(errors**2, axis=1)), dtype=np.float64)
