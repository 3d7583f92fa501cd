"""The steps of the story, one after the other. The seal is written first and opened last.

    outcome = tell(make_story(seed=0), Path("bags/demo"), TellOptions(lockstep=True), print)

Ctrl-C at any step ends every process; what is finished stays, and the exception names it.
"""

from __future__ import annotations

import json
import shutil
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from hd_control.core.errors import GoalError, HdError
from hd_control.core.params_file import params_text
from hd_control.nodes.run_plan import FOUR
from hd_control.story.commands import Commands
from hd_control.story.guards import alone, enough_disk, free_domain
from hd_control.story.live import LiveRobot, NotKept
from hd_control.story.outcome import Outcome, quantity, tracking_in
from hd_control.story.plan import StoryPlan
from hd_sim.challenge_score import score_joint
from hd_sim.runner import RunSetup
from hd_sim.truth import open_seal

SEAL, DIAGNOSIS, BETTER, CONTROLLERS = "truth.seal", "diagnosis.json", "better.yaml", "controllers"
EXCITATION, BEFORE, AFTER = "excitation", "goal_before", "goal_after"
STARTED, NODES = "controllers_before", ("torque_node", "fusion_node", "motion_node")
APPLY_SAYS_NO = 1
Tell = Callable[[str], None]


@dataclass(frozen=True)
class TellOptions:
    """`wall`: never fall back to lock-step. `domain` None: a free one. `every_joint`: ladders for all joints.

    On the wall clock every node is a process; in lock-step `one_process` holds them all (but the recorder).
    """

    lockstep: bool = False
    wall: bool = False
    keep: bool = False
    every_joint: bool = False
    domain: int | None = None
    one_process: bool = True


def tell(story: StoryPlan, folder: Path, options: TellOptions, say: Tell) -> Outcome:
    """Runs the story into a new folder. Raises HdError; KeyboardInterrupt with a text that names what is kept."""
    enough_disk(folder.parent, story.seconds, story.visible.joints)
    with alone(f"writing {folder}"), _kept(folder):
        folder.mkdir(parents=True, exist_ok=True)
        story.seal(folder / SEAL)
        outcome = _with_fallback(story, folder, options, say)
        if not options.keep:
            shutil.rmtree(folder / "logs", ignore_errors=True)
            shutil.rmtree(folder / "wall_clock", ignore_errors=True)
        return outcome


@contextmanager
def _kept(folder: Path) -> Iterator[None]:
    """Names what is there if the story does not come to its end."""
    try:
        yield
    except (KeyboardInterrupt, HdError) as error:
        done = sorted(path.name for path in folder.iterdir() if path.name != SEAL) if folder.is_dir() else []
        if not done:
            shutil.rmtree(folder, ignore_errors=True)
            raise
        error.args = (f"{error}{'; ' if str(error) else ''}kept in {folder}: {', '.join(done)}",)
        raise


def _with_fallback(story: StoryPlan, folder: Path, options: TellOptions, say: Tell) -> Outcome:
    """On the wall clock; if the machine does not keep 1 kHz, the whole story again in lock-step."""
    if options.lockstep:
        return _Telling(story, folder, options, True, say).run()
    try:
        return _Telling(story, folder, options, False, say).run()
    except (NotKept, GoalError) as error:
        if options.wall:
            raise
        say(f"this machine did not keep 1 kHz ({error}); the story again in lock-step")
    attempt = folder / "wall_clock"
    attempt.mkdir()
    for path in sorted(folder.iterdir()):
        if path not in (attempt, folder / SEAL):
            path.rename(attempt / path.name)
    return _Telling(story, folder, options, True, say).run()


