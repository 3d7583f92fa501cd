"""Recorded sensor samples through fusion, motion and torque stage again: what was commanded, or would have been.

bag = read_replay_bag("bags/run1")
values = complete_values(bag)
made = replay(bag, values)
differences(bag, made)

Only ticks at which every sensor was recorded are taken, as the nodes do: they act on complete ticks only. Pure: no ROS,
no clock. The stages are those that nodes and runner run; an unchanged recording of the runner gives the same numbers
bit for bit.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from hd_control.chain.chain import COMMON, LAWS, Values, chain_stages, for_joints, shipped_values
from hd_control.chain.motion_stage import MotionStage
from hd_control.chain.stage import Bus
from hd_control.core import topics
from hd_control.core.arrays import FloatArray, IntArray
from hd_control.core.errors import BagError, ConfigError, GoalError
from hd_control.core.parameters import ParameterSet
from hd_control.core.robot import Robot
from hd_control.core.strict_yaml import params_of, parse_yaml
from hd_control.laws.goals import GoalLimits, check_goal, goal_from_points
from hd_control.laws.trajectory import Goal
from hd_control.record.columns import Columns
from hd_control.record.reader import BagReader
from hd_control.safety.limits import safety_limits

# ---- A recording as input of the chain: samples by tick, temperatures, goals, parameters, outputs to compare ----


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
    """All joints' temperatures by row where one of them changes; those not known yet are NaN."""
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


# ---- The replay and its differences ----------------------------------------------------------------


@dataclass(frozen=True)
class Difference:
    """One field of one output: largest and RMS difference to the recording (made - recorded, SI), the joint of the
    largest, the first tick whose bits differ (None: none does), and how many ticks were compared."""

    topic: str
    field: str
    largest: float
    rms: float
    joint: str
    first_tick: int | None
    first_time: float | None
    compared: int


@dataclass(frozen=True)
class Replayed:
    """Outputs by topic and field, (n, joints); `faults`: what the stages report at the end; `notes`: goals refused."""

    outputs: Mapping[str, Table]
    faults: tuple[str, ...]
    notes: tuple[str, ...]


def complete_values(bag: ReplayBag, changes: Values | None = None) -> dict[str, dict[str, Any]]:
    """Values of every node: as shipped, then as attached to the bag, then `changes`. Raises ConfigError."""
    found = {}
    for node in NODES:
        parameters: ParameterSet = LAWS[node].PARAMETERS
        found[node] = _shipped(node, parameters, bag.robot)
        for source, own in (("bag", bag.values.get(node, {})), ("changes", (changes or {}).get(node, {}))):
            unknown = [name for name in own if name not in parameters.names]
            if source == "changes" and [name for name in unknown if name not in (*COMMON.names, "limits")]:
                raise ConfigError(f"{node}: no parameter {unknown[0]!r}")
            given = {name: value for name, value in own.items() if name in parameters.names}
            found[node] = _over(parameters, found[node], given, bag.robot)
        parameters.check(found[node], bag.robot.joints, node)
    return found


def _shipped(node: str, parameters: ParameterSet, robot: Robot) -> dict[str, Any]:
    shipped = {name: value for name, value in shipped_values(node).items() if name in parameters.names}
    return for_joints(shipped, parameters, robot.joint_names)


def _over(parameters: ParameterSet, base: dict[str, Any], own: dict[str, Any], robot: Robot) -> dict[str, Any]:
    """`own` over `base`; lists of more joints are cut to the robot's by name."""
    names = own.get("joint_names")
    if names is not None and not set(robot.joint_names) <= set(names):
        raise ConfigError(
            f"{parameters.owner}: the parameters are for {len(names)} joints ({', '.join(names)}), the recording has "
            f"{robot.joints} ({', '.join(robot.joint_names)})"
        )
    return {**base, **for_joints(own, parameters, robot.joint_names)}


