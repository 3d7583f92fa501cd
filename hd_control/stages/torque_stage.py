"""The torque law with layer 1 of the safety gate behind it."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np

from hd_control.control import safety_gate as gate
from hd_control.control import torque
from hd_control.core.blocks import Block, FloatArray
from hd_control.core.faults import FaultCode
from hd_control.core.robot import Robot
from hd_control.stages import topics
from hd_control.stages.fault_book import FaultBook
from hd_control.stages.stage import ERROR, OK, Bus, Stage
from hd_control.stages.wiring import TORQUE


class TorqueStage(Stage):
    """Torque law and gate. An exception of the law becomes a command that is not finite: the gate stops and latches."""

    def __init__(self, robot: Robot, dt: float, joint_names: Sequence[str], limits: Block) -> None:
        super().__init__(TORQUE, torque, robot, dt, joint_names)
        joints = len(self.joint_names)
        self.limits = limits
        self.gate_state = gate.initial_gate_state(joints)
        self.measured = gate.new_measured(joints)
        self.ages, self.ticks, self.allowed = np.zeros(joints), np.zeros(joints), np.zeros(joints)
        self.stopped_command = np.full(joints, np.nan)
        self.exception: Exception | None = None
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
        self.gate_state, self.gate_open = gate.deactivate(self.gate_state), False

    def read(self, bus: Bus) -> None:
        super().read(bus)
        if topics.REFERENCE not in bus:
            self.absent(topics.REFERENCE)

    def absent(self, topic: str) -> None:
        """Without a reference the joint is meant to stand where it is."""
        if self.reference is not None:
            self.reference.desired_position = self.sample.joint_position
            self.reference.desired_velocity = 0.0

    def act(self, tick: int) -> None:
        try:
            self.advance()
            assert self.output is not None
            command = self.output.motor_torque
        except Exception as error:  # F33: the gate turns the missing command into a stop
            self.exception = self.exception or error
            command = self.stopped_command
        if self.exception is not None:
            command = self.stopped_command
        self.tick = tick
        self.allowed = self.through_gate(tick, command)

    def results(self) -> Bus:
        return {topics.COMMAND: {"effort": self.allowed}}

    @property
    def outgoing(self) -> FloatArray:
        return self.allowed

    def outgoing_places(self, topic: str) -> dict[str, range]:
        return {"effort": range(len(self.joint_names))}

    def through_gate(self, tick: int, command: Any) -> Any:
        """The last step before publishing."""
        if not self.gate_open:
            self.gate_state = gate.activate(self.gate_state, self.limits, self.sample.motor_torque)
            self.gate_open = True
        self.ticks.fill(tick)
        if self.reset_asked:
            self.answer_reset()
        allowed, self.gate_state, faults = gate.safety_gate_compiled(
            command, self.measured, self.ages, self.ticks, self.limits, self.gate_state
        )
        if faults:
            self.faults.note(faults, tick)
        return allowed

    def answer_reset(self) -> None:
        """Between two ticks, on request of the reset service."""
        self.measured.joint_position = self.sample.joint_position
        self.measured.joint_velocity = self.sample.joint_velocity
        self.gate_state, refused = gate.reset(self.gate_state, self.measured, self.limits)
        if not refused:
            self.exception = None
            self.faults.clear()
        self.reset_answer, self.reset_asked = refused, False

    def report(self) -> tuple[int, str, dict[str, Any]]:
        values: dict[str, Any] = {"gate_stopped": bool(self.gate_state.stopped), **self.faults.values(self.joint_names)}
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
            return ERROR, f"{FaultCode.EXCEPTION.text}: {self.exception!r}", values
        if self.gate_state.stopped != 0.0:
            return ERROR, self.faults.headline(self.joint_names) or "stopped; call reset", values
        return OK, "", values

    def emergency(self) -> None:
        self.exception = self.exception or RuntimeError("an exception in another part of this node")
