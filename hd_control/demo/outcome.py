"""What came out of a story, as plain data: for the table, the picture and the JSON form `hd.demo/1`."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

from hd_control.demo.live import Phase
from hd_control.lab.page.model_figures import percent_of
from hd_control.lab.signals.tracking import Tracking, tracking_of
from hd_control.record.reader import BagReader

HALF = 0.5
"""The tracking error of a joint whose effect is fed forward falls below this share."""
NOTICED = ("missing", "missing_and_unknown", "unknown")
"""Verdicts after which a joint gets a ladder."""


@dataclass
class Outcome:
    """Grows with the steps of the story. Documents are those that the commands wrote; tracking is by phase name."""

    folder: str
    clock: str
    phases: dict[str, Phase] = field(default_factory=dict)
    tracking: dict[str, Tracking] = field(default_factory=dict)
    compare: Mapping[str, Any] = field(default_factory=dict)
    diagnosis: Mapping[str, Any] = field(default_factory=dict)
    ladder: Mapping[str, Any] = field(default_factory=dict)
    applied: Mapping[str, Any] = field(default_factory=dict)
    truth: Mapping[str, Any] = field(default_factory=dict)
    scores: Mapping[str, Any] = field(default_factory=dict)

    @property
    def suspects(self) -> list[str]:
        """Joints in whose model something is missing."""
        return [name for name, said in self.diagnosis.get("joints", {}).items() if said["verdict"] in NOTICED]

    @property
    def diagnosed(self) -> list[dict[str, Any]]:
        """Every named effect: joint, name, confidence, parameters; an unknown one has the variables it depends on."""
        found = []
        for joint, said in self.diagnosis.get("joints", {}).items():
            for effect in said["effects"]:
                found.append({"joint": joint, **{k: effect[k] for k in ("name", "confidence", "parameters")}})
            if said["unknown"] is not None:
                found.append({"joint": joint, "name": "unknown", "depends_on": said["unknown"]["variables"]})
        return found

    @property
    def hidden(self) -> list[dict[str, Any]]:
        """What the seal says: joint, name, strength, values in the words of the model. Empty before it is opened."""
        joints = self.truth.get("joints", {})
        return [
            {
                "joint": effect["joint"],
                "name": effect["name"],
                "strength": effect["strength"],
                "parameters": joints[effect["joint"]]["parameters"].get(effect["name"], {}),
            }
            for effect in self.truth.get("world", {}).get("effects", [])
        ]

    @property
    def right(self) -> bool:
        """Is the diagnosis of every joint right?"""
        return bool(self.scores) and all(score["correct"] for score in self.scores.values())

    def errors(self, joint: str) -> tuple[float, float, float, str]:
        """Held-out model error as given and at the end, noise floor, in the channel's unit."""
        steps = self.ladder["joints"][joint]
        first, last = steps["rungs"][0], steps["rungs"][-1]
        return first["error_held_out"], last["error_held_out"], last["noise_floor"], steps["unit"]

    def rms(self, phase: str) -> dict[str, float] | None:
        """Tracking error of every joint, RMS in rad; None if the phase was not run."""
        return self.tracking[phase].rms() if phase in self.tracking else None

    def fed_forward(self, joint: str) -> tuple[list[str], list[str]]:
        """Effects added to a joint's model that changed a controller, and `effect: reason` of those that did not."""
        added = [rung["effect"] for rung in self.ladder.get("joints", {}).get(joint, {}).get("rungs", [])[2:]]
        rows = [row for row in self.applied.get("rows", []) if row["joint"] == joint]
        used = [e for e in added if any(r["effect"] == e and r["applied"] and r["value"] != r["before"] for r in rows)]
        refused = [row for row in rows if row["effect"] in added and not row["applied"]]
        left = [f"{row['effect'].replace('_', ' ')}: {row['note']}" for row in refused]
        return used, left

    def json(self, report: str, picture: str, seconds: float) -> dict[str, Any]:
        """The form of `hd.demo/1`."""
        ladders = {joint: found["rungs"] for joint, found in self.ladder.get("joints", {}).items()}
        return {
            "schema": "hd.demo/1",
            "bag": str(self.phases["excitation"].bag),
            "bags": {name: str(phase.bag) for name, phase in self.phases.items()},
            "clock": self.clock,
            "stopped": None,
            "missed_ticks_percent": max(phase.missed for phase in self.phases.values()),
            "hidden_effects": self.hidden,
            "diagnosed": self.diagnosed,
            "right": self.right,
            "ladder": ladders,
            "tracking_before": self.rms("goal_before"),
            "tracking_after": self.rms("goal_after"),
            "fed_forward": {joint: self.fed_forward(joint)[0] for joint in ladders},
            "report": report,
            "picture": picture or None,
            "seconds": seconds,
        }


