"""`fusion_node`: three raw sensors to one state estimate.

Exit codes: 0 stopped on request, 1 internal fault, 2 bad configuration.
"""

from __future__ import annotations

from typing import Any

from hd_control.nodes.process import run_node
from hd_control.nodes.stage_shell import StageShell
from hd_control.sensing import fusion
from hd_control.stages.stage import Stage
from hd_control.stages.wiring import FUSION


class FusionNode(StageShell):
    """One law."""

    def __init__(self) -> None:
        super().__init__("fusion_node", fusion.PARAMETERS)

    def make_stages(self, values: Any) -> list[Stage]:
        return [Stage(FUSION, fusion, self.robot, self.dt)]


def main() -> None:
    """Entry point; ends the process with the exit code."""
    run_node(FusionNode)


if __name__ == "__main__":
    main()
