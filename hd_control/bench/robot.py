"""The real nodes on the wall clock, idle or beside busy programs, and how often the machine itself oversleeps.

    live_run("four", 10.0)                -> LiveResult: four processes and a recorder, seven joints, real laws, 1 kHz
    live_run("four", 10.0, loaded=True)   -> the same while ordinary programs keep every processor busy

Beside each run a bare loop, which only sleeps, counts the milliseconds that the machine takes from everybody.
Its share stands beside the figure and is never subtracted.
"""

from __future__ import annotations

import contextlib
import json
import secrets
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from hd_control.bench.measure import keep_busy
from hd_control.core.errors import HdError
from hd_control.core.resources import config_path
from hd_control.nodes.process import request_real_time
from hd_control.session.session import Children, RunPlan, Session, child_environment, log_folder

JOINTS = tuple(f"joint_{number}" for number in range(1, 8))
PERIOD_NS = 1_000_000
FAST_PERIOD, FAST_SUBSTEPS = 0.00025, 8


@dataclass(frozen=True)
class LiveResult:
    """From a sample to its command, us; ticks whose command came late or that were slept through, %; milliseconds at
    which a bare loop beside the run woke more than a millisecond late, %; did the safety gate stop the robot?"""

    p50: float
    p99: float
    late: float
    bare_late: float
    stopped: bool


def _four(folder: Path) -> RunPlan:
    return RunPlan(bag=folder / "bag")


def _per_joint(folder: Path) -> RunPlan:
    return RunPlan(bag=folder / "bag", joint_groups=tuple((name,) for name in JOINTS))


def _one(folder: Path) -> RunPlan:
    return RunPlan(nodes=("chain",))


def _one_fast(folder: Path) -> RunPlan:
    text = Path(config_path("plant/arm_a.yaml")).read_text(encoding="utf-8")
    text = text.replace("period: 0.001", f"period: {FAST_PERIOD}").replace(
        "substeps_per_ms: 5", f"substeps_per_ms: {FAST_SUBSTEPS}"
    )
    plant = folder / "arm_4khz.yaml"
    plant.write_text(text, encoding="utf-8")
    own = {"period": FAST_PERIOD, "limits": "limits_4khz.yaml"}
    return RunPlan(nodes=("chain",), plant=str(plant), robot="arm_a", parameters={"chain": own})


FORMS: dict[str, Callable[[Path], RunPlan]] = {
    "four": _four,
    "per_joint": _per_joint,
    "one": _one,
    "one_4khz": _one_fast,
}
"""Name of a row -> its processes, with files in a folder: four nodes and a recorder; a torque node for each joint and a
recorder; chain and plant in one process at 1 and at 4 kHz."""


def live_run(form: str, seconds: float, loaded: bool = False) -> LiveResult:
    """One run of `seconds` after the drives are armed. Raises HdError if the nodes fail or the drives never obey."""
    with contextlib.ExitStack() as stack:
        folder = Path(stack.enter_context(tempfile.TemporaryDirectory(prefix="hd_bench_")))
        children = stack.enter_context(Children(child_environment()))
        session = stack.enter_context(Session(FORMS[form](folder), 1 + secrets.randbelow(100), log_folder()))
        session.activate()
        session.wait_until_armed()
        if loaded:
            keep_busy(children)
        first = session.fresh_diagnostics(session.plant_node)
        bare = children.start(
            "bare", [sys.executable, "-m", "hd_control.bench.robot", str(seconds)], stdout=subprocess.PIPE
        )
        time.sleep(seconds)
        last = session.fresh_diagnostics(session.plant_node)
        text, _ = bare.communicate(timeout=seconds + 60.0)
    if bare.returncode != 0:
        raise HdError(f"the bare loop failed with exit code {bare.returncode}")
    ticks, late, skipped = (int(last[name]) - int(first[name]) for name in ("ticks", "late", "skipped"))
    p50, p99 = (float(last.get(name, "nan")) for name in ("answer_p50_us", "answer_p99_us"))
    total = max(1, ticks + skipped)
    return LiveResult(p50, p99, 100.0 * (late + skipped) / total, json.loads(text), last["gate_stopped"] == "True")


def bare_late(seconds: float) -> float:
    """Share of milliseconds at which a thread that only sleeps wakes more than a millisecond late, %."""
    from hd_control import _plane

    request_real_time()
    late = _plane.bare_loop(PERIOD_NS, round(seconds * 1e9 / PERIOD_NS))
    return float(100.0 * np.mean(late > PERIOD_NS))


if __name__ == "__main__":
    print(json.dumps(bare_late(float(sys.argv[1]))), flush=True)
