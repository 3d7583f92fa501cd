"""A challenge as a folder: two bags, the user's model, the sealed truth, a text that says how to go on; the score."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import Any

from hd_control.core.errors import ConfigError
from hd_control.core.files import write_whole
from hd_sim.puzzles.arm_recordings import ArmPair, make_arm_pair
from hd_sim.puzzles.draw import Case, Neutral, unknown_named
from hd_sim.puzzles.recordings import Pair, record_pair, write_bag
from hd_sim.truth import open_seal, write_seal

# ---- The score of one diagnosis against the sealed truth, from the plain JSON form (`hd.diagnosis/1`) ----
#
# Names are compared first, then what the answer says of the unknown, then the numbers. Names that a judge's world also
# justifies (`tolerated`) count neither as right nor as wrong; "unknown" among them does the same for the flag.


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
"""Variables that say the same of an unknown effect: rotor and joint angle differ by the torsion only."""


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
        """Is the whole answer right? On a poor recording a refusal is right too; see `refused`."""
        found = self.unknown_variable is None or (self.unknown_flagged and self.unknown_variable)
        return self.clean and bool(found)

    def to_dict(self) -> dict[str, Any]:
        """Plain types, for the record."""
        return asdict(self) | {"correct": self.correct}


def score_joint(
    answer: Mapping[str, Any], truth: Mapping[str, Any], tolerated: tuple[str, ...] = (), neutral: Neutral | None = None
) -> Score:
    """Scores the JSON form of one joint. `truth`: `names`, `unknown`, `parameters`, as sealed; `neutral`: `Case`."""
    names, hidden = list(truth["names"]), list(truth["unknown"])
    effects = list(answer.get("effects") or [])
    claimed = [effect["name"] for effect in effects]
    tolerated = (*tolerated, *(e["name"] for e in effects if _is_neutral(e, neutral or {})))
    right = tuple(name for name in claimed if name in names)
    spare = tuple(name for name in claimed if name in tolerated and name not in names)
    wrong = tuple(name for name in claimed if name not in names and name not in tolerated)
    missed = tuple(name for name in names if name not in claimed)
    verdict = str(answer["verdict"])
    flagged = verdict in ("unknown", "missing_and_unknown")
    also_named = bool(hidden) and bool(set(spare) & {also for h in hidden for also in unknown_named(h).also})
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


def _is_neutral(effect: Mapping[str, Any], neutral: Neutral) -> bool:
    """Is this what the world always has, with parameters in the bounds that it has there?"""
    if effect["name"] not in neutral:
        return False
    given = effect.get("parameters") or {}
    for name, (low, high) in neutral[effect["name"]].items():
        value = (given.get(name) or {}).get("value")
        if value is None or not low <= float(value) <= high:
            return False
    return True


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
        return any(said.get("channel") in unknown_named(name).channels for name in hidden)
    found = {SAME_VARIABLE.get(name, name) for name in said.get("variables") or []} - {"motor_direction", "direction"}
    return any(found & set(unknown_named(name).variables) for name in hidden) and len(found) <= 2


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


# ---- The folder ------------------------------------------------------------------------------------


FIT, HELD_OUT, MODEL, ROBOT, SEAL, README = "fit", "held_out", "model.yaml", "robot.urdf", "truth.seal", "README.txt"
DIAGNOSIS_SCHEMA = "hd.diagnosis/1"
_METADATA = {"clock": "lockstep", "command_delay_samples": "1"}
_TEXT = """Something may be hidden in {what}. Find out what.

{fit:12} {seconds} s recorded, for finding it
{held_out:12} a second recording of the same robot, for checking
{model:12} what the data sheet says
{robot:12} the robot description
{seal:12} what is hidden; only `hd challenge check` opens it

Next, in this folder:

  hd info {fit}
  hd compare {fit} --model {model}
  hd diagnose {fit} --model {model} --json diagnosis.json
  hd challenge check . diagnosis.json
  hd ladder {fit} --model {model} --held-out {held_out}
"""


@dataclass(frozen=True)
class Challenge:
    """What was written, and the nominal model by joint in plain types, which the caller writes to `model.yaml`."""

    folder: Path
    joint_names: tuple[str, ...]
    models: Mapping[str, Mapping[str, Any]]


def make_challenge(folder: Path, case: Case) -> Challenge:
    """Writes bags of a random joint, seal and text into an existing folder. Raises BagError, ConfigError."""
    return write_challenge(folder, record_pair(case))


def write_challenge(folder: Path, pair: Pair) -> Challenge:
    """The same for a pair of either world."""
    name = str(pair.model["joint"])
    recordings = {FIT: pair.fit, HELD_OUT: pair.held_out}
    _write(folder, (name,), recordings, str(pair.model["robot"]), pair.period, pair.truth, "this joint")
    return Challenge(folder, (name,), {name: pair.model})


def make_arm_challenge(folder: Path, seed: int) -> Challenge:
    """The same for a seven-joint arm with hidden effects on some of its joints."""
    pair: ArmPair = make_arm_pair(seed)
    recordings = {FIT: pair.fit, HELD_OUT: pair.held_out}
    _write(folder, pair.joint_names, recordings, pair.robot, pair.period, pair.truth, "some joints of this arm")
    return Challenge(folder, pair.joint_names, pair.models)


def _write(
    folder: Path,
    joint_names: tuple[str, ...],
    recordings: Mapping[str, Mapping[str, Any]],
    robot: str,
    period: float,
    truth: Mapping[str, Any],
    what: str,
) -> None:
    for name, columns in recordings.items():
        write_bag(folder / name, joint_names, columns, robot, period, _METADATA)
    write_whole(folder / ROBOT, robot)
    write_seal(folder / SEAL, truth)
    seconds = round(len(recordings[FIT]["time"]) * period)
    words = {"fit": FIT, "held_out": HELD_OUT, "model": MODEL, "robot": ROBOT, "seal": SEAL}
    write_whole(folder / README, _TEXT.format(what=what, seconds=seconds, **words))


def check_challenge(folder: Path, diagnosis: Mapping[str, Any]) -> dict[str, tuple[Score, dict[str, Any]]]:
    """Opens the seal and scores a written diagnosis: joint -> (score, what was hidden there).

    Raises ConfigError if the diagnosis is of another schema or leaves joints out.
    """
    if diagnosis.get("schema") != DIAGNOSIS_SCHEMA or not isinstance(diagnosis.get("joints"), Mapping):
        raise ConfigError(f"the diagnosis has schema {diagnosis.get('schema')!r}, expected {DIAGNOSIS_SCHEMA}")
    answers = diagnosis["joints"]
    truth = open_seal(folder / SEAL)
    missing = [name for name in truth["joints"] if name not in answers]
    if missing:
        raise ConfigError(f"the diagnosis says nothing of {', '.join(missing)}")
    case = truth.get("case", {})
    tolerated = tuple(case.get("tolerated", ()))
    neutral, poor = case.get("neutral", {}), case.get("category") == "poor"
    found = {}
    for name, hidden in truth["joints"].items():
        try:
            score = score_joint(answers[name], hidden, tolerated, neutral)
        except (KeyError, TypeError, AttributeError, ValueError) as error:
            raise ConfigError(f"the diagnosis of {name} is not in the form of {DIAGNOSIS_SCHEMA} ({error})") from None
        found[name] = (score, {**hidden, "poor": poor, "motion": case.get("motion", "general")})
    return found


def is_right(score: Score, hidden: Mapping[str, Any]) -> bool:
    """Is the answer right? On a poor recording a refusal is, too."""
    return score.correct or (bool(hidden["poor"]) and score.refused)
