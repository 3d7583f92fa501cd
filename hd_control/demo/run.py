"""The steps of the demo, one after the other. The seal is written first and opened last.

    outcome = run_demo(make_story(seed=0), Path("bags/demo"), DemoOptions(lockstep=True), print)

Steps that are `hd` commands run as a user would run them, in processes that know no more than a user. Before the first
step it is made sure that no other demo runs, that a ROS domain is free and that the disk has room. Ctrl-C at any step
ends every process; what is finished stays, and the exception names it.
"""

from __future__ import annotations

import contextlib
import errno
import fcntl
import json
import os
import random
import shlex
import shutil
import signal
import socket
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from hd_control.core.errors import GoalError, HdError
from hd_control.core.files import write_whole
from hd_control.core.parameters import params_text
from hd_control.demo.live import LiveRobot, NotKept
from hd_control.demo.outcome import Outcome, quantity, tracking_in
from hd_control.demo.plan import StoryPlan
from hd_control.record.bag_folder import FLOOR_BYTES, FLOOR_SHARE
from hd_control.session.session import FOUR, Children, child_environment
from hd_sim.puzzles.puzzle import score_joint
from hd_sim.runner import RunSetup
from hd_sim.truth import open_seal

# ---- Steps that are `hd` commands of their own -----------------------------------------------------


PATIENCE = 600.0
"""s after which a command counts as stuck."""
FINE = (0, 3)
"""Exit codes that give an answer: done, and partly read."""


class Commands:
    """Runs `hd` commands in a folder; their text goes to FOLDER/logs, their answer is the JSON that they write."""

    def __init__(
        self, folder: Path, say: Callable[[str], None], domain: int | None = None, gently: bool = False
    ) -> None:
        """`gently`: leave the processor to nodes that run on the wall clock."""
        self._folder, self._say, self._domain, self._nice = folder, say, domain, 10 if gently else 0

    def run(self, words: Sequence[str], answer: str, allowed: Sequence[int] = FINE) -> dict[str, Any]:
        """Runs `hd WORDS --json ANSWER` returns the JSON. Raises HdError with the command's own line if it fails."""
        shown = f"hd {shlex.join(words)}"
        self._say(shown)
        log = self._folder / "logs" / f"{Path(answer).stem}.txt"
        log.parent.mkdir(exist_ok=True)
        command = [sys.executable, "-m", "hd_control.cli.main", *words, "--json", answer, "--force"]
        children = Children(child_environment(self._domain, real_time=False))
        with log.open("wb") as stream:
            process = children.start("hd", command, stdout=stream, stderr=stream, cwd=self._folder)
            try:
                if self._nice:
                    os.setpriority(os.PRIO_PROCESS, process.pid, self._nice)
                end = time.monotonic() + PATIENCE
                while process.poll() is None and time.monotonic() < end:
                    time.sleep(0.02)
            finally:
                _end(process)
        if process.returncode not in allowed:
            lines = log.read_text(errors="replace").strip().splitlines()
            why = lines[-1].removeprefix("hd: ") if lines else f"exit code {process.returncode}"
            raise HdError(f"{shown}: {why}")
        found: dict[str, Any] = json.loads((self._folder / answer).read_text(encoding="utf-8"))
        return found


def _end(process: subprocess.Popen[bytes]) -> None:
    """Ends a command that still runs, with the workers of its group."""
    for number in (signal.SIGTERM, signal.SIGKILL):
        if process.poll() is not None:
            return
        with contextlib.suppress(ProcessLookupError):
            os.killpg(process.pid, number)
        with contextlib.suppress(subprocess.TimeoutExpired):
            process.wait(3.0)


# ---- What must be right before the first step ------------------------------------------------------


DOMAINS = range(1, 101)
"""Above, the ports of the middleware run into those that the system hands out."""
BYTES_PER_JOINT_SECOND, BYTES_PER_SECOND = 250_000, 600_000
"""Recorded: seven joints at 1 kHz take 2.3 MB/s."""


