"""The second world against closed forms: energy, friction curve, hysteresis loop, delays, noise, step size."""

import math
import re
from pathlib import Path

import numpy as np
import pytest

from hd_control.core.errors import ConfigError
from hd_control.drive.library import names_that_may_be_missing
from hd_sim import _second_world
from hd_sim.second_world.hidden import KNOWN, UNNAMED, hide, in_recording, true_parameters
from hd_sim.second_world.motion import MOTIONS
from hd_sim.second_world.plant import PERIOD, draw_plant, simulate, stream, substeps_of

ROOT = Path(__file__).resolve().parents[2]
SMOOTH = {"coulomb": 0.0, "viscous": 0.0, "torsional_damping": 0.0, "ripple_share": 0.0}


def played(plant, seconds=3.0, number=0, substeps=0):
    reference = MOTIONS["general"](stream(plant.seed, "test"), plant.room(), seconds)
    return simulate(in_recording(plant, number, seconds), reference, number, substeps)


def quiet(seed, **values):
    """A joint whose sensors are exact and whose clocks agree."""
    exact = [n for n, _, _ in _second_world.FIELDS if n.endswith(("_noise", "_step", "_late", "_disturbance"))]
    kept = {"friction_step"}
    plain = dict.fromkeys([name for name in exact if name not in kept], 0.0)
    return draw_plant(seed).with_values({**plain, "jitter": 0.0, "clock_drift": 0.0, **values})


def test_energy_is_kept_without_friction():
    plant = draw_plant(3).with_values({**SMOOTH, "swinging_share": 0.2, "swinging_damping": 0.0})
    for name in ("kinematic_error", "nonlinear_stiffness", "backlash", "payload", "damaged_tooth"):
        plant = hide(plant, name, 1.0)
    joint = _second_world.Joint(plant.array())
    joint.rest(0.8)
    before = joint.energy()
    joint.step(2.5e-5, 0.0, 40_000)
    moved = abs(joint.state[2] - 0.8)
    scale = plant.values["gravity_torque"]
    assert moved > 0.1 and abs(joint.energy() - before) < 1e-6 * scale


def test_an_undamped_joint_swings_at_its_resonance():
    values = {**SMOOTH, "gravity_torque": 0.0}
    plant = draw_plant(5).with_values(values)
    v, joint = plant.values, _second_world.Joint(plant.array())
    joint.rest(0.0)
    state = joint.state
    state[0] = 1e-4
    joint.place(state)
    frequency = math.sqrt(v["stiffness_1"] * (1.0 / v["rotor_inertia"] + 1.0 / v["link_inertia"])) / (2.0 * math.pi)
    torsion, h = [], 1e-5
    for _ in range(20_000):
        joint.step(h, 0.0, 1)
        torsion.append(joint.state[0] - joint.state[2])
    crossings = np.flatnonzero((np.array(torsion[:-1]) < 0.0) & (np.array(torsion[1:]) >= 0.0))
    measured = (crossings.size - 1) / ((crossings[-1] - crossings[0]) * h)
    assert measured == pytest.approx(frequency, rel=2e-3)


def steady_bristle(v, steady, share):
    z, h = 0.0, 0.02 * steady / abs(v)
    for _ in range(1000):
        z += h * _second_world.bristle_rate(z, v, steady, share)
    return z


@pytest.mark.parametrize("v", [0.01, 0.3, -0.3])
def test_a_bristle_slides_at_its_steady_deflection(v):
    assert steady_bristle(v, 1e-4, 0.6) == pytest.approx(math.copysign(1e-4, v), rel=1e-6)


def test_small_motions_of_a_bristle_are_elastic():
    """Below the elastic share nothing creeps, however often it is shaken (what the LuGre law does not keep)."""
    z, h = 0.0, 1e-5
    for k in range(200_000):
        v = 0.004 * math.cos(2.0 * math.pi * 20.0 * k * h) + 0.0
        z += h * _second_world.bristle_rate(z, v, 1e-4, 0.6)
        assert abs(z) < 0.6e-4
    expected = h * sum(0.004 * math.cos(2.0 * math.pi * 20.0 * k * h) for k in range(200_000))
    assert z == pytest.approx(expected, abs=1e-12)


