"""Values that change while the laws run: no jump; a model takes half a second, gains and bounds a tenth."""

import numpy as np
import pytest

from hd_control.chain.stage import RAMP_TIME
from hd_sim.plant_config import PlantConfig
from hd_sim.runner import Runner, RunSetup
from hd_sim.scenario import find_scenario, make_plan

SCENARIO, CHANGE = "sine_joint_3_0p5hz", 2600
RAMP = round(RAMP_TIME * 1e3)
BETTER = {
    "torque_node": {
        "kinematic_feedforward": True, "kinematic_cosine_4": [4.89736e-5] * 7, "kinematic_sine_2": [2.909e-4] * 7,
        "kinematic_sine_4": [3.14456e-5] * 7, "coulomb_torque_initial": [15.0] * 7, "load_friction_linear": [1e-3] * 7,
        "coulomb_torque_high": [35.0] * 7, "coulomb_torque_low": [-35.0] * 7,
    },
    "fusion_node": {"gauge_offset": [6.0] * 7, "gauge_gain": [1.05] * 7, "gauge_cosine_2": [1.0] * 7},
}  # fmt: skip


def run(change, ticks=CHANGE + 2 * RAMP, look=lambda runner: None, still=False):
    """Commands (ticks,) and estimates of Coulomb friction of a run in which `change(runner)` happens before CHANGE."""
    config = PlantConfig.from_file("single_joint_3")
    runner = Runner(RunSetup(config, 0, {"torque_node": {"adapt_friction": False}}))
    start, limit = config.start_position, runner.goal_limits.velocity
    plan = make_plan(find_scenario(SCENARIO), runner.robot.joint_names, start, limit, runner.period)
    goals, commands, coulomb = ({} if still else dict(plan.goals)), [], []
    for tick in range(ticks):
        if tick in goals:
            runner.offer(goals[tick])
        if tick == CHANGE:
            change(runner)
        commands.append(float(runner.step()["motor_torque_command"]["effort"][0]))
        look(runner)
        coulomb.append(float(runner.torque.state.coulomb_torque[0]))
    assert not runner.world.seam.stopped
    return np.array(commands), np.array(coulomb), runner


def adopt(node, **changes):
    """A change of one node's values, as the parameter services make it."""

    def change(runner):
        stage = dict(runner.stages)[node]
        setup = RunSetup(PlantConfig.from_file("single_joint_3"), 0, {"torque_node": {"adapt_friction": False}})
        given = {**setup.node_values(node)}
        one = {name: value[:1] if isinstance(value, list) else value for name, value in changes.items()}
        stage.adopt(stage.prepare({**given, **one}))

    return change


@pytest.mark.parametrize("node", ["torque_node", "fusion_node"])
def test_the_torque_does_not_jump(node):
    """The first tick after the change differs by less than a hundredth of what the change is worth in the end."""
    plain, _, _ = run(lambda runner: None)
    changed, _, _ = run(adopt(node, **BETTER[node]))
    np.testing.assert_array_equal(changed[:CHANGE], plain[:CHANGE])
    difference = np.abs(changed - plain)
    assert difference[CHANGE + RAMP :].max() > 1.0, "the change is worth something"
    assert 0.0 < difference[CHANGE] < 0.05 * difference[CHANGE + RAMP :].max()


def test_the_new_values_are_reached_after_the_ramp():
    _, coulomb, runner = run(adopt("torque_node", **BETTER["torque_node"]))
    assert coulomb[CHANGE - 1] == pytest.approx(21.6) and coulomb[CHANGE + RAMP - 1] == pytest.approx(15.0)
    middle = coulomb[CHANGE - 1 : CHANGE + RAMP]
    np.testing.assert_allclose(np.diff(middle), (15.0 - 21.6) / RAMP, rtol=1e-9)
    assert runner.torque.params.kinematic_feedforward == 1.0
    np.testing.assert_array_equal(runner.torque.params.kinematic_sine[0], [0.0, 2.909e-4, 0.0, 3.14456e-5])


def test_f21_a_gain_ramps_over_a_tenth_of_a_second_also_during_a_ramp_of_the_model():
    def both(runner):
        adopt("torque_node", **BETTER["torque_node"])(runner)
        adopt("torque_node", **BETTER["torque_node"], motor_velocity_gain=[400.0])(runner)

    gains = []
    _, _, runner = run(both, CHANGE + 120, lambda runner: gains.append(runner.torque.params.motor_velocity_gain[0]))
    np.testing.assert_allclose(gains[CHANGE : CHANGE + 100], np.linspace(499.0, 400.0, 100), rtol=1e-12)
    assert gains[CHANGE - 1] == 500.0 and set(gains[CHANGE + 100 :]) == {400.0}
    assert 0.2 * 2.909e-4 < runner.torque.params.kinematic_sine[0][1] < 0.3 * 2.909e-4


def test_f21_the_torque_takes_no_step_when_a_gain_is_doubled():
    plain, _, _ = run(lambda runner: None, CHANGE + 150)
    changed, _, _ = run(adopt("torque_node", motor_velocity_gain=[1000.0]), CHANGE + 150)
    difference = np.abs(changed - plain)[CHANGE:]
    assert difference.max() > 1.0, "the change is worth something"
    assert 0.0 < difference[0] < 0.05 * difference.max()


def test_a_restart_goes_on_with_the_estimates_and_ramps_what_changed_meanwhile():
    def restart(runner):
        adopt("torque_node", coulomb_torque_initial=[15.0])(runner)
        for _, stage in runner.stages:
            stage.start()

    _, coulomb, _ = run(restart, still=True)
    assert coulomb[CHANGE] == pytest.approx(21.6, abs=0.1) and coulomb[-1] == pytest.approx(15.0)
