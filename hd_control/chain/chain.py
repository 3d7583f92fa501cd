"""The chain of one robot without ROS: three stages in the order in which their messages arrive; their parameters.

Shipped parameter values come from `config/nodes.yaml` and `config/<node>.yaml`.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

from hd_control import _chain
from hd_control.chain.fusion_stage import FusionStage
from hd_control.chain.motion_stage import MotionStage
from hd_control.chain.stage import Bus, Stage
from hd_control.chain.torque_stage import TorqueStage
from hd_control.core import topics
from hd_control.core.parameters import Change, Parameter, ParameterSet, Shape
from hd_control.core.resources import config_path
from hd_control.core.robot import Robot
from hd_control.core.strict_yaml import load_params_file
from hd_control.laws import fusion, motion, torque
from hd_control.safety.limits import SafetyLimits

LAWS: Mapping[str, Any] = {"fusion_node": fusion, "motion_node": motion, "torque_node": torque}
Values = Mapping[str, Mapping[str, Any]]
"""Complete parameter values by node."""


@dataclass(frozen=True)
class ChainStages:
    """The three stages of one robot."""

    fusion: FusionStage
    motion: MotionStage
    torque: TorqueStage

    def by_node(self) -> list[tuple[str, Stage]]:
        """Node names with their stages, in the order in which they run."""
        return list(zip(LAWS, (self.fusion, self.motion, self.torque), strict=True))


def chain_stages(robot: Robot, period: float, values: Values, limits: SafetyLimits) -> ChainStages:
    """The stages with their parameters, ready for the first tick. `period` s. Raises ConfigError."""
    found = ChainStages(
        FusionStage(robot, period, limits),
        MotionStage(robot, period, values["motion_node"]["goal_blend_time"]),
        torque_stage(robot, period, values["torque_node"], limits),
    )
    for node, stage in found.by_node():
        stage.adopt(stage.prepare(values[node]))
        stage.start()
    for numbers, columns in found.fusion.signals():
        found.torque.watch(robot.joint_names, numbers, columns)
    return found


def add_stages(sequence: _chain.Sequence, stages: Sequence[Stage], bus: Bus, temperature_ticks: int = 1) -> Bus:
    """Adds the stages to a compiled list, in order; what one makes is copied to where the next reads it.

    `bus`: where the sensors' numbers are. Temperatures are copied every so many ticks. Returns the bus with outputs.
    """
    for stage in stages:
        for topic, source, target in stage.copies(bus):
            sequence.copy(source, target)
            if topic == topics.TEMPERATURE:
                sequence.every(temperature_ticks)
        if stage.input_ticks is not None:
            sequence.stamp(stage.input_ticks)
        sequence.call(stage.step_capsule())
        bus = bus | stage.outgoing_arrays()
    return bus


def torque_stage(robot: Robot, period: float, values: Mapping[str, Any], limits: SafetyLimits) -> TorqueStage:
    """The stage of the joints and the law that the values of a torque node name. Raises ConfigError."""
    return TorqueStage(robot, period, torque.selected_joints(values), limits, values.get("plug_in", ""))


# ---- Parameters that every node has, and shipped values --------------------------------------------


CHAIN_PARTS = ("fusion", "motion", "torque")

COMMON = ParameterSet(
    "nodes",
    (
        Parameter("robot", "robot description: shipped name or path of a URDF", kind=str, change=Change.FIXED),
        Parameter("period", "control period", "s", low=1e-4, high=0.1, change=Change.FIXED),
        Parameter("autostart", "configure and activate without a manager", kind=bool, change=Change.FIXED),
        Parameter(
            "publisher_depth",
            "messages kept for slow readers: 1 on the wall clock, more for a lock-step recording",
            kind=int,
            low=1,
            high=10_000,
            change=Change.FIXED,
        ),
        Parameter("introspection", "publish every number of the law each tick", kind=bool, change=Change.HOT),
    ),
)


def shipped_values(node: str) -> dict[str, Any]:
    """Shipped values of a node's parameters. The chain takes its laws' values from their own files, with a
    prefix, and those of the plant without one.

    Raises ConfigError for a file that is missing or malformed.
    """
    values = load_params_file(config_path("nodes.yaml"), node)
    if node == "chain":
        values.update(load_params_file(config_path("plant_node.yaml"), "plant_node"))
        for part in CHAIN_PARTS:
            law = load_params_file(config_path(f"{part}_node.yaml"), f"{part}_node")
            values.update({f"{part}.{name}": value for name, value in law.items() if name not in COMMON.names})
    values.update(load_params_file(config_path(f"{node}.yaml"), node))
    return values


def for_joints(values: Mapping[str, Any], parameters: ParameterSet, joint_names: Sequence[str]) -> dict[str, Any]:
    """Values with their per-joint lists cut to a robot that has some of the joints in `joint_names`, matched by name.

    Lists of a law with a prefix (`torque.joint_names`) are cut by its own names. Other values stay as they are.
    """
    found = dict(values)
    for head in (name.removesuffix("joint_names") for name in parameters.names if name.endswith("joint_names")):
        known = list(values.get(f"{head}joint_names", ()))
        if known == list(joint_names) or not set(joint_names) <= set(known):
            continue
        rows = [known.index(name) for name in joint_names]
        for parameter in parameters.parameters:
            name = parameter.name
            own = name.startswith(head) and "." not in name.removeprefix(head)
            if own and parameter.shape is Shape.PER_JOINT and len(values.get(name, ())) == len(known):
                found[name] = [values[name][row] for row in rows]
        found[f"{head}joint_names"] = list(joint_names)
    return found
