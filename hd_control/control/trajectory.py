"""Goals become references by tick. Time is `(tick - start tick) * period`; no clock is read.

A new goal starts at the present reference with its velocity and acceleration, so it may replace one in motion. The last
point is held exactly. How points are joined: `hd_control.control.path`.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import ArrayLike

from hd_control.control.goal_shapes import enveloped_sine, moves, quintic_move, sine_goal
from hd_control.control.path import Goal, Motion, Path, braking_path, hold_path, plan_path
from hd_control.core.arrays import FloatArray

__all__ = ["Goal", "Motion", "Path", "TrajectoryFollower", "enveloped_sine", "moves", "quintic_move", "sine_goal"]


class TrajectoryFollower:
    """The reference by tick: holds, follows one path, and may have one more that starts later.

    The state is `active` and `pending` (paths, never changed once made) and `cursor`, which only saves search time.
    Positions are in rad, in the order of `joint_names`; `period` is the length of a tick in s.
    """

    def __init__(
        self,
        joint_names: Sequence[str],
        period: float,
        position: ArrayLike,
        tick: int = 0,
        blend_time: float = 0.2,
    ) -> None:
        self.joint_names, self.period, self.blend_time = tuple(joint_names), period, blend_time
        self.active = hold_path(position, tick, period)
        self.pending: Path | None = None
        self.cursor = 0

    def copy(self) -> TrajectoryFollower:
        """An independent follower in the same state."""
        twin = TrajectoryFollower(self.joint_names, self.period, self.active.end.position, 0, self.blend_time)
        twin.active, twin.pending, twin.cursor = self.active, self.pending, self.cursor
        return twin

    def hold(self, position: ArrayLike, tick: int) -> None:
        """Stands still at `position` (n,) from `tick` on, without a blend; drops every goal."""
        self.active, self.pending, self.cursor = hold_path(position, tick, self.period), None, 0

    def at(self, tick: int) -> Motion:
        """The reference at a present or future tick; changes nothing. May be called from another thread."""
        pending = self.pending  # read before `active`: `sample` promotes in the other order
        path = pending if pending is not None and tick >= pending.start_tick else self.active
        out = np.empty(3 * len(self.joint_names))
        path.evaluate(tick, 0, out)
        position, velocity, acceleration = out.reshape(3, -1)
        return Motion(position, velocity, acceleration)

    def start_tick(self, goal: Goal, tick: int) -> int:
        """Tick at which a goal received at `tick` begins."""
        return tick if goal.start_tick is None else goal.start_tick

    def plan(self, goal: Goal, tick: int) -> Path:
        """The path that a goal would give, from the reference at its start tick on; changes nothing."""
        start = self.start_tick(goal, tick)
        return plan_path(goal, self.joint_names, self.at(start), start, self.period, self.blend_time)

    def accept(self, goal: Goal | Path, tick: int) -> Path:
        """Follows a goal, or better the path that `check_goal` made of it, from its start tick on.

        A start tick in the future leaves the present motion alone until then; only one goal waits, the newest.
        """
        path = self.plan(goal, tick) if isinstance(goal, Goal) else goal
        if path.start_tick > tick:
            self.pending = path
        else:
            self.active, self.pending, self.cursor = path, None, 0
        return path

    def delay(self, ticks: float) -> None:
        """Whatever is planned happens `ticks` later, fractions included; the present reference stays as it is."""
        self.active = self.active.delayed(ticks)
        self.pending = None if self.pending is None else self.pending.delayed(ticks)

    def sample(self, tick: float, out: FloatArray | None = None) -> tuple[FloatArray, FloatArray, FloatArray]:
        """Desired position, velocity, acceleration at a tick, (n,) each: views of `out` (3n,) if it is given."""
        if self.pending is not None and tick >= self.pending.start_tick:
            self.active, self.pending, self.cursor = self.pending, None, 0
        n = len(self.joint_names)
        values = np.empty(3 * n) if out is None else out
        self.cursor = self.active.evaluate(tick, self.cursor, values)
        return values[:n], values[n : 2 * n], values[2 * n :]

    def moving(self, tick: float) -> bool:
        """True until the last accepted goal has ended."""
        return self.pending is not None or tick < self.active.end_tick

    def stop(self, tick: int, acceleration_limit: ArrayLike) -> Path:
        """Brings all joints to rest within `acceleration_limit` (n,) rad/s^2; drops every goal."""
        path = braking_path(self.at(tick), tick, self.period, np.asarray(acceleration_limit, dtype=float))
        self.active, self.pending, self.cursor = path, None, 0
        return path
