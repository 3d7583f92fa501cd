"""Does a motion keep the tolerances that came with its goal? Pure; time is ticks.

Codes are those of `control_msgs/action/FollowJointTrajectory`.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from hd_control.core.arrays import FloatArray

SUCCESSFUL, INVALID_GOAL, INVALID_JOINTS, OLD_STAMP, PATH_VIOLATED, GOAL_VIOLATED = 0, -1, -2, -3, -4, -5
CODES = {"joint_unknown": INVALID_JOINTS, "joint_repeated": INVALID_JOINTS, "joint_missing": INVALID_JOINTS}
CODES |= {"start_stamp": OLD_STAMP}
"""Code of a refusal (`GoalError.code`); every other refusal is INVALID_GOAL."""
UNITS = ("rad", "rad/s")


@dataclass(frozen=True)
class Tolerances:
    """Largest errors of position and velocity, (n,) each; infinite where nothing is demanded."""

    position: FloatArray
    velocity: FloatArray

    @classmethod
    def none(cls, joints: int) -> Tolerances:
        """Nothing is demanded."""
        return cls(np.full(joints, np.inf), np.full(joints, np.inf))


@dataclass(frozen=True)
class Outcome:
    """How a motion ended: code of the action and one sentence."""

    code: int
    text: str


class GoalWatch:
    """Watches one motion from `start_tick` to `end_tick`, and `patience` ticks more for the goal's tolerance."""

    def __init__(
        self,
        joint_names: Sequence[str],
        start_tick: int,
        end_tick: int,
        path: Tolerances,
        goal: Tolerances,
        patience: int = 0,
    ) -> None:
        self.joint_names, self.start_tick, self.end_tick = tuple(joint_names), start_tick, end_tick
        self.path, self.goal, self.patience = path, goal, patience

    def judge(self, tick: int, position_error: FloatArray, velocity_error: FloatArray) -> Outcome | None:
        """The outcome at a tick, None while the motion goes on. Errors are reference minus measurement, (n,)."""
        if tick < self.start_tick:
            return None
        errors = (np.abs(position_error), np.abs(velocity_error))
        if tick < self.end_tick:
            found = self._worst(errors, self.path)
            return Outcome(PATH_VIOLATED, f"path tolerance: {found}") if found else None
        found = self._worst(errors, self.goal)
        if not found:
            return Outcome(SUCCESSFUL, "goal reached")
        late = tick >= self.end_tick + self.patience
        return Outcome(GOAL_VIOLATED, f"goal tolerance: {found}") if late else None

    def _worst(self, errors: tuple[FloatArray, FloatArray], limits: Tolerances) -> str:
        """Joint, error and limit of the largest excess; empty if there is none."""
        worst, text = 1.0, ""
        for kind, unit, error, limit in zip(
            ("position", "velocity"), UNITS, errors, (limits.position, limits.velocity), strict=True
        ):
            share = error / limit
            joint = int(np.argmax(share))
            if share[joint] > worst:
                worst = float(share[joint])
                text = f"{self.joint_names[joint]}: {kind} error {error[joint]:.4g} {unit} > {limit[joint]:.4g} {unit}"
        return text
