"""Free run: what the model predicts from a measured start when only the recorded motor torque drives it.

All windows of a recording run at once, as vectors. One step holds the motor torque; the spring is implicit (midpoint),
Coulomb friction is set-valued (soft threshold), effects follow through `Effect.advance`:

    I* dv = T (u - tau - R) - T G s,  M dw = T (tau - rest - L),  tau = tau_mid + c (dv - dw),  c = T k_t / 4 + k d / 2

with R + G s the motor columns, L the link columns, k_t the tangent stiffness of spring and transmission columns.
Source: docs/equations/prediction.md (W1), (W2), (W3).
"""

from __future__ import annotations

from dataclasses import dataclass, field, replace

import numpy as np

from hd_control.core.arrays import BoolArray, FloatArray, IntArray
from hd_control.core.errors import ConfigError
from hd_control.drive.effect import DriveStates
from hd_control.drive.link import OwnLink
from hd_control.drive.model import JointModel
from hd_control.drive.predict_plant import Plant, rows_of
from hd_control.drive.predict_step import Stepper

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
    ConfigError if the model lacks stiffness or rotor inertia, or no window is whole.
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
