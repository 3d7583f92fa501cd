"""Kill a node, press Ctrl-C, give nonsense: what stops, what lives on, which exit codes."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import time
from pathlib import Path

import pytest
from node_runs import MortalSession, random_domain

from hd_control.record.black_box_files import black_boxes
from hd_control.record.reader import BagReader
from hd_control.session.session import MODULES, RunPlan, child_environment

pytestmark = pytest.mark.process
ROOT = Path(__file__).resolve().parents[2]


def hear_ctrl_c() -> None:
    """In the child: a suite that a script starts in the background inherits a Ctrl-C that is ignored."""
    signal.signal(signal.SIGINT, signal.SIG_DFL)


def test_f18_killed_torque_node_stops_the_plant_in_ten_ticks_and_latches(tmp_path: Path) -> None:
    """In a namespace, so that relative names are tested as well."""
    folder = {"black_box_folder": str(tmp_path / "boxes")}
    values = {"plant_node": {"lockstep_timeout": 0.5, "pause_at_tick": 300} | folder, "torque_node": folder}
    plan = RunPlan(lockstep=True, namespace="arm", parameters=values)
    with MortalSession(plan, random_domain(), tmp_path) as session:
        session.activate()
        session.wait_until_tick(300)
        session.kill("torque_node")
        session.run_to(350)
        session.wait_for(lambda: session.diagnostics("plant_node").get("gate_stopped") == "True", 10.0, "no stop")
        found = session.diagnostics("plant_node")
        # Tick 299 had the last command, so it acts in tick 300; ages count from there.
        assert 300 < int(found["gate_stop_tick"]) <= 300 + 10
        assert "node_killed" in found["message"] and found["level"] == "2"
        assert session.set_parameters("plant_node", {"pause_at_tick": 400}) == ""
        assert "inputs healthy for 0 samples" in session.reset("plant_node")
        session.wait_until_tick(400)
        session.wait_for(lambda: session.diagnostics("plant_node").get("tick") == "400", 10.0, "the plant stands")
        assert session.diagnostics("plant_node")["gate_stopped"] == "True"
        for change in ("deactivate", "activate"):
            session.client.transition(["/arm/plant_node"], change, 30.0)
        assert session.fresh_diagnostics("plant_node")["gate_stopped"] == "True", "a new activation is no reset"
        assert all(session.alive(node) for node in ("plant_node", "fusion_node", "motion_node"))
    codes = session.exit_codes
    assert codes.pop("torque_node") == -signal.SIGKILL
    assert set(codes.values()) == {0}, codes
    [box] = black_boxes(tmp_path / "boxes" / "arm" / "plant_node")
    assert box.name == "000001_HD-F18"
    bag = BagReader(box)
    ticks = bag.columns("encoder").stamps_ns // 1_000_000
    assert bag.complete and ticks[0] == 0 and ticks[-1] == 399 and len(ticks) == 400
    assert bag.metadata["hd_session"]["stop_tick"] == found["gate_stop_tick"]


def test_ctrl_c_leaves_no_process(tmp_path: Path) -> None:
    script = (
        "import sys, time\n"
        "from pathlib import Path\n"
        "from hd_control.session.session import RunPlan\n"
        "from hd_control.session.session import Session\n"
        f"with Session(RunPlan(lockstep=True), {random_domain()}, Path({str(tmp_path)!r})) as session:\n"
        "    session.activate()\n"
        "    print(*(session._children.processes[process.node].pid for process in session.processes), flush=True)\n"
        "    time.sleep(60)\n"
    )
    process = subprocess.Popen(
        [sys.executable, "-c", script],
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
        env=child_environment(),
        cwd=ROOT,
        preexec_fn=hear_ctrl_c,
    )
    assert process.stdout is not None
    pids = [int(text) for text in process.stdout.readline().split()]
    assert len(pids) == 4 and all(Path(f"/proc/{pid}").exists() for pid in pids)
    process.send_signal(signal.SIGINT)
    process.wait(20.0)
    assert not any(Path(f"/proc/{pid}").exists() for pid in pids)


@pytest.mark.parametrize(
    ("node", "arguments", "words"),
    [
        ("torque_node", ["-p", "gain:=1.0"], ["gain: unknown parameter", "torque_node"]),
        ("fusion_node", ["-p", "robot:=nowhere"], ["nowhere"]),
        ("plant_node", ["-p", "period:=0.002"], ["period: 0.002 s", "0.001 s"]),
        ("motion_node", ["--params-file", "/no/such/file.yaml"], ["/no/such/file.yaml"]),
    ],
)
def test_bad_configuration_is_one_line_and_exit_code_2(node: str, arguments: list[str], words: list[str]) -> None:
    done = subprocess.run(
        [sys.executable, "-m", MODULES[node], "--ros-args", *arguments],
        capture_output=True,
        text=True,
        timeout=30.0,
        env=child_environment(random_domain(), False),
        check=False,
    )
    lines = [line for line in done.stderr.splitlines() if line.startswith("error:")]
    assert done.returncode == 2 and len(lines) == 1 and "Traceback" not in done.stderr, done.stderr
    assert all(word in lines[0] for word in words), lines[0]


def test_a_node_stops_on_sigterm_with_code_0() -> None:
    process = subprocess.Popen(
        [sys.executable, "-m", MODULES["fusion_node"], "--ros-args", "-p", "autostart:=true"],
        env=child_environment(random_domain(), False),
        stderr=subprocess.PIPE,
        text=True,
    )
    assert process.stderr is not None
    line = process.stderr.readline()
    assert "run " in line, line
    time.sleep(0.5)
    os.kill(process.pid, signal.SIGTERM)
    assert process.wait(10.0) == 0
