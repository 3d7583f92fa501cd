"""A goal is checked completely before acceptance and never repaired. A refusal is one GoalError and changes nothing.

Order and codes: `size`, `joint_unknown`, `joint_repeated`, `joint_missing`, `length`, `not_finite`, `time`,
`start_stamp`, `start_position`, `start_speed`, `position_limit`, `velocity_limit`, `acceleration_limit`,
`torque_limit`, `final_velocity`.

Position, velocity and acceleration are checked at the exact extrema of every segment of the path, the blend from the
present reference included; a step of velocity counts as an acceleration over one sample. Torque is sampled: the rigid
arm of the robot description at the ends and the middle of every segment, at up to 41 places if there are few segments;
a peak between them can be missed. A path that keeps position and acceleration limits can always brake within them, so
there is no separate braking check.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from hd_control.control.goal_form import check_arrays, check_names, check_size, check_times, goal_from_points, refusal
from hd_control.control.motion import in_robot_order
from hd_control.control.motion_vdc import rigid_torque
from hd_control.control.path import Goal, Path
from hd_control.control.trajectory import TrajectoryFollower
from hd_control.core.arrays import FloatArray
from hd_control.core.robot import Robot

MAX_LEAD = 60.0
"""s between reception and start."""
__all__ = ["GoalLimits", "check_goal", "goal_from_points"]
TORQUE_SAMPLES = 1000
ROUNDING = 1e-9
"""A limit may be exceeded by this much, in its own unit, so that a goal may end exactly on it."""


@dataclass(frozen=True)
class GoalLimits:
    """What a goal has to keep, per joint (n,) in the robot's order, SI."""

    robot: Robot
    position_low: FloatArray
    position_high: FloatArray
    velocity: FloatArray
    acceleration: FloatArray
    torque: FloatArray
    start_tolerance: FloatArray
    start_speed_tolerance: FloatArray
    allow_partial: bool = False

    @classmethod
    def from_values(cls, values: Mapping[str, Any], robot: Robot) -> GoalLimits:
        """Limits of the motion node's parameter values; position and torque limits of the robot description."""
        chosen = in_robot_order(values, robot)
        return cls(
            robot,
            robot.position_low,
            robot.position_high,
            np.array(chosen["velocity_limit"], dtype=float),
            np.array(chosen["acceleration_limit"], dtype=float),
            robot.effort_limit,
            np.array(chosen["goal_start_tolerance"], dtype=float),
            np.array(chosen["goal_start_speed_tolerance"], dtype=float),
            bool(chosen["allow_partial_goals"]),
        )


def check_goal(
    goal: Goal, follower: TrajectoryFollower, limits: GoalLimits, measured_position: ArrayLike, tick: int
) -> Path:
    """The path to hand to `follower.accept`. `measured_position` (n,) rad at `tick`. Raises GoalError."""
    check_size(goal)
    check_names(goal, limits.robot.joint_names, limits.allow_partial)
    check_arrays(goal)
    check_times(goal, follower.period)
    _check_stamp(goal, follower, tick)
    _check_start(goal, follower, limits, np.asarray(measured_position, dtype=float), tick)
    path = follower.plan(goal, tick)
    _check_extrema(goal, path, limits)
    _check_torque(goal, path, limits)
    _check_end(goal)
    return path


def _check_stamp(goal: Goal, follower: TrajectoryFollower, tick: int) -> None:
    lead = (follower.start_tick(goal, tick) - tick) * follower.period
    if lead < 0.0:
        raise refusal("start_stamp", "", f"start {-lead:g} s in the past", "Use stamp 0 for now")
    if lead > MAX_LEAD:
        raise refusal("start_stamp", "", f"start {lead:g} s ahead > {MAX_LEAD:g} s", "Send the goal later")


def _check_start(goal: Goal, follower: TrajectoryFollower, limits: GoalLimits, measured: FloatArray, tick: int) -> None:
    names, remedy = limits.robot.joint_names, "Start from where the arm is"
    lag = np.abs(follower.at(tick).position - measured)
    if not np.all(lag <= limits.start_tolerance):
        joint = int(np.argmin(lag <= limits.start_tolerance))
        what = f"measured position {lag[joint]:g} rad from the reference > {limits.start_tolerance[joint]:g} rad"
        raise refusal("start_position", names[joint], what, "Let the arm settle, or reset the reference")
    if goal.times[0] > 0.0:
        return
    start = follower.start_tick(goal, tick)
    present, rows = follower.at(start), limits.robot.indices(goal.joint_names)
    places = {"the reference": present.position} | ({"the measured position": measured} if start == tick else {})
    for place, position in places.items():
        gap, most = np.abs(goal.positions[0] - position[rows]), limits.start_tolerance[rows]
        if np.any(gap > most):
            i = int(np.argmax(gap > most))
            what = f"point 0, position {goal.positions[0, i]:g} rad is {gap[i]:g} rad from {place} > {most[i]:g} rad"
            raise refusal("start_position", goal.joint_names[i], what, remedy)
    if goal.velocities is not None:
        gap, most = np.abs(goal.velocities[0] - present.velocity[rows]), limits.start_speed_tolerance[rows]
        if np.any(gap > most):
            i = int(np.argmax(gap > most))
            what = f"point 0, velocity is {gap[i]:g} rad/s from the reference > {most[i]:g} rad/s"
            raise refusal("start_speed", goal.joint_names[i], what, remedy + " with the speed that it has")


