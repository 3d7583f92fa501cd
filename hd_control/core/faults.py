"""Faults: named values with code, joint, number and limit. The hot loop keeps numbers; text is made outside of it.

HD-F18 node_killed joint_3: input age 10 samples >= 10 samples. Check that the sending node lives; then call reset.
"""

from __future__ import annotations

import enum
from collections.abc import Sequence
from dataclasses import dataclass


class Action(enum.IntEnum):
    """Reactions, weakest first. Several faults at once: the strongest wins, and none replaces a stronger one."""

    REFUSE = 0
    REPORT = 1
    DEGRADE = 2
    CONTROLLED_STOP = 3
    TORQUE_RAMP = 4


class FaultCode(enum.IntEnum):
    """Numbers of the fault table; the text form is HD-F01 and so on. A number never gets another meaning: `RESERVED`.

    Faults that compare a number with a limit are made as a `Fault`, see `KINDS`; the others are one line of words,
    made by `line` where they are found.
    """

    FRAME_LOST = 1
    STAMP_STUCK = 2
    VALUE_FROZEN = 3
    NOT_FINITE = 4
    SPIKE = 5
    POSITION_DISAGREE = 7
    GAUGE_RAIL = 8
    GAUGE_BRANCH = 9
    GAUGE_DRIFT = 10
    CLOCK_JUMP = 15
    OVERRUN = 17
    NODE_KILLED = 18
    NODE_BACK = 19
    PARAM_BAD = 20
    PARAM_MOVING = 21
    GOAL_BAD = 22
    TWO_PUBLISHERS = 24
    MODEL_MISMATCH = 25
    YAML_BAD = 26
    BAG_DAMAGED = 27
    BAG_FOREIGN = 28
    BAG_HUGE = 29
    DISK_FULL = 30
    RECORDER_SLOW = 31
    EXCEPTION = 33
    ADAPTATION = 34
    TORQUE_LIMITED = 37
    RATE_LIMITED = 38
    RATE_PERSISTENT = 39
    ENVELOPE = 40
    LET_GO = 41
    STOP_LEFT = 42
    OVERSPEED = 43
    STAMP_AHEAD = 44
    TEMPERATURE_BAD = 45
    BRAKE_HELD = 46
    SLIPPED = 47
    NOT_OBEYED = 48

    @property
    def number(self) -> str:
        """`HD-F07`."""
        return f"HD-F{self.value:02d}"

    @property
    def text(self) -> str:
        """Code and name as people read them, `HD-F07 position_disagree`."""
        return f"{self.number} {self.name.lower()}"

    def line(self, what: str, where: str = "") -> str:
        """`HD-F22 goal_bad joint_3: what`: code, place (joint, node, file; may be empty) and finding in one line."""
        return f"{self.text}{' ' + where if where else ''}: {what}"


RESERVED: dict[int, str] = {
    6: "a counter that wraps, which is unwrapped and no fault",
    **dict.fromkeys((11, 12, 13, 14), "a CAN bridge"),
    16: "a simulated clock, which no node reads",
    23: "streams of goals",
    32: "requests to a web page",
    35: "contact of the arm",
    36: "a tick beyond 2^53, which is HD-F02",
}
"""Numbers without a fault in this version, and what each is kept for."""


@dataclass(frozen=True)
class FaultKind:
    """How a fault reads: what was compared, how, in which unit, and what to do about it."""

    quantity: str
    relation: str
    unit: str
    remedy: str


