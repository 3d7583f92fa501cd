"""`motion_node`: goals to references, references and joint states to the required joint torque.

Goals on `joint_trajectory` are checked completely before acceptance; the answer is on `~/goal_status` (latched):
`accepted ID …` or the refusal. Stamp 0 starts at the next ticks. The action `follow_joint_trajectory` is served where
`control_msgs` is installed.

Exit codes: 0 stopped on request, 1 internal fault, 2 bad configuration.
"""

from __future__ import annotations

from typing import Any

from hd_control.chain.motion_stage import MotionStage
from hd_control.chain.stage import Stage
from hd_control.laws import motion
from hd_control.nodes.goals import GoalService, serve_trajectory_action
from hd_control.nodes.process import run_node
from hd_control.nodes.stage_shell import StageShell
from hd_control.nodes.stop_services import ModeInput, follow_drives, serve_reset


class MotionNode(StageShell):
    """One law with a trajectory in front of it."""

    def __init__(self) -> None:
        super().__init__("motion_node", motion.PARAMETERS)
        self.goals = GoalService(self, self.motion, lambda: self.values)
        self.modes = ModeInput(self, self.motion)
        follow_drives(self, self.motion)
        self.action = serve_trajectory_action(self, self.goals, self.motion)
        serve_reset(self, lambda: self.motion)

    def make_stages(self, values: Any) -> list[Stage]:
        self.motion = MotionStage(self.robot, self.dt, values["goal_blend_time"])
        return [self.motion]

    def status(self) -> tuple[bytes, str, dict[str, Any]]:
        level, text, values = super().status()
        return level, text, values | self.goals.values()


def main() -> None:
    """Entry point; ends the process with the exit code."""
    run_node(MotionNode)


if __name__ == "__main__":
    main()
