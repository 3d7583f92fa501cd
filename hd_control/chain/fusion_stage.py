"""The fusion law between the sensor monitors: bad readings are bridged or withheld, disagreement withholds the torque.

A withheld number is "not a number" in the output; the torque law makes of it a command that is not finite, and the
guard stops. So a stop needs no topic of its own, in one process or in four. The cause is in the report of this stage.
"""

from __future__ import annotations

from typing import Any

from hd_control import _chain
from hd_control.chain.black_box import FaultBook
from hd_control.chain.stage import OK, WARN, Stage, ramp_kinds
from hd_control.chain.wiring import FUSION
from hd_control.core.arrays import FloatArray
from hd_control.core.blocks import Block
from hd_control.core.robot import Robot
from hd_control.laws import fusion
from hd_control.safety.limits import SafetyLimits


class FusionStage(Stage):
    """Fusion with its monitors."""

    def __init__(self, robot: Robot, dt: float, limits: SafetyLimits) -> None:
        super().__init__(FUSION, fusion, robot, dt)
        n = robot.joints
        blocks = {kind: fusion.layout(f"Fusion{kind.title()}", n) for kind in ("params", "sample", "output", "state")}
        native = _chain.FusionTick(n, dt, limits.guard.array, ramp_kinds(fusion, blocks["params"]))
        self._use(native, blocks)
        self.raw = Block(blocks["sample"], native.raw)
        self.faults = FaultBook(native.faults)

    @property
    def missed_motion(self) -> FloatArray:
        """Motion (n,) rad that a position sensor missed while it repeated one reading, the larger of both sensors."""
        found: FloatArray = self.native.missed_motion
        return found

    def signals(self) -> list[tuple[FloatArray, dict[tuple[str, str], slice]]]:
        """The readings as they came, before the monitors."""
        [(_, columns)] = super().signals()
        return [(self.raw.array, columns)]

    def report(self) -> tuple[int, str, dict[str, Any]]:
        values: dict[str, Any] = dict(self.faults.values(self.joint_names))
        if self.native.compared:
            for name, numbers in (
                ("residual_mean", self.native.residual_mean),
                ("residual_ripple", self.native.residual_ripple),
            ):
                values[name] = " ".join("not observable" if x != x else f"{x:.4g}" for x in numbers.tolist())
        text = self.faults.headline(self.joint_names)
        return (WARN if text else OK), text, values
