"""Scores of one diagnosis against the sealed truth of its joint, from the plain JSON form (`hd.diagnosis/1`).

Names are compared first, then what the answer says of the unknown, then the numbers. Names that a judge's world also
justifies (`tolerated`) count neither as right nor as wrong; "unknown" among them does the same for the flag.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import asdict, dataclass, field
from typing import Any

from hd_sim.cases import UNKNOWN

CONFIDENT = 0.5
"""A wrong name with at least this confidence is a wrong confident claim."""
REFUSED = "cannot_tell"
SILENT = (REFUSED, "failed")
"""Verdicts that answer nothing."""
SAME_VARIABLE = {
    "motor_position": "joint_position",
    "motor_torque_applied": "motor_torque",
    "gauge_torque": "joint_torque",
}
"""Variables that tell the same of an unknown effect: rotor and joint angle differ by the torsion only."""


@dataclass(frozen=True)
class Score:
    """One joint. `right`, `wrong`, `missed`, `tolerated`: names. Flags: None where there is nothing to ask.

    `top_1`: the first name is right; `group`: every hidden effect is named or among the confusable ones of a name;
    `exact`: exactly the hidden names; `clean`: exact, answered, and no needless unknown flag; `false_alarm`: something
    claimed on a joint that hides nothing; `confident_wrong`: a wrong name with confidence, or a needless unknown flag.
    """

    verdict: str
    right: tuple[str, ...] = ()
    wrong: tuple[str, ...] = ()
    missed: tuple[str, ...] = ()
    tolerated: tuple[str, ...] = ()
    refused: bool = False
    top_1: bool | None = None
    group: bool | None = None
    exact: bool = False
    clean: bool = False
    false_alarm: bool | None = None
    confident_wrong: bool = False
    unknown_flagged: bool = False
    unknown_channel: bool | None = None
    unknown_variable: bool | None = None
    parameters: tuple[Mapping[str, Any], ...] = field(default=())

    @property
    def correct(self) -> bool:
        """Is the whole answer right? On a poor recording a refusal is right too; `refused` tells."""
        found = self.unknown_variable is None or (self.unknown_flagged and self.unknown_variable)
        return self.clean and bool(found)

    def to_dict(self) -> dict[str, Any]:
        """Plain types, for the record."""
        return asdict(self) | {"correct": self.correct}


def score_joint(answer: Mapping[str, Any], truth: Mapping[str, Any], tolerated: tuple[str, ...] = ()) -> Score:
    """Scores the JSON form of one joint. `truth`: `names`, `unknown`, `parameters`, as sealed."""
    names, hidden = list(truth["names"]), list(truth["unknown"])
    effects = list(answer.get("effects") or [])
    claimed = [effect["name"] for effect in effects]
    right = tuple(name for name in claimed if name in names)
    spare = tuple(name for name in claimed if name in tolerated and name not in names)
    wrong = tuple(name for name in claimed if name not in names and name not in tolerated)
    missed = tuple(name for name in names if name not in claimed)
    verdict = str(answer["verdict"])
    flagged = verdict in ("unknown", "missing_and_unknown")
    also_named = bool(hidden) and bool(set(spare) & {also for h in hidden for also in UNKNOWN[h].also})
    needless = flagged and not hidden and "unknown" not in tolerated
    exact = not wrong and not missed
    sure = any(e["name"] in wrong and float(e.get("confidence") or 0.0) >= CONFIDENT for e in effects)
    judged = [name for name in claimed if name not in spare]
    return Score(
        verdict=verdict,
        right=right,
        wrong=wrong,
        missed=missed,
        tolerated=spare,
        refused=verdict == REFUSED,
        top_1=bool(judged) and judged[0] in names if names else None,
        group=_in_group(names, effects) if names else None,
        exact=exact,
        clean=exact and not needless and verdict not in SILENT,
        false_alarm=(bool(wrong) or needless) if not names and not hidden else None,
        confident_wrong=sure or needless,
        unknown_flagged=flagged or also_named,
        unknown_channel=_unknown_right(answer, hidden, "channel", also_named) if hidden else None,
        unknown_variable=_unknown_right(answer, hidden, "variables", also_named) if hidden else None,
        parameters=tuple(_parameters(effects, truth.get("parameters", {}))),
    )


def _in_group(names: list[str], effects: list[Mapping[str, Any]]) -> bool:
    """Is every hidden name claimed, or offered as confusable with a claim or as its runner-up?"""
    offered = set()
    for effect in effects:
        runner_up = effect.get("runner_up")
        offered |= {effect["name"], *(effect.get("confusable_with") or [])}
        offered |= {runner_up.get("name") if isinstance(runner_up, Mapping) else runner_up}
    return all(name in offered for name in names)


def _unknown_right(answer: Mapping[str, Any], hidden: list[str], what: str, also_named: bool) -> bool:
    """Does the unknown part name the right channel, or at least one right variable and no more than one other?"""
    if also_named:
        return True
    said = answer.get("unknown")
    if not said:
        return False
    if what == "channel":
        return any(said.get("channel") in UNKNOWN[name].channels for name in hidden)
    found = {SAME_VARIABLE.get(name, name) for name in said.get("variables") or []} - {"motor_direction", "direction"}
    return any(found & set(UNKNOWN[name].variables) for name in hidden) and len(found) <= 2


def _parameters(effects: list[Mapping[str, Any]], truth: Mapping[str, Mapping[str, float]]) -> list[dict[str, Any]]:
    """Relative errors and coverage of every parameter that truth and answer both give.

    Cosine and sine of one wave are judged by the length of their difference over the amplitude.
    """
    found: list[dict[str, Any]] = []
    for effect in effects:
        true = truth.get(effect["name"], {})
        given = effect.get("parameters") or {}
        for name, value in true.items():
            if name not in given or given[name].get("value") is None:
                continue
            size, value = _size(name, true), _same_turn(name, value, float(given[name]["value"]))
            error = abs(float(given[name]["value"]) - value) / size if size > 0.0 else math.inf
            low, high = given[name].get("low"), given[name].get("high")
            covered = None if low is None or high is None else bool(low <= value <= high)
            found.append({"effect": effect["name"], "name": name, "relative_error": error, "covered": covered})
    return found


def _same_turn(name: str, value: float, near: float) -> float:
    """A phase by whole turns next to another one; other values as they are."""
    turn = 2.0 * math.pi
    return value + turn * round((near - value) / turn) if name.endswith("_phase") else value


def _size(name: str, true: Mapping[str, float]) -> float:
    """What an error is relative to: the value, the amplitude of the wave that the parameter belongs to, 1 rad of a
    phase."""
    if name.endswith("_phase"):
        return 1.0
    kind, _, order = name.rpartition("_")
    if kind in ("cosine", "sine") or kind.endswith(("_cosine", "_sine")):
        stem = kind.removesuffix("cosine").removesuffix("sine")
        return math.hypot(true.get(f"{stem}cosine_{order}", 0.0), true.get(f"{stem}sine_{order}", 0.0))
    return abs(true[name])
