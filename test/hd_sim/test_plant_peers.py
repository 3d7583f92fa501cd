"""The world against other simulators, and against nonsense: MuJoCo, random plants, random commands."""

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from oracles.plant_runs import flywheel

from hd_control.bench import peers
from hd_sim.hidden_effects import EFFECTS
from hd_sim.plant import Plant
from hd_sim.plant_config import PlantConfig
from hd_sim.truth import HiddenEffect, apply_hidden, nominal


def test_mujoco_moves_the_nominal_arm_the_same_way():
    """Without dry friction both simulate the same equations; MuJoCo is of first order, so its step is made small."""
    mujoco = pytest.importorskip("mujoco")
    config = nominal(PlantConfig.from_file("arm_b")).with_settings(coulomb_torque=0.0, friction_law="coulomb")
    plant, substeps = Plant(config), 50
    model = mujoco.MjModel.from_xml_string(peers.arm_as_mjcf(config, 1e-3 / substeps))
    data, start = mujoco.MjData(model), plant.state
    data.qpos[::2], data.qpos[1::2] = start.motor_position, start.joint_position - start.motor_position
    hold = plant.gravity_torque(config.start_position)
    for k in range(300):
        torque = hold + 0.2 * config.drives["rated_torque"] * np.sin(12e-3 * k + np.arange(7))
        plant.step(torque)
        data.ctrl[:] = torque
        mujoco.mj_step(model, data, nstep=substeps)
    moved = np.abs(plant.true_joint_position - config.start_position)
    apart = np.abs(data.qpos[::2] + data.qpos[1::2] - plant.true_joint_position)
    assert moved.max() > 0.04
    assert apart.max() < 3e-6  # halves when MuJoCo halves its step: 1.8e-6 measured at 50, 8.8e-7 at 100


@pytest.mark.parametrize("peer", [peers.compiled_plant, peers.numpy_peer, peers.mujoco_peer])
def test_peers_advance(peer):
    if peer is peers.mujoco_peer:
        pytest.importorskip("mujoco")
    advance = peer(PlantConfig.from_file("arm_c"), 5)
    for _ in range(3):
        advance()


choices = st.lists(
    st.tuples(st.integers(0, 6), st.sampled_from(list(EFFECTS)), st.floats(0.0, 4.0)), min_size=1, max_size=12
)


@settings(max_examples=60)
@given(effects=choices, seed=st.integers(0, 1000), arm=st.sampled_from(["arm_a", "arm_b", "arm_c"]))
def test_no_mixture_of_effects_makes_the_world_explode(effects, seed, arm):
    """Full-size random torques for 0.3 s: everything stays finite, hysteresis below saturation, energy bounded."""
    base = PlantConfig.from_file(arm)
    config = apply_hidden(base, [HiddenEffect(*effect) for effect in effects], seed)
    plant = Plant(config, seed)
    torque = np.random.default_rng(seed).uniform(-1.0, 1.0, (300, 7)) * base.drives["rated_torque"]
    record = plant.step_many(torque, truth=True)
    state = plant.state
    assert np.isfinite(state.array).all()
    assert all(np.isfinite(column).all() for column in record.samples.values())
    rate = config.drives["hysteresis_rate"]
    saturation = np.divide(config.drives["hysteresis_stiffness"], rate, out=np.zeros(7), where=rate > 0)
    assert np.all(np.abs(state.hysteresis_torque) <= saturation * (1 + 1e-12))
    assert np.abs(record.truth["joint_velocity"]).max() < 100.0


@settings(max_examples=60)
@given(values=st.lists(st.floats(allow_nan=True, allow_infinity=True), min_size=7, max_size=7))
def test_no_command_makes_the_world_explode(values):
    plant = Plant(PlantConfig.from_file("arm_a"))
    for _ in range(20):
        plant.step(values)
    assert np.isfinite(plant.state.array).all()
    assert np.all(np.abs(plant.sample().motor_torque_applied) <= plant.config.drives["torque_limit"])


@pytest.mark.parametrize("inertia", [0.05, 0.005])
def test_stiff_light_joints_are_stable_at_coarse_steps(inertia):
    """k = 2.9e5 N m/rad on a light link: stable at 1 ms, where an explicit spring needs far smaller steps."""
    config = flywheel(inertia=inertia, stiffness_linear=2.9e5, torsional_damping=290.0, rotor_inertia=28.0)
    plant = Plant(replace(config, substeps_per_ms=1 if inertia > 0.01 else 2))
    plant.external_torque(joint=[50.0])
    plant.step([0.0])
    plant.external_torque()
    plant.step_many(np.zeros((500, 1)), samples=False)
    state = plant.state
    assert abs(state.joint_velocity[0] - state.motor_velocity[0]) < 1e-6
    momentum = 28.0 * state.motor_velocity[0] + inertia * state.joint_velocity[0]
    assert momentum == pytest.approx(50.0 * 1e-3, rel=1e-9)


def test_friction_that_is_reported_as_truth_balances_the_rotor():
    """Sliding: F = k_c g(tau) stribeck + c + k_v v; sticking: what the motor and the spring leave."""
    config = PlantConfig.from_file("single_joint_5").with_settings(current_time_constant=0.0)
    plant = Plant(config)
    p = {name: values[0] for name, values in config.drives.items()}
    plant.step_many(np.full((3000, 1), 40.0), samples=False)
    real = plant.true_state()
    v, tau = real.motor_velocity[0], real.joint_torque[0]
    load = 1.0 + p["load_friction_linear"] * abs(tau) + p["load_friction_quadratic"] * tau**2
    expected = p["coulomb_torque"] * load + p["friction_offset"] + p["viscous_positive"] * v
    assert v > 0.1
    assert real.friction_torque[0] == pytest.approx(expected, rel=2e-3)  # mean of a substep against its end
    still = Plant(config)
    still.step_many(np.full((200, 1), 1.0), samples=False)
    assert still.state.motor_velocity[0] == 0.0
    assert still.true_state().friction_torque[0] == pytest.approx(1.0 - still.true_state().joint_torque[0], abs=1e-6)


def test_cogging_moves_a_free_rotor_as_written():
    """Near a stable point the rotor swings with omega^2 = order * amplitude * N / (I* + J)."""
    config = flywheel(cogging_order=[6.0, 0.0], cogging_amplitude=[-2.0, 0.0], torsional_damping=300.0)
    plant = Plant(config)
    state = plant.state
    state.motor_position = state.joint_position = 1e-5
    plant.restore(state)
    stiffness = 6.0 * 2.0 * config.drives["gear_ratio"][0]
    total = config.drives["rotor_inertia"][0] + 1.0
    motion = plant.step_many(np.zeros((2000, 1)), truth=True).truth["motor_position"][:, 0]
    crossings = np.flatnonzero((motion[1:] < 0) != (motion[:-1] < 0))
    period = 2.0 * np.mean(np.diff(crossings)) * 1e-3
    assert period == pytest.approx(2.0 * np.pi / np.sqrt(stiffness / total), rel=0.03)
