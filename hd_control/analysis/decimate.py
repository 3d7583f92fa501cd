"""Long recordings at a lower rate, so that an hour costs no more memory than a fraction of it.

Only odd factors: the middle of a block of held values is then a sample, and the held value of the block

    U(f) = H(f) u(f),   H = sinc(f T) / sinc(f D T) in the pass band

acts, held over D T, exactly as the fast values did over T each.
"""

from __future__ import annotations

from functools import lru_cache

import numpy as np

from hd_control.core.arrays import FloatArray

LONGEST_ROWS = 1_200_000
"""20 min at 1 kHz; longer recordings are decimated."""
HALF_WIDTH = 12
"""Half length of the filter in samples of the lower rate."""
PASS, STOP = 0.8, 1.1
"""Edges of the filter in units of the new Nyquist frequency; what folds back stays above the pass band."""


def factor_of(rows: int, longest: int = LONGEST_ROWS) -> int:
    """The smallest odd factor that brings `rows` below `longest`."""
    factor = max(1, -(-rows // longest))
    return factor if factor % 2 else factor + 1


@lru_cache(maxsize=8)
def _taps(factor: int, held: bool) -> FloatArray:
    from scipy.signal import firwin2

    nyquist = np.linspace(0.0, 1.0, 513)
    gain = np.interp(nyquist * factor, [PASS, STOP], [1.0, 0.0])
    if held:
        gain *= np.sinc(nyquist / 2.0) / np.maximum(0.1, np.sinc(nyquist * factor / 2.0))
    taps: FloatArray = firwin2(2 * HALF_WIDTH * factor + 1, nyquist, gain)
    taps /= taps.sum()
    return taps


def decimate(values: FloatArray, factor: int, held: bool) -> FloatArray:
    """(n,) -> (n // factor,) at every `factor`-th sample; NaN where the filter would touch a NaN."""
    from scipy.signal import upfirdn

    count = values.size // factor
    taps = _taps(factor, held)
    half = taps.size // 2
    bad = ~np.isfinite(values)
    filled = np.where(bad, 0.0, values)
    if bad.any() and not bad.all():
        index = np.arange(values.size)
        filled = np.interp(index, index[~bad], values[~bad])
    # Odd reflection at both ends; output i has the filter's middle on sample factor * i, or on the middle of its block.
    head, tail = 2.0 * filled[0] - filled[half:0:-1], 2.0 * filled[-1] - filled[-2 : -half - 2 : -1]
    long = np.concatenate([head, filled, tail])[factor // 2 if held else 0 :]
    low: FloatArray = upfirdn(taps, long, 1, factor)[2 * HALF_WIDTH :][:count].copy()
    spoiled = np.add.reduceat(bad, np.arange(0, count * factor, factor)) > 0
    low[np.convolve(spoiled, np.ones(2 * HALF_WIDTH + 1), "same")[:count] > 0.0] = np.nan
    return low
