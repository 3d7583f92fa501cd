"""Faults: named values with code, joint, number and limit. The hot loop keeps numbers; text is made outside of it.

HD-F18 node_killed joint_3: input age 10 samples >= 10 samples. Check that the sending node lives; then call reset.
"""

from __future__ import annotations

import enum
from collections.abc import Sequence
from dataclasses import dataclass
from functools import lru_cache

from hd_control.core.resources import config_path
from hd_control.core.strict_yaml import load_yaml


class Action(enum.IntEnum):
    """Reactions, weakest first. Several faults at once: the strongest wins, and none replaces a stronger one."""

    REFUSE = 0
    REPORT = 1
    DEGRADE = 2
    CONTROLLED_STOP = 3
    TORQUE_RAMP = 4


class FaultCode(enum.IntEnum):
    """Numbers of the fault table; the text form is HD-F01 and so on."""

    FRAME_LOST = 1
    STAMP_STUCK = 2
    VALUE_FROZEN = 3
    NOT_FINITE = 4
    SPIKE = 5
    WRAP = 6
    POSITION_DISAGREE = 7
    GAUGE_RAIL = 8
    GAUGE_BRANCH = 9
    GAUGE_DRIFT = 10
    BUS_OFF = 11
    SEND_FULL = 12
    FRAME_BAD = 13
    FOREIGN_ID = 14
    CLOCK_JUMP = 15
    SIM_CLOCK = 16
    OVERRUN = 17
    NODE_KILLED = 18
    NODE_BACK = 19
    PARAM_BAD = 20
    PARAM_MOVING = 21
    GOAL_BAD = 22
    GOAL_SILENT = 23
    TWO_PUBLISHERS = 24
    MODEL_MISMATCH = 25
    YAML_BAD = 26
    BAG_DAMAGED = 27
    BAG_FOREIGN = 28
    BAG_HUGE = 29
    DISK_FULL = 30
    RECORDER_SLOW = 31
    WEB_HOSTILE = 32
    EXCEPTION = 33
    ADAPTATION = 34
    CONTACT = 35
    OVERFLOW = 36
    TORQUE_LIMITED = 37
    RATE_LIMITED = 38
    RATE_PERSISTENT = 39
    ENVELOPE = 40
    LET_GO = 41
    STOP_LEFT = 42
    OVERSPEED = 43

    @property
    def text(self) -> str:
        """Code and name as people read them, `HD-F07 position_disagree`."""
        return f"HD-F{self.value:02d} {self.name.lower()}"


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
    FaultCode.WRAP: FaultKind("unwrapped step", "outside +-", "rad", "Check encoder_period and resolver_period"),
    FaultCode.POSITION_DISAGREE: FaultKind(
        "motor - joint position", "outside +-", "rad", "Check joint-sensor coupling and offsets"
    ),
    FaultCode.GAUGE_RAIL: FaultKind(
        "gauge reading", "outside +-", "N m", "Check the load, the bridge and its amplifier"
    ),
    FaultCode.GAUGE_BRANCH: FaultKind(
        "bridge branch open? 2 beta amplitude", ">", "N m", "Check the wires of the strain-gauge bridge"
    ),
    FaultCode.GAUGE_DRIFT: FaultKind(
        "mean residual of the three sensors", "outside +-", "N m", "Calibrate the gauge again at a known load"
    ),
    FaultCode.BUS_OFF: FaultKind(
        "error counter", ">=", "", "Check bus wiring and termination, then restart the bridge by hand"
    ),
    FaultCode.SEND_FULL: FaultKind(
        "commands dropped in a row", ">=", "", "Check that the bus is powered and not overloaded"
    ),
    FaultCode.FRAME_BAD: FaultKind("bad frames in a row", ">=", "", "Check wiring, ids and counters on the bus"),
    FaultCode.FOREIGN_ID: FaultKind("counter of the frame", "!=", "", "Remove the second sender of this id"),
    FaultCode.CLOCK_JUMP: FaultKind(
        "jump of the system clock",
        "outside +-",
        "s",
        "Nothing to do: control does not use that clock; mind the stamps of other programs",
    ),
    FaultCode.SIM_CLOCK: FaultKind("tick", "<=", "", "Start the simulated clock again; outputs hold meanwhile"),
    FaultCode.OVERRUN: FaultKind("late ticks in a row", ">=", "samples", "Lower the load of this computer"),
    FaultCode.NODE_KILLED: FaultKind("input age", ">=", "samples", "Check that the sending node lives"),
    FaultCode.NODE_BACK: FaultKind("run ids seen", ">", "", "Check why the sending node restarted"),
    FaultCode.PARAM_BAD: FaultKind("value", "against", "", "Use a value that the rule in the text allows"),
    FaultCode.PARAM_MOVING: FaultKind("active", "!=", "", "Deactivate the node first: this parameter needs INACTIVE"),
    FaultCode.GOAL_BAD: FaultKind("value", "against", "", "Change the goal as the text says"),
    FaultCode.GOAL_SILENT: FaultKind("goal age", ">=", "samples", "Check the sender of the goals"),
    FaultCode.TWO_PUBLISHERS: FaultKind("publishers", ">", "", "Stop the second source of commands"),
    FaultCode.MODEL_MISMATCH: FaultKind("differences", ">", "", "Make robot description and parameters agree"),
    FaultCode.YAML_BAD: FaultKind("line", "against", "", "Repair the named line and key"),
    FaultCode.BAG_DAMAGED: FaultKind("records kept", "<", "", "Run hd recover; the original stays as it is"),
    FaultCode.BAG_FOREIGN: FaultKind("topics skipped", ">", "", "Map the topics, see docs/signals.md"),
    FaultCode.BAG_HUGE: FaultKind("size", ">", "bytes", "Read a part of the bag"),
    FaultCode.DISK_FULL: FaultKind("bytes left", "<", "bytes", "Free space, then start the recorder again"),
    FaultCode.RECORDER_SLOW: FaultKind("messages dropped", ">", "", "Record fewer topics or use a faster disk"),
    FaultCode.WEB_HOSTILE: FaultKind(
        "requests refused", ">", "", "Close other pages; start the workbench again for a new token"
    ),
    FaultCode.EXCEPTION: FaultKind("exceptions", ">", "", "Report the recorded traceback"),
    FaultCode.ADAPTATION: FaultKind(
        "tracking error over the one at the bound", ">", "", "Check the bounds and the model of the joint"
    ),
    FaultCode.CONTACT: FaultKind("disturbing torque", "outside +-", "N m", "Look what the arm has touched"),
    FaultCode.OVERFLOW: FaultKind("tick", ">", "", "Activate the node again"),
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
    FaultCode.OVERSPEED: FaultKind("joint velocity", "outside +-", "rad/s", "Look at the command and at the sensors"),
    FaultCode.STOP_LEFT: FaultKind(
        "velocity in a controlled stop", "outside +-", "rad/s", "Look for a load or a sensor that does not fit"
    ),
}


