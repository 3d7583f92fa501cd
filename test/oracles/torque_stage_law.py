"""The torque law with layer 1 of the guard behind it, and the monitors of ticks and adaptation."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np

from hd_control import _laws
from hd_control.chain.black_box import UNKNOWN_STOP, BlackBox, FaultBook
from hd_control.chain.stage import ERROR, OK, Bus, Stage
from hd_control.chain.wiring import TORQUE
from hd_control.core import topics
from hd_control.core.arrays import FloatArray
from hd_control.core.blocks import Block
from hd_control.core.faults import Action, Fault, FaultCode, strongest
from hd_control.core.robot import Robot
from hd_control.laws import torque
from hd_control.safety import loop_monitors as adaptation
from hd_control.safety.guard import Guard, Mode
from hd_control.safety.limits import SafetyLimits

WATCH_TICKS = 10
"""The adaptation is looked at every so many ticks."""
REFERENCE_TOLERANCE = 0.005
"""rad; a reference further from the joint refuses a reset: the arm would jump to it."""


class TorqueStage(Stage):
    """Torque law and guard. An exception of the law becomes a command that is not finite: the guard stops."""

    def __init__(self, robot: Robot, dt: float, joint_names: Sequence[str], limits: SafetyLimits) -> None:
        super().__init__(TORQUE, torque, robot, dt, joint_names)
        joints, rows = len(self.joint_names), robot.indices(self.joint_names)
        self.limits = limits
        low, high, speed = robot.position_low[rows], robot.position_high[rows], robot.velocity_limit[rows]
        self.guard = Guard(limits, low, high, speed, dt)
        names = ("motor_position", "motor_velocity", "joint_position", "joint_velocity")
        self._measured = [(self.guard.measured.view(name), self.sample.view(name)) for name in names]
        self._used_sample = self.sample.array[: self.sample.layout.slices["motor_torque"].start]
        self.degraded_samples, self._lost = 0, 0.0
        self._joint_torque, self._railed = self.sample.view("joint_torque"), np.zeros(joints)
        self.adaptation = adaptation.initial(joints)
        self.ages, self.ticks, self.allowed = np.zeros(joints), np.zeros(joints), np.zeros(joints)
        self._left = np.zeros(joints)
        self.black_box = BlackBox(dt)
        self.black_box.watch(self.joint_names, self._left, {(topics.COMMAND, "effort"): slice(0, joints)})
        for numbers, columns in self.signals():
            self.black_box.watch(self.joint_names, numbers, columns)
        self.stopped_command = np.full(joints, np.nan)
        self.exception: BaseException | None = None
        self.faults = FaultBook()
        self.gate_open = False
        self.reset_asked = False
        self.reset_answer: list[str] | None = None

    def start(self) -> None:
        """A new activation: estimates and a latched stop survive, the filters fill again.

        The gate opens with the torque that the drive holds.
        """
        kept = None if self.state is None else torque.restarted(self.state)
        before = self.params
        super().start()
        assert self.params is not None
        same_law = kept is not None and kept.layout == torque.initial_state(self.params).layout
        self.state = kept if same_law else None
        if same_law and before is not None:  # a model that changed meanwhile goes on from the estimates that survive
            self.params = self._taken = before
        self.guard.deactivate()
        self.gate_open = False
        self.adaptation = adaptation.initial(len(self.joint_names))

    def read(self, bus: Bus) -> None:
        super().read(bus)
        if topics.REFERENCE not in bus:
            self.absent(topics.REFERENCE)

    def absent(self, topic: str) -> None:
        """Without a reference the joint is meant to stand where it is."""
        if self.reference is not None:
            self.reference.desired_position = self.sample.joint_position
            self.reference.desired_velocity = 0.0

    @property
    def gate_state(self) -> Block:
        """State of the gate behind the law."""
        return self.guard.gate

    @property
    def mode(self) -> str:
        """INACTIVE, ACTIVE, DEGRADED, STOPPING, HOLDING or STOPPED."""
        mode = self.guard.mode
        return "DEGRADED" if mode is Mode.ACTIVE and self.degraded_samples > 0 else mode.name

    def act(self, tick: int) -> None:
        demands = self._monitor(tick)
        try:
            self._advance_law()
            assert self.output is not None
            command = self._checked(self.output.motor_torque)
        except Exception as error:  # F33: the gate turns the missing command into a stop
            self.exception = self.exception or error
            command = self.stopped_command
        if self.exception is not None and not self.guard.stopped:  # until it is latched; then the law may prove itself
            command = self.stopped_command
        self.tick = tick
        self.allowed = self.through_gate(tick, command, demands)
        self._left[:] = self.allowed
        self.black_box.note(tick, self.stop_cause if self.guard.stopped else None)

    @property
    def stop_cause(self) -> Fault | BaseException:
        """What the latched stop is due to."""
        return self.exception or self.faults.first_stop or UNKNOWN_STOP

    @property
    def reference_array(self) -> FloatArray:
        """The numbers of the reference."""
        assert self.reference is not None
        return self.reference.array

    def _checked(self, command: FloatArray) -> FloatArray:
        """The command; not a number for joints with an input that is not finite, which a law might clip."""
        used, reference = self._used_sample, self.reference_array
        if _laws.all_finite(used) and _laws.all_finite(reference):
            return command
        n = command.size
        finite = np.isfinite(used.reshape(-1, n)).all(axis=0) & np.isfinite(reference.reshape(-1, n)).all(axis=0)
        return np.where(finite, command, np.nan)

    def _advance_law(self) -> None:
        """The law's step; degraded, the estimates stay as they were, bit for bit."""
        before = self.state
        self.advance()
        if self.degraded_samples > 0 and before is not None and self.state is not None:
            for name in adaptation.ESTIMATES:
                if name in before.layout.slices:
                    self.state.view(name)[...] = before.view(name)

    def _monitor(self, tick: int) -> list[Fault]:
        """Lost ticks and the adaptation; counts how long the robot stays degraded."""
        gap = tick - self.tick - 1 if self.tick >= 0 else 0
        self._lost, found = adaptation.lost_ticks(gap, self._lost, self.limits)
        self._railed, more = adaptation.gauge_rail(self._joint_torque, self._railed, self.limits.guard)
        found += more
        if tick % WATCH_TICKS == 0 and self.state is not None and self.state.layout.name == "TorqueState":
            assert self.params is not None
            self.adaptation, more = adaptation.watch(
                self.adaptation, self.state, self.params, self.sample, self.reference_array, self.limits.guard,
                WATCH_TICKS * self.dt,
            )  # fmt: skip
            found += more
        if found and strongest(found) >= Action.DEGRADE:
            self.degraded_samples = int(self.limits.guard.recover_samples)
        elif self.degraded_samples > 0:
            self.degraded_samples -= 1
        return found

    def results(self) -> Bus:
        return {topics.COMMAND: {"effort": self.allowed}}

    @property
    def outgoing(self) -> FloatArray:
        return self.allowed

    def outgoing_places(self, topic: str) -> dict[str, range]:
        return {"effort": range(len(self.joint_names))}

    def through_gate(self, tick: int, command: Any, demands: Sequence[Fault] = ()) -> Any:
        """The last step before publishing."""
        if not self.gate_open:
            self.guard.activate(self.sample.motor_torque)
            self.gate_open = True
        self.ticks.fill(tick)
        for target, source in self._measured:
            target[:] = source
        if self.reset_asked:
            self.answer_reset()
        allowed, faults = self.guard.step(command, self.ages, self.ticks, demands)
        if faults:
            self.faults.note(faults, tick)
        return allowed

    def answer_reset(self) -> None:
        """Between two ticks, on request of the reset service."""
        refused = self.guard.reset(self._reasons_of_reference())
        if not refused:
            self.exception = None
            self.faults.clear()
            if self.state is not None:
                self.state = torque.restarted(self.state)
        self.reset_answer, self.reset_asked = refused, False

    def _reasons_of_reference(self) -> list[str]:
        """Why the law may not take over again: a goal runs, or the reference is not where the joint is."""
        reference, sample, found = self.reference, self.sample, []
        assert reference is not None
        for j, name in enumerate(self.joint_names):
            if not reference.desired_velocity[j] == 0.0:
                found.append(f"{name}: a goal is active; reset the motion law first")
            gap = float(reference.desired_position[j] - sample.joint_position[j])
            if not abs(gap) <= REFERENCE_TOLERANCE:
                found.append(
                    f"{name}: reference {gap:.4g} rad from the joint, limit {REFERENCE_TOLERANCE:g} rad; "
                    "reset the motion law first"
                )
        return found

    def report(self) -> tuple[int, str, dict[str, Any]]:
        values: dict[str, Any] = {
            "gate_stopped": self.guard.stopped,
            "mode": self.mode,
            **self.faults.values(self.joint_names),
        }
        if self.state is not None:
            for name in (
                "coulomb_torque",
                "friction_offset",
                "viscous_positive",
                "viscous_negative",
                "torsional_compliance",
            ):
                if name not in self.state.layout.slices:
                    continue
                values[name] = " ".join(f"{number:.6g}" for number in self.state.view(name))
        if self.exception is not None:
            return ERROR, FaultCode.EXCEPTION.line(repr(self.exception)), values
        if self.guard.stopped:
            return ERROR, self.faults.headline(self.joint_names) or "stopped; call reset", values
        return OK, "", values

    def emergency(self, error: BaseException | None = None) -> None:
        if self.exception is None:
            self.exception = error or RuntimeError("an exception in another part of this node")
            self.black_box.mark(self.exception)
