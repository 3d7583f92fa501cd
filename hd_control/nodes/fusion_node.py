"""`fusion_node`: three raw sensors to one state estimate.

Exit codes: 0 stopped on request, 1 internal fault, 2 bad configuration.
"""

from __future__ import annotations

from typing import Any

from hd_control.chain.fusion_stage import FusionStage
from hd_control.chain.stage import Stage
from hd_control.core.parameters import ParameterSet
from hd_control.laws import fusion
from hd_control.nodes.process import run_node
from hd_control.nodes.stage_shell import StageShell
from hd_control.safety.limits import LIMITS, safety_limits


class FusionNode(StageShell):
    """One law."""

    def __init__(self) -> None:
        super().__init__(
            "fusion_node",
            ParameterSet("fusion_node", (*fusion.PARAMETERS.parameters, LIMITS), fusion.PARAMETERS.rules),
        )

    def make_stages(self, values: Any) -> list[Stage]:
        return [FusionStage(self.robot, self.dt, safety_limits(values["limits"], self.robot.joint_names, self.dt))]


def main() -> None:
    """Entry point; ends the process with the exit code."""
    run_node(FusionNode)


if __name__ == "__main__":
    main()
