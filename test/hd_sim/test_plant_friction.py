"""Friction and hysteresis of the world: exact hold, no chatter, rate independence, brake."""

from dataclasses import replace

import numpy as np
import pytest
from oracles.plant_runs import arm_c, flywheel, pinocchio_gravity, start_on_spring

from hd_sim.plant import Plant
from hd_sim.plant_config import PlantConfig


@pytest.mark.parametrize("arm", ["arm_c", "arm_a"])
def test_static_hold_does_not_drift_at_all(arm):
    """Half of the breakaway torque, held from 3 s to 13 s: rotor and link stay on the same bits."""
    plant = Plant(PlantConfig.from_file(arm))
    if arm == "arm_c":
        start_on_spring(plant)
    hold = pinocchio_gravity(plant.config, plant.config.start_position) + 0.5 * plant.config.drives["coulomb_torque"]
    plant.step_many(np.tile(hold, (3000, 1)), samples=False)
    before = plant.state
    plant.step_many(np.tile(hold, (10_000, 1)), samples=False)
    after = plant.state
    assert np.array_equal(before.motor_position, after.motor_position)
    assert np.array_equal(before.joint_position, after.joint_position)


@pytest.mark.parametrize("substeps", [1, 5, 10, 20])
def test_slow_motion_does_not_chatter(substeps):
    """0.001 rad/s under a stiff rotor servo, friction falling with speed: the rotor never stops or turns back."""
    config = replace(PlantConfig.from_file("single_joint_3"), substeps_per_ms=substeps)
    plant = Plant(config)
    speeds = []
    for k in range(4000):
        state = plant.state
        wanted = 0.001 * max(0.0, 1e-3 * k - 0.1)
        torque = 4e5 * (wanted - state.motor_position) + 2e4 * (0.001 * (k > 100) - state.motor_velocity)
        plant.step(torque)
        speeds.append(float(state.motor_velocity[0]))
    settled = np.array(speeds[1500:])
    assert np.all(settled > 0.0)
    assert settled.mean() == pytest.approx(0.001, rel=0.01)
    assert settled.std() < 1e-4


def test_breakaway_torque_is_coulomb_friction_plus_offset():
    config = flywheel(coulomb_torque=4.0, friction_offset=0.5)
    for torque, moves in ((4.49, False), (4.51, True), (-3.49, False), (-3.51, True)):
        plant = Plant(config)
        plant.step_many(np.full((200, 1), torque), samples=False)
        assert bool(plant.state.motor_velocity[0] != 0.0) is moves


@pytest.mark.parametrize(("drag", "sign"), [(0.0, 1.0), (5.0, 1.0), (5.0, -1.0)])
def test_steady_speed_has_its_closed_form(drag, sign):
    """u = k_c + k_v v + k_q v^2 at constant speed; 20 s are more than ten time constants."""
    config = flywheel(coulomb_torque=4.0, viscous_positive=20.0, viscous_negative=20.0, quadratic_drag=drag)
    plant = Plant(config)
    plant.step_many(np.full((20_000, 1), sign * 30.0), samples=False)
    speed = 26.0 / 20.0 if drag == 0.0 else (-20.0 + np.sqrt(400.0 + 4.0 * drag * 26.0)) / (2.0 * drag)
    assert plant.state.motor_velocity[0] == pytest.approx(sign * speed, rel=1e-9)


@pytest.mark.parametrize("per_cycle", [20, 100, 1000, 4000])
def test_hysteresis_work_does_not_depend_on_the_step(per_cycle):
    """A 1 mrad sine, A = 72 500 N m/rad, A/alpha = 15 N m: 0.047588 J per cycle; closed loops are rate-independent."""
    config = flywheel(hysteresis_stiffness=72_500.0, hysteresis_rate=72_500.0 / 15.0)
    plant = Plant(replace(config, substeps_per_ms=1), accounts=True)
    work = [plant.state.hysteresis_work[0]]
    for k in range(3 * per_cycle):
        state = plant.state
        state.motor_velocity = state.joint_velocity = state.motor_acceleration = state.joint_acceleration = 0.0
        state.joint_position, state.motor_position = 0.0, 1e-3 * np.sin(2.0 * np.pi * (k + 1) / per_cycle)
        plant.restore(state)
        plant.advance()
        work.append(plant.state.hysteresis_work[0])
    assert work[-1] - work[-1 - per_cycle] == pytest.approx(0.047588, rel=2e-5)  # six printed digits
    assert abs(plant.state.hysteresis_torque[0]) <= 15.0


