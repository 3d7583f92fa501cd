"""The motion law with the trajectory in front of it. Goals are checked by another thread and handed over as paths."""

from __future__ import annotations

from typing import Any

import numpy as np

from hd_control.chain.stage import OK, Stage
from hd_control.chain.wiring import MOTION
from hd_control.core.robot import Robot
from hd_control.laws import motion
from hd_control.laws.trajectory import Path, SlowMotion, TrajectoryFollower, refusal

LOST_TOLERANCE = 0.05
"""rad; a reference further from the joint is no motion any more: the goal is dropped, the reference is set anew."""
DEGRADED = "DEGRADED"
STOPPED = ("STOPPING", "HOLDING", "STOPPED")
NOT_READY = {
    DEGRADED: "wait until the cause is gone",
    "STOPPING": "wait for rest, then call reset",
    "HOLDING": "call reset",
    "STOPPED": "call reset",
}
"""Modes of the torque law in which no goal is accepted, and what to do."""
MODES = ("INACTIVE", "ACTIVE", *NOT_READY)
"""Modes of a torque law, from the one that needs least attention to the one that needs most."""


class MotionStage(Stage):
    """Follows one path, holds the measured position before the first and after a joint has lost its reference.

    `controller_mode` is the worst mode that the torque law has reported, "" before the first; any thread may set it. While
    it is DEGRADED the path runs slowly (`slow_motion`) and new goals are refused.
    """

    def __init__(self, robot: Robot, dt: float, blend_time: float) -> None:
        super().__init__(MOTION, motion, robot, dt)
        self.blend_time = blend_time
        self.follower: TrajectoryFollower | None = None
        self._handover: Path | None = None
        self._reference_array = self._find_reference_array()
        self._measured = self.sample.joint_position
        self.late_goals = self.aborted_goals = 0
        self.controller_mode = ""
        self.slow = SlowMotion(dt)
        self.reset_asked = False
        self.reset_answer: list[str] | None = None

    def start(self) -> None:
        """A new activation: link parameters survive, the reference starts at the measured position."""
        kept = None if self.state is None else motion.restarted(self.state)
        super().start()
        self.state, self.follower, self._handover = kept, None, None
        self.slow.reset()

    def refuse_unless_ready(self) -> None:
        """Raises GoalError while the torque law is degraded or stopped."""
        remedy = NOT_READY.get(self.controller_mode)
        if remedy is not None:
            what = f"the torque law is {self.controller_mode}, goals need ACTIVE"
            raise refusal("controller_state", "", what, f"{remedy[0].upper()}{remedy[1:]}")

    def hand_over(self, path: Path) -> None:
        """Gives a checked path to the loop, from any thread; the newest wins."""
        self._handover = path

    def has(self, path: Path | None) -> bool:
        """Is this path followed, or will it be? From any thread."""
        handed, follower = self._handover, self.follower  # read first: the loop moves a path from here to there
        return path is handed or (follower is not None and (path is follower.pending or path is follower.active))

    def act(self, tick: int) -> None:
        if self.follower is None:
            self.follower = TrajectoryFollower(
                self.joint_names, self.dt, self.sample.joint_position, tick, self.blend_time
            )
        self._check_reference(tick)
        path, self._handover = self._handover, None
        if path is not None:
            self._take(path, tick)
        degraded = self.controller_mode == DEGRADED
        if degraded or not self.slow.at_rest:
            self._sample_slowly(tick, degraded)
        else:
            self.follower.sample(tick, self._reference_array)
        super().act(tick)

    def _sample_slowly(self, tick: int, degraded: bool) -> None:
        """The reference on the path's own time; back at full rate the path itself is put off by what was lost."""
        follower, slow = self.follower, self.slow
        assert follower is not None
        slow.step(degraded)
        follower.sample(tick - slow.lag, self._reference_array)
        slow.scale(self._reference_array)
        if slow.rate == 1.0:
            follower.delay(slow.lag)
            slow.reset()

    def _check_reference(self, tick: int) -> None:
        """Drops the goal when a joint does not follow any more, or on a reset: the reference becomes its position."""
        follower, measured = self.follower, self._measured
        assert follower is not None
        far = np.abs(self._reference_array[: measured.size] - measured) > LOST_TOLERANCE
        lost = self.tick >= 0 and bool(far.any())
        if self.controller_mode in STOPPED and follower.moving(tick - self.slow.lag):
            lost = True  # A2 and A3 abort the goal
        if (lost or self.reset_asked) and np.isfinite(measured).all():
            self.aborted_goals += int(follower.moving(tick - self.slow.lag))
            follower.hold(measured, tick)
            self.slow.reset()
            if self.reset_asked:
                self.reset_answer, self.reset_asked = [], False

    def _take(self, path: Path, tick: int) -> None:
        assert self.follower is not None
        if path.start_tick < tick or not self.slow.at_rest:  # made for a reference that is not there any more
            self.late_goals += 1
        else:
            self.follower.accept(path, tick)

    def _find_reference_array(self) -> Any:
        """The reference block begins with position, velocity, acceleration: the follower writes straight into it."""
        assert self.reference is not None
        return self.reference.array[: 3 * len(self.joint_names)]

    def report(self) -> tuple[int, str, dict[str, Any]]:
        follower = self.follower
        if follower is None:
            return OK, "", {"goal": "none"}
        moving = follower.moving(self.tick - self.slow.lag)
        return (
            OK,
            "",
            {
                "goal": follower.active.identifier,
                "moving": moving,
                "rate": self.slow.rate,
                "late_goals": self.late_goals,
                "aborted_goals": self.aborted_goals,
            },
        )
