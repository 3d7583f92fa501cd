"""A torque law in Python in a node: it runs in lock-step, says what it is, and its exception stops the robot."""

from __future__ import annotations

from pathlib import Path

import pytest
from node_runs import random_domain

from hd_control.session.session import RunPlan, Session

LAW = """
from hd_control.laws.plug_ins import PythonLaw

class Law(PythonLaw):
    ticks = 0

    def step(self, sample, reference):
        self.ticks += 1
        if self.ticks > {limit}:
            raise RuntimeError("a bug in a law")
        return reference.joint_torque_required
"""


@pytest.fixture
def installed(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A folder with the package's metadata, on the path of the node processes."""
    info = tmp_path / "my_laws-0.1.dist-info"
    info.mkdir()
    (info / "METADATA").write_text("Metadata-Version: 2.1\nName: my_laws\nVersion: 0.1\n")
    (info / "entry_points.txt").write_text("[hd_control.laws]\nmine = my_law:Law\n")
    monkeypatch.setenv("PYTHONPATH", str(tmp_path), prepend=":")
    return tmp_path


@pytest.mark.parametrize("nodes", [("torque_node", "motion_node", "fusion_node", "plant_node"), ("chain",)])
def test_f33_it_says_that_it_is_not_real_time_and_its_exception_stops_the_robot(
    installed: Path, tmp_path: Path, nodes: tuple[str, ...]
) -> None:
    (installed / "my_law.py").write_text(LAW.format(limit=400))
    one = len(nodes) == 1
    owner, name = ("chain", "torque.plug_in") if one else ("torque_node", "plug_in")
    given = {owner: {name: "mine"}}
    plant = "chain" if one else "plant_node"
    given.setdefault(plant, {})["pause_at_tick"] = 300
    plan = RunPlan(nodes=nodes, plant="single_joint_5", lockstep=True, parameters=given)
    with Session(plan, random_domain(), tmp_path / "logs") as session:
        session.activate()
        session.wait_until_tick(300)
        said = session.fresh_diagnostics(owner)
        assert said["loop"].startswith("not real time") and said["plug_in"].startswith("Law: a law in Python")
        assert said["mode"] == "ACTIVE" and said["gate_stopped"] == "False"
        session.run_to(500)
        said = session.fresh_diagnostics(owner)
        assert said["mode"] in ("STOPPING", "HOLDING", "STOPPED") and "a bug in a law" in said["message"]
    assert set(session.exit_codes.values()) == {0}, session.exit_codes
