"""`docs/faults.md`: one section per fault, with the line that people read when it is raised.

Faults that compare no numbers are lines of words: each example goes through the function that finds the fault in a run.
"""

from __future__ import annotations

import errno
import os
import struct
import tempfile
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np

from hd_control.chain import black_box
from hd_control.chain.chain import shipped_values
from hd_control.core.errors import HdError
from hd_control.core.faults import KINDS, RESERVED, Action, Fault, FaultCode
from hd_control.core.resources import config_path
from hd_control.core.strict_yaml import load_params_file, load_yaml, parse_yaml
from hd_control.laws import torque
from hd_control.laws.goals import check_times
from hd_control.laws.trajectory import Goal
from hd_control.record.bag_folder import write_error
from hd_control.record.cdr import JointStateCodec
from hd_control.record.mcap_write import MAGIC, McapFile
from hd_control.record.reader import BagReader
from hd_control.record.recorder import Recorder
from hd_control.record.writer import BagWriter


@dataclass(frozen=True)
class FaultPage:
    """One entry of `config/fault_pages.yaml`; `samples`: from the onset until the action starts, at most.

    A fault of `KINDS` has `example`, the numbers of a finding; the others have `remedy`.
    """

    meaning: str
    found_by: str
    samples: str
    action: str
    test: str
    remedy: str = ""
    example: Mapping[str, Any] | None = None


@lru_cache
def fault_pages() -> dict[FaultCode, FaultPage]:
    """The entry of every fault. Raises ConfigError for a malformed file, KeyError for a fault without an entry."""
    found = load_yaml(config_path("fault_pages.yaml"))
    return {code: FaultPage(**found[code.name.lower()]) for code in FaultCode}


def fault_page() -> str:
    """The page."""
    lines = [
        "# Faults",
        "",
        "Made from `hd_control/core/faults.py` and `config/fault_pages.yaml` by `python -m hd_control.pages`; a test",
        "fails when it is not current. Every fault has a code, an action, a line and a test; the lines below are",
        "made by the code that makes them in a run. Actions and goals: [safety](safety.md).",
        "This is not a certified safety function.",
        "",
        f"Numbers that no fault has are reserved: {_reserved()}.",
    ]
    for code, page in fault_pages().items():
        remedy = page.remedy or KINDS[code].remedy
        lines += ["", f"## {code.text}", "", f"{page.meaning[0].upper()}{page.meaning[1:]}.", ""]
        lines += ["```text", raised(code), "```", ""]
        lines += [f"- found by: {page.found_by}", f"- samples until the action: {page.samples}"]
        lines += [f"- action: {page.action}", f"- what to do: {remedy[0].lower()}{remedy[1:]}", f"- test: {page.test}"]
    return "\n".join(lines) + "\n"


def _reserved() -> str:
    """`6 (...), 11 to 14 (a CAN bridge), 16 (...)`."""
    groups: dict[str, list[int]] = {}
    for number, meaning in RESERVED.items():
        groups.setdefault(meaning, []).append(number)
    spans = {why: f"{n[0]} to {n[-1]}" if len(n) > 1 else f"{n[0]}" for why, n in groups.items()}
    return ", ".join(f"{span} ({why})" for why, span in spans.items())


def raised(code: FaultCode) -> str:
    """The line of a fault as people read it, made where the fault itself is made."""
    return IN_WORDS[code]() if code in IN_WORDS else with_numbers(code)


def with_numbers(code: FaultCode) -> str:
    """The line of a fault of `KINDS` with the example numbers of its page."""
    given = dict(fault_pages()[code].example or {})
    joint, limit = given["joint"], given["limit"]
    if isinstance(limit, str):
        limit = load_params_file(config_path("limits.yaml"), "limits")[limit]
        limit = limit[joint] if isinstance(limit, list) else limit
    value = float(given["value"]) if "value" in given else given["times"] * limit
    return Fault(code, joint, value, limit, Action[given["action"].upper()]).text()


