"""`torque_node`: from the required joint torque to the motor torque, behind the safety gate.

Parameter `joints` selects one, some or all joints, so one process per joint is possible. Services: `~/reset` ends a
latched stop. Exit codes: 0 stopped on request, 1 internal fault, 2 bad configuration.
"""

from __future__ import annotations

import sys
import time
from typing import Any

from std_srvs.srv import Trigger

from hd_control.control import gate_limits, torque
from hd_control.core.parameters import ParameterSet
from hd_control.nodes.gate_values import LIMITS, limits_block
from hd_control.nodes.process import run_node
from hd_control.nodes.stage import Stage
from hd_control.nodes.stage_shell import StageShell
from hd_control.nodes.torque_stage import TorqueStage

RESET_WAIT = 1.0


def serve_reset(node: StageShell, stage: TorqueStage) -> None:
    """`~/reset` (std_srvs/Trigger): granted when all inputs were healthy long enough, else every reason is given."""

    def answer(request: Any, response: Trigger.Response) -> Trigger.Response:
        stage.reset_answer, stage.reset_asked = None, True
        end = time.monotonic() + RESET_WAIT
        while stage.reset_answer is None and time.monotonic() < end:
            time.sleep(0.002)
        if stage.reset_answer is None:
            stage.reset_asked = False
            reasons = ["no ticks arrive; start the plant or the bridge"]
        else:
            reasons = stage.reset_answer
        response.success, response.message = not reasons, "; ".join(reasons) or "reset"
        return response

    node.create_service(Trigger, "~/reset", answer)


class TorqueNode(StageShell):
    """One law, one gate."""

    def __init__(self) -> None:
        super().__init__("torque_node", ParameterSet("torque_node", (*torque.PARAMETERS.parameters, LIMITS), torque.PARAMETERS.rules))
        serve_reset(self, self.torque)
        for warning in torque.warnings(self.values):
            self.get_logger().warning(warning)

    def make_stages(self, values: Any) -> list[Stage]:
        names = torque.selected_joints(values)
        self.torque = TorqueStage(self.robot, self.dt, names, limits_block(values["limits"], names, self.dt))
        return [self.torque]


def main() -> int:
    """Entry point."""
    return run_node(TorqueNode)


if __name__ == "__main__":
    sys.exit(main())
