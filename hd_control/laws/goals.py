"""A goal is checked completely before acceptance and never repaired; then its tolerances are watched while it moves.

A refusal is one GoalError and changes nothing. Order and codes: `size`, `joint_unknown`, `joint_repeated`,
`joint_missing`, `length`, `not_finite`, `time`, `start_stamp`, `start_position`, `start_speed`, `position_limit`,
`velocity_limit`, `acceleration_limit`, `torque_limit`, `final_velocity`.

Position, velocity and acceleration are checked at the exact extrema of every segment of the path, the blend from the
present reference included; a step of velocity counts as an acceleration over one sample. Torque is sampled: the rigid
arm of the robot description at the ends and the middle of every segment, at up to 41 places if there are few segments;
a peak between them can be missed. A path that keeps position and acceleration limits can always brake within them, so
there is no separate braking check.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from hd_control.core.arrays import FloatArray
from hd_control.core.robot import Robot
from hd_control.laws.motion import in_robot_order, rigid_torque
from hd_control.laws.trajectory import Goal, Path, TrajectoryFollower, refusal

# ---- The form: sizes, joint names, array lengths, finite numbers, times ----------------------------


MAX_POINTS, MAX_DURATION, MAX_BYTES = 10_000, 3600.0, 4_000_000
"""Points; s; bytes of numbers."""


def goal_from_points(
    joint_names: Sequence[str],
    times: Sequence[float],
    positions: Sequence[Sequence[float]],
    velocities: Sequence[Sequence[float]] = (),
    accelerations: Sequence[Sequence[float]] = (),
    start_tick: int | None = None,
    identifier: str = "",
) -> Goal:
    """A Goal from the lists of a message, one row per point; rows of velocities may be empty for all points together.

    Raises GoalError `size` or `length`.
    """
    if len(times) > MAX_POINTS:
        raise refusal("size", "", f"{len(times)} points > {MAX_POINTS}", "Send the motion in parts")
    tables = [
        _table(name, rows, len(times), len(joint_names))
        for name, rows in zip(
            ("positions", "velocities", "accelerations"), (positions, velocities, accelerations), strict=True
        )
    ]
    if tables[0] is None:
        raise refusal("length", "", "no positions", "Give positions at every point")
    return Goal(
        tuple(joint_names), np.array(times, dtype=float), tables[0], tables[1], tables[2], start_tick, identifier
    )


def _table(name: str, rows: Sequence[Sequence[float]], points: int, joints: int) -> FloatArray | None:
    sizes = [len(row) for row in rows]
    if not any(sizes):
        return None
    for point, size in enumerate(sizes):
        if size != joints:
            what = f"point {point}, {size} {name}, expected {joints}"
            raise refusal("length", "", what, f"Give {name} for every joint at every point, or for none")
    if len(sizes) != points:
        raise refusal("length", "", f"{len(sizes)} rows of {name}, expected {points}", "Give one row per point")
    return np.array(rows, dtype=float)


def check_bytes(size: int) -> None:
    """Raises GoalError `size` for a message of so many bytes: asked before it becomes numbers, which takes long."""
    if size > MAX_BYTES:
        raise refusal("size", "", f"{size} bytes > {MAX_BYTES}", "Send the motion in parts")


def check_size(goal: Goal) -> None:
    """Raises GoalError `size`."""
    points = len(goal.times)
    given = [x for x in (goal.times, goal.positions, goal.velocities, goal.accelerations) if x is not None]
    size = sum(np.asarray(x).nbytes for x in given)
    if points == 0:
        raise refusal("size", "", "no points", "Give at least one point")
    if points > MAX_POINTS:
        raise refusal("size", "", f"{points} points > {MAX_POINTS}", "Send the motion in parts")
    check_bytes(size)
    if goal.times[-1] > MAX_DURATION:
        raise refusal("size", "", f"duration {goal.times[-1]:g} s > {MAX_DURATION:g} s", "Send the motion in parts")


def check_names(goal: Goal, known: Sequence[str], allow_partial: bool) -> None:
    """Raises GoalError `joint_unknown`, `joint_repeated` or `joint_missing`. `known`: the robot's joints."""
    names = goal.joint_names
    for name in names:
        if name not in known:
            raise refusal("joint_unknown", str(name), "unknown joint", f"Use some of {', '.join(known)}")
        if names.count(name) > 1:
            raise refusal("joint_repeated", name, f"named {names.count(name)} times", "Name it once")
    missing = [name for name in known if name not in names]
    if not names or (missing and not allow_partial):
        raise refusal("joint_missing", missing[0], "not in the goal", "Name every joint, or set allow_partial_goals")


def check_arrays(goal: Goal) -> None:
    """Raises GoalError `length` or `not_finite`."""
    wanted = (len(goal.times), len(goal.joint_names))
    named = {"positions": goal.positions, "velocities": goal.velocities, "accelerations": goal.accelerations}
    for name, values in named.items():
        if values is not None and np.shape(values) != wanted:
            what = f"{name} of shape {np.shape(values)}, expected {wanted}"
            raise refusal("length", "", what, "Give one value per joint at every point")
    if goal.accelerations is not None and goal.velocities is None:
        raise refusal("length", "", "accelerations without velocities", "Give velocities too")
    if not np.all(np.isfinite(goal.times)):
        point = int(np.argmin(np.isfinite(goal.times)))
        raise refusal("not_finite", "", f"point {point}, time {goal.times[point]}", "Give finite numbers")
    for name, values in named.items():
        if values is not None and not np.all(np.isfinite(values)):
            point, joint = np.argwhere(~np.isfinite(values))[0]
            what = f"point {point}, {name} {values[point, joint]}"
            raise refusal("not_finite", goal.joint_names[joint], what, "Give finite numbers")


def check_times(goal: Goal, period: float) -> None:
    """Raises GoalError `time`. `period` in s."""
    times = np.asarray(goal.times, dtype=float)
    if times[0] < 0.0:
        raise refusal("time", "", f"point 0, time {times[0]:g} s < 0", "Count time from the start of the goal")
    steps = np.diff(times)
    short = steps < period * (1.0 - 1e-6)
    if np.any(short):
        point = int(np.argmax(short))
        what = f"point {point + 1}, {steps[point]:g} s after point {point} < {period:g} s, one sample"
        raise refusal("time", "", what, "Order the points by time, at least one sample apart")
    first = times[times > 0.0]
    if first.size == 0 or first[0] < period * (1.0 - 1e-6):
        raise refusal(
            "time", "", f"point 0, time {times[0]:g} s < {period:g} s, one sample", "Allow time for the motion"
        )


# ---- The tolerances that came with a goal, in the motion; time is ticks ----------------------------
#
# Codes are those of `control_msgs/action/FollowJointTrajectory`.


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


# ---- The check -------------------------------------------------------------------------------------


MAX_LEAD = 60.0
"""s between reception and start."""
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
    """The path to hand to `TrajectoryFollower.accept`. `measured_position` (n,) rad at `tick`. Raises GoalError."""
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
