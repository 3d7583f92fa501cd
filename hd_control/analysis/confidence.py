"""How sure is a name: from what it gains beside the strongest effect, and whether something unknown is left over.

The weights are fitted on random drives whose seeds are kept for calibration (docs/diagnosis.md).
"""

from __future__ import annotations

import numpy as np

WEIGHTS = (-2.5, 1.8, 1.1, -3.3)
"""Offset, log10 of the gain, log10 of it over the strongest gain on its channels, something unknown left (logistic)."""
LARGEST_GAIN, SMALLEST_SHARE = 1e4, 1e-4
LEAST = 0.5
"""A name that is less likely right than wrong is not said."""


def features(gain: float, strongest: float, unknown: bool) -> tuple[float, float, float, float]:
    """(1, log10 gain, log10 share of the strongest gain on its channels, 1 if something unknown is left)."""
    share = float(np.clip(gain / strongest, SMALLEST_SHARE, 1.0)) if strongest > 0.0 else 1.0
    return 1.0, float(np.log10(np.clip(gain, 1.0, LARGEST_GAIN))), float(np.log10(share)), float(unknown)


def confidence(gain: float, strongest: float, unknown: bool) -> float:
    """Probability in [0, 1] that the named effect is the missing one. Gains in nats."""
    score = float(np.dot(WEIGHTS, features(gain, strongest, unknown)))
    return 1.0 / (1.0 + float(np.exp(-score)))
