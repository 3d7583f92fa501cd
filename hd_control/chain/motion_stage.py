"""The motion law with the trajectory in front of it. Goals are checked by another thread and handed over as paths."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from hd_control import _chain
from hd_control.chain.stage import OK, Stage, ramp_kinds
from hd_control.chain.wiring import MOTION
from hd_control.core.arrays import FloatArray
from hd_control.core.errors import GoalError
from hd_control.core.faults import FaultCode
from hd_control.core.robot import Robot
from hd_control.core.topics import CONNECTING, DRIVES_STOPPED, WARMING
from hd_control.laws import motion
from hd_control.laws.trajectory import Motion, Path, TrajectoryFollower, hold_path

DEGRADED = "DEGRADED"
NOT_READY = {
    DEGRADED: "wait until the cause is gone",
    "STOPPING": "wait for rest, then call reset",
    "HOLDING": "call reset",
    "STOPPED": "call reset",
}
"""Modes of the torque law in which no goal is accepted, and what to do."""
NOT_ARMED_CODE = "not_armed"
NOT_ARMED = {
    CONNECTING: "Activate the torque node: no command has come",
    WARMING: "Wait: commands must come in time 100 times in a row",
    DRIVES_STOPPED: "Call reset of the node of the drives",
}
"""States of the drives in which no goal is accepted, and what to do."""
MODES = ("INACTIVE", "ACTIVE", *NOT_READY)
"""Modes of a torque law, from the one that needs least attention to the one that needs most."""


class StageFollower(TrajectoryFollower):
    """What the compiled tick follows, for threads beside the loop: planning starts from here. Changes nothing."""

    def __init__(self, stage: MotionStage) -> None:
        self._stage = stage
        self.joint_names, self.period, self.blend_time = stage.joint_names, stage.dt, stage.blend_time
        self.cursor = 0

    @property
    def active(self) -> Path:  # type: ignore[override]
        """The path that is followed."""
        return self._stage.path_of(self._stage.native.active)

    @property
    def pending(self) -> Path | None:  # type: ignore[override]
        """The path that starts later."""
        found = self._stage.native.pending
        return None if found is None else self._stage.path_of(found)

    def copy(self) -> TrajectoryFollower:
        """An independent follower in the same state."""
        pending = self.pending  # read before `active`: the loop promotes in the other order
        active = self.active
        twin = TrajectoryFollower(self.joint_names, self.period, active.end.position, 0, self.blend_time)
        twin.active, twin.pending = active, pending
        return twin

    def moving(self, tick: float) -> bool:
        return bool(self._stage.native.moving(float(tick)))

    def hold(self, position: ArrayLike, tick: int) -> None:
        raise NotImplementedError("the loop alone sets the reference")


class MotionStage(Stage):
    """Follows one path, holds the measured position before the first and after a joint has lost its reference.

    `controller_mode` is the worst mode that the torque law has reported, "" before the first; any thread may set it.
    While it is DEGRADED the path runs slowly and new goals are refused. `drive_state` is what the drives say of
    themselves, "" if nobody says it; goals that start at once are refused until they are armed.
    """

    def __init__(self, robot: Robot, dt: float, blend_time: float) -> None:
        super().__init__(MOTION, motion, robot, dt)
        n, self.blend_time = robot.joints, blend_time
        kinds = ("params", "sample", "reference", "output", "state")
        blocks = {kind: motion.layout(f"Motion{kind.title()}", n) for kind in kinds}
        self._use(_chain.MotionTick(n, dt, ramp_kinds(motion, blocks["params"])), blocks)
        self._paths: dict[int, tuple[Path, Any]] = {}
        self._numbers = 0
        self._resets = 0
        self.drive_state = ""

    @property
    def follower(self) -> StageFollower | None:
        """The reference as threads beside the loop see it; None before the first tick."""
        return None if self.native.active is None else StageFollower(self)

    @property
    def controller_mode(self) -> str:
        """The mode of the torque law."""
        return ("", *MODES)[int(self.native.mode)]

    @controller_mode.setter
    def controller_mode(self, mode: str) -> None:
        self.native.mode = ("", *MODES).index(mode)

    @property
    def late_goals(self) -> int:
        """Paths that came too late to start where they begin."""
        return int(self.native.late_goals)

    @property
    def aborted_goals(self) -> int:
        """Goals that were dropped in motion."""
        return int(self.native.aborted_goals)

    @property
    def reset_asked(self) -> bool:
        """A reset waits for the next tick."""
        return bool(self.native.reset_asked)

    @reset_asked.setter
    def reset_asked(self, asked: bool) -> None:
        self.native.reset_asked = asked

    @property
    def reset_answer(self) -> list[str] | None:
        """The answer to a reset, once: no reason against it; None while there is none."""
        return [] if self.native.resets != self._resets else None

    @reset_answer.setter
    def reset_answer(self, answer: None) -> None:
        self._resets = self.native.resets

    def refuse_unless_ready(self, at_once: bool = False) -> None:
        """Raises GoalError while the torque law is degraded or stopped, or the drives do not obey.

        Drives that are being armed refuse only a goal that starts `at_once`; a later start may find them armed.
        """
        remedy = NOT_READY.get(self.controller_mode)
        if remedy is not None:
            text = FaultCode.GOAL_BAD.line(f"the torque law is {self.controller_mode}, goals need ACTIVE")
            raise GoalError("controller_state", f"{text}. {remedy[0].upper()}{remedy[1:]}.")
        if self.drive_state in NOT_ARMED and (at_once or self.drive_state == DRIVES_STOPPED):
            text = FaultCode.GOAL_BAD.line(f"not yet armed: the drives are {self.drive_state}")
            raise GoalError(NOT_ARMED_CODE, f"{text}. {NOT_ARMED[self.drive_state]}.")

    def hand_over(self, path: Path) -> None:
        """Gives a checked path to the loop, from any thread; the newest wins."""
        self._numbers += 1
        end = np.concatenate([path.end.position, path.end.velocity, path.end.acceleration])
        native = _chain.MotionPath(
            self._numbers, path.start_tick, path.period, np.ascontiguousarray(path.knots),
            np.ascontiguousarray(path.coefficients).ravel(), end,
        )  # fmt: skip
        used = self._used()
        self._paths = {number: item for number, item in self._paths.items() if number in used or number == used[-1]}
        self._paths[self._numbers] = (path, native)
        self.native.hand_over(native)

    def has(self, path: Path | None) -> bool:
        """Is this path followed, or will it be? From any thread."""
        used = self._used()
        return path is not None and any(known is path and number in used for number, (known, _) in self._paths.items())

    def _used(self) -> list[int]:
        """Numbers of the paths that the loop may follow. Read in the order in which the loop moves a path."""
        native = self.native
        handed = native.handed_over
        seen = [native.pending, native.active]
        newest = [self._numbers]  # the loop may hold the newest between taking and following it
        return [number for number in (handed, *(each[0] for each in seen if each is not None)) if number] + newest

    def path_of(self, seen: tuple[int, int, FloatArray, FloatArray]) -> Path:
        """A path as the loop has it now: number, start tick, knots, end."""
        number, start, knots, end = seen
        known = self._paths.get(number)
        if known is None:
            return hold_path(end[: len(self.joint_names)], start, self.dt)
        path = known[0]
        if path.start_tick == start and np.array_equal(path.knots, knots):
            return path
        return replace(path, start_tick=start, knots=knots)

    def report(self) -> tuple[int, str, dict[str, Any]]:
        follower = self.follower
        if follower is None:
            return OK, "", {"goal": "none"}
        return (
            OK,
            "",
            {
                "goal": follower.active.identifier,
                "moving": follower.moving(self.tick - self.native.lag),
                "rate": self.native.rate,
                "late_goals": self.late_goals,
                "aborted_goals": self.aborted_goals,
            },
        )


__all__ = ["MODES", "NOT_READY", "Motion", "MotionStage", "StageFollower"]
