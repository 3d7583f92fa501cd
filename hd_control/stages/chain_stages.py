"""The chain of one robot without ROS: fusion, motion and torque stage in the order in which their messages arrive."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

from hd_control.control import motion, torque
from hd_control.control.guard_limits import SafetyLimits
from hd_control.core.robot import Robot
from hd_control.sensing import fusion
from hd_control.stages.fusion_stage import FusionStage
from hd_control.stages.motion_stage import MotionStage
from hd_control.stages.stage import Stage
from hd_control.stages.torque_stage import TorqueStage

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
        TorqueStage(robot, period, torque.selected_joints(values["torque_node"]), limits),
    )
    for node, stage in found.by_node():
        stage.adopt(stage.prepare(values[node]))
        stage.start()
    for numbers, columns in found.fusion.signals():
        found.torque.black_box.watch(robot.joint_names, numbers, columns)
    return found
