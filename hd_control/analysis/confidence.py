"""How sure is a name: from what it gains beside the strongest effect, and whether something unknown is left over.

The weights are fitted on random drives whose seeds are kept for calibration (docs/diagnosis.md).
"""

from __future__ import annotations

import numpy as np

WEIGHTS = (3.3, 0.8, -2.6)
"""Offset, log10 of the gain over that of the strongest named effect, something unknown left (logistic)."""
SMALLEST_SHARE = 1e-4


def features(gain: float, strongest: float, unknown: bool) -> tuple[float, float, float]:
    """(1, log10 share of the strongest gain, 1 if something unknown is left)."""
    share = float(np.clip(gain / strongest, SMALLEST_SHARE, 1.0)) if strongest > 0.0 else 1.0
    return 1.0, float(np.log10(share)), float(unknown)


def confidence(gain: float, strongest: float, unknown: bool) -> float:
    """Probability in [0, 1] that the named effect is the missing one. Gains in nats."""
    score = float(np.dot(WEIGHTS, features(gain, strongest, unknown)))
    return 1.0 / (1.0 + float(np.exp(-score)))
