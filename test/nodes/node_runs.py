"""Sessions for process tests: lock-step, local discovery, a random domain, bounded waits."""

from __future__ import annotations

import os
import random
import signal
from dataclasses import replace
from pathlib import Path

import numpy as np

from hd_control.laws.trajectory import Goal, quintic_move
from hd_control.session.session import RunPlan, Session

START = np.array([0.2, 0.5, -0.6, 1.0, -0.5, 0.4, 0.3])
"""Start position of the shipped plant arm_a, rad."""
JOINTS = tuple(f"joint_{number}" for number in range(1, 8))
PAUSE, GOAL_TICK, END = 160, 180, 520  # the brakes open at tick 100


def a_goal() -> Goal:
    """All joints by 0.05 rad at 0.3 rad/s; times in whole nanoseconds, as a message carries them."""
    goal = quintic_move(JOINTS, START, START + 0.05, 0.3, "move")
    return replace(goal, start_tick=GOAL_TICK, times=np.round(goal.times, 9))


def run_with_goal(session: Session, end: int = END) -> None:
    """To a pause, a goal that starts 20 ticks later, then to the end; every run does the same at the same ticks."""
    session.activate()
    session.wait_until_tick(PAUSE)
    session.send_goal(a_goal())
    session.run_to(end)


class MortalSession(Session):
    """A session whose nodes may be killed: from then on the end of a process is no error."""

    killed = False

    def _ended(self) -> list[str]:
        return [] if self.killed else super()._ended()

    def pid(self, node: str) -> int:
        """Process id of a node that is going to end."""
        self.killed = True
        return self._children.processes[node].pid

    def kill(self, node: str) -> None:
        """Kills a node's process and waits for its end."""
        os.kill(self.pid(node), signal.SIGKILL)
        self.wait_for(lambda: not self.alive(node), 5.0, "the node did not die")

    def alive(self, node: str) -> bool:
        """True while the node's process runs."""
        return self._children.processes[node].poll() is None


def random_domain() -> int:
    return random.SystemRandom().randint(1, 100)


def record(folder: Path, **plan: object) -> Path:
    """Runs a plan with a goal and a recorder in lock-step; returns the bag."""
    plant = "chain" if "chain" in plan.get("nodes", ()) else "plant_node"  # type: ignore[operator]
    chosen = RunPlan(lockstep=True, bag=folder / "bag", parameters={plant: {"pause_at_tick": PAUSE}}, **plan)  # type: ignore[arg-type]
    with Session(chosen, random_domain(), folder / "logs") as session:
        run_with_goal(session)
    assert set(session.exit_codes.values()) == {0}, session.exit_codes
    return folder / "bag"