class _Telling:
    """One run of the story on one clock."""

    def __init__(self, story: StoryPlan, folder: Path, options: TellOptions, lockstep: bool, say: Tell) -> None:
        self.story, self.folder, self.options, self.say = story, folder, options, say
        self.domain = free_domain(options.domain)
        self.commands = Commands(folder, lambda text: say(f"$ {text}"), self.domain, gently=not lockstep)
        nodes = ("chain",) if lockstep and options.one_process else FOUR
        self.robot = LiveRobot(story, folder, lockstep, self.domain, nodes)
        self.outcome = Outcome(str(folder), "lockstep" if lockstep else "wall")

    def run(self) -> Outcome:
        """All steps."""
        self._controllers_before()
        clock = "in lock-step" if self.robot.lockstep else "in real time, 1 kHz"
        names = ", ".join(process.node for process in self.robot.session.processes)
        self.say(f"a robot with something hidden in it: {names}, {clock}")
        with self.robot:
            self._record(EXCITATION, "it moves so that every effect shows")
            self._record(BEFORE, "a goal, with the controllers as commissioned")
            self._look()
            if self._add():
                self._improve()
        self._open_seal()
        return self.outcome

    def _record(self, name: str, meaning: str, prepare: Callable[[], None] | None = None) -> None:
        plan = self.story.excitation if name == EXCITATION else self.story.goal
        self.say(f"{name}: {plan.ticks * self.story.visible.period:.0f} s, {meaning}")
        attach = [self.folder / STARTED / f"{node}.yaml" for node in NODES]
        if name == AFTER:
            attach = [new if (new := self.folder / CONTROLLERS / old.name).is_file() else old for old in attach]
        phase = self.robot.phase(name, plan, attach, prepare)
        self.outcome.phases[name] = phase
        if name != EXCITATION:
            self.outcome.tracking[name] = tracking_in(phase)

    def _controllers_before(self) -> None:
        """The parameters with which the nodes start, as files."""
        place = self.folder / STARTED
        place.mkdir()
        setup = RunSetup(self.story.visible, self.story.seed, self.story.values)
        for node in NODES:
            (place / f"{node}.yaml").write_text(params_text(setup.node_values(node)), encoding="utf-8")

    def _look(self) -> None:
        """Compare and diagnose. They know the recordings and the data sheet."""
        model = ["--model", self.story.model]
        self.outcome.compare = self.commands.run(["compare", BEFORE, *model], "compare.json")
        self._notes(self.outcome.compare)
        for joint, found in self.outcome.compare["joints"].items():
            self.say(f"  {joint}: {_worst(found['channels'])}")
        self.outcome.diagnosis = self.commands.run(["diagnose", EXCITATION, *model], DIAGNOSIS)
        self._notes(self.outcome.diagnosis)
        for joint, found in self.outcome.diagnosis["joints"].items():
            self.say(f"  {joint}: {_answer(found)}")

    def _notes(self, answer: Mapping[str, Any]) -> None:
        """What is wrong with a recording, each remark once."""
        for note in dict.fromkeys(note for found in answer["joints"].values() for note in found["notes"]):
            self.say(f"  ! {note}")

    def _add(self) -> bool:
        """The ladder of every joint in whose model something is missing. False if there is none."""
        joints = list(self.outcome.diagnosis["joints"]) if self.options.every_joint else self.outcome.suspects
        if not joints:
            return False
        words = ["ladder", EXCITATION, "--held-out", BEFORE, "--model", self.story.model, "-o", BETTER]
        words += [word for joint in joints for word in ("--joint", joint)]
        self.outcome.ladder = self.commands.run(words, "ladder.json")
        for joint, found in self.outcome.ladder["joints"].items():
            steps = ", ".join(rung["effect"].replace("_", " ") for rung in found["rungs"][2:]) or "nothing"
            self.say(f"  {joint}: added {steps}; stopped: {found['stopped_because']}")
        return True

    def _improve(self) -> None:
        """The new model as parameter files and into the running nodes, then the same goal again."""
        model = ["apply", "--model", BETTER, "--diagnosis", DIAGNOSIS]
        model += [word for joint in self.outcome.ladder["joints"] for word in ("--joint", joint)]
        files = [word for node in NODES[:2] for word in ("--params", f"{STARTED}/{node}.yaml")]
        self.commands.run([*model, *files, "-o", CONTROLLERS], "apply.json", (0, APPLY_SAYS_NO))

        def load() -> None:
            words = [*model, "--live", "--domain", str(self.domain)]
            self.outcome.applied = self.commands.run(words, "apply_live.json", (0, APPLY_SAYS_NO))
            changed = sum(len(values) for values in self.outcome.applied["changed"].values())
            self.say(f"  {changed} parameters changed in the running nodes, the model ramps in")

        self._record(AFTER, "the same goal with the new model", load)

    def _open_seal(self) -> None:
        """What was hidden, and whether the written diagnosis is right."""
        answers = json.loads((self.folder / DIAGNOSIS).read_text(encoding="utf-8"))["joints"]
        truth: dict[str, Any] = open_seal(self.folder / SEAL)
        self.outcome.truth = truth
        self.outcome.scores = {
            joint: score_joint(answers[joint], hidden).to_dict() for joint, hidden in truth["joints"].items()
        }


def _worst(channels: dict[str, Any]) -> str:
    """The channel with the largest error over its noise."""
    ratio = {name: c["rms_error"] / c["noise_floor"] for name, c in channels.items() if c["noise_floor"]}
    if not ratio:
        return "no channel can be judged"
    name = max(ratio, key=lambda one: ratio[one])
    error, floor = (quantity(channels[name][key], channels[name]["unit"]) for key in ("rms_error", "noise_floor"))
    return f"largest in {name.replace('_', ' ')}: error {error}, noise {floor}"


def _answer(found: dict[str, Any]) -> str:
    """The verdict of one joint in short."""
    names = [f"{e['name'].replace('_', ' ')} ({100.0 * e['confidence']:.0f} %)" for e in found["effects"]]
    names += [f"unknown, depends on {', '.join(found['unknown']['variables'])}"] if found["unknown"] else []
    return f"{found['verdict'].replace('_', ' ')}{': ' if names else ''}{', '.join(names)}"