# ---- Faults in words -------------------------------------------------------------------------------


def _message(call: Callable[[], object]) -> str:
    """The text of the error that a call raises."""
    try:
        call()
    except HdError as error:
        return str(error)
    raise AssertionError("the example of a fault was accepted")


def _param_bad() -> str:
    values = shipped_values("torque_node")
    own = {name: values[name] for name in torque.PARAMETERS.names} | {"derivative_cutoff": -1.0}
    return _message(lambda: torque.PARAMETERS.check(own, len(own["joint_names"])))


def _param_moving() -> str:
    before = {name: shipped_values("torque_node")[name] for name in torque.PARAMETERS.names}
    after = before | {"law": "direct"}
    return torque.PARAMETERS.refusal(before, after, len(before["joint_names"]), active=True)


def _model_mismatch() -> str:
    values = shipped_values("torque_node")
    smaller: Any = SimpleNamespace(joint_names=tuple(values["joint_names"][:6]))
    return _message(lambda: torque.configure(values, smaller, 0.001))


def _goal_bad() -> str:
    goal = Goal(("joint_1",), np.array([0.0, 1.0, 0.5]), np.zeros((3, 1)))
    return _message(lambda: check_times(goal, 0.001))


def _yaml_bad() -> str:
    return _message(lambda: parse_yaml("torque_gain: 1.0\nlaw: direct\ntorque_gain: 2.0\n", "torque_node.yaml"))


def _problem(write: Callable[[Any], object]) -> str:
    """The first thing that a reader says of a recording that `write` makes."""
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder, "arm.mcap")
        with path.open("wb", buffering=0) as raw:
            write(raw)
        return str(BagReader(path).problems[0])


def _bag_damaged() -> str:
    return _problem(lambda raw: raw.write(MAGIC + struct.pack("<BQ", 5, 40) + bytes(17)))


def _foreign_bag(raw: Any) -> None:
    file = McapFile(raw)
    file.add_message(file.add_channel("/pose", file.add_schema("pose", "{}", "jsonschema"), {}, "json"), 0, 0, 0, b"{}")
    file.finish()


def _bag_huge() -> str:
    chunk = struct.pack("<QQQII", 0, 0, 1 << 40, 0, 3) + b"lz4" + struct.pack("<Q", 8) + bytes(8)
    return _problem(lambda raw: raw.write(MAGIC + struct.pack("<BQ", 6, len(chunk)) + chunk))


def _disk_full() -> str:
    return str(write_error(Path("bags/arm/arm_0.mcap"), OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))))


def _recorder_slow() -> str:
    codec = JointStateCodec(("joint_1",), position=True)
    with tempfile.TemporaryDirectory() as folder:
        recorder = Recorder(BagWriter(Path(folder, "arm")), queue_depth=20)
        recorder.add_topic("encoder")
        for tick in range(32):
            recorder.offer("encoder", tick, codec.encode(tick * 1_000_000, "0" * 16, position=[0.0]))
        recorder.close()
        return recorder.losses()


def _exception() -> str:
    return black_box.words(ValueError("gain is not a number"), ())[1].splitlines()[0]


IN_WORDS: dict[FaultCode, Callable[[], str]] = {
    FaultCode.PARAM_BAD: _param_bad,
    FaultCode.PARAM_MOVING: _param_moving,
    FaultCode.GOAL_BAD: _goal_bad,
    FaultCode.MODEL_MISMATCH: _model_mismatch,
    FaultCode.YAML_BAD: _yaml_bad,
    FaultCode.BAG_DAMAGED: _bag_damaged,
    FaultCode.BAG_FOREIGN: lambda: _problem(_foreign_bag),
    FaultCode.BAG_HUGE: _bag_huge,
    FaultCode.DISK_FULL: _disk_full,
    FaultCode.RECORDER_SLOW: _recorder_slow,
    FaultCode.EXCEPTION: _exception,
}
"""An example of each fault that is none of `KINDS`."""
