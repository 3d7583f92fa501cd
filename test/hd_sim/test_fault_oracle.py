"""The oracle of the fault campaign: a swing that only changes its form is no fault, energy that is added is one."""

import numpy as np
import pytest
from fault_injection import Case, Injection, make_runner
from oracles.deadlines import deadline
from oracles.unsafe_run import RunOracle, link_mobility

from hd_sim.plant import Plant
from hd_sim.plant_config import PlantConfig

JOINT = "single_joint_7"


def found_after_stop(push):
    """What the oracle finds in 60 ms of a wound-up joint; the drive gives the weight and `push` times the velocity."""
    config = PlantConfig.from_file(JOINT)
    plant, drives = Plant(config), config.drives
    state = plant.state
    state.torsion = state.torsion + 3e-3
    state.motor_position = state.motor_position + 3e-3
    state.brake_request, state.joint_torque = 0.0, state.joint_torque + 3e-3 * drives["stiffness_linear"]
    plant.restore(state)
    wide = np.array([1e6])
    oracle = RunOracle(wide, wide, -wide, wide, wide, 10, drives["rotor_inertia"], drives["stiffness_linear"])
    for tick in range(60):
        now = plant.state
        torque = plant.gravity_torque(now.joint_position) + push * now.motor_velocity
        oracle.look(tick, torque, True, True, True, tick, now, plant)
        plant.step(torque)
    assert oracle.fastest > 0.2, "the spring sets the link in motion from rest"
    return oracle.found


def test_the_energy_of_the_spring_may_show_in_the_link():
    assert found_after_stop(-100.0) == found_after_stop(0.0) == []


def test_energy_that_the_stop_adds_is_found():
    assert {letter for _, letter, _ in found_after_stop(300.0)} == {"d"}


def test_a_speed_that_is_no_number_is_found():
    plant = Plant(PlantConfig.from_file(JOINT))
    one = np.ones(1)
    oracle, state = RunOracle(one, one, -one, one, one, 10, one, one), plant.state
    oracle.look(0, 0.0 * one, True, True, True, 0, state, plant)
    state.joint_velocity = one * np.nan
    oracle.look(1, 0.0 * one, True, True, True, 1, state, plant)
    assert (1, "d", 0) in oracle.found


@pytest.mark.parametrize("name", [JOINT, "arm_a"])
def test_mobility_is_the_answer_to_a_torque(name):
    plant = Plant(PlantConfig.from_file(name))
    q, zeros = plant.config.start_position, np.zeros(plant.joints)
    for joint, mobility in enumerate(link_mobility(plant, q)):
        torque = plant.gravity_torque(q) + np.eye(plant.joints)[joint]
        assert plant._kernel.accelerate(q, zeros, torque, zeros)[0][joint] == pytest.approx(mobility, rel=1e-9)


def seen_by(*injections):
    runner = make_runner(Case(1, 1, JOINT, 0.0, 0.3, injections))
    for _ in range(150):
        runner.step()
    return [runner.seen[injection] for injection in injections]


def test_a_fault_behind_another_is_seen_when_it_arrives():
    bad = Injection("encoder", "not_finite", 0, 120, 6, 1.0)
    assert seen_by(bad) == [list(range(120, 126))]
    assert deadline(bad, list(range(120, 126))) == 123
    slow = Injection("encoder", "slow", 0, 119, 20, 0.01)
    assert seen_by(slow, bad)[1] == [121, 123, 125]
    assert deadline(bad, [121, 123, 125]) == 126
    missing = Injection("resolver", "off", 0, 115, 9, 1.0)
    assert seen_by(missing, bad)[1] == [124, 125]
    assert deadline(bad, [124, 125]) is None
    raising = Injection("torque", "exception", 0, 120, 9, 1.0)
    assert seen_by(missing, raising)[1][0] == 124
    assert deadline(raising, [124]) == 125


def test_silence_is_seen_at_once():
    silent = Injection("joint_states", "off", 0, 120, 20, 1.0)
    assert deadline(silent, []) == 130
