"""The two papers' laws as laws of the torque node, in the whole chain with fusion, motion law, gate and plant."""

import numpy as np
import pytest

from hd_control.core.errors import ConfigError
from hd_control.laws import torque
from hd_sim.plant_config import PlantConfig
from hd_sim.runner import Runner, RunSetup
from hd_sim.scenario import find_scenario, make_plan

KINEMATIC = {"kinematic_cosine_4": 4.89736e-5, "kinematic_sine_2": 2.909e-4, "kinematic_sine_4": 3.14456e-5}
MANIFOLD = {
    "law": "integral_manifold", "load_sine": -10.0, "rotor_coulomb": 3.0, "tracking_damping": 100.0, **KINEMATIC,
}  # fmt: skip


def values(**changes):
    """Overrides of the torque node; a number holds for every joint."""
    return {"torque_node": {k: [v] * 7 if isinstance(v, float) else v for k, v in changes.items()}}


def follow(scenario, plant, node_values, ticks=None):
    """Largest true joint error in the scenario's window rad, the runner, and every output block's torque command."""
    runner = Runner(RunSetup(PlantConfig.from_file(plant), 0, node_values))
    start, limit = runner.world.seam.plant.config.start_position, runner.goal_limits.velocity
    plan = make_plan(find_scenario(scenario), runner.robot.joint_names, start, limit, runner.period)
    goals, errors, commands = dict(plan.goals), [], []
    for tick in range(ticks or plan.ticks):
        if tick in goals:
            runner.offer(goals[tick])
        true = runner.world.seam.plant.true_joint_position.copy()
        bus = runner.step()
        errors.append(bus["joint_reference"]["position"] - true)
        commands.append(bus["motor_torque_command"]["effort"].copy())
    window = slice(round(plan.window[0] * 1e3), round(plan.window[1] * 1e3))
    return np.abs(np.array(errors)[window]).max(axis=0, initial=0.0), runner, np.array(commands)


@pytest.mark.parametrize(("joint", "most"), [(3, 6e-4), (5, 9e-4), (7, 1.4e-3)])
def test_torque_feedback_carries_a_joint(joint, most):
    error, runner, commands = follow(
        f"sine_joint_{joint}_0p5hz", f"single_joint_{joint}", values(law="torque_feedback")
    )
    assert runner.torque.params.layout.name == "FeedbackParams"
    assert error[0] < most
    assert not runner.world.seam.stopped and not runner.torque.guard.stopped
    direct, *_ = follow(f"sine_joint_{joint}_0p5hz", f"single_joint_{joint}", values(law="direct"))
    assert error[0] < direct[0]
    assert np.isfinite(commands).all()


def test_torque_feedback_carries_the_whole_arm():
    error, runner, _ = follow("coordinated", "arm_a", values(law="torque_feedback"))
    assert error.max() < 4e-3
    assert not runner.world.seam.stopped and runner.world.seam.late == 0


def test_integral_manifold_follows_with_known_load_and_beats_the_plain_law():
    """Gravity is the known smooth load; real sensors, Coulomb friction fed forward, one sample of delay."""
    error, runner, _ = follow("sine_joint_5_0p5hz", "single_joint_5", values(**MANIFOLD))
    plain, *_ = follow("sine_joint_5_0p5hz", "single_joint_5", values(**MANIFOLD, composition="comparison"))
    assert runner.torque.params.layout.name == "ManifoldParams"
    assert error[0] < 1.3e-3
    assert error[0] < 0.6 * plain[0]
    assert not runner.world.seam.stopped


@pytest.mark.parametrize("law", ["torque_feedback", "integral_manifold"])
def test_a_run_repeats_bit_for_bit(law):
    first, again = (follow("sine_joint_5_0p5hz", "single_joint_5", values(law=law), 1200)[2] for _ in range(2))
    np.testing.assert_array_equal(first, again)


@pytest.mark.parametrize("law", ["torque_feedback", "integral_manifold"])
def test_the_gate_behind_the_law_stops_on_what_is_not_finite(law):
    _, runner, _ = follow("sine_joint_5_0p5hz", "single_joint_5", values(law=law), 500)
    stage = runner.torque
    stage.sample.joint_torque = stage.sample.joint_position = np.nan
    stage.reference.joint_torque_required = np.nan
    stage.act(500)
    assert stage.guard.stopped
    assert np.isfinite(stage.outgoing).all()


def test_another_law_in_a_new_activation_starts_anew_and_the_same_law_goes_on():
    _, runner, _ = follow("sine_joint_5_0p5hz", "single_joint_5", values(law="torque_feedback"), 500)
    stage, setup = runner.torque, RunSetup(PlantConfig.from_file("single_joint_5"), 0, values())
    assert stage.state.layout.name == "FeedbackState"
    stage.start()
    assert stage.state.started.item() == 0.0  # kept, but its filters fill again
    stage.adopt(stage.prepare(setup.node_values("torque_node")))
    stage.start()
    assert stage.state is None
    for _ in range(300):
        runner.step()
    assert stage.state.layout.name == "TorqueState"
    assert "coulomb_torque" in stage.report()[2]


@pytest.mark.parametrize("law", ["torque_feedback", "integral_manifold"])
def test_one_joint_alone_computes_the_same_as_among_seven(law):
    node = RunSetup(PlantConfig.from_file("arm_a"), 0, values(law=law)).node_values("torque_node")
    rng, found = np.random.default_rng(1), {}
    numbers = rng.uniform(-0.1, 0.1, (6, 7)), rng.uniform(-0.1, 0.1, (3, 7))
    for names in (node["joint_names"], ["joint_4"]):
        params = torque.configure({**node, "joints": list(names)}, None, 1e-3)
        rows = [node["joint_names"].index(name) for name in names]
        sample, reference = torque.new_sample(len(names)), torque.new_reference(len(names))
        sample.array[:], reference.array[:] = numbers[0][:, rows].ravel(), numbers[1][:, rows].ravel()
        state = torque.initial_state(params)
        for _ in range(5):
            output, state = torque.step(params, state, sample, reference, 1e-3)
        found[len(names)] = output.motor_torque[rows.index(3)]
    assert found[1] == found[7]


def test_wrong_values_of_a_law_name_the_joint():
    node = RunSetup(PlantConfig.from_file("arm_a"), 0, values(law="integral_manifold")).node_values("torque_node")
    node["link_inertia"][3] = 0.0
    with pytest.raises(ConfigError, match="joint_4: the integral-manifold law needs link_inertia above 0"):
        torque.configure(node, None, 1e-3)
