"""A recording as input of the chain: samples by tick, temperatures, goals, parameters, and the outputs to compare.

Only ticks at which every sensor was recorded are taken, as the nodes do: they act on complete ticks only.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from hd_control.control.goal_check import goal_from_points
from hd_control.control.path import Goal
from hd_control.core.arrays import FloatArray, IntArray
from hd_control.core.errors import BagError, ConfigError, GoalError
from hd_control.core.robot import Robot
from hd_control.core.strict_yaml import params_of, parse_yaml
from hd_control.record.columns import Columns
from hd_control.record.reader import BagReader
from hd_control.stages import topics

OUTPUTS = (topics.JOINT_STATES, topics.MOTOR_STATES, topics.REFERENCE, topics.REQUIRED, topics.COMMAND)
"""Topics that the chain makes, in the order in which it makes them."""
NODES = ("fusion_node", "motion_node", "torque_node")
Table = Mapping[str, FloatArray]
"""Arrays (n, joints) of one topic by field."""


@dataclass(frozen=True)
class ReplayBag:
    """Everything that a replay needs, n ticks in order, joints in the order of the robot.

    `ticks` (n,); `topics`: sensors and recorded outputs by topic and field (n, joints), NaN where a message is missing;
    `temperatures` (joints,) degC by row; `goals` with the row before which each was received; `values`: attached
    parameters by node. `left_out`: ticks without all sensors. `whole` False: data are missing; `problems` says which.
    `events`: goals and temperatures as messages, topic, time ns and bytes.
    """

    path: str
    robot: Robot
    period: float
    ticks: IntArray
    topics: Mapping[str, Table]
    temperatures: Mapping[int, FloatArray]
    goals: tuple[tuple[int, Goal], ...]
    values: Mapping[str, Mapping[str, Any]]
    left_out: int = 0
    whole: bool = True
    problems: tuple[str, ...] = ()
    notes: tuple[str, ...] = ()
    events: tuple[tuple[str, int, bytes], ...] = ()


def read_replay_bag(path: str | Path, robot: Robot | None = None, period: float | None = None) -> ReplayBag:
    """Reads a recording for a replay. `robot`, `period` s: instead of those of the bag.

    Raises BagError if a sensor topic, the robot or the joints do not fit.
    """
    with BagReader(path) as bag:
        missing = [name for name in topics.SENSORS if not bag.has(name)]
        if missing:
            known = ", ".join(sorted(bag.topics)) or "no topic"
            raise BagError(f"{path}: {', '.join(missing)} not recorded; a replay needs {', '.join(topics.SENSORS)}; "
                           f"there is {known}")  # fmt: skip
        arm = robot if robot is not None else _robot_of(bag)
        tables = {name: bag.columns(name) for name in (*topics.SENSORS, *OUTPUTS) if bag.has(name)}
        for name, columns in tables.items():
            _check_joints(bag, name, columns, arm)
        encoder = tables[topics.ENCODER]
        step = period if period is not None else _period_of(bag, encoder)
        rows = {name: _ticks(columns, step) for name, columns in tables.items()}
        every = np.unique(np.concatenate([rows[name] for name in topics.SENSORS]))
        ticks = every[np.all([np.isin(every, rows[name]) for name in topics.SENSORS], axis=0)]
        if not ticks.size:
            raise BagError(f"{path}: no tick has all of {', '.join(topics.SENSORS)}")
        found = {name: _aligned(columns, rows[name], ticks, arm) for name, columns in tables.items()}
        goals, notes = _goals_of(bag, encoder, ticks, step, found.get(topics.REFERENCE))
        temperatures = _temperatures_of(bag, ticks, step, arm)
        values, more = _values_of(bag)
        problems = tuple(str(problem) for problem in bag.problems)
        return ReplayBag(
            str(path), arm, step, ticks, found, temperatures, goals, values, int(every.size - ticks.size), bag.complete,
            problems, (*notes, *more), _events_of(bag, encoder, step),
        )  # fmt: skip


def _robot_of(bag: BagReader) -> Robot:
    """The robot description that the bag carries."""
    attached = bag.attachments.get("robot.urdf")
    if attached is not None:
        return Robot.from_urdf(attached.decode("utf-8", "replace"), f"{bag.path}: robot.urdf")
    if bag.has(topics.DESCRIPTION):
        return Robot.from_urdf(str(next(bag.messages(topics.DESCRIPTION))[1].data), f"{bag.path}: robot_description")
    raise BagError(f"{bag.path}: carries no robot description; give --robot")


def _check_joints(bag: BagReader, topic: str, columns: Columns, robot: Robot) -> None:
    if set(columns.names) != set(robot.joint_names):
        raise BagError(
            f"{bag.path}: {topic} has {len(columns.names)} joints ({', '.join(columns.names)}), "
            f"the robot {robot.joints} ({', '.join(robot.joint_names)}); give the --robot of this recording"
        )


def _period_of(bag: BagReader, encoder: Columns) -> float:
    """The control period: as the session recorded it, else the most frequent distance of the stamps."""
    for record in bag.metadata.values():
        try:
            return float(record["period"])
        except (KeyError, ValueError):
            continue
    steps = np.diff(encoder.stamps_ns)
    steps = steps[steps > 0]
    if not steps.size:
        raise BagError(f"{bag.path}: one tick only; the period is not known")
    return float(np.median(steps)) * 1e-9


def _ticks(columns: Columns, period: float) -> IntArray:
    """Tick of every message, (m,)."""
    step = round(period * 1e9)
    return np.asarray((columns.stamps_ns + step // 2) // step, dtype=np.int64)


def _aligned(columns: Columns, own: IntArray, ticks: IntArray, robot: Robot) -> dict[str, FloatArray]:
    """The arrays of a topic at the chosen ticks; the first message of a tick counts, as in the nodes."""
    first, places = np.unique(own, return_index=True)
    there = np.isin(ticks, first)
    rows = places[np.searchsorted(first, ticks[there])]
    order = [columns.names.index(name) for name in robot.joint_names]
    found = {}
    for name in topics.fields(columns.topic.strip("/").split("/")[-1]):
        table = np.full((ticks.size, robot.joints), np.nan)
        if name in columns.values:
            table[there] = columns.values[name][rows][:, order]
        found[name] = table
    return found


def _temperatures_of(bag: BagReader, ticks: IntArray, period: float, robot: Robot) -> dict[int, FloatArray]:
    """All joints' temperatures by row where one of them changes; those not told yet are NaN."""
    if not bag.has(topics.TEMPERATURE):
        return {}
    columns = bag.columns(topics.TEMPERATURE)
    values, held = columns.values["temperature"], np.full(robot.joints, np.nan)
    rows = np.searchsorted(ticks, _ticks(columns, period))
    found: dict[int, FloatArray] = {}
    for row, line in zip(rows.tolist(), values, strict=True):
        for index, name in enumerate(robot.joint_names):
            if name in columns.names and np.isfinite(line[columns.names.index(name)]):
                held[index] = line[columns.names.index(name)]
        found[row] = held.copy()
    return {row: line for row, line in found.items() if row < ticks.size}