@contextmanager
def alone(what: str) -> Iterator[None]:
    """Only one demo of a user at a time: two would take each other's milliseconds. Raises HdError if one runs."""
    folder = Path(os.environ.get("XDG_RUNTIME_DIR") or tempfile.gettempdir())
    path = folder / f"hd_demo_{os.getuid()}.lock"
    handle = os.open(path, os.O_RDWR | os.O_CREAT | os.O_CLOEXEC | os.O_NOFOLLOW, 0o600)
    try:
        try:
            fcntl.flock(handle, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except OSError as error:
            if error.errno not in (errno.EAGAIN, errno.EACCES):
                raise
            owner = os.pread(handle, 200, 0).decode(errors="replace").strip() or "of an unknown process"
            raise HdError(f"another hd demo runs ({owner}); wait for its end or stop it") from None
        os.ftruncate(handle, 0)
        os.pwrite(handle, f"process {os.getpid()}, {what}".encode(), 0)
        yield
    finally:
        os.close(handle)  # releases the lock; the empty file stays, removing it would race with the next one


def domain_in_use(domain: int) -> bool:
    """Does a process of this machine take part in a ROS domain? Each binds one of the domain's unicast ports."""
    base = 7400 + 250 * domain
    return any(_taken(base + offset) for offset in (10, 11, 12, 13))


def _taken(port: int) -> bool:
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as probe:
        try:
            probe.bind(("0.0.0.0", port))
        except OSError as error:
            return error.errno == errno.EADDRINUSE
        return False


def free_domain(wanted: int | None) -> int:
    """The wanted ROS domain, or a random one that nobody uses. Raises HdError if it, or all of them, are in use."""
    if wanted is not None:
        if not 0 <= wanted <= DOMAINS[-1]:
            raise HdError(f"--domain {wanted} is outside [0, {DOMAINS[-1]}]")
        if domain_in_use(wanted):
            raise HdError(f"ROS domain {wanted} is in use on this machine; leave --domain out, or name another one")
        return wanted
    chosen = random.SystemRandom().sample(DOMAINS, len(DOMAINS))
    found = next((domain for domain in chosen if not domain_in_use(domain)), None)
    if found is None:
        raise HdError(f"all ROS domains from {DOMAINS[0]} to {DOMAINS[-1]} are in use on this machine")
    return found


def enough_disk(folder: Path, seconds: float, joints: int) -> None:
    """Is there room for the recordings, above what the recorder leaves free? Raises HdError with the numbers."""
    usage = shutil.disk_usage(folder)
    floor = min(FLOOR_BYTES, FLOOR_SHARE * usage.total)
    needed = floor + seconds * (BYTES_PER_SECOND + joints * BYTES_PER_JOINT_SECOND)
    if usage.free < needed:
        raise HdError(
            f"{folder}: {usage.free / 1e6:.0f} MB are free, {needed / 1e6:.0f} MB are needed "
            f"(the recorder leaves {floor / 1e6:.0f} MB free); free some space or choose another disk with -o"
        )


# ---- The steps -------------------------------------------------------------------------------------


SEAL, DIAGNOSIS, BETTER, CONTROLLERS = "truth.seal", "diagnosis.json", "better.yaml", "controllers"
EXCITATION, BEFORE, AFTER = "excitation", "goal_before", "goal_after"
STARTED, NODES = "controllers_before", ("torque_node", "fusion_node", "motion_node")
APPLY_SAYS_NO = 1
Say = Callable[[str], None]


@dataclass(frozen=True)
class DemoOptions:
    """`wall`: never fall back to lock-step. `domain` None: a free one. `every_joint`: ladders for all joints.

    On the wall clock every node is a process; in lock-step `one_process` holds them all (but the recorder).
    """

    lockstep: bool = False
    wall: bool = False
    keep: bool = False
    every_joint: bool = False
    domain: int | None = None
    one_process: bool = True


def run_demo(story: StoryPlan, folder: Path, options: DemoOptions, say: Say) -> Outcome:
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


def _with_fallback(story: StoryPlan, folder: Path, options: DemoOptions, say: Say) -> Outcome:
    """On the wall clock; if the machine does not keep 1 kHz, the whole story again in lock-step."""
    if options.lockstep:
        return _DemoRun(story, folder, options, True, say).run()
    try:
        return _DemoRun(story, folder, options, False, say).run()
    except (NotKept, GoalError) as error:
        if options.wall:
            raise
        say(f"this machine did not keep 1 kHz ({error}); the story again in lock-step")
    attempt = folder / "wall_clock"
    attempt.mkdir()
    for path in sorted(folder.iterdir()):
        if path not in (attempt, folder / SEAL):
            path.rename(attempt / path.name)
    return _DemoRun(story, folder, options, True, say).run()


class _DemoRun:
    """One run of the story on one clock."""

    def __init__(self, story: StoryPlan, folder: Path, options: DemoOptions, lockstep: bool, say: Say) -> None:
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
            write_whole(place / f"{node}.yaml", params_text(setup.node_values(node)))

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
