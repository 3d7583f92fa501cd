"""Takes goals in the executor thread, checks them completely, answers, and hands accepted paths to the loop."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import replace
from typing import Any

from std_msgs.msg import String
from trajectory_msgs.msg import JointTrajectory

from hd_control.control.goal_check import GoalLimits, check_goal
from hd_control.control.path import Path, braking_path
from hd_control.control.trajectory import Goal
from hd_control.core.errors import GoalError
from hd_control.nodes.convert import goal_from_message
from hd_control.nodes.lifecycle_shell import Shell
from hd_control.nodes.ros_loop import chain_qos, latched_qos
from hd_control.stages import topics
from hd_control.stages.motion_stage import MotionStage

LEADS = (10, 40, 160, 640)
"""Ticks between the check and the start of a goal that starts now; the next one if the check took longer."""


class GoalDesk:
    """`joint_trajectory` in, `~/goal_status` out: `accepted ID start_tick N end_tick M`, or the refusal's text."""

    def __init__(self, node: Shell, stage: MotionStage, values: Callable[[], Mapping[str, Any]]) -> None:
        self._node, self._stage, self._values = node, stage, values
        self._status = node.create_publisher(String, "~/goal_status", latched_qos())
        self._received = self.refused = 0
        self.last_refusal = ""
        node.create_subscription(JointTrajectory, topics.GOAL, self._take, chain_qos(10))

    def _take(self, message: JointTrajectory) -> None:
        self._received += 1
        name = message.header.frame_id or f"goal_{self._received}"
        try:
            text = self.offer(goal_from_message(message, self._node.dt_ns, name))
        except GoalError as error:
            text = self.last_refusal = f"refused {name} {error.code}: {error}"
            self.refused += 1
        self._status.publish(String(data=text))

    def values(self) -> dict[str, Any]:
        """For diagnostics, and so for the recording: refused goals with their reason."""
        return {"goals_refused": self.refused, "last_goal_refusal": self.last_refusal}

    def offer(self, goal: Goal) -> str:
        """The answer to an accepted goal. Raises GoalError; nothing has changed then."""
        path = self.accept(goal)
        return f"accepted {goal.identifier} start_tick {path.start_tick} end_tick {path.end_tick}"

    def accept(self, goal: Goal) -> Path:
        """The path that is now followed. Raises GoalError; nothing has changed then."""
        stage = self._stage
        if not self._node.active or stage.follower is None:
            raise GoalError(
                "not_active", "HD-F22 goal_bad: the motion law does not run. Activate it and start the plant."
            )
        stage.refuse_unless_ready()
        limits = GoalLimits.from_values(self._values(), self._node.robot)
        for lead in LEADS if goal.start_tick is None else (0,):
            tick = stage.tick
            dated = replace(goal, start_tick=tick + lead) if goal.start_tick is None else goal
            path = check_goal(dated, stage.follower.copy(), limits, stage.sample.joint_position.copy(), tick)
            if path.start_tick > stage.tick:
                stage.hand_over(path)
                return path
        raise GoalError("start_stamp", "HD-F22 goal_bad: the start passed during the check. Give a later start.")

    def brake(self) -> None:
        """Brings the reference to rest within the acceleration limits; drops every goal."""
        stage, limits = self._stage, GoalLimits.from_values(self._values(), self._node.robot)
        if stage.follower is not None:
            start = stage.tick + LEADS[0]
            motion = stage.follower.at(start)
            stage.hand_over(braking_path(motion, start, stage.dt, limits.acceleration))
