"""hd replay --live: recorded sensors into running nodes, tick by tick and on the clock."""

import json
from pathlib import Path

import pytest
from node_runs import random_domain, record

from hd_control.cli.main import main
from hd_control.session.session import RunPlan, Session

GOLDEN = Path(__file__).resolve().parents[2] / "bags" / "golden" / "adaptive_arm"
pytestmark = pytest.mark.process


def test_every_tick_is_answered_when_stepped(tmp_path):
    domain, plan = random_domain(), RunPlan(nodes=("torque_node", "motion_node", "fusion_node"), lockstep=True)
    with Session(plan, domain, tmp_path / "logs") as session:
        session.activate()
        said = tmp_path / "said.json"
        words = ["replay", str(GOLDEN), "--live", "--stepped", "--domain", str(domain), "--json", str(said)]
        assert main(words) == 0
        assert json.loads(said.read_text())["answered"] == 180
    assert set(session.exit_codes.values()) == {0}, session.exit_codes


def test_a_recording_of_the_nodes_comes_back_bit_for_bit(tmp_path):
    """Four processes in lock-step with a goal; recorder, reader and replay without ROS."""
    said = tmp_path / "said.json"
    assert main(["replay", str(record(tmp_path)), "--json", str(said)]) == 0
    answer = json.loads(said.read_text())
    assert answer["identical"] and answer["ticks"] >= 399 and len(answer["outputs"]) == 10
    assert max(one["largest"] for one in answer["outputs"]) == 0.0