def _goals_of(
    bag: BagReader, encoder: Columns, ticks: IntArray, period: float, reference: Table | None
) -> tuple[tuple[tuple[int, Goal], ...], tuple[str, ...]]:
    """Goals with the row of the first sample after their reception."""
    if not bag.has(topics.GOAL):
        return (), ()
    found, notes, step = [], [], round(period * 1e9)
    received = _ticks(encoder, period)
    for log_time_ns, message in bag.messages(topics.GOAL):
        sample = min(int(np.searchsorted(encoder.log_times_ns, log_time_ns)), len(received) - 1)
        row = min(int(np.searchsorted(ticks, received[sample])), ticks.size - 1)
        try:
            goal = _goal_of(message, step)
        except GoalError as error:
            notes.append(f"a goal is left out: {error}")
            continue
        if goal.start_tick is None:
            row, goal = _dated(goal, row, ticks, reference)
            notes.append(
                f"goal {goal.identifier or row}: no start stamp; start tick {goal.start_tick} by the reference"
            )
        found.append((row, goal))
    return tuple(found), tuple(notes)


def _goal_of(message: Any, step: int) -> Goal:
    points, stamp = message.points, _stamp(message.header.stamp)
    return goal_from_points(
        list(message.joint_names),
        [_stamp(point.time_from_start) / 1e9 for point in points],
        [point.positions for point in points],
        [point.velocities for point in points],
        [point.accelerations for point in points],
        None if stamp == 0 else (stamp + step // 2) // step,
        message.header.frame_id,
    )


def _stamp(time: Any) -> int:
    return int(time.sec) * 1_000_000_000 + int(time.nanosec)


def _dated(goal: Goal, row: int, ticks: IntArray, reference: Table | None) -> tuple[int, Goal]:
    """A goal that started "now": it began in the tick before the recorded reference first moved after its reception."""
    start = row + 1
    if reference is not None:
        moved = np.any(np.diff(reference["position"], axis=0) != 0.0, axis=1)
        later = np.flatnonzero(moved[row:])
        start = row + int(later[0]) if later.size else start
    start = min(start, ticks.size - 1)
    return min(row, start), replace(goal, start_tick=int(ticks[start]))


def _events_of(bag: BagReader, encoder: Columns, period: float) -> tuple[tuple[str, int, bytes], ...]:
    """Goals and temperatures with the tick's time at which they were received, ns."""
    step, ticks = round(period * 1e9), _ticks(encoder, period)
    found = []
    for topic in filter(bag.has, (topics.GOAL, topics.TEMPERATURE)):
        for log_time_ns, payload in bag.raw(topic):
            row = min(int(np.searchsorted(encoder.log_times_ns, log_time_ns)), len(ticks) - 1)
            found.append((topic, int(ticks[row]) * step, bytes(payload)))
    return tuple(found)


def _values_of(bag: BagReader) -> tuple[dict[str, dict[str, Any]], tuple[str, ...]]:
    """Attached parameters by node."""
    found, notes, attached = {}, [], bag.attachments
    for node in NODES:
        name = f"{node}.yaml"
        if name not in attached:
            notes.append(f"{node}: no parameters in the bag; as shipped")
            continue
        try:
            found[node] = params_of(parse_yaml(attached[name], name), name, node)
        except ConfigError as error:
            raise BagError(f"{bag.path}: attached {error}") from None
    return found, tuple(notes)
