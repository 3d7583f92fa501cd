"""Accuracy of the integrator: rotor error against an extrapolated limit, energy, agreement with a plain plant."""

from functools import lru_cache

import numpy as np
import pytest
from oracles.plant_runs import EnergyBook, arm_c, pinocchio_gravity, profile, start_on_spring

from hd_control.bench.peers import SlowPlant
from hd_sim.plant import Plant
from hd_sim.plant_config import PlantConfig

PROFILES = ("in_phase", "phased", "square")


def rotor_motion(name: str, substeps: int, scheme: str = "reversals_resolved") -> np.ndarray:
    plant = Plant(arm_c(substeps, scheme))
    start_on_spring(plant)
    return plant.step_many(profile(name, plant.config, 1000), samples=False, truth=True).truth["motor_position"]


@lru_cache(maxsize=3)
def limit(name: str) -> np.ndarray:
    """Richardson extrapolation of the first-order scheme: another scheme, consistent with itself to 8e-7 rad."""
    return 2.0 * rotor_motion(name, 1600, "first_order") - rotor_motion(name, 800, "first_order")


@pytest.mark.parametrize("name", PROFILES)
def test_rotor_error_is_below_one_encoder_count(name):
    five = np.abs(rotor_motion(name, 5) - limit(name)).max()
    ten = np.abs(rotor_motion(name, 10) - limit(name)).max()
    assert five <= 1.3e-5
    assert ten <= 4.0e-6


def test_first_order_scheme_is_first_order():
    errors = [np.abs(rotor_motion("in_phase", n, "first_order") - limit("in_phase")).max() for n in (10, 20)]
    assert errors[0] == pytest.approx(1.4e-4, rel=0.1)
    assert errors[0] / errors[1] == pytest.approx(2.0, rel=0.1)


@pytest.mark.parametrize(("substeps", "bound"), [(5, 5e-4), (10, 1.3e-4), (20, 3.2e-5)])
def test_energy_balance(substeps, bound):
    plant = Plant(arm_c(substeps), accounts=True)
    start_on_spring(plant)
    book = EnergyBook(plant.config)
    begin, worst, kinetic = book.energy(plant.state), 0.0, 0.0
    for torque in profile("phased", plant.config, 1000):
        plant.step(torque)
        state = plant.state
        worst = max(worst, abs(book.energy(state) - begin - book.balance(state)))
        kinetic = max(kinetic, float(0.5 * plant.config.drives["rotor_inertia"] @ state.motor_velocity**2))
    assert kinetic > 10.0  # the arm moves, so the balance says something
    assert worst <= bound


@pytest.mark.parametrize("name", PROFILES)
def test_link_solves_are_rarely_repeated(name):
    plant = Plant(arm_c(10))
    start_on_spring(plant)
    plant.step_many(profile(name, plant.config, 1000), samples=False)
    assert plant.state.extra_link_solves <= 0.002 * 10 * 1000


@pytest.mark.parametrize(("arm", "substeps", "scheme"), [
    ("arm_c", 5, "reversals_resolved"), ("arm_c", 10, "reversals_resolved"), ("arm_c", 10, "first_order"),
    ("arm_a", 5, "reversals_resolved"), ("single_joint_3", 10, "reversals_resolved"),
])  # fmt: skip
def test_agrees_with_the_plain_plant(arm, substeps, scheme):
    """Two implementations of the same steps: 0.2 s with starts, stops and reversals, to 1e-11 rad (rounding only)."""
    config = arm_c(substeps, scheme) if arm == "arm_c" else PlantConfig.from_file(arm)
    fast, slow = Plant(config), SlowPlant(config)
    slow.set_state(**{name: getattr(fast.state, name) for name in slow.s})
    time = 1e-3 * np.arange(200)[:, None]
    wave = 6.0 * config.drives["coulomb_torque"] * np.sin(40.0 * time + np.arange(config.joints))
    turns = 0
    for torque in pinocchio_gravity(config, config.start_position) + wave:
        before = fast.state.motor_velocity.copy()
        fast.step(torque)
        slow.step(torque)
        turns += int(np.sum((before != 0.0) & (before * fast.state.motor_velocity <= 0.0)))
    assert turns > 0
    assert np.abs(fast.state.motor_position - slow.s["motor_position"]).max() < 1e-11
    assert np.abs(fast.state.joint_position - slow.s["joint_position"]).max() < 1e-11
    assert np.abs(fast.state.joint_velocity - slow.s["joint_velocity"]).max() < 1e-8
