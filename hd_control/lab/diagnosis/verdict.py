"""What a diagnosis says of one joint, values only (schema hd.diagnosis/1), and what else would explain the data.

`rivals` gives for a name what the best other explanation would lose; the dataclasses below hold the answer.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from hd_control.lab.diagnosis.candidates import Group
from hd_control.lab.diagnosis.coverage import Coverage
from hd_control.lab.diagnosis.fit import Fit, Interval
from hd_control.lab.diagnosis.search import Search, Selection

# ---- What the best other explanation of the same data would lose -----------------------------------


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


# ---- The answer ------------------------------------------------------------------------------------


ADEQUATE, MISSING, UNKNOWN = "adequate", "missing", "unknown"
MISSING_AND_UNKNOWN, CANNOT_TELL = "missing_and_unknown", "cannot_tell"
VERDICTS = (ADEQUATE, MISSING, UNKNOWN, MISSING_AND_UNKNOWN, CANNOT_TELL)


@dataclass(frozen=True)
class NamedEffect:
    """An effect that the data show to be missing. Errors: held-out RMS in the unit of `channel`, with the effects named
    before it and without, then with it. `parameters` by name with 95 % intervals; `units` by name. `beside`: gain of
    the strongest other named effect on the same channels, nats; `unknown_beside`: something unknown is left on one."""

    name: str
    title: str
    confidence: float
    channel: str
    gain: float
    t: float
    error_before: float
    error_after: float
    parameters: Mapping[str, Interval]
    units: Mapping[str, str]
    evidence: str
    rivals: tuple[Rival, ...] = ()
    beside: float = 0.0
    unknown_beside: bool = False

    @property
    def confusable_with(self) -> list[str]:
        """Effects that explain the same data nearly as well."""
        return [rival.name for rival in self.rivals if rival.confusable]

    def json(self) -> dict[str, Any]:
        """The form of `hd.diagnosis/1`."""
        values = {
            name: {"value": i.value, "unit": self.units.get(name, ""), "low": i.low, "high": i.high}
            for name, i in self.parameters.items()
        }
        runner_up = None
        if self.rivals:
            best = self.rivals[0]
            runner_up = {"name": best.name, "loss": best.loss, "probability": 1.0 - best.probability}
            runner_up["share_of_gain"] = best.share
        return {
            "name": self.name,
            "confidence": self.confidence,
            "channel": self.channel,
            "error_before": self.error_before,
            "error_after": self.error_after,
            "held_out": True,
            "parameters": values,
            "evidence": self.evidence,
            "runner_up": runner_up,
            "confusable_with": self.confusable_with,
            "gain_nats": self.gain,
            "gain_beside_nats": self.beside,
            "unknown_beside": self.unknown_beside,
        }


@dataclass(frozen=True)
class Unknown:
    """Structure that no library effect explains: where, on what it depends, and how that shows."""

    channel: str
    variables: tuple[str, ...]
    evidence: str

    def json(self) -> dict[str, Any]:
        """The form of `hd.diagnosis/1`."""
        return {"channel": self.channel, "variables": list(self.variables), "evidence": self.evidence}


@dataclass(frozen=True)
class Experiment:
    """What to record next: why, and how."""

    purpose: str
    how: str


@dataclass(frozen=True)
class ChannelError:
    """One channel, held out, its unit: RMS of the left side, of the refitted baseline, of everything found, noise."""

    unit: str
    measured: float
    baseline: float
    explained: float
    noise_floor: float


@dataclass(frozen=True)
class JointDiagnosis:
    """The answer for one joint, with what pictures and later steps need (`fit` is None after a refusal).
    `contradictions`: what signals and model disagree in; then nothing is named."""

    joint: str
    verdict: str
    effects: tuple[NamedEffect, ...]
    unknown: Unknown | None
    experiments: tuple[Experiment, ...]
    channels: Mapping[str, ChannelError]
    coverage: Coverage | None
    notes: tuple[str, ...] = ()
    fit: Fit | None = None
    base: Mapping[str, Interval] = field(default_factory=dict)
    seconds: float = 0.0
    contradictions: tuple[str, ...] = ()

    def json(self) -> dict[str, Any]:
        """The form of `hd.diagnosis/1`."""
        return {
            "verdict": self.verdict,
            "effects": [effect.json() for effect in self.effects],
            "unknown": None if self.unknown is None else self.unknown.json(),
            "experiments": [{"purpose": e.purpose, "how": e.how} for e in self.experiments],
            "channels": {
                name: {
                    "unit": c.unit,
                    "rms_measured": c.measured,
                    "error_baseline": c.baseline,
                    "error_explained": c.explained,
                    "noise_floor": c.noise_floor,
                }
                for name, c in self.channels.items()
            },
            "notes": list(self.notes),
            "contradictions": list(self.contradictions),
        }