@dataclass(frozen=True)
class Fault:
    """One finding of one sample. `joint` is an index, -1 if the fault belongs to no joint."""

    code: FaultCode
    joint: int
    value: float
    limit: float
    action: Action

    def text(self, joint_names: Sequence[str] = ()) -> str:
        """Code, joint, value, limit and remedy in one line."""
        kind = KINDS[self.code]
        where = "" if self.joint < 0 else f" joint_{self.joint + 1}"
        if 0 <= self.joint < len(joint_names):
            where = f" {joint_names[self.joint]}"
        unit = f" {kind.unit}" if kind.unit else ""
        seen = f"{kind.quantity} {self.value:.6g}{unit} {kind.relation} {self.limit:.6g}{unit}"
        if self.code is FaultCode.NOT_FINITE:
            seen = f"{kind.quantity} {self.value:g} is not a finite number"
        after = "; then call reset" if self.action >= Action.CONTROLLED_STOP else ""
        return f"{self.code.text}{where}: {seen}. {kind.remedy}{after}."


def strongest(faults: Sequence[Fault]) -> Action:
    """The action that a list of faults demands; REFUSE, the weakest, for an empty list."""
    return max((fault.action for fault in faults), default=Action.REFUSE)


# ----------------------------------------------------------------------------------------------------
# What is known of every fault besides its numbers: how it is found, what happens, where it is tested.
#
# The entries are in config/fault_pages.yaml; docs/faults.md is made of them.
#
# State: `built` works in this version, `elsewhere` names the part that answers for it, `open` is not built yet.


@dataclass(frozen=True)
class FaultPage:
    """One entry of the manual. `samples`: from the onset until the action starts, at most."""

    meaning: str
    found_by: str
    samples: str
    action: str
    state: str
    test: str


@lru_cache
def pages() -> dict[FaultCode, FaultPage]:
    """The entry of every fault. Raises ConfigError for a malformed file, KeyError for a fault without an entry."""
    found = load_yaml(config_path("fault_pages.yaml"))
    return {code: FaultPage(**found[code.name.lower()]) for code in FaultCode}


def manual() -> str:
    """docs/faults.md: one section per fault, from this table and the texts of `faults.py`."""
    lines = [
        "# Faults",
        "",
        "Made from `config/fault_pages.yaml` by `python -m hd_control.core.faults > docs/faults.md`. Every",
        "fault has a code, an action, a text with value, limit and remedy, and a test. What is not built yet says so.",
        "Actions and goals: docs/safety.md. This is not a certified safety function.",
    ]
    for code, page in pages().items():
        kind = KINDS[code]
        unit = f", {kind.unit}" if kind.unit else ""
        lines += ["", f"## {code.text}", "", f"{page.meaning[0].upper()}{page.meaning[1:]}.", ""]
        lines += [f"- found by: {page.found_by}", f"- compared: {kind.quantity} {kind.relation} limit{unit}"]
        lines += [f"- samples until the action: {page.samples}", f"- action: {page.action}"]
        lines += [f"- what to do: {kind.remedy}", f"- state: {page.state}", f"- test: {page.test}"]
    return "\n".join(lines) + "\n"


if __name__ == "__main__":
    print(manual(), end="")
