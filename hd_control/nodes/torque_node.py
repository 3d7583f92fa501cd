"""`torque_node`: from the required joint torque to the motor torque, behind the safety gate.

Parameter `joints` selects one, some or all joints, so one process per joint is possible. Services: `~/reset` ends a
latched stop, `~/black_box` writes what a stop has left.

Exit codes: 0 stopped on request, 1 internal fault, 2 bad configuration.
"""

from __future__ import annotations

from typing import Any

from hd_control import _plane
from hd_control.chain.chain import torque_stage
from hd_control.chain.stage import Stage
from hd_control.core.parameters import ParameterSet
from hd_control.laws import torque
from hd_control.nodes.process import run_node
from hd_control.nodes.stage_shell import StageShell
from hd_control.nodes.stop_services import BLACK_BOX, ModePublisher, serve_black_box, serve_reset
from hd_control.safety.limits import LIMITS, safety_limits


class TorqueNode(StageShell):
    """One law, one gate."""

    def __init__(self) -> None:
        own = (*torque.PARAMETERS.parameters, LIMITS, *BLACK_BOX)
        super().__init__("torque_node", ParameterSet("torque_node", own, torque.PARAMETERS.rules))
        self.mode_topic = ModePublisher(self)
        self.black_boxes = serve_black_box(self, lambda: {"": self.torque.black_box})
        serve_reset(self, lambda: self.torque)
        for warning in torque.warnings(self.values):
            self.get_logger().warning(warning)

    def make_stages(self, values: Any) -> list[Stage]:
        names = torque.selected_joints(values)
        self.torque = torque_stage(self.robot, self.dt, values, safety_limits(values["limits"], names, self.dt))
        return [self.torque]

    def after_stages(self, plane: _plane.Loop, program: _plane.Program) -> None:
        self.mode_topic.announce(plane, program, self.torque)

    def status(self) -> tuple[bytes, str, dict[str, Any]]:
        level, text, values = super().status()
        return level, text, values | self.black_boxes.values()

    def leave(self) -> None:
        super().leave()
        self.black_boxes.stop()


def main() -> None:
    """Entry point; ends the process with the exit code."""
    run_node(TorqueNode)


if __name__ == "__main__":
    main()
