"""What a diagnosis says of one joint: values only, in the words of `interfaces` (schema hd.diagnosis/1)."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

from hd_control.analysis.fit import Fit
from hd_control.analysis.gates import Coverage
from hd_control.analysis.intervals import Interval
from hd_control.analysis.rivals import Rival

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
    """The answer for one joint, with what pictures and later steps need (`fit` is None after a refusal)."""

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
        }