def test_the_friction_curve_is_the_one_of_the_page():
    plant = draw_plant(8)
    for name in ("stribeck_friction", "load_dependent_friction", "temperature_friction", "asymmetric_friction"):
        plant = hide(plant, name, 1.0)
    v, speed, load, warm = plant.values, np.array([-0.5, 0.02, 0.9]), np.array([3.0, -1.0, 8.0]), np.full(3, 40.0)
    slide, fluid = _second_world.friction(plant.array(), speed, load, np.zeros(3), warm, np.zeros(3))
    stribeck = 1.0 + v["stribeck_excess"] / (1.0 + (speed / v["stribeck_velocity"]) ** 2)
    mesh = np.sqrt(1.0 + (v["mesh_load"] * load) ** 2)
    assert slide == pytest.approx(v["coulomb"] * stribeck * mesh * (1.0 + v["coulomb_asymmetry"] * np.sign(speed)))
    thin = np.exp(-v["viscous_decay"] * (40.0 - v["reference_temperature"]))
    assert fluid == pytest.approx(v["viscous"] * thin * speed * (1.0 + v["viscous_asymmetry"] * np.sign(speed)))


def loop(shape, exponent, amplitude=4e-4, travel=1e-4):
    """Bouc-Wen variable over three periods of a torsion, at the steps of the last two."""
    n = 20_000
    x = amplitude * np.sin(2.0 * np.pi * 3.0 * np.arange(3 * n + 1) / (3 * n))
    w, found = 0.0, []
    for dx in np.diff(x):
        w += _second_world.bouc_wen_rate(w, dx, travel, shape, exponent)
        found.append(w)
    return x[1:], np.array(found), n


@pytest.mark.parametrize(("shape", "exponent"), [(0.75, 1.5), (0.95, 1.0), (0.6, 2.0)])
def test_the_hysteresis_loop_closes_and_loses_energy(shape, exponent):
    x, w, n = loop(shape, exponent)
    second, third = slice(n, 2 * n), slice(2 * n, 3 * n)
    assert np.abs(w[third] - w[second]).max() < 1e-3 and np.abs(w).max() <= 1.0 + 1e-9
    area = float(np.sum(w[third] * np.gradient(x)[third]))
    assert 0.0 < area < 4.0 * 4e-4


def test_the_first_branch_of_the_loop_has_its_closed_form():
    """n = 1, sigma = 1: w = 1 - exp(-x / travel)."""
    w, h = 0.0, 1e-7
    for _ in range(2000):
        w += _second_world.bouc_wen_rate(w, h, 1e-4, 1.0, 1.0)
    assert w == pytest.approx(1.0 - math.exp(-2.0), rel=1e-3)


def test_delay_and_reported_torque():
    """The torque at tick k is the set-point of three ticks before; a held value acts from its stamp to the next."""
    plant = quiet(4, torque_at_stamp=0.0, transport_delay=3e-3, current_lag=3e-5, ripple_share=0.0)
    columns, truths = played(plant)
    wanted = truths["set_point"]  # of the interval that ends at the tick
    assert truths["motor_torque"][10:] == pytest.approx(wanted[7:-3], abs=1e-9 * plant.values["rated_torque"])
    assert np.array_equal(columns["motor_torque"][:-1], wanted[1:])


def test_a_torque_sampled_at_the_stamp_is_that_of_the_instant():
    plant = quiet(4, torque_at_stamp=1.0, ripple_share=0.0)
    columns, truths = played(plant)
    assert columns["motor_torque"] == pytest.approx(truths["motor_torque"], abs=2e-3 * plant.values["rated_torque"])
    between = np.std(columns["motor_torque"][1:] - truths["motor_torque"][:-1])
    assert between > 2.0 * np.std(columns["motor_torque"] - truths["motor_torque"])


def test_a_late_channel_shows_the_past():
    plant = quiet(4, resolver_late=5e-4)
    columns, truths = played(plant)
    time = np.arange(columns["joint_position"].size) * PERIOD
    rate = np.gradient(truths["joint_velocity"], PERIOD)
    past = truths["joint_position"] - 5e-4 * truths["joint_velocity"] + 0.5 * (5e-4) ** 2 * rate
    assert columns["joint_position"][20:] == pytest.approx(past[20:], abs=3e-7)
    assert np.abs(np.interp(time, time, truths["joint_position"])[20:] - columns["joint_position"][20:]).max() > 1e-4


@pytest.mark.parametrize(
    ("values", "column", "size"),
    [
        ({"gauge_noise": 0.03}, "gauge_torque", 0.03),
        ({"gauge_step": 0.2}, "gauge_torque", 0.2 / math.sqrt(12.0)),
        ({"resolver_noise": 4e-6}, "joint_position", 4e-6),
        (
            {"encoder_noise": 1e-4, "encoder_step": 3e-4},
            "motor_shaft_position",
            math.hypot(1e-4, 3e-4 / math.sqrt(12.0)),
        ),
        ({"torque_noise": 0.02, "torque_at_stamp": 0.0}, "motor_torque", 0.02),
    ],
)
def test_noise_and_resolution_are_as_large_as_they_say(values, column, size):
    """Against the same joint with exact sensors; the encoder's steps, which the controller sees, stay the same."""
    exact = quiet(6, torque_at_stamp=0.0, encoder_step=values.get("encoder_step", 0.0))
    noisy, clean = played(exact.with_values(values))[0][column], played(exact)[1]
    true = {
        "gauge_torque": played(exact)[0]["gauge_torque"],
        "joint_position": clean["joint_position"],
        "motor_shaft_position": exact.values["gear_ratio"] * clean["motor_position"],
        "motor_torque": played(exact)[0]["motor_torque"],
    }[column]
    assert np.std(noisy[20:] - true[20:]) == pytest.approx(size, rel=0.06)