KINDS: dict[FaultCode, FaultKind] = {
    FaultCode.FRAME_LOST: FaultKind(
        "lost ticks in a row", ">=", "samples", "Check the sensors, their wiring and the load of this computer"
    ),
    FaultCode.STAMP_STUCK: FaultKind("stamp not advancing, tick", "<=", "", "Check that the source counts its ticks"),
    FaultCode.VALUE_FROZEN: FaultKind(
        "equal readings in motion", ">=", "samples", "Check the sensor that repeats one value and its wiring"
    ),
    FaultCode.NOT_FINITE: FaultKind("number", "against", "", "Look at the recorded inputs"),
    FaultCode.SPIKE: FaultKind("reading - prediction", "outside +-", "", "Check shielding and connector of the sensor"),
    FaultCode.POSITION_DISAGREE: FaultKind(
        "motor - joint position", "outside +-", "rad", "Check joint-sensor coupling and offsets"
    ),
    FaultCode.GAUGE_RAIL: FaultKind(
        "gauge reading", "at the rail of +-", "N m", "Check the load, the bridge and its amplifier"
    ),
    FaultCode.GAUGE_BRANCH: FaultKind(
        "bridge branch open? 2 beta amplitude", ">", "N m", "Check the wires of the strain-gauge bridge"
    ),
    FaultCode.GAUGE_DRIFT: FaultKind(
        "mean residual of the three sensors", "outside +-", "N m", "Calibrate the gauge again at a known load"
    ),
    FaultCode.CLOCK_JUMP: FaultKind(
        "jump of the system clock",
        "outside +-",
        "s",
        "Control does not use that clock; mind the stamps of other programs",
    ),
    FaultCode.OVERRUN: FaultKind("late and skipped ticks", ">", "", "Lower the load of this computer"),
    FaultCode.NODE_KILLED: FaultKind("input age", ">=", "samples", "Check that the sending node lives"),
    FaultCode.NODE_BACK: FaultKind("messages of another run id", ">", "", "Check why the sending node restarted"),
    FaultCode.TWO_PUBLISHERS: FaultKind("publishers", ">", "", "Stop the second source of this topic"),
    FaultCode.ADAPTATION: FaultKind(
        "tracking error over the one at the bound", ">", "", "Check the bounds and the model of the joint"
    ),
    FaultCode.TORQUE_LIMITED: FaultKind("motor torque", "outside +-", "N m", "Lower gains or the speed of the motion"),
    FaultCode.RATE_LIMITED: FaultKind(
        "motor torque change", "outside +-", "N m", "Lower gains or check motor_torque_rate_limit"
    ),
    FaultCode.RATE_PERSISTENT: FaultKind("rate excesses in a row", ">=", "samples", "Look for a limit cycle"),
    FaultCode.ENVELOPE: FaultKind(
        "position where braking would end",
        "outside",
        "rad",
        "Move the joint back inside its limits by hand or with a goal",
    ),
    FaultCode.LET_GO: FaultKind(
        "zero commands in a row while the joint moves", ">=", "samples", "Look why the controller let the joint go"
    ),
    FaultCode.STOP_LEFT: FaultKind(
        "velocity in a controlled stop", "outside +-", "rad/s", "Look for a load or a sensor that does not fit"
    ),
    FaultCode.OVERSPEED: FaultKind("joint velocity", "outside +-", "rad/s", "Look at the command and at the sensors"),
    FaultCode.STAMP_AHEAD: FaultKind(
        "stamp ahead of the present tick by", ">", "samples", "Check the clock of the source and who else publishes"
    ),
    FaultCode.TEMPERATURE_BAD: FaultKind(
        "motor temperature", "too far from", "degC", "Check the temperature sensor and who else publishes its topic"
    ),
    FaultCode.BRAKE_HELD: FaultKind(
        "command minus torque of the gauge",
        "outside +-",
        "N m",
        "Look at the command, or calibrate the gauge",
    ),
    FaultCode.SLIPPED: FaultKind(
        "motion after the brake opened", "outside +-", "rad", "Look why the command does not hold the joint"
    ),
    FaultCode.NOT_OBEYED: FaultKind(
        "torque of the drive", "against a command of", "N m", "Look who else commands the drive, or why it has stopped"
    ),
}
"""The faults that compare a number with a limit."""


@dataclass(frozen=True)
class Fault:
    """One finding of one sample. `code` is one of `KINDS`; `joint` is an index, -1 if the fault belongs to no joint."""

    code: FaultCode
    joint: int
    value: float
    limit: float
    action: Action

    def text(self, joint_names: Sequence[str] = ()) -> str:
        """Code, joint, value, limit and remedy in one line."""
        kind = KINDS[self.code]
        where = "" if self.joint < 0 else f"joint_{self.joint + 1}"
        if 0 <= self.joint < len(joint_names):
            where = joint_names[self.joint]
        unit = f" {kind.unit}" if kind.unit else ""
        seen = f"{kind.quantity} {self.value:.6g}{unit} {kind.relation} {self.limit:.6g}{unit}"
        if self.code is FaultCode.NOT_FINITE:
            seen = f"{kind.quantity} {self.value:g} is not a finite number"
        after = "; then call reset" if self.action >= Action.CONTROLLED_STOP else ""
        return self.code.line(f"{seen}. {kind.remedy}{after}.", where)


def strongest(faults: Sequence[Fault]) -> Action:
    """The action that a list of faults demands; REFUSE, the weakest, for an empty list."""
    return max((fault.action for fault in faults), default=Action.REFUSE)
