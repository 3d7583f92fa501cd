"""The fusion law between the sensor monitors: bad readings are bridged or withheld, disagreement withholds the torque.

A withheld number is "not a number" in the output; the torque law makes of it a command that is not finite, and the
guard stops. So a stop needs no topic of its own, in one process or in four. The cause is in the report of this stage.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np

from hd_control.chain.black_box import FaultBook
from hd_control.chain.stage import OK, WARN, Stage
from hd_control.chain.wiring import FUSION
from hd_control.core.arrays import FloatArray
from hd_control.core.blocks import Block
from hd_control.core.faults import Action, Fault
from hd_control.core.robot import Robot
from hd_control.laws import fusion
from hd_control.safety import sensor_monitors
from hd_control.safety import sensor_monitors as monitors
from hd_control.safety.limits import SafetyLimits

REDUNDANCY_TICKS = 4
"""The residual is summed every so many ticks; the motor turns by much less than a quarter of a ripple meanwhile."""
_ROWS = ("motor_shaft_position", "joint_position", "gauge_torque")


class FusionStage(Stage):
    """Fusion with its monitors."""

    def __init__(self, robot: Robot, dt: float, limits: SafetyLimits) -> None:
        super().__init__(FUSION, fusion, robot, dt)
        self._sensor_limits = monitors.SensorLimits.from_block(limits.guard)
        step, n = limits.guard.position_step_limit, robot.joints
        self._limit = np.stack([step, step, limits.guard.gauge_step_limit])
        self._rejected = float(limits.guard.rejected_samples)
        self.faults = FaultBook()
        self._reading, self._scale = np.empty((3, n)), np.ones((3, n))
        self._raw = [self.sample.view(name) for name in _ROWS]
        self._parts = fusion.layout("FusionOutput", n).slices
        self._screen: monitors.Screen | None = None
        self._redundancy: monitors.Redundancy | None = None
        self._stuck: sensor_monitors.Stuck | None = None
        self.missed_motion = np.zeros(n)
        self.raw = self.sample.copy()

    def adopt(self, params: Block) -> None:
        super().adopt(params)
        scale = self._scale.copy()
        scale[0] = params.gear_ratio
        periods = np.stack([params.encoder_period / params.gear_ratio, params.resolver_period, np.zeros(params.joints)])
        self._scale, self._period = scale, periods if periods.any() else None
        self._stiffness = params.torsional_stiffness

    def start(self) -> None:
        super().start()
        self._screen = self._redundancy = self._stuck = None
        self._run = np.zeros((2, len(self.joint_names)))

    def act(self, tick: int) -> None:
        self.raw.array[:] = self.sample.array
        faults = self._before()
        self.advance()
        faults += self._after(tick)
        self.tick = tick
        if faults:
            self.faults.note(faults, tick)

    def _before(self) -> list[Fault]:
        """Screens the readings in place."""
        reading = self._reading
        for row, view in enumerate(self._raw):
            reading[row] = view
        reading /= self._scale
        if self._screen is None:
            self._screen = monitors.first_screen(reading)
            self._frozen = monitors.Frozen(reading[2].copy(), np.zeros(reading.shape[1]), reading[0].copy())
            return []
        used, self._screen, faults = monitors.screen(reading, self._screen, self._limit, self._period, self._rejected)
        if faults:
            changed, scaled = ~(used == reading), used * self._scale
            for row, view in enumerate(self._raw):
                view[changed[row]] = scaled[row][changed[row]]
        return faults

    def _after(self, tick: int) -> list[Fault]:
        """Compares the sensors with each other; withholds the joint torque where they disagree."""
        assert self.output is not None
        numbers, parts, limits = self.output.array, self._parts, self._sensor_limits
        motor, joint, gauge = numbers[parts["motor_position"]], numbers[parts["resolver_position"]], self._raw[2]
        apart, self._run[0], faults = monitors.disagree(motor, joint, self._run[0], limits)
        railed, self._run[1], rail = monitors.at_rail(gauge, self._run[1], limits)
        stuck, self._frozen, frozen = monitors.frozen(gauge, motor, self._frozen, limits)
        redundant = self._compare(numbers, parts) if tick % REDUNDANCY_TICKS == 0 else []
        faults = [*faults, *rail, *frozen, *redundant]
        if faults:
            stops = apart | railed | stuck
            stops[[fault.joint for fault in redundant if fault.action is Action.CONTROLLED_STOP]] = True
            numbers[parts["joint_torque"]][stops] = np.nan
        return faults

    def _compare(self, numbers: FloatArray, parts: Mapping[str, slice]) -> list[Fault]:
        """The relation between the three sensors, Zhu (1), and positions that do not take part in it any more."""
        motor, joint, error = (
            numbers[parts[name]] for name in ("motor_position", "resolver_position", "kinematic_error")
        )
        torque, shaft = numbers[parts["joint_torque"]], numbers[parts["motor_shaft_position"]]
        positions, limits = np.stack([motor, joint]), self._sensor_limits
        stuck = self._stuck or sensor_monitors.first_stuck(positions)
        self.missed_motion, self._stuck, found = sensor_monitors.stuck(
            positions, torque / self._stiffness - error, stuck, limits.frozen_samples, limits.stuck_motion_limit,
            REDUNDANCY_TICKS,
        )  # fmt: skip
        residual = torque - self._stiffness * (motor + error - joint)
        memory = self._redundancy or monitors.first_redundancy(shaft)
        self._redundancy, faults = monitors.redundancy(residual, shaft, numbers[parts["gauge_angle"]], memory, limits)
        return [*found, *faults]

    def signals(self) -> list[tuple[FloatArray, dict[tuple[str, str], slice]]]:
        """The readings as they came, before the monitors."""
        [(_, columns)] = super().signals()
        return [(self.raw.array, columns)]

    def report(self) -> tuple[int, str, dict[str, Any]]:
        values: dict[str, Any] = dict(self.faults.values(self.joint_names))
        memory = self._redundancy
        if memory is not None:
            for name, numbers in (("residual_mean", memory.mean), ("residual_ripple", memory.ripple)):
                values[name] = " ".join("not observable" if x != x else f"{x:.4g}" for x in numbers)
        text = self.faults.headline(self.joint_names)
        return (WARN if text else OK), text, values
