"""Recorded sensor samples through fusion, motion and torque stage again: what was commanded, or would have been.

bag = read_replay_bag("bags/run1")
values = complete_values(bag)
made = replay(bag, values)
differences(bag, made)

Pure: no ROS, no clock. The stages are those that nodes and runner run; an unchanged recording of the runner gives the
same numbers bit for bit.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from hd_control.control.goal_check import GoalLimits, check_goal
from hd_control.control.path import Goal
from hd_control.core.arrays import FloatArray
from hd_control.core.errors import ConfigError, GoalError
from hd_control.core.parameters import ParameterSet
from hd_control.core.robot import Robot
from hd_control.stages import topics
from hd_control.stages.chain_stages import LAWS, Values, chain_stages
from hd_control.stages.gate_values import safety_limits
from hd_control.stages.motion_stage import MotionStage
from hd_control.stages.node_parameters import COMMON, for_joints, shipped_values
from hd_control.stages.replay_bag import NODES, OUTPUTS, ReplayBag, Table
from hd_control.stages.stage import Bus


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