def tracking_in(phase: Phase) -> Tracking:
    """The tracking of a recorded phase within its window. Raises BagError."""
    with BagReader(phase.bag) as bag:
        return tracking_of(bag).within(*phase.window)


def quantity(value: float, unit: str) -> str:
    """A number as a person reads it: angles in µrad."""
    return f"{value * 1e6:.3g} µrad" if unit == "rad" else f"{value:.3g} {unit}"


def table(outcome: Outcome) -> list[str]:
    """The result as text: what was hidden and named, model errors, tracking errors, and what to think of them."""
    lines = ["", f"{'hidden (seal opened last)':<36}diagnosed before"]
    named = [f"{d['joint']} {d['name']}" + _sure(d) for d in outcome.diagnosed] or ["nothing"]
    hidden = [f"{h['joint']} {h['name']}" for h in outcome.hidden] or [""]
    for i in range(max(len(named), len(hidden))):
        lines.append(f"{hidden[i] if i < len(hidden) else '':<36}{named[i] if i < len(named) else ''}")
    lines += [f"  {text}" for text in _values(outcome)]
    lines.append("the diagnosis is right" if outcome.right else "the diagnosis is WRONG: " + _wrong(outcome))
    for joint in outcome.ladder.get("joints", {}):
        before, after, floor, unit = outcome.errors(joint)
        texts = [quantity(value, unit) for value in (before, after, floor)]
        share = percent_of(after / before) if before else "-"
        lines.append(f"model error of {joint}, held out: {texts[0]} -> {texts[1]} ({share}); noise {texts[2]}")
    return [*lines, *_tracking(outcome), *verdicts(outcome)]


def _sure(named: Mapping[str, Any]) -> str:
    if "confidence" in named:
        return f" ({100.0 * named['confidence']:.0f} %)"
    return f" (depends on {', '.join(named['depends_on'])})"


def _values(outcome: Outcome) -> list[str]:
    """True beside fitted values, where both have one of the same name."""
    found = []
    for hidden in outcome.hidden:
        mine = [d for d in outcome.diagnosed if (d["joint"], d["name"]) == (hidden["joint"], hidden["name"])]
        for name, true in hidden["parameters"].items():
            for said in [d["parameters"][name] for d in mine if name in d["parameters"]]:
                found.append(f"{name}: true {true:.4g}, found {said['value']:.4g} {said['unit']}")
    return found


def _wrong(outcome: Outcome) -> str:
    """Which joints were judged wrongly."""
    said = []
    for joint, score in outcome.scores.items():
        if not score["correct"]:
            parts = [f"{what} {', '.join(score[what])}" for what in ("missed", "wrong") if score[what]]
            said.append(f"{joint}: {'; '.join(parts) or score['verdict']}")
    return " | ".join(said) or "no answer"


def _tracking(outcome: Outcome) -> list[str]:
    before, after = outcome.rms("goal_before"), outcome.rms("goal_after")
    if before is None or after is None:
        return []
    lines = ["tracking error, the same goal", "  joint       before     after   (RMS, µrad)"]
    for joint, value in before.items():
        ratio = f"{value / after[joint]:.1f} times smaller" if joint in outcome.suspects and after[joint] else ""
        lines.append(f"  {joint:9} {value * 1e6:8.1f}  {after[joint] * 1e6:8.1f}   {ratio}".rstrip())
    return lines


def verdicts(outcome: Outcome) -> list[str]:
    """One honest sentence for each joint with a new model."""
    before, after = outcome.rms("goal_before"), outcome.rms("goal_after")
    if before is None or after is None:
        return ["nothing was found, so the controllers stay as they are and no second goal was run"]
    return [_verdict(outcome, joint, before[joint], after[joint]) for joint in outcome.suspects]


def _verdict(outcome: Outcome, joint: str, before: float, after: float) -> str:
    used, left = outcome.fed_forward(joint)
    share = f"{percent_of(after / before)} of before" if before else "not measurable before"
    if not used:
        reasons: Sequence[str] = left or ["nothing was added to its model"]
        why = "; ".join(reasons)
        return f"{joint}: better on paper only, tracking is {share}: feed-forward cannot help here ({why})"
    names = ", ".join(name.replace("_", " ") for name in used)
    if after <= HALF * before:
        return f"{joint}: with the {names} in its controllers the tracking error is {share}"
    return f"{joint}: the {names} is in its controllers, yet the tracking error is {share}, not halved"
