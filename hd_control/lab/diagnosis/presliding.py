"""Presliding, tested on the rows that every other fit leaves out: the first millirad of travel after each reversal.

Everything else is fixed at its fitted value; what is left there is compared with friction that builds up over a travel.
Friction that is whole at once leaves stick phases, which the effect's column does not explain: the claim asks for a
torque near the Coulomb torque and for a large part of the rows' energy.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from hd_control.core.arrays import FloatArray
from hd_control.drive.effect import MOTOR
from hd_control.drive.effects.presliding import Presliding
from hd_control.lab.diagnosis.fit import Fit, Interval, RawRows, widened

DISTANCES = np.geomspace(2e-5, 3e-3, 26)
LEAST_SHARE = 0.6
"""Of the energy of these rows that the effect must explain, held out."""
TORQUE_RATIO = (0.4, 2.5)
"""Torque that builds up over the Coulomb torque."""
LEAST_GAIN = 150.0
LEAST_T = 8.0
BLOCK_S = 0.66
FOLDS = 6
DRAWS = 200


@dataclass(frozen=True)
class PreslidingFound:
    """Presliding in the rows near reversals: held-out gain nats, t over blocks, errors N m before and after."""

    gain: float
    t: float
    error_before: float
    error_after: float
    parameters: dict[str, Interval]


def presliding(fit: Fit) -> PreslidingFound | None:
    """Presliding if the rows near reversals show it; None if not, or if there is no rotor balance."""
    equations = fit.dictionary.equations
    channel = equations.channels.get(MOTOR)
    coulomb = fit.base(MOTOR, "coulomb_friction")
    if channel is None or coulomb is None or coulomb <= 0.0:
        return None
    residual = RawRows(fit.dictionary, fit.selection).residual(fit.coefficients)[MOTOR]
    rows = np.flatnonzero(~channel.blurred(~equations.derived.usable) & ~channel.valid)
    if rows.size < 100:
        return None
    noise = 1.4826 * float(np.median(np.abs(residual[channel.fitted])))
    sums = _sums(fit, residual / noise, rows, channel.time[rows])
    return _judge(sums, float(np.mean(residual[rows] ** 2)) ** 0.5, noise, coulomb)


def _sums(fit: Fit, residual: FloatArray, rows: np.ndarray, time: FloatArray) -> FloatArray:
    """(blocks, 3, distances): sums of x y, x x and y y by block, in units of the noise."""
    states, channel = fit.dictionary.equations.states, fit.dictionary.equations.channels[MOTOR]
    _, block = np.unique(np.floor(time / BLOCK_S), return_inverse=True)
    y = residual[rows]
    columns = np.concatenate(
        [Presliding.columns(states, {"presliding_distance": float(d)})[MOTOR] for d in DISTANCES], axis=1
    )
    x = channel.rows_of(columns)[rows]
    found = np.zeros((block.max() + 1, 3, DISTANCES.size))
    np.add.at(found[:, 0], block, x * y[:, None])
    np.add.at(found[:, 1], block, x**2)
    np.add.at(found[:, 2], block, np.repeat(y[:, None] ** 2, DISTANCES.size, axis=1))
    return found


def _judge(sums: FloatArray, error: float, noise: float, coulomb: float) -> PreslidingFound | None:
    blocks = len(sums)
    total = sums.sum(axis=0)
    fold = np.arange(blocks) % FOLDS
    gains = np.zeros((blocks, DISTANCES.size))
    for f in range(FOLDS):
        rest = total - sums[fold == f].sum(axis=0)
        torque = rest[0] / np.maximum(rest[1], 1e-300)
        gains[fold == f] = torque * sums[fold == f, 0] - 0.5 * torque**2 * sums[fold == f, 1]
    best = int(np.argmax(gains.sum(axis=0)))
    gain, energy = float(gains[:, best].sum()), 0.5 * float(total[2, best])
    distance, torque = _vertex(total)
    if (
        gain < LEAST_GAIN
        or gain < LEAST_SHARE * energy
        or not TORQUE_RATIO[0] < torque * noise / coulomb < TORQUE_RATIO[1]
    ):
        return None
    random = np.random.default_rng(0)
    draws = np.array([_vertex(sums[random.integers(0, blocks, blocks)].sum(axis=0)) for _ in range(DRAWS)])
    low, high = np.quantile(draws, [0.025, 0.975], axis=0)
    logs = np.sign(gains[:, best]) * np.log1p(np.abs(gains[:, best]))
    t = float(logs.mean() / (logs.std(ddof=1) / np.sqrt(blocks)))
    if t < LEAST_T:
        return None
    values = {
        "presliding_distance": Interval(distance, float(low[0]), float(high[0])),
        "presliding_torque": Interval(noise * torque, noise * float(low[1]), noise * float(high[1])),
    }
    after = error * float(np.sqrt(max(0.0, 1.0 - gain / energy)))
    return PreslidingFound(gain, t, error, after, widened(Presliding.name, values))


def _vertex(total: FloatArray) -> tuple[float, float]:
    """Best distance (parabola over its logarithm) and the torque there."""
    gain = 0.5 * total[0] ** 2 / np.maximum(total[1], 1e-300)
    i = int(np.clip(np.argmax(gain), 1, DISTANCES.size - 2))
    left, middle, right = gain[i - 1 : i + 2]
    bend = left - 2.0 * middle + right
    shift = float(np.clip(0.5 * (left - right) / bend, -1.0, 1.0)) if bend < 0.0 else 0.0
    place = i + shift
    log = np.interp(place, np.arange(DISTANCES.size), np.log(DISTANCES))
    torque = np.interp(place, np.arange(DISTANCES.size), total[0] / np.maximum(total[1], 1e-300))
    return float(np.exp(log)), float(torque)
