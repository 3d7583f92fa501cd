"""`chain`: fusion, motion and torque in one process and one thread, on the same topics. Started by hd_sim.nodes.chain.

Parameters of the laws are those of their own nodes with a prefix: `torque.law`, `motion.position_gain` and so on; their
shipped values come from the nodes' own files. Exit codes: 0 stopped, 1 internal fault, 2 bad configuration.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from hd_control import _chain, _plane
from hd_control.chain.black_box import BlackBox
from hd_control.chain.chain import CHAIN_PARTS, torque_stage
from hd_control.chain.fusion_stage import FusionStage
from hd_control.chain.motion_stage import MotionStage
from hd_control.chain.stage import Stage
from hd_control.core.parameters import Change, Parameter, ParameterSet
from hd_control.laws import fusion, motion, torque
from hd_control.nodes.goals import GoalService, serve_trajectory_action
from hd_control.nodes.stage_shell import StageShell, own_values, prefixed
from hd_control.nodes.stop_services import BLACK_BOX, ModePublisher, follow_drives, serve_black_box, serve_reset
from hd_control.safety.limits import LIMITS, safety_limits

LAWS = {"fusion": fusion, "motion": motion, "torque": torque}
WITH_PLANT = Parameter("with_plant", "run the simulated plant in the same thread", kind=bool, change=Change.FIXED)


def chain_parameters() -> ParameterSet:
    """The parameters of all laws, with prefixes, and the chain's own."""
    laws = [prefixed(LAWS[part].PARAMETERS, part) for part in CHAIN_PARTS]
    parameters = tuple(p for law in laws for p in law.parameters if p.name != "motion.robot")
    return ParameterSet(
        "chain", (*parameters, LIMITS, *BLACK_BOX, WITH_PLANT), tuple(rule for law in laws for rule in law.rules)
    )


class ChainNode(StageShell):
    """Three stages in a row. `extra` are parameters of a plant in the same process."""

    def __init__(self, extra: ParameterSet | None = None) -> None:
        own = chain_parameters()
        if extra is not None:
            own = ParameterSet("chain", own.parameters + extra.parameters, own.rules + extra.rules)
        super().__init__("chain", own, CHAIN_PARTS)
        self.goals = GoalService(self, self.motion, lambda: own_values(self.values, "motion"))
        self.mode_topic = ModePublisher(self)
        follow_drives(self, self.motion)
        self.black_boxes = serve_black_box(self, self.boxes)
        self.action = serve_trajectory_action(self, self.goals, self.motion)
        serve_reset(self, lambda: self.torque)

    def boxes(self) -> dict[str, BlackBox]:
        """The black boxes of this process by folder."""
        return {"": self.torque.black_box}

    def make_stages(self, values: Mapping[str, Any]) -> list[Stage]:
        own = own_values(values, "torque")
        names = torque.selected_joints(own)
        self.motion = MotionStage(self.robot, self.dt, values["motion.goal_blend_time"])
        self.torque = torque_stage(self.robot, self.dt, own, safety_limits(values["limits"], names, self.dt))
        limits = safety_limits(values["limits"], self.robot.joint_names, self.dt)
        fusion_stage = FusionStage(self.robot, self.dt, limits)
        for numbers, columns in fusion_stage.signals():
            self.torque.watch(self.robot.joint_names, numbers, columns)
        return [fusion_stage, self.motion, self.torque]

    def after_stages(self, plane: _plane.Loop, program: _plane.Program) -> None:
        program.step(_chain.ModeLink(self.torque.native, self.motion.native).step_capsule())
        self.mode_topic.announce(plane, program, self.torque)

    def status(self) -> tuple[bytes, str, dict[str, Any]]:
        level, text, values = super().status()
        return level, text, values | self.goals.values() | self.black_boxes.values()

    def leave(self) -> None:
        super().leave()
        self.black_boxes.stop()