def test_jitter_is_the_clocks_own():
    plant = quiet(6, jitter=3e-5)
    columns, truths = played(plant)
    error = columns["joint_position"] - truths["joint_position"]
    fast = np.abs(truths["joint_velocity"]) > 0.3
    assert np.std(error[fast] / truths["joint_velocity"][fast]) == pytest.approx(3e-5, rel=0.05)


def test_smaller_steps_change_nothing_that_a_sensor_sees():
    plant = quiet(7)
    for name in ("stribeck_friction", "torsional_hysteresis", "backlash", "kinematic_error"):
        plant = hide(plant, name, 1.0)
    coarse, fine = (played(plant, substeps=n)[1] for n in (24, 96))
    assert np.abs(coarse["joint_position"] - fine["joint_position"]).max() < 2e-6
    assert np.abs(coarse["joint_torque"] - fine["joint_torque"]).max() < 2e-3 * plant.values["rated_torque"]


def sliding_friction(plant, substeps, speed=-1.3):
    """Friction torque of a rotor too heavy to be slowed down, over the last of 50 ms; and what it should be."""
    heavy = dict.fromkeys(("rotor_inertia", "link_inertia"), 1e9) | {"viscous": 0.0, "bristle_damping": 0.0}
    joint = _second_world.Joint(plant.with_values(heavy).array())
    joint.rest(0.0)
    state = joint.state
    state[1] = state[3] = speed
    joint.place(state)
    joint.step(1e-3 / substeps, 0.0, 49 * substeps)
    found = []
    for _ in range(substeps):
        joint.step(1e-3 / substeps, 0.0, 1)
        found.append(joint.torques()[1])
    return np.array(found), plant.values["coulomb"] * np.sign(speed) * (1.0 - plant.values["coulomb_asymmetry"])


def test_weak_bristles_get_the_steps_that_they_need():
    """Explicit steps longer than 2.78 settling times of a bristle make the friction chatter."""
    usual = draw_plant(7).with_values({"bristle_travel": 4e-5})
    weak = usual.with_values({"coulomb_asymmetry": 0.85})
    assert (substeps_of(usual), substeps_of(weak)) == (24, 192)
    for plant in (usual, weak):
        friction, expected = sliding_friction(plant, substeps_of(plant))
        assert friction == pytest.approx(expected, rel=1e-6)
    chatter, expected = sliding_friction(weak, 24)
    assert np.abs(chatter / expected - 1.0).max() > 0.5


def test_a_seed_gives_the_same_recording_and_each_number_another_one():
    one, again, other = played(draw_plant(9))[0], played(draw_plant(9))[0], played(draw_plant(9), number=1)[0]
    assert all(np.array_equal(one[name], again[name]) for name in one)
    assert not np.array_equal(one["gauge_torque"], other["gauge_torque"])


@pytest.mark.parametrize("name", [*KNOWN, *UNNAMED])
def test_every_effect_changes_the_recording(name):
    plain = draw_plant(11)
    before, after = played(plain, 10.0)[0], played(hide(plain, name, 1.0), 10.0)[0]
    assert all(np.isfinite(column).all() for column in after.values())
    assert not np.array_equal(before["gauge_torque"], after["gauge_torque"]) or not np.array_equal(
        before["joint_position"], after["joint_position"]
    )


def test_the_vocabulary_is_that_of_the_library():
    assert set(KNOWN) == set(names_that_may_be_missing())
    for name in KNOWN:
        values = hide(draw_plant(2), name, 1.0).values
        assert all(math.isfinite(value) for value in true_parameters(name, values)[0].values())
    with pytest.raises(ConfigError, match="unknown effect"):
        hide(draw_plant(2), "nothing", 1.0)


def test_the_compiled_world_includes_nothing_of_the_first_one():
    files = sorted((ROOT / "hd_sim" / "cpp").glob("second_*"))
    included = {name for path in files for name in re.findall(r'#include "(.*)"', path.read_text())}
    assert len(files) == 3 and included == {"blocks.hpp", "second_world.hpp", "second_recorder.hpp"}
