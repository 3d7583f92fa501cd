"""A challenge as a folder: two bags, the user's model beside them, the truth sealed, a text that says how to go on."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from hd_control.core.errors import ConfigError
from hd_sim.arm_pairs import ArmPair, make_arm_pair
from hd_sim.cases import Case
from hd_sim.challenge_score import Score, score_joint
from hd_sim.drive_bag import write_bag
from hd_sim.pairs import record_pair
from hd_sim.truth import open_seal, write_seal

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
    pair = record_pair(case)
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
    (folder / ROBOT).write_text(robot, encoding="utf-8")
    write_seal(folder / SEAL, truth)
    seconds = round(len(recordings[FIT]["time"]) * period)
    words = {"fit": FIT, "held_out": HELD_OUT, "model": MODEL, "robot": ROBOT, "seal": SEAL}
    (folder / README).write_text(_TEXT.format(what=what, seconds=seconds, **words), encoding="utf-8")


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
    poor = case.get("category") == "poor"
    found = {}
    for name, hidden in truth["joints"].items():
        try:
            score = score_joint(answers[name], hidden, tolerated)
        except (KeyError, TypeError, AttributeError, ValueError) as error:
            raise ConfigError(f"the diagnosis of {name} is not in the form of {DIAGNOSIS_SCHEMA} ({error})") from None
        found[name] = (score, {**hidden, "poor": poor, "motion": case.get("motion", "general")})
    return found


def is_right(score: Score, hidden: Mapping[str, Any]) -> bool:
    """Is the answer right? On a poor recording a refusal is, too."""
    return score.correct or (bool(hidden["poor"]) and score.refused)
