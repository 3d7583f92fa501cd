"""`torque_node`: from the required joint torque to the motor torque, behind the safety gate.

Parameter `joints` selects one, some or all joints, so one process per joint is possible. Services: `~/reset` ends a
latched stop. Exit codes: 0 stopped on request, 1 internal fault, 2 bad configuration.
"""

from __future__ import annotations

from typing import Any

from hd_control.control import torque
from hd_control.core.parameters import ParameterSet
from hd_control.nodes.process import run_node
from hd_control.nodes.reset_service import serve_reset
from hd_control.nodes.stage_shell import StageShell
from hd_control.stages.gate_values import LIMITS, safety_limits
from hd_control.stages.stage import Stage
from hd_control.stages.torque_stage import TorqueStage


class TorqueNode(StageShell):
    """One law, one gate."""

    def __init__(self) -> None:
        super().__init__(
            "torque_node", ParameterSet("torque_node", (*torque.PARAMETERS.parameters, LIMITS), torque.PARAMETERS.rules)
        )
        serve_reset(self, lambda: self.torque)
        for warning in torque.warnings(self.values):
            self.get_logger().warning(warning)

    def make_stages(self, values: Any) -> list[Stage]:
        names = torque.selected_joints(values)
        self.torque = TorqueStage(self.robot, self.dt, names, safety_limits(values["limits"], names, self.dt))
        return [self.torque]


def main() -> None:
    """Entry point; ends the process with the exit code."""
    run_node(TorqueNode)


if __name__ == "__main__":
    main()
