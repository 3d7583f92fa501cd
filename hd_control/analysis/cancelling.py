"""Two effects that cancel each other on one channel are no two effects: what is left of them is one on another channel.

An offset of the gauge stands in the rotor and the link balance; with a friction offset that cancels it on the rotor it
is a constant torque on the link, which neither name explains.
"""

from __future__ import annotations

import numpy as np

from hd_control.analysis.fit import Fit
from hd_control.analysis.groups import Group
from hd_control.analysis.search import Search, Selection
from hd_control.core.arrays import FloatArray

LEFT = 0.1
"""What is left of two contributions, RMS over the smaller of both, below which they cancel."""


def without_cancelling(search: Search, selection: Selection) -> Selection:
    """The selection with the best curve in place of a cancelling pair; the selection itself if there is none."""
    fit = Fit.of(search.dictionary, search.scores, selection)
    pair = _pair(fit, selection)
    if pair is None:
        return selection
    wide, narrow = pair
    rest = tuple(g for g in selection if g not in pair)
    channels = set(wide.channels) - set(narrow.channels)
    ranking = search.ranking(rest)
    curves = [i for i, g in enumerate(search.groups) if g.is_curve and set(g.channels) <= channels]
    best = max(curves, key=lambda i: float(ranking[i]), default=None)
    if best is None or not search.support(search.groups[best], rest).accepted:
        return selection
    return search.prune(search.extend(search.forward(search.tidy((*rest, search.groups[best])))))


def _pair(fit: Fit, selection: Selection) -> tuple[Group, Group] | None:
    """A group on several channels and one on a part of them that cancels it there."""
    for wide in selection:
        for narrow in selection:
            if wide is narrow or wide.is_curve or narrow.is_curve or not set(narrow.channels) < set(wide.channels):
                continue
            a, b = (_contribution(fit, group, narrow.channels) for group in (wide, narrow))
            if _rms(a + b) < LEFT * min(_rms(a), _rms(b)):
                return wide, narrow
    return None


def _contribution(fit: Fit, group: Group, channels: tuple[str, ...]) -> FloatArray:
    """What a group adds to the whitened rows of some channels."""
    dictionary, found = fit.dictionary, []
    scaled = fit.coefficients * dictionary.norm
    for name in channels:
        part = dictionary.rows[name]
        mine = np.isin(part.index, group.index)
        found.append(part.columns[:, mine] @ scaled[part.index[mine]])
    return np.concatenate(found)


def _rms(x: FloatArray) -> float:
    return float(np.sqrt(np.mean(x**2))) if x.size else 0.0
