"""Effects that act near reversals only, such as presliding, tested on the rows that every other fit leaves out.

These are the rows of the rotor balance in the first millirad of travel after each reversal. Everything else is fixed at
its fitted value; what is left there is compared with the effect's one column over the grid of its shape. Friction that
is whole at once leaves stick phases, which no such column explains: the claim asks for a torque near the Coulomb torque
and for a large part of the rows' energy, as the effect says (`Effect.near_reversals`).
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from hd_control.core.arrays import FloatArray
from hd_control.drive.effect import COULOMB, MOTOR, Effect, NearReversals
from hd_control.lab.diagnosis.fit import Fit, Interval, RawRows, widened

LEAST_GAIN = 150.0
LEAST_T = 8.0
BLOCK_S = 0.66
FOLDS = 6
DRAWS = 200


@dataclass(frozen=True)
class FoundNearReversals:
    """An effect in the rows near reversals: held-out gain nats, t over blocks, errors N m before and after."""

    gain: float
    t: float
    error_before: float
    error_after: float
    parameters: dict[str, Interval]


def near_reversals(fit: Fit, effect: type[Effect]) -> FoundNearReversals | None:
    """The effect if the rows near reversals show it; None if not, if there is no rotor balance, or if the effect is not
    tested there."""
    equations = fit.dictionary.equations
    channel = equations.channels.get(MOTOR)
    coulomb, test = fit.base(MOTOR, COULOMB), effect.near_reversals
    if test is None or channel is None or coulomb is None or coulomb <= 0.0:
        return None
    residual = RawRows(fit.dictionary, fit.selection).residual(fit.coefficients)[MOTOR]
    rows = np.flatnonzero(~channel.blurred(~equations.derived.usable) & ~channel.valid)
    if rows.size < 100:
        return None
    noise = 1.4826 * float(np.median(np.abs(residual[channel.fitted])))
    sums = _sums(fit, effect, test, residual / noise, rows)
    found = _judge(sums, test, float(np.mean(residual[rows] ** 2)) ** 0.5, noise, coulomb)
    return None if found is None else replace(found, parameters=widened(effect, found.parameters))


def _sums(
    fit: Fit, effect: type[Effect], test: NearReversals, residual: FloatArray, rows: NDArray[np.intp]
) -> FloatArray:
    """(blocks, 3, grid): sums of x y, x x and y y by block, in units of the noise."""
    states, channel = fit.dictionary.equations.states, fit.dictionary.equations.channels[MOTOR]
    _, block = np.unique(np.floor(channel.time[rows] / BLOCK_S), return_inverse=True)
    y = residual[rows]
    columns = np.concatenate([effect.columns(states, {test.entry: value})[MOTOR] for value in test.grid], axis=1)
    x = channel.rows_of(columns)[rows]
    found = np.zeros((block.max() + 1, 3, len(test.grid)))
    np.add.at(found[:, 0], block, x * y[:, None])
    np.add.at(found[:, 1], block, x**2)
    np.add.at(found[:, 2], block, np.repeat(y[:, None] ** 2, len(test.grid), axis=1))
    return found


def _judge(
    sums: FloatArray, test: NearReversals, error: float, noise: float, coulomb: float
) -> FoundNearReversals | None:
    """What the sums show, its intervals by resampled blocks; None if that is too little for a claim."""
    blocks, grid = len(sums), np.array(test.grid)
    total = sums.sum(axis=0)
    fold = np.arange(blocks) % FOLDS
    gains = np.zeros((blocks, grid.size))
    for f in range(FOLDS):
        rest = total - sums[fold == f].sum(axis=0)
        torque = rest[0] / np.maximum(rest[1], 1e-300)
        gains[fold == f] = torque * sums[fold == f, 0] - 0.5 * torque**2 * sums[fold == f, 1]
    best = int(np.argmax(gains.sum(axis=0)))
    gain, energy = float(gains[:, best].sum()), 0.5 * float(total[2, best])
    value, torque = _vertex(total, grid)
    low, high = test.over_coulomb
    if gain < LEAST_GAIN or gain < test.share * energy or not low < torque * noise / coulomb < high:
        return None
    random = np.random.default_rng(0)
    draws = np.array([_vertex(sums[random.integers(0, blocks, blocks)].sum(axis=0), grid) for _ in range(DRAWS)])
    lows, highs = np.quantile(draws, [0.025, 0.975], axis=0)
    logs = np.sign(gains[:, best]) * np.log1p(np.abs(gains[:, best]))
    t = float(logs.mean() / (logs.std(ddof=1) / np.sqrt(blocks)))
    if t < LEAST_T:
        return None
    values = {
        test.entry: Interval(value, float(lows[0]), float(highs[0])),
        test.amplitude: Interval(noise * torque, noise * float(lows[1]), noise * float(highs[1])),
    }
    after = error * float(np.sqrt(max(0.0, 1.0 - gain / energy)))
    return FoundNearReversals(gain, t, error, after, values)


def _vertex(total: FloatArray, grid: FloatArray) -> tuple[float, float]:
    """Best value of the grid (parabola over its logarithm) and the torque there."""
    gain = 0.5 * total[0] ** 2 / np.maximum(total[1], 1e-300)
    i = int(np.clip(np.argmax(gain), 1, grid.size - 2))
    left, middle, right = gain[i - 1 : i + 2]
    bend = left - 2.0 * middle + right
    shift = float(np.clip(0.5 * (left - right) / bend, -1.0, 1.0)) if bend < 0.0 else 0.0
    place = i + shift
    log = np.interp(place, np.arange(grid.size), np.log(grid))
    torque = np.interp(place, np.arange(grid.size), total[0] / np.maximum(total[1], 1e-300))
    return float(np.exp(log)), float(torque)
