"""The form of a goal: sizes, joint names, array lengths, finite numbers, times. A refusal is one GoalError."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from hd_control.control.path import GOAL_BAD, Goal
from hd_control.core.arrays import FloatArray
from hd_control.core.errors import GoalError

MAX_POINTS, MAX_DURATION, MAX_BYTES = 10_000, 3600.0, 4_000_000
"""Points; s; bytes of numbers."""


def refusal(code: str, joint: str, what: str, remedy: str) -> GoalError:
    """The error with its text, `HD-F22 goal_bad joint_3: what. remedy.`; `joint` may be empty."""
    return GoalError(code, f"{GOAL_BAD} {joint + ': ' if joint else ''}{what}. {remedy}.")


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


def check_size(goal: Goal) -> None:
    """Raises GoalError `size`."""
    points = len(goal.times)
    given = [x for x in (goal.times, goal.positions, goal.velocities, goal.accelerations) if x is not None]
    size = sum(np.asarray(x).nbytes for x in given)
    if points == 0:
        raise refusal("size", "", "no points", "Give at least one point")
    if points > MAX_POINTS:
        raise refusal("size", "", f"{points} points > {MAX_POINTS}", "Send the motion in parts")
    if size > MAX_BYTES:
        raise refusal("size", "", f"{size} bytes > {MAX_BYTES}", "Send the motion in parts")
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
