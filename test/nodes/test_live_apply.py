"""hd apply --live: a model into running nodes, and into the chain that holds them all."""

import pytest
from node_runs import PAUSE, random_domain

from hd_control.cli.main import main
from hd_control.drive.model import JointModel, Model, ModelValue
from hd_control.drive.model_yaml import save_model
from hd_control.nodes.run_plan import RunPlan
from hd_control.nodes.session import Session

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
        session.wait_for(lambda: "coulomb_torque" in session.diagnostics(node), 10.0, "no diagnostics")
        before = session.diagnostics(node)
        session.wait_for(lambda: session.diagnostics(node) != before, 10.0, "no new diagnostics")
        said = session.diagnostics(node)
        assert said["gate_stopped"] == "False"
        assert float(said["coulomb_torque"].split()[2]) == 18.0
    assert set(session.exit_codes.values()) == {0}, session.exit_codes


def test_without_nodes_it_says_how_to_start_them(tmp_path, capsys):
    assert main(["apply", "--model", "arm_a", "--live", "--domain", str(random_domain())]) == 2
    assert "start them with hd up" in capsys.readouterr().err
