"""The noise of a channel from the residual of everything at once: what no column explains."""

from __future__ import annotations

import numpy as np

from hd_control.analysis.channels import Channel
from hd_control.analysis.folds import Blocks
from hd_control.analysis.noise import Noise, fit_noise
from hd_control.core.arrays import BoolArray, FloatArray, IntArray

RIDGE_NOISE = 1e-7
LONELY = 2.0
"""Error in unseen rows over that in seen ones, relative to the usual ratio, from which on a block stands alone."""


def rich_noise(channel: Channel, raw: FloatArray, velocity: FloatArray) -> Noise:
    """Noise from the residual of everything at once: what no column explains.

    A rich fit leaves too little in its own rows and too much in rows that it has not seen, both by the same factor to
    first order and most at low frequencies, where the columns live; the noise is their geometric mean, row by row.
    """
    scale = np.sqrt((raw[channel.fitted] ** 2).sum(axis=0))
    scale[scale == 0.0] = 1.0
    x, y, use = raw / scale, channel.left, channel.fitted
    block, fold = Blocks().of(channel.time)
    parts = [use & (fold == f) for f in range(-1, Blocks().folds)]
    grams = [x[part].T @ x[part] for part in parts]
    rights = [x[part].T @ y[part] for part in parts]
    gram, right = sum(grams) + RIDGE_NOISE * np.eye(scale.size), sum(rights)
    seen = y - x @ np.linalg.solve(gram, right)
    unseen = seen.copy()
    for f in range(Blocks().folds):
        rows = fold == f
        unseen[rows] = y[rows] - x[rows] @ np.linalg.solve(gram - grams[f + 1], right - rights[f + 1])
    residual = np.sign(seen) * np.sqrt(np.abs(seen * _without_outliers(seen, unseen, block, use & (fold >= 0))))
    noise = fit_noise(residual, channel.valid)
    rows = noise.usable(channel.valid) & use
    noise = noise.levelled(residual, velocity, rows).scaled_on(residual, velocity, rows)
    count = int(use.sum())
    freedom = max(count - scale.size, count // 4)
    return noise.with_deviation(seen[use], float(np.sqrt(count / max(freedom, 1))))


def _without_outliers(seen: FloatArray, unseen: FloatArray, block: IntArray, use: BoolArray) -> FloatArray:
    """What a fit leaves in rows that it has not seen, without blocks that only they themselves tell anything of.

    A place that was visited once cannot be predicted from the rest: that is no noise. (rows,) each, `use`: rows that
    were held out.
    """
    count = int(block.max(initial=0)) + 1
    power = [np.bincount(block[use], r[use] ** 2, count) for r in (unseen, seen)]
    told = power[1] > 0.0
    if not told.any():
        return unseen
    ratio = np.sqrt(np.divide(power[0], power[1], out=np.ones(count), where=told))
    usual = float(np.median(ratio[told]))
    alone = use & (ratio > LONELY * usual)[block]
    return np.where(alone, usual * seen, unseen)
