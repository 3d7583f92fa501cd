"""The node of docs/tutorials/your_drives.md, as printed there, against the real control chain in lock-step."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

import pytest
from command_blocks import ROOT, Written, steps

from hd_control.session.session import RunPlan, Session, child_environment

TICKS = 150
PAGE = ROOT / "docs" / "tutorials" / "your_drives.md"


@pytest.mark.process
def test_every_tick_of_the_example_is_answered(tmp_path: Path) -> None:
    (node,) = (step for step in steps(PAGE) if isinstance(step, Written))
    script = tmp_path / node.name
    script.write_text(node.text)
    domain = 1 + hash(tmp_path.name) % 100
    plan = RunPlan(nodes=("torque_node", "motion_node", "fusion_node"), lockstep=True)
    with Session(plan, domain, tmp_path / "logs") as session:
        session.activate()
        done = subprocess.run(
            [sys.executable, str(script), "--lockstep", "--ticks", str(TICKS)],
            env=child_environment(domain),
            capture_output=True,
            text=True,
            timeout=60.0,
        )
    assert done.returncode == 0, done.stderr
    assert f"{TICKS} ticks, {TICKS} answered in time" in done.stdout
