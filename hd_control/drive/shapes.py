"""Small mathematical forms that several effects share: harmonics, and levels that follow a travel with memory."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from hd_control.core.arrays import FloatArray

ROUNDS = 5
"""Newton rounds of `approach` with stiffening; quadratic from a start below the root, 1e-12 for stiffening < 5."""


def harmonic_names(orders: Sequence[int]) -> tuple[str, ...]:
    """`cosine_n`, `sine_n` for every order, in the order of the columns of `harmonics`."""
    return tuple(f"{part}_{n}" for n in orders for part in ("cosine", "sine"))


def harmonics(angle: FloatArray, orders: Sequence[int]) -> FloatArray:
    """cos and sin of every order (increasing) times the angle rad, (n, 2 k): order by order, cos first."""
    base = math.gcd(*orders)
    cosine, sine = np.cos(base * angle), np.sin(base * angle)
    waves, c, s = [], cosine, sine
    for multiple in range(1, orders[-1] // base + 1):  # angle addition costs less than another sine
        if multiple > 1:
            c, s = c * cosine - s * sine, s * cosine + c * sine
        if multiple * base in orders:
            waves += [c, s]
    return np.stack(waves, axis=-1)


def harmonic_slopes(angle: FloatArray, orders: Sequence[int]) -> FloatArray:
    """Derivative of `harmonics` by the angle, (n, 2 k)."""
    waves = harmonics(angle, orders)
    slopes = np.empty_like(waves)
    factors = np.array(orders, dtype=float)
    slopes[..., 0::2] = -factors * waves[..., 1::2]
    slopes[..., 1::2] = factors * waves[..., 0::2]
    return slopes


def held(signal: FloatArray) -> FloatArray:
    """The signal (n,) with every NaN replaced by the last real value before it (at the start: the first after it)."""
    real = np.isfinite(signal)
    if bool(real.all()):
        return signal
    if not bool(real.any()):
        return np.zeros_like(signal)
    last = np.maximum.accumulate(np.where(real, np.arange(signal.size), -1))
    return np.asarray(signal[np.where(last < 0, int(np.argmax(real)), last)])


def approach_step(level: Any, change: Any, rate: float, stiffening: float = 0.0) -> FloatArray:
    """H after its driving variable moved by `change` from where it was `level`; numbers or arrays.

    dH/d|x| = rate (s - H) / (1 + stiffening (1 - s H)), s the sign of dx, |H| <= 1, exact for a monotone change of
    any size. Without stiffening: hysteresis and bristle over their travel, docs/equations/transmission.md (T7) and
    docs/equations/friction.md (F12). With it: hysteresis over the torque, stiffening = A/k,
    docs/equations/transmission.md (T9).
    """
    s = np.where(np.asarray(change) >= 0.0, 1.0, -1.0)
    return np.asarray(s * (1.0 - _gap(1.0 - s * level, rate * np.abs(change), stiffening)))


def approach(x: FloatArray, rate: float, noise: float = 0.0, stiffening: float = 0.0) -> FloatArray:
    """`approach_step` along a signal x (n,), from H = 0 at its start; x is held where it is NaN.

    A turn back by less than `noise` (unit of x) is no reversal. One scalar step per reversal, the rest at once.
    """
    x = held(np.atleast_1d(x))
    if x.size < 2:
        return np.zeros(x.size)
    turns = _reversals(x, noise)
    base = x[turns]
    travel = np.diff(np.append(base, x[-1]))
    sign = np.where(travel >= 0.0, 1.0, -1.0)
    gaps = _gaps_at_reversals(sign, rate * np.abs(travel), stiffening)
    # The sample at a reversal still belongs to the stretch before it.
    length = np.diff(np.append(turns + 1, x.size))
    length[0] += 1
    s = np.repeat(sign, length)
    gone = np.maximum(s * (x - np.repeat(base, length)), 0.0)
    return np.asarray(s * (1.0 - _gap(np.repeat(gaps, length), rate * gone, stiffening)))


def _reversals(x: FloatArray, noise: float) -> NDArray[np.int64]:
    """Index 0 and every extreme of x from which it turns back by more than `noise`."""
    step = np.diff(x)
    moving = np.flatnonzero(step)
    if moving.size == 0:
        return np.zeros(1, dtype=np.int64)
    sign = np.sign(step[moving])
    extremes = moving[1:][sign[1:] != sign[:-1]]
    if noise <= 0.0:
        return np.concatenate([[0], extremes]).astype(np.int64)
    found, best, best_value, up = [0], 0, float(x[0]), 0
    for i, value in zip([*extremes.tolist(), x.size - 1], [*x[extremes].tolist(), float(x[-1])], strict=True):
        if up == 0:
            if abs(value - best_value) > noise:
                up, best, best_value = (1 if value > best_value else -1), i, value
        elif up * (value - best_value) >= 0.0:
            best, best_value = i, value
        elif up * (best_value - value) > noise:
            found.append(best)
            up, best, best_value = -up, i, value
    return np.array(found, dtype=np.int64)


def _gaps_at_reversals(sign: FloatArray, travel: FloatArray, stiffening: float) -> FloatArray:
    """1 - s H at the start of every monotone stretch, (m,); `travel` is multiplied with the rate."""
    level, gaps = 0.0, []
    for s, distance in zip(sign.tolist(), travel.tolist(), strict=True):
        gap = 1.0 - s * level
        gaps.append(gap)
        level = s * (1.0 - _gap_number(gap, distance, stiffening))
    return np.array(gaps)


def _gap(gap: FloatArray, travel: FloatArray, stiffening: float) -> FloatArray:
    """y with ln y + p y = ln gap + p gap - travel, p = stiffening: what is left of the gap after a travel."""
    if stiffening == 0.0:
        return np.asarray(gap * np.exp(-travel))
    gap = np.maximum(gap, 1e-300)
    target = np.log(gap) + stiffening * gap - travel
    y = np.maximum(gap * np.exp(-travel), 1e-300)  # below the root of a concave function: Newton rises to it
    for _ in range(ROUNDS):
        y = y * (1.0 + target - np.log(y)) / (1.0 + stiffening * y)
    return np.asarray(y)


def _gap_number(gap: float, travel: float, stiffening: float) -> float:
    y = gap * math.exp(-min(travel, 600.0))
    if stiffening == 0.0 or y <= 0.0:
        return y
    target = math.log(gap) + stiffening * gap - travel
    for _ in range(ROUNDS):
        y = y * (1.0 + target - math.log(y)) / (1.0 + stiffening * y)
    return y
