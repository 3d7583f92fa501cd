"""Which groups explain a joint's residual: forward selection with exchange, on held-out scores, with strict acceptance.

forward: add the best acceptable effect; after each addition drop, reshape and exchange what is selected
extend:  up to two free curves, the net for what the library does not know; forward again
restart: start with each of the best free curves, so that an unknown effect is not explained by a pile of look-alikes
choose:  smallest loss plus penalties
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from hd_control.core.arrays import FloatArray, IntArray
from hd_control.lab.diagnosis.candidates import Group
from hd_control.lab.diagnosis.dictionary import Dictionary
from hd_control.lab.diagnosis.scores import Scores


@dataclass(frozen=True)
class Thresholds:
    """When a group is accepted: nats, shares of half the whitened rows, t over blocks (docs/diagnosis.md)."""

    gain: float = 40.0
    share: float = 0.004
    curve_share: float = 0.006
    t: float = 3.0
    burst_gain: float = 150.0
    most_effects: int = 6
    most_curves: int = 2
    curve_penalty: float = 25.0
    effect_penalty: float = 15.0
    companion: float = 1e-4
    relative: float = 0.1
    beside_curve: float = 0.3
    curve_relative: float = 0.015
    """A curve must explain this share more than laws do: no law is exact, and a curve fits what it leaves."""
    curve_beside_any: float = 5e-4
    """The same beside laws without a shape."""
    coupled: bool = False
    """Every group acts on all rows: what an inexact law leaves may look like a curve of any balance."""


@dataclass(frozen=True)
class Support:
    """What the data say for a group beside a selection: held-out gain nats, t over blocks, gain without best blocks."""

    gain: float
    t: float
    without_best: float
    without_best_three: float
    accepted: bool


Selection = tuple[Group, ...]


class Search:
    """Searches one dictionary. `groups` limits what may be selected (default: all)."""

    def __init__(
        self, dictionary: Dictionary, scores: Scores, thresholds: Thresholds | None = None, groups: Sequence[Group] = ()
    ) -> None:
        self.dictionary, self.scores = dictionary, scores
        self.thresholds = thresholds or Thresholds()
        self.groups = list(groups or dictionary.groups)
        shapes: dict[str, int] = {}
        for group in self.groups:
            shapes[group.name] = shapes.get(group.name, 0) + 1
        self.penalty = np.array(
            [0.25 * g.index.size * np.log(500.0) + 0.5 * np.log(shapes[g.name]) + 1.5 for g in self.groups]
        )
        self._library = np.array([not group.is_curve for group in self.groups])
        self._place = {id(group): i for i, group in enumerate(self.groups)}
        self._rankings: dict[frozenset[int], FloatArray] = {}
        self._supports: dict[tuple[int, frozenset[int]], Support] = {}

    def index(self, selection: Selection) -> IntArray:
        """Coefficients of the base and a selection."""
        return np.concatenate([self.dictionary.base, *(group.index for group in selection)])

    def ranking(self, selection: Selection) -> FloatArray:
        """Penalised held-out gain of every group on top of a selection; -inf for what it holds already."""
        key = _key(selection)
        if key not in self._rankings:
            self._rankings[key] = self._ranking(selection)
        return self._rankings[key]

    def _ranking(self, selection: Selection) -> FloatArray:
        names = {group.name for group in selection}
        free = [i for i, group in enumerate(self.groups) if group.name not in names]
        ranking = np.full(len(self.groups), -np.inf)
        if free:
            gains = self.scores.gains(self.index(selection), [self.groups[i] for i in free])
            ranking[free] = gains - self.penalty[free]
        return ranking

    def support(self, group: Group, selection: Selection) -> Support:
        """Support of a group on top of a selection that does not hold it."""
        key = (int(group.index[0]), _key(selection))
        if key not in self._supports:
            self._supports[key] = self._support(group, selection)
        return self._supports[key]

    def _support(self, group: Group, selection: Selection) -> Support:
        without = self.scores.block_losses(self.index(selection))
        d = without - self.scores.block_losses(self.index((*selection, group)))
        d = d[without > 0.0]
        gain = float(d.sum())
        logs = np.sign(d) * np.log1p(np.abs(d))
        error = float(logs.std(ddof=1)) / np.sqrt(d.size) if d.size > 2 else np.inf
        t = float(logs.mean()) / error if error > 0.0 else 0.0
        best = np.sort(d)[::-1]
        one, three = gain - float(best[:1].sum()), gain - float(best[:3].sum())
        return Support(gain, t, one, three, self._accept(group, gain, t, one, three))

    def _accept(self, group: Group, gain: float, t: float, one: float, three: float) -> bool:
        limits = self.thresholds
        share = limits.curve_share if group.is_curve else limits.share
        if gain <= limits.gain or gain <= share * 0.5 * self.dictionary.rows_touched(group):
            return False
        if t > limits.t and three > 0.0:
            return True
        return not group.is_curve and gain > limits.burst_gain and one > limits.gain

    def criterion(self, selection: Selection) -> float:
        """Loss plus penalties: smaller is better."""
        limits = self.thresholds
        extra = [
            self.penalty[self._place[id(g)]] + (limits.curve_penalty if g.is_curve else limits.effect_penalty)
            for g in selection
        ]
        return self.scores.loss(self.index(selection)) + float(sum(extra))

    def margin(self, selection: Selection, channels: Sequence[str]) -> float:
        """nats by which a curve on these channels must gain more: what an inexact law with a shape may leave there."""
        limits, found = self.thresholds, [0.0]
        for g in selection:
            if g.effect is not None and (limits.coupled or set(g.channels) & set(channels)):
                share = limits.curve_relative if self._bent(g) else limits.curve_beside_any
                found.append(share * self.support(g, tuple(h for h in selection if h is not g)).gain)
        return max(found)

    def _bent(self, group: Group) -> bool:
        """True for a law with a shape that is fitted, or that leaves rows out."""
        states = self.dictionary.equations.states
        effect = group.effect
        return effect is not None and bool(
            effect.shape_bounds(group.shape, states) or effect.blind(states, group.shape)
        )

    def forward(self, selection: Selection) -> Selection:
        """Adds acceptable effects, best first, and tidies up after each."""
        while sum(not g.is_curve for g in selection) < self.thresholds.most_effects:
            added = self._add(selection, self._library)
            if added is None:
                break
            tidied = self.tidy(self.tidy(added))
            if len(tidied) <= len(selection) and self.criterion(tidied) >= self.criterion(selection) - 1e-6:
                break
            selection = tidied
        return selection

    def _add(self, selection: Selection, allowed: np.ndarray, tries: int = 4) -> Selection | None:
        ranking = np.where(allowed, self.ranking(selection), -np.inf)
        seen: set[str] = set()
        for i in np.argsort(-ranking):
            group = self.groups[i]
            if ranking[i] <= 0.0 or len(seen) >= tries:
                return None
            if group.name in seen:
                continue
            seen.add(group.name)
            if self.support(group, selection).accepted:
                return (*selection, group)
        return None

    def tidy(self, selection: Selection) -> Selection:
        """Drops what is no longer acceptable, re-chooses shapes, exchanges look-alikes."""
        for group in selection:
            if group not in selection:
                continue
            rest = tuple(g for g in selection if g is not group)
            if not self.support(group, rest).accepted:
                selection = rest
                continue
            ranking = self.ranking(rest)
            if group.is_curve:
                ranking = np.where(self._library, ranking, -np.inf)
            own = float(self.ranking(rest)[self._place[id(group)]])
            same = np.array([g.name == group.name for g in self.groups])
            for kind, margin in ((same, 0.3), (~same & self._library, 3.0)):
                best = int(np.argmax(np.where(kind, ranking, -np.inf)))
                if ranking[best] > own + margin and self.groups[best] is not group:
                    if kind is not same and not self.support(self.groups[best], rest).accepted:
                        continue
                    selection = (*rest, self.groups[best])
                    group, own = self.groups[best], float(ranking[best])
        return selection

    def extend(self, selection: Selection) -> Selection:
        """Adds free curves where effects leave structure, and lets effects replace them where they can."""
        while sum(g.is_curve for g in selection) < self.thresholds.most_curves:
            added = self._add(selection, ~self._library, tries=3)
            if added is None:
                break
            tidied = self.forward(self.tidy(self.tidy(added)))
            fresh = [g for g in tidied if g.is_curve and g not in selection]
            margin = max((self.margin(selection, g.channels) for g in fresh), default=0.0)
            if self.criterion(tidied) >= self.criterion(selection) - max(margin, 1e-6):
                break
            selection = tidied
        return selection

    def prune(self, selection: Selection) -> Selection:
        """Drops weak effects that only describe what the inexact law of a strong neighbour leaves on its channel, and
        effects that merely resemble a part of a selected curve."""
        gains = {id(g): self.support(g, tuple(h for h in selection if h is not g)).gain for g in selection}

        def companion(g: Group, h: Group) -> bool:
            if g is h or not set(g.channels) & set(h.channels) or g.is_curve:
                return False
            family = bool(g.effect and h.effect and g.effect.family and g.effect.family == h.effect.family)
            limits = self.thresholds
            share = limits.beside_curve if h.is_curve else limits.relative if family else limits.companion
            return gains[id(g)] <= share * gains[id(h)]

        strong = tuple(g for g in selection if not any(companion(g, h) for h in selection))
        rest = {id(g): tuple(h for h in strong if h is not g) for g in strong}
        return tuple(g for g in strong if g.is_curve or self.support(g, rest[id(g)]).gain > self.thresholds.gain)

    def best_curves(self, selection: Selection, count: int = 3) -> list[Group]:
        """The free curves with the largest acceptable gain on top of a selection."""
        ranking = np.where(self._library, -np.inf, self.ranking(selection))
        order = [int(i) for i in np.argsort(-ranking)[:count] if ranking[i] > self.thresholds.gain]
        return [self.groups[i] for i in order if self.support(self.groups[i], selection).accepted]

    def run(self) -> Selection:
        """The selection with the smallest criterion over the plain way and the restarts."""
        best = self.extend(self.forward(()))
        if len(best) > 1 or any(g.is_curve for g in best):
            for curve in self.best_curves(()):
                other = self.extend(self.forward((curve,)))
                mine = {id(g) for g in best}
                fresh = [g for g in other if g.is_curve and id(g) not in mine]
                margin = max((self.margin(best, g.channels) for g in fresh), default=0.0)
                if self.criterion(other) < self.criterion(best) - margin:
                    best = other
        return best


def _key(selection: Selection) -> frozenset[int]:
    return frozenset(int(group.index[0]) for group in selection)
