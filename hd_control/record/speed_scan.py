"""Speeds of a joint, block by block: range, decades between fast and slow, reversals, without keeping every sample."""

from __future__ import annotations

from typing import Any

import numpy as np

from hd_control.core.arrays import FloatArray

STANDSTILL = 0.01
"""Below this share of the largest speed a joint counts as standing still."""
MOST_SAMPLES = 600_000
"""Samples kept for the percentiles: all of 10 min at 1 kHz, every k-th of more."""
PERCENTILES = (1, 99)


class SpeedScan:
    """Speeds of one joint. `rows`: how many will come, about; longer series are thinned for the percentiles only."""

    def __init__(self, rows: int) -> None:
        self._stride = max(1, -(-rows // MOST_SAMPLES))
        self._seen = 0
        self._low, self._high = np.inf, -np.inf
        self._samples: list[FloatArray] = []
        # Runs of equal sign, by their largest speed with its sign; those that can no longer count are dropped.
        self._runs: FloatArray = np.zeros(0)

    def add(self, speeds: FloatArray) -> None:
        """The next speeds, (n,); those that are not finite are left out."""
        speeds = speeds[np.isfinite(speeds)]
        if len(speeds) == 0:
            return
        self._samples.append(np.abs(speeds[-self._seen % self._stride :: self._stride]))
        self._seen += len(speeds)
        self._low, self._high = min(self._low, float(speeds.min())), max(self._high, float(speeds.max()))
        signs = np.sign(speeds)
        starts = np.concatenate([[0], np.flatnonzero(np.diff(signs)) + 1])
        runs = np.concatenate([self._runs, np.maximum.reduceat(np.abs(speeds), starts) * signs[starts]])
        self._runs = runs[np.abs(runs) > STANDSTILL * self._largest]

    @property
    def _largest(self) -> float:
        return max(self._high, -self._low)

    def result(self) -> dict[str, Any] | None:
        """Range, decades while moving and reversals; None without any speed."""
        if self._seen == 0:
            return None
        samples = np.concatenate(self._samples)
        moving = samples[samples > STANDSTILL * self._largest]
        slow, fast = np.percentile(moving, PERCENTILES) if len(moving) else (1.0, 1.0)
        return {
            "low": self._low,
            "high": self._high,
            "unit": "rad/s",
            "decades": float(np.log10(fast / slow)),
            "reversals": int((np.diff(np.sign(self._runs)) != 0).sum()),
        }