def test_brake_holds_after_its_closing_time_and_not_before():
    plant = Plant(PlantConfig.from_file("arm_a"))
    plant.brake(True)
    for _ in range(50):
        plant.step(np.zeros(7))
    falling = plant.state.motor_velocity.copy()
    assert np.abs(falling[1]) > 0.1  # the shoulder carries 500 N m and has been let go
    for _ in range(300):
        plant.step(np.zeros(7))
    held = plant.state
    assert np.array_equal(held.motor_velocity, np.zeros(7))
    for _ in range(1000):
        plant.step(np.zeros(7))
    assert np.array_equal(plant.state.motor_position, held.motor_position)
    plant.brake(False)
    plant.step(np.zeros(7))
    assert plant.state.motor_velocity[1] != 0.0


@pytest.mark.parametrize("law", ["bristle", "maxwell_slip"])
def test_laws_with_memory_build_friction_up_over_their_travel(law):
    """Below breakaway the rotor moves a little and comes to rest; far beyond it friction is Coulomb friction."""
    config = flywheel(coulomb_torque=4.0, friction_law=law, presliding_distance=1e-4, viscous_positive=20.0)
    plant = Plant(config)
    plant.step_many(np.full((2000, 1), 2.0), samples=False)
    assert 1e-5 < plant.state.motor_position[0] < 2e-4
    assert abs(plant.state.motor_velocity[0]) < 1e-6
    plant.step_many(np.full((20_000, 1), 30.0), samples=False)
    assert plant.state.motor_velocity[0] == pytest.approx(1.3, rel=1e-6)


def test_bristle_law_starts_like_a_spring():
    """Presliding stiffness k_c / x_pre: a tenth of the Coulomb torque moves x_pre / 10 and a little more."""
    plant = Plant(flywheel(coulomb_torque=4.0, friction_law="bristle", presliding_distance=1e-4))
    plant.step_many(np.tile(np.linspace(0.0, 0.4, 4000)[:, None], 1), samples=False)
    travel = -np.log(1.0 - 0.1) * 1e-4  # z = x_pre (1 - exp(-phi / x_pre)) for motion in one direction
    assert plant.state.motor_position[0] == pytest.approx(travel, rel=0.02)


def test_friction_follows_load():
    """Breakaway rises with the torque that the gear carries: G = k_c (1 + g1 |tau| + g2 tau^2)."""
    config = flywheel(
        coulomb_torque=4.0, load_friction_linear=0.02, load_friction_quadratic=3e-4, torsional_damping=200
    )
    plant = Plant(config)
    load = 30.0
    breakaway = 4.0 * (1.0 + 0.02 * load + 3e-4 * load**2)
    plant.external_torque(joint=np.array([-load]))
    for torque, moves in ((load + 0.98 * breakaway, False), (load + 1.02 * breakaway, True)):
        plant.step_many(np.full((6000, 1), torque), samples=False)
        assert bool(abs(plant.state.motor_velocity[0]) > 1e-4) is moves


def test_reversals_happen_inside_steps_on_a_coupled_arm():
    plant = Plant(arm_c(5))
    wave = 6.0 * np.sin(2.0 * np.pi * 2e-3 * np.arange(1000)[:, None] + np.arange(7))
    torque = plant.gravity_torque(plant.config.start_position) + plant.config.drives["coulomb_torque"] * wave
    speed = plant.step_many(torque, samples=False, truth=True).truth["motor_velocity"]
    assert np.sum(speed[1:] * speed[:-1] < 0.0) > 10