def _where(goal: Goal, path: Path, segment: int) -> str:
    """The segment in the goal's own point numbers."""
    middle = 0.5 * (path.knots[segment] + path.knots[segment + 1]) * path.period
    after = int(np.searchsorted(goal.times, middle))
    return "before point 0" if after == 0 else f"between points {after - 1} and {after}"


def _check_extrema(goal: Goal, path: Path, limits: GoalLimits) -> None:
    found = path.extrema()
    rows = (
        ("position_limit", "position", "rad", limits.position_low, limits.position_high),
        ("velocity_limit", "velocity", "rad/s", -limits.velocity, limits.velocity),
        ("acceleration_limit", "acceleration", "rad/s^2", -limits.acceleration, limits.acceleration),
    )
    for i, (code, name, unit, low, high) in enumerate(rows):
        below, above = found[:, :, 2 * i] < low - ROUNDING, found[:, :, 2 * i + 1] > high + ROUNDING
        if below.any() or above.any():
            segment, joint = (int(x) for x in np.argwhere(below | above)[0])
            over = bool(above[segment, joint])
            value, limit = found[segment, joint, 2 * i + over], (high if over else low)[joint]
            what = f"{_where(goal, path, segment)}, {name} {value:g} {unit} {'>' if over else '<'} {limit:g} {unit}"
            remedy = "Keep the path inside" if i == 0 else "Allow more time"
            raise refusal(code, limits.robot.joint_names[joint], what, remedy)
    if goal.order == 1:
        _check_corners(path, limits)


def _check_corners(path: Path, limits: GoalLimits) -> None:
    """Straight lines meet in steps of velocity; each counts as an acceleration over one sample."""
    before = _state(_columns(path), np.diff(path.knots) * path.period)[1]
    after = np.concatenate([path.coefficients[1:, :, 1], np.zeros((1, before.shape[1]))])
    corner = np.abs(after - before) / path.period
    over = corner > limits.acceleration + ROUNDING * (1.0 / path.period)
    if np.any(over):
        segment, joint = (int(x) for x in np.argwhere(over)[0])
        what = (
            f"corner after {path.knots[segment + 1] * path.period:g} s, acceleration "
            f"{corner[segment, joint]:g} rad/s^2 > {limits.acceleration[joint]:g} rad/s^2 over one sample"
        )
        raise refusal("acceleration_limit", limits.robot.joint_names[joint], what, "Give velocities at the points")


def _columns(path: Path) -> FloatArray:
    """The coefficients (6, s, n), each power in one run of memory."""
    return np.ascontiguousarray(np.moveaxis(path.coefficients, 2, 0))


def _state(c: FloatArray, t: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Position, velocity, acceleration (s, n) of every segment at its own time t (s,). `c`: `_columns` of the path."""
    x = t[:, None]
    return (
        c[0] + x * (c[1] + x * (c[2] + x * (c[3] + x * (c[4] + x * c[5])))),
        c[1] + x * (2 * c[2] + x * (3 * c[3] + x * (4 * c[4] + x * 5 * c[5]))),
        2 * c[2] + x * (6 * c[3] + x * (12 * c[4] + x * 20 * c[5])),
    )


def _check_torque(goal: Goal, path: Path, limits: GoalLimits) -> None:
    lengths, columns = np.diff(path.knots) * path.period, _columns(path)
    for share in np.linspace(0.0, 1.0, min(max(3, 1 + TORQUE_SAMPLES // max(1, len(lengths))), 41)):
        if share == 0.0 and goal.order == 5:
            continue  # accelerations are continuous: the end of the segment before
        torque = rigid_torque(limits.robot, *_state(columns, share * lengths))
        over = np.abs(torque) > limits.torque
        if np.any(over):
            segment, joint = (int(x) for x in np.argwhere(over)[0])
            what = (
                f"{_where(goal, path, segment)}, required torque {torque[segment, joint]:g} N m outside "
                f"+-{limits.torque[joint]:g} N m"
            )
            raise refusal("torque_limit", limits.robot.joint_names[joint], what, "Allow more time, or avoid this pose")


def _check_end(goal: Goal) -> None:
    if goal.velocities is not None and np.any(np.abs(goal.velocities[-1]) > ROUNDING):
        joint = int(np.argmax(np.abs(goal.velocities[-1])))
        what = f"point {len(goal.times) - 1}, final velocity {goal.velocities[-1, joint]:g} rad/s is not 0"
        raise refusal("final_velocity", goal.joint_names[joint], what, "End at rest")
