"""hd apply --live: a model into running nodes, and into the chain that holds them all."""

import json
import threading
from contextlib import contextmanager
from dataclasses import replace

import numpy as np
import pytest
from node_runs import PAUSE, random_domain

from hd_control.cli.main import main
from hd_control.drive.model import JointModel, Model, ModelValue
from hd_control.drive.model_file import save_model
from hd_control.laws.trajectory import sine_goal
from hd_control.session.session import RunPlan, Session
from hd_sim.plant_config import PlantConfig
from hd_sim.truth import HiddenEffect, apply_hidden, nominal

pytestmark = pytest.mark.process


def fitted(value):
    return ModelValue(value, source="fitted", interval=tuple(sorted((0.9 * value, 1.1 * value))))


@pytest.mark.parametrize("nodes", [("torque_node", "motion_node", "fusion_node", "plant_node"), ("chain",)])
def test_a_model_ramps_into_running_nodes(nodes, tmp_path, capsys):
    effects = {
        "kinematic_error": {"sine_2": fitted(2e-4)},
        "coulomb_friction": {"coulomb_torque": fitted(20.0)},
        "gauge_offset": {"gauge_offset": fitted(0.5)},
        "gauge_ripple": {"cosine_2": fitted(0.2), "joint_turn": ModelValue(1.0)},
    }
    model, plant = tmp_path / "better.yaml", "chain" if nodes == ("chain",) else "plant_node"
    save_model(Model(None, {"joint_3": JointModel(120.0, effects=effects)}), model)
    prefix = "torque." if nodes == ("chain",) else ""
    given = {plant: {"pause_at_tick": PAUSE}}
    given.setdefault(nodes[0], {})[f"{prefix}adapt_friction"] = False
    domain, plan = random_domain(), RunPlan(nodes=nodes, lockstep=True, parameters=given)
    with Session(plan, domain, tmp_path / "logs") as session:
        session.activate()
        session.wait_until_tick(PAUSE)
        assert main(["apply", "--model", str(model), "--live", "--domain", str(domain)]) == 0
        text = capsys.readouterr().out
        assert (
            "the model ramps in over 0.5 s" in text
            and "joint_3 gauge_ripple was left: gauge_joint_turns needs INACTIVE" in text
        )
        session.run_to(PAUSE + 1200)
        node = nodes[0]
        fusion, head = ("chain", "fusion.") if nodes == ("chain",) else ("fusion_node", "")
        gauge = session.get_parameters(fusion, [f"{head}gauge_offset", f"{head}gauge_cosine_2"])
        assert [value[2] for value in gauge.values()] == [0.5, 0.0]
        names = [f"{prefix}{name}" for name in ("kinematic_sine_2", "coulomb_torque_initial", "kinematic_feedforward")]
        found = session.get_parameters(node, names)
        assert found[names[0]][2] == 2e-4 and found[names[1]][2] == 18.0 and found[names[2]] is True
        said = session.fresh_diagnostics(node)
        assert said["gate_stopped"] == "False"
        assert float(said["coulomb_torque"].split()[2]) == 18.0
    assert set(session.exit_codes.values()) == {0}, session.exit_codes


def test_without_nodes_it_says_how_to_start_them(tmp_path, capsys):
    assert main(["apply", "--model", "arm_a", "--live", "--domain", str(random_domain())]) == 2
    assert "start them with hd up" in capsys.readouterr().err


@contextmanager
def paced(session):
    """Lets lock-step go on by at most 150 ticks in 50 ms: at its own speed the goal would end meanwhile."""
    ending = threading.Event()

    def pace():
        while not ending.wait(0.05):
            session.set_parameters("chain", {"pause_at_tick": session.tick() + 150})

    thread = threading.Thread(target=pace)
    thread.start()
    try:
        yield
    finally:
        ending.set()
        thread.join(30.0)


def test_a_change_that_makes_it_worse_is_taken_back(tmp_path, capsys):
    """The same sine, a hidden kinematic error; the wrong sign is withdrawn, the right one stays."""
    hidden = apply_hidden(
        nominal(PlantConfig.from_file("single_joint_3")), [HiddenEffect("joint_3", "kinematic_error", 6.0)], 3
    )
    waves = {f"{kind}_{n}": float(hidden.drives[f"kinematic_{kind}"][0][n - 1])
             for kind in ("cosine", "sine") for n in (2, 4)}  # fmt: skip
    plant = {"pause_at_tick": PAUSE, "nominal": True, "hide": ["joint_3:kinematic_error:6.0"], "seed": 3}
    plan = RunPlan(nodes=("chain",), plant="single_joint_3", lockstep=True, parameters={"chain": plant})
    domain, said = random_domain(), tmp_path / "said.json"

    def apply(sign):
        values = {"kinematic_error": {key: fitted(sign * value) for key, value in waves.items()}}
        save_model(Model(None, {"joint_3": JointModel(120.0, effects=values)}), tmp_path / "m.yaml", force=True)
        words = ["apply", "--model", str(tmp_path / "m.yaml"), "--live", "--watch", "4", "--domain", str(domain)]
        return main([*words, "--json", str(said), "--force"]), json.loads(said.read_text())["tracking"]["ratio"]

    with Session(plan, domain, tmp_path / "logs") as session:
        session.activate()
        session.wait_until_tick(PAUSE)
        goal = sine_goal(("joint_3",), hidden.start_position, 0.1, 0.5, 100)
        session.send_goal(replace(goal, start_tick=PAUSE + 100, times=np.round(goal.times, 9)))
        with paced(session):
            session.wait_until_tick(7000, 120.0)
            code, ratio = apply(-1.0)
            assert code == 1 and ratio > 1.05 and "withdrawn" in capsys.readouterr().out
            assert session.get_parameters("chain", ["torque.kinematic_feedforward"]) == {
                "torque.kinematic_feedforward": False
            }
            code, ratio = apply(1.0)
            assert code == 0 and ratio < 0.7
            assert session.get_parameters("chain", ["torque.kinematic_feedforward"]) == {
                "torque.kinematic_feedforward": True
            }
    assert set(session.exit_codes.values()) == {0}, session.exit_codes
