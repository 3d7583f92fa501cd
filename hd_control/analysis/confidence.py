"""From gain, consistency and rivals to a probability that a name is right; calibrated on random drives."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from hd_control.analysis.rivals import Rival

WEIGHTS = (-1.0, 0.5, 1.5, 2.0)
"""Offset, log10 gain, probability against the best rival, share that it leaves unexplained (logistic)."""


def features(gain: float, t: float, others: Sequence[Rival]) -> tuple[float, ...]:
    """(1, log10 gain, probability against the best rival, share of the gain that it leaves)."""
    best = min((rival.probability for rival in others), default=1.0)
    left = 1.0 - min(1.0, max((rival.share for rival in others), default=0.0))
    return 1.0, float(np.log10(max(gain, 1.0))), best, left


def confidence(gain: float, t: float, others: Sequence[Rival]) -> float:
    """Probability in [0, 1] that the named effect is the missing one."""
    score = float(np.dot(WEIGHTS, features(gain, t, others)))
    return 1.0 / (1.0 + float(np.exp(-score)))
