"""The robot of a story on live nodes: motion in phases, each recorded in a bag of its own.

Between two phases all nodes are inactive and the brakes hold, so that the computer may think. Every phase begins the
same way: nodes activated, a second of rest, then the motion. Adapted estimates survive from phase to phase.
"""

from __future__ import annotations

import math
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from types import TracebackType
from typing import Any

from hd_control.core.errors import HdError
from hd_control.demo.plan import StoryPlan
from hd_control.nodes.fast_loop import missed_percent
from hd_control.session.session import RunPlan, Session
from hd_sim.scenario import Plan

LEAD = 200
"""Ticks between activation and what is prepared before the motion; the drives obey after 100."""
START_S = 10.0
"""Longest wait for drives that obey, on the wall clock; on a machine that keeps 1 kHz it takes 0.1 s."""
SLOWEST = 12.0
"""Lock-step may take so many times the motion's own time."""


class RobotStopped(HdError):
    """The safety gate stopped the robot."""

    exit_code = 1


class NotKept(RobotStopped):
    """The wall clock was too fast for this machine."""


@dataclass(frozen=True)
class Phase:
    """A recorded motion: its bag, the stamps of the window of its tracking error in ns, missed ticks in per cent."""

    bag: Path
    window: tuple[int, int]
    missed: float


class LiveRobot:
    """The nodes of a story's robot, as a context manager; leaving it stops all processes."""

    def __init__(self, story: StoryPlan, folder: Path, lockstep: bool, domain: int, nodes: tuple[str, ...]) -> None:
        self.story, self.lockstep, self._folder = story, lockstep, folder
        world = "chain" if "chain" in nodes else "plant_node"
        given = _by_executable(story, world == "chain")
        given[world] = {**given.get(world, {}), **story.plant_values()}
        plan = RunPlan(
            nodes=nodes,
            plant=story.plant,
            robot=story.visible.robot.name,
            lockstep=lockstep,
            bag=folder / "excitation",
            parameters=given,
        )
        self.session = Session(plan, domain, folder / "logs")
        self._configured = False

    def __enter__(self) -> LiveRobot:
        self.session.__enter__()
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.session.__exit__(kind, error, trace)

    def phase(
        self, name: str, plan: Plan, attach: Sequence[Path] = (), prepare: Callable[[], None] | None = None
    ) -> Phase:
        """Records one motion. `attach`: parameter files for the bag; `prepare` is called before it, the robot at rest.

        Raises RobotStopped, NotKept, HdError.
        """
        session, period = self.session, self.story.visible.period
        begun = self._activate(self._folder / name, [str(path) for path in attach] or [""]) + LEAD
        if prepare is not None:
            prepare()
        shift = self._move(plan, begun)
        self._until(plan.ticks + shift, plan.ticks * period)
        world = session.fresh_diagnostics(session.plant_node)
        self._check()
        session.deactivate()
        first, last = (round(round(time / period + shift) * period * 1e9) for time in plan.window)
        return Phase(self._folder / name, (first, last), missed_percent(world))

    def _activate(self, bag: Path, attach: list[str]) -> int:
        """Activates all nodes, the recorder with a new bag; returns the first tick of the phase."""
        session = self.session
        if not self._configured:
            session.configure()
            self._configured = True
        refused = session.set_parameters("recorder_node", {"bag": str(bag), "attach": attach})
        first = max(session.tick(), 0)
        if self.lockstep:
            refused = refused or session.set_parameters(session.plant_node, {"pause_at_tick": first + LEAD})
        if refused:
            raise HdError(refused)
        known = session.tick()
        session.activate_again()
        if self.lockstep:
            self._until(first + LEAD, LEAD * 1e-3)
            return first
        session.wait_for(lambda: session.tick() > known, START_S, "the plant does not run")
        first = session.tick()
        self._until(first + LEAD, LEAD * 1e-3)
        return first

    def _move(self, plan: Plan, begun: int) -> int:
        """Hands the goal over; returns how many ticks later than planned the motion begins."""
        session, period = self.session, self.story.visible.period
        ((_, goal),) = plan.goals
        planned = goal.start_tick or 0
        if self.lockstep:
            session.send_goal(replace(goal, start_tick=begun + planned), period)
            refused = session.set_parameters(session.plant_node, {"pause_at_tick": begun + plan.ticks})
            if refused:
                raise HdError(refused)
            return begun
        try:
            session.wait_until_armed(START_S)
        except HdError as error:
            raise NotKept(str(error)) from error
        self._until(session.tick() + planned, planned * period)
        answer = session.send_goal(replace(goal, start_tick=None), period)
        return int(answer.split()[answer.split().index("start_tick") + 1]) - planned

    def _until(self, tick: int, seconds: float) -> None:
        """Waits for a tick and looks for stops meanwhile. Raises RobotStopped, NotKept, HdError."""
        end = time.monotonic() + (60.0 + seconds * SLOWEST if self.lockstep else START_S + 1.5 * seconds)

        def there() -> bool:
            self._check()
            if time.monotonic() > end:
                kind = HdError if self.lockstep else NotKept
                raise kind(f"the plant did not come to tick {tick} in time, it is at {self.session.tick()}")
            return self.session.tick() >= tick

        self.session.wait_for(there, math.inf, "")

    def _check(self) -> None:
        """Raises RobotStopped if a gate has stopped the robot, HdError if the recording failed."""
        for process in self.session.processes:
            said = self.session.diagnostics(process.node)
            if said.get("gate_stopped") == "True":
                kind = RobotStopped if self.lockstep else NotKept
                raise kind(f"{process.node} stopped the robot: {said.get('message', '')}")
            if process.executable == "recorder_node" and said.get("level") == "2":
                raise HdError(f"the recording failed: {said.get('message', '')}")


def _by_executable(story: StoryPlan, in_one: bool) -> dict[str, dict[str, Any]]:
    """The controllers' parameters by executable; in one process they carry the stage's prefix."""
    if not in_one:
        return {node: dict(own) for node, own in story.values.items()}
    pairs = ((node.removesuffix("_node"), own) for node, own in story.values.items())
    return {"chain": {f"{stage}.{name}": value for stage, own in pairs for name, value in own.items()}}