def replay(
    bag: ReplayBag,
    values: Values,
    limits: str = "limits.yaml",
    recorded_inputs: bool = False,
    progress: Callable[[int], None] = lambda row: None,
) -> Replayed:
    """Runs the chain over the recording. `recorded_inputs`: every stage gets what was recorded, not what the stage
    before it makes now, so that a difference shows where it arises. Raises ConfigError."""
    bounds = safety_limits(limits, bag.robot.joint_names, bag.period)
    chain = chain_stages(bag.robot, bag.period, values, bounds)
    stages = chain.by_node()
    chain.torque.native.compares_applied = False  # the recorded drive has obeyed the recorded commands
    made = {name: {f: np.full_like(bag.topics[topics.ENCODER]["position"], np.nan) for f in topics.fields(name)}
            for name in OUTPUTS}  # fmt: skip
    places: dict[str, Any] = {node: bag.robot.indices(stage.joint_names) for node, stage in stages}
    goals = _Goals(bag, GoalLimits.from_values(values["motion_node"], bag.robot), chain.motion)
    recorded = {name: bag.topics[name] for name in OUTPUTS if name in bag.topics} if recorded_inputs else {}
    sensors = [(name, bag.topics[name]) for name in topics.SENSORS]
    for row, tick in enumerate(bag.ticks.tolist()):
        goals.before(row, tick)
        bus: Bus = {name: {field: table[row] for field, table in tables.items()} for name, tables in sensors}
        if row in bag.temperatures:
            bus[topics.TEMPERATURE] = {"temperature": bag.temperatures[row]}
        for name, table in recorded.items():
            bus[name] = {field: column[row] for field, column in table.items()}
        for node, stage in stages:
            for name, arrays in stage.step(tick, bus).items():
                for field, numbers in arrays.items():
                    made[name][field][row, places[node]] = numbers
                if name not in recorded:
                    bus[name] = arrays
        if row % 500 == 0:
            progress(row)
    reports = [(node, stage.report()) for node, stage in stages]
    return Replayed(made, tuple(f"{node}: {text}" for node, (_, text, _) in reports if text), tuple(goals.notes))


class _Goals:
    """Hands the goals of the recording to the motion stage when they were received."""

    def __init__(self, bag: ReplayBag, limits: GoalLimits, stage: MotionStage) -> None:
        self.left, self.limits, self.stage = list(bag.goals), limits, stage
        self.notes: list[str] = []

    def before(self, row: int, tick: int) -> None:
        """Offers every goal received before this row; one that comes before the first tick waits for it."""
        while self.left and self.left[0][0] <= row and self.stage.follower is not None:
            self._offer(self.left.pop(0)[1], tick)

    def _offer(self, goal: Goal, tick: int) -> None:
        follower = self.stage.follower
        assert follower is not None
        measured = self.stage.sample.joint_position.copy()
        try:
            self.stage.hand_over(check_goal(goal, follower.copy(), self.limits, measured, self.stage.tick))
        except GoalError as error:
            self.notes.append(f"goal {goal.identifier} at tick {tick} is refused: {error}")


def differences(bag: ReplayBag, made: Replayed) -> list[Difference]:
    """Every recorded output against the made one, in the order of the chain."""
    found = []
    for topic in OUTPUTS:
        for field, recorded in bag.topics.get(topic, {}).items():
            found.append(_difference(bag, topic, field, made.outputs[topic][field], recorded))
    return found


def _difference(bag: ReplayBag, topic: str, field: str, made: FloatArray, recorded: FloatArray) -> Difference:
    there = np.asarray(np.isfinite(recorded).any(axis=1))
    other: NDArray[np.bool_] = there[:, None] & (made != recorded) & ~(np.isnan(made) & np.isnan(recorded))
    size = np.where(other, np.nan_to_num(np.abs(made - recorded), nan=np.inf), 0.0)
    rows = np.flatnonzero(other.any(axis=1))
    first = int(rows[0]) if rows.size else None
    worst = int(np.argmax(size.max(axis=0))) if size.size else 0
    count = int(there.sum())
    return Difference(
        topic, field, float(size.max(initial=0.0)), float(np.sqrt(np.sum(size**2) / max(1, count * size.shape[1]))),
        bag.robot.joint_names[worst], None if first is None else int(bag.ticks[first]),
        None if first is None else float((bag.ticks[first] - bag.ticks[0]) * bag.period), count,
    )  # fmt: skip
