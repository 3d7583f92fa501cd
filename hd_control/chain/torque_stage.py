"""The torque law with layer 1 of the guard behind it, and the monitors of ticks and adaptation."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any

from hd_control import _chain
from hd_control.chain.black_box import BlackBox, FaultBook, span
from hd_control.chain.motion_stage import MODES
from hd_control.chain.stage import ERROR, OK, Bus, Stage, ramp_kinds, start_places
from hd_control.chain.wiring import TORQUE
from hd_control.core import topics
from hd_control.core.arrays import FloatArray
from hd_control.core.blocks import Block
from hd_control.core.faults import FaultCode
from hd_control.core.robot import Robot
from hd_control.laws import torque
from hd_control.laws.plug_ins import command_of, law_named
from hd_control.safety.guard import Guard, envelope, refusals
from hd_control.safety.limits import SafetyLimits

_KINDS = {"TorqueParams": 0, "ManifoldParams": 1, "FeedbackParams": 2}


class TorqueStage(Stage):
    """Torque law and guard. What is no finite number becomes a stop in the guard, whatever the law is.

    `plug_in` names a law in Python that gives the command in place of the compiled one (`laws/plug_ins.py`). Raises
    ConfigError if there is none.
    """

    def __init__(
        self, robot: Robot, dt: float, joint_names: Sequence[str], limits: SafetyLimits, plug_in: str = ""
    ) -> None:
        super().__init__(TORQUE, torque, robot, dt, joint_names)
        self.plug_in = law_named(plug_in, self.joint_names, dt) if plug_in else None
        self.limits = limits
        rows = robot.indices(self.joint_names)
        self._bounds = robot.position_low[rows], robot.position_high[rows], robot.velocity_limit[rows]
        self.exception: BaseException | None = None
        self._resets = 0
        self._watched: list[tuple[tuple[str, ...], FloatArray, dict[tuple[str, str], slice]]] = []
        self._make(torque.layout("TorqueParams", len(self.joint_names)).zeros())

    def _make(self, params: Block) -> None:
        """The compiled tick of the law that this parameter block belongs to."""
        n, before = len(self.joint_names), getattr(self, "native", None)
        state, output = torque.initial_state(params).layout, torque.output_layout(params)
        native = _chain.TorqueTick(
            n, self.dt, _KINDS[params.layout.name], self.limits.gate.array, self.limits.guard.array,
            envelope(*self._bounds), *span(self.dt), ramp_kinds(torque, params.layout),
            start_places(torque, params.layout, state),
            [math.nan if topic in TORQUE.optional else -1.0 for topic in TORQUE.inputs],
        )  # fmt: skip
        blocks = {
            "params": params.layout,
            "sample": torque.layout("TorqueSample", n),
            "reference": torque.layout("TorqueReference", n),
            "output": output,
            "state": state,
        }
        self.allowed: FloatArray = native.allowed
        self._use(native, blocks)
        self.guard = Guard(self.limits, *self._bounds, self.dt, 0, native.guard)
        self.faults = FaultBook(native.faults)
        if before is not None:
            self._take_over(before)
        self.black_box = BlackBox(self.dt, native.ring)
        own = (self.joint_names, self.allowed, {(topics.COMMAND, "effort"): slice(0, n)})
        signals = [(self.joint_names, *each) for each in self.signals()]
        for names, numbers, columns in (own, *signals, *self._watched):
            self.black_box.watch(names, numbers, columns)

    def _take_over(self, before: Any) -> None:
        """Another law in the same place: a latched stop, its fault and the last torque stay."""
        native = self.native
        for name in ("gate", "state", "stop", "measured"):
            getattr(native.guard, name)[:] = getattr(before.guard, name)
        native.faults.take_over(before.faults)
        native.sample[:], native.reference[:], native.allowed[:] = before.sample, before.reference, before.allowed
        native.degraded_samples, native.lost, native.failed = before.degraded_samples, before.lost, before.failed
        native.railed[:], native.input_ticks[:] = before.railed, before.input_ticks

    def watch(self, joint_names: Sequence[str], numbers: FloatArray, columns: dict[tuple[str, str], slice]) -> None:
        """More numbers for the black box: what other stages of the process receive."""
        self._watched.append((tuple(joint_names), numbers, columns))
        self.black_box.watch(joint_names, numbers, columns)

    def adopt(self, params: Block) -> None:
        if params.layout != self._layouts["params"] and self.native.tick < 0:
            self._make(params)
        if params.layout == self._layouts["params"]:
            super().adopt(params)
        else:
            self._offered = params

    def start(self) -> None:
        """A new activation: estimates and a latched stop survive, the filters fill again.

        The gate opens with the torque that the drive holds. Another law begins anew.
        """
        if self._offered is not None and self._offered.layout != self._layouts["params"]:
            self._make(self._offered)
            self.native.offer(self._offered.array)
        super().start()
        if self.plug_in is not None:
            self.plug_in.start()

    def read(self, bus: Bus, tick: int) -> None:
        super().read(bus, tick)
        if topics.REFERENCE not in bus:
            self.absent(topics.REFERENCE)

    def stand_ins(self, topic: str) -> list[tuple[FloatArray, FloatArray | None]]:
        """Without a reference the joint is meant to stand where it is."""
        if self.reference is None or topic != topics.REFERENCE:
            return []
        position, velocity = (self.reference.view(name) for name in ("desired_position", "desired_velocity"))
        return [(position, self.sample.view("joint_position")), (velocity, None)]

    def act(self, tick: int) -> None:
        if self.plug_in is None:
            self.native.act(tick)
        else:
            self.native.act_with(tick, self._command_of_plug_in())
        if self.native.ring.stops:
            self.black_box.look()

    def step_capsule(self) -> Any:
        return self.native.step_capsule() if self.plug_in is None else self.act

    def _command_of_plug_in(self) -> FloatArray | None:
        """None after an exception: the guard stops."""
        assert self.plug_in is not None and self.reference is not None
        try:
            return command_of(self.plug_in, self.sample, self.reference)
        except Exception as error:  # F33: whatever a law in Python does
            self.emergency(error)
            return None

    @property
    def gate_state(self) -> Block:
        """State of the gate behind the law."""
        return self.guard.gate

    @property
    def mode(self) -> str:
        """INACTIVE, ACTIVE, DEGRADED, STOPPING, HOLDING or STOPPED."""
        return MODES[int(self.native.mode) - 1]

    @property
    def degraded_samples(self) -> int:
        """Ticks for which the robot stays degraded."""
        return int(self.native.degraded_samples)

    @property
    def reset_asked(self) -> bool:
        """A reset waits for the next tick."""
        return bool(self.native.reset_asked)

    @reset_asked.setter
    def reset_asked(self, asked: bool) -> None:
        self.native.reset_asked = asked

    @property
    def reset_answer(self) -> list[str] | None:
        """The answer to a reset, once: reasons against it; None while there is none."""
        if self.native.resets == self._resets:
            return None
        reasons = refusals(self.native.refusals, self.joint_names)
        if not reasons:
            self.exception = None
        return reasons

    @reset_answer.setter
    def reset_answer(self, answer: None) -> None:
        self._resets = self.native.resets

    @property
    def outgoing(self) -> FloatArray:
        return self.allowed

    def outgoing_places(self, topic: str) -> dict[str, range]:
        return {"effort": range(len(self.joint_names))}

    def report(self) -> tuple[int, str, dict[str, Any]]:
        values: dict[str, Any] = {
            "gate_stopped": self.guard.stopped,
            "mode": self.mode,
            **self.faults.values(self.joint_names),
        }
        if self.plug_in is not None:
            values["plug_in"] = f"{type(self.plug_in).__name__}: a law in Python, not real time"
        state = self.state if self.plug_in is None else None
        for name in torque.ESTIMATES if state is not None else ():
            if state is not None and name in state.layout.slices:
                values[name] = " ".join(f"{number:.6g}" for number in state.view(name))
        if self.exception is not None and self.native.failed:
            return ERROR, f"{FaultCode.EXCEPTION.text}: {self.exception!r}", values
        if self.guard.stopped:
            return ERROR, self.faults.headline(self.joint_names) or "stopped; call reset", values
        return OK, "", values

    def emergency(self, error: BaseException | None = None) -> None:
        """From any thread: the next command is none, the guard stops. Until it is latched; then the law may go on."""
        if self.exception is None or not self.native.failed:
            self.exception = error or RuntimeError("an exception in another part of this node")
            self.black_box.mark(self.exception)
            self.native.failed = True
