"""Noise of a channel as an autoregression; whitening makes its rows independent with unit variance."""

from __future__ import annotations

from dataclasses import dataclass, field, replace

import numpy as np

from hd_control.core.arrays import BoolArray, FloatArray

ORDER = 16
WHITEN_ROWS = 64
"""Rows that are whitened by one product of matrices."""
SPEED_BINS = 8
LEVELS = (0.4, 3.0)


@dataclass(frozen=True)
class Noise:
    """e_k + sum_i lags[i] e_{k-1-i} = scale * level(v_k) * white_k. lags (ORDER,), scale in the channel's unit.

    `levels` (k,): how much louder the white part is at motor speeds `speeds` (k,) rad/s than on average.
    `deviation`: standard deviation of the noise itself in the channel's band, same unit (the noise floor).
    """

    lags: FloatArray
    scale: float
    deviation: float
    speeds: FloatArray = field(default_factory=lambda: np.zeros(1))
    levels: FloatArray = field(default_factory=lambda: np.ones(1))

    def whiten(self, rows: FloatArray) -> FloatArray:
        """Whitened rows (n,) or (n, k); the first ORDER rows are not usable."""
        out = np.empty_like(rows)
        weights = np.concatenate([self.lags[::-1], [1.0]]) / self.scale
        order, step = self.lags.size, WHITEN_ROWS
        filters = np.zeros((step, step + order))
        for i in range(step):
            filters[i, i : i + order + 1] = weights
        out[:order] = rows[:order] / self.scale
        for start in range(order, len(rows), step):
            block = rows[start - order : start + step]
            out[start : start + step] = filters[: len(block) - order, : len(block)] @ block
        return np.asarray(out)

    def level(self, velocity: FloatArray) -> FloatArray:
        """Level of the white part at motor velocities (n,) rad/s."""
        return np.asarray(np.interp(np.abs(velocity), self.speeds, self.levels))

    def divided(self, factor: float) -> Noise:
        """The noise of the rows divided by `factor`."""
        return replace(self, scale=self.scale / factor, deviation=self.deviation / factor)

    def levelled(self, residual: FloatArray, velocity: FloatArray, rows: BoolArray) -> Noise:
        """With the level over speed that a residual has on some rows: jitter of the clock is louder at speed."""
        white, speed = np.abs(self.whiten(residual)[rows]), np.abs(velocity[rows])
        if white.size < 20 * SPEED_BINS:
            return self
        edges = np.quantile(speed, np.linspace(0.0, 1.0, SPEED_BINS + 1))
        place = np.clip(np.searchsorted(edges, speed, side="right") - 1, 0, SPEED_BINS - 1)
        found = [float(np.median(white[place == i])) if (place == i).any() else np.nan for i in range(SPEED_BINS)]
        levels = np.nan_to_num(np.array(found), nan=float(np.nanmedian(found)))
        levels = np.clip(levels / np.sqrt(np.mean(levels**2)), *LEVELS)
        centres = np.maximum.accumulate(0.5 * (edges[1:] + edges[:-1]))
        return replace(self, speeds=centres, levels=levels)

    def scaled_on(self, residual: FloatArray, velocity: FloatArray, rows: BoolArray) -> Noise:
        """The same with the level that the residual has on some rows, its largest values left out."""
        white = np.abs(self.whiten(residual)[rows]) / self.level(velocity[rows])
        if white.size == 0:
            return self
        inside = white < 4.0 * 1.4826 * np.median(white)
        return self.divided(1.0 / max(float(np.sqrt(np.mean(white[inside] ** 2))), 1e-6))

    def with_deviation(self, residual: FloatArray, factor: float) -> Noise:
        """The same with the standard deviation of a residual, its largest 0.5 % left out, times a factor."""
        inside = np.abs(residual) <= np.quantile(np.abs(residual), 0.995) if residual.size else residual
        level = float(np.sqrt(np.mean(residual[inside] ** 2))) if residual.size else self.deviation
        return replace(self, deviation=factor * level)

    def usable(self, valid: BoolArray) -> BoolArray:
        """Rows whose whole filter history is valid."""
        return with_history(valid, self.lags.size)


def with_history(valid: BoolArray, lags: int = ORDER) -> BoolArray:
    """Valid rows (n,) behind `lags` valid ones: those that can be whitened, and so fitted."""
    bad = np.concatenate([[0], np.cumsum(~valid)])
    index = np.arange(valid.size)
    low = index - lags
    return np.asarray((low >= 0) & (bad[index + 1] == bad[np.maximum(low, 0)]))


def fit_noise(residual: FloatArray, valid: BoolArray) -> Noise:
    """Least squares on rows with valid history, then twice more without the largest residuals (bursts stay visible):

    lags = argmin sum_k (e_k + sum_i lags[i] e_{k-1-i})^2 over rows with |e_k + ...| < 4 scale
    scale = RMS of e_k + sum_i lags[i] e_{k-1-i} on these rows
    """
    lags = np.zeros(ORDER)
    rows = np.flatnonzero(with_history(valid))
    history = np.stack([residual[rows - lag] for lag in range(1, ORDER + 1)], axis=1)
    target = residual[rows]
    keep = np.ones(rows.size, dtype=bool)
    scale = 1.0
    for _ in range(3):
        gram = history[keep].T @ history[keep]
        gram[np.diag_indices(ORDER)] *= 1.0 + 1e-9
        gram[np.diag_indices(ORDER)] += 1e-300
        lags = -np.linalg.solve(gram, history[keep].T @ target[keep])
        white = target + history @ lags
        scale = max(float(1.4826 * np.median(np.abs(white))), 1e-300)
        keep = np.abs(white) < 4.0 * scale
    scale = max(float(np.sqrt(np.mean(white[keep] ** 2))), 1e-300)
    inside = np.abs(target) <= np.quantile(np.abs(target), 0.995)
    return Noise(lags, scale, float(np.sqrt(np.mean(target[inside] ** 2))))
