"""How sure is a name: what the best other explanation of the same data would lose."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from hd_control.analysis.groups import Group
from hd_control.analysis.search import Search, Selection

RESAMPLES = 200
CONFUSABLE_LOSS = 10.0
CONFUSABLE_PROBABILITY = 0.95
CONFUSABLE_SHARE = 0.95
RIVALS = 3


@dataclass(frozen=True)
class Rival:
    """Another effect in place of a selected one: nats lost, probability over resampled blocks that the named effect is
    better, share of its gain that the rival explains."""

    name: str
    loss: float
    probability: float
    share: float

    @property
    def confusable(self) -> bool:
        """True if the data do not separate the two."""
        return self.probability < CONFUSABLE_PROBABILITY or self.loss < CONFUSABLE_LOSS or self.share > CONFUSABLE_SHARE


def rivals(search: Search, selection: Selection, group: Group, seed: int = 0) -> list[Rival]:
    """The best other effects in place of `group`, best first."""
    rest = tuple(g for g in selection if g is not group)
    ranking = search.ranking(rest)
    scores = search.scores
    without = scores.block_losses(search.index(rest))
    mine = scores.block_losses(search.index((*rest, group)))
    gain = float((without - mine).sum())
    found: list[Rival] = []
    random = np.random.default_rng(seed)
    draws = random.integers(0, without.size, (RESAMPLES, without.size))
    for i in np.argsort(-ranking):
        other = search.groups[int(i)]
        if len(found) >= RIVALS or not np.isfinite(ranking[i]):
            break
        if other.is_curve or other.name == group.name or other.name in {r.name for r in found}:
            continue
        theirs = scores.block_losses(search.index((*rest, other)))
        difference = theirs - mine
        better = float(np.mean(difference[draws].sum(axis=1) > 0.0))
        share = float((without - theirs).sum()) / gain if gain > 0.0 else 1.0
        found.append(Rival(other.name, float(difference.sum()), better, max(0.0, share)))
    return found
