"""Hidden effects: every name acts, strength 0 does nothing, the nominal plant is plain, the seal holds."""

import json
import stat

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from oracles.plant_runs import flywheel

from hd_control.core.errors import ConfigError
from hd_sim.hidden_effects import EFFECTS, OUTSIDE, VOCABULARY
from hd_sim.plant import Plant
from hd_sim.plant_config import SETTINGS, PlantConfig
from hd_sim.truth import HiddenEffect, apply_hidden, nominal, open_seal, truth_of, write_seal

MAY_BE_MISSING = """kinematic_error torsional_hysteresis nonlinear_stiffness backlash load_dependent_friction
stribeck_friction asymmetric_friction quadratic_drag temperature_friction presliding motor_cogging torque_constant_error
actuation_delay gauge_ripple gauge_gain gauge_offset joint_sensor_eccentricity payload link_friction
structural_resonance""".split()

SENSOR_ONLY = {"gauge_ripple", "gauge_gain", "gauge_offset", "gauge_zero_drift", "gauge_fourth_harmonic",
               "joint_sensor_eccentricity", "sampling_jitter"}  # fmt: skip


def run(config: PlantConfig, truth: bool = False):
    """1.5 s of motion of all joints from the nominal holding torque."""
    time = 1e-3 * np.arange(1500)[:, None]
    gravity = Plant(nominal(PlantConfig.from_file("arm_a"))).gravity_torque(config.start_position)
    wave = 0.3 * config.drives["rated_torque"] * np.sin(9.0 * time + np.arange(config.joints))
    return Plant(config).step_many(gravity + wave, truth=truth)


def test_vocabulary_is_complete_and_there_is_more():
    assert sorted(VOCABULARY) == sorted(MAY_BE_MISSING)
    assert len(OUTSIDE) >= 5
    assert not set(OUTSIDE) & set(MAY_BE_MISSING)


@pytest.mark.parametrize("name", list(EFFECTS))
def test_every_effect_changes_what_the_sensors_show(name):
    """On the nominal arm, on joint 3. Sensor effects must not move anything; the others must."""
    base = nominal(PlantConfig.from_file("arm_a"))
    changed = apply_hidden(base, [HiddenEffect(2, name, 1.0)], seed=4)
    if name == "friction_step":
        changed = changed.with_settings(friction_step_time=0.5)
    plain, other = run(base, truth=True), run(changed, truth=True)
    moved = not np.array_equal(plain.truth["joint_position"], other.truth["joint_position"])
    assert moved is (name not in SENSOR_ONLY)
    seen = [column for column in plain.samples if not np.array_equal(plain.samples[column], other.samples[column])]
    assert seen
    assert np.isfinite(other.truth["joint_position"]).all()
    assert np.abs(other.truth["joint_torque"]).max() < 5000.0


@pytest.mark.parametrize("arm", ["arm_a", "single_joint_5"])
def test_strength_zero_changes_nothing(arm):
    for config in (PlantConfig.from_file(arm), nominal(PlantConfig.from_file(arm))):
        nothing = apply_hidden(
            config, [HiddenEffect(j, name, 0.0) for name in EFFECTS for j in range(config.joints)], seed=1
        )
        assert np.array_equal(nothing.parameters().array, config.parameters().array)


@pytest.mark.parametrize("name", list(EFFECTS))
def test_effects_stay_on_their_joint_and_do_not_move_each_other(name):
    base = nominal(PlantConfig.from_file("arm_a"))
    alone = apply_hidden(base, [HiddenEffect("joint_3", name, 1.0)], seed=9)
    both = apply_hidden(base, [HiddenEffect("joint_5", "motor_cogging"), HiddenEffect("joint_3", name)], seed=9)
    for setting, values in alone.drives.items():
        others = np.arange(7) != 2
        assert np.array_equal(values[others], base.drives[setting][others])
        assert np.array_equal(values[2], both.drives[setting][2])


def test_nominal_plant_has_no_effect_left():
    """On the nominal plant, every setting that an effect may change is at its neutral value."""
    config = nominal(PlantConfig.from_file("arm_c"))
    touched = set()
    for name in EFFECTS:
        for seed in range(4):
            changed = apply_hidden(config, [HiddenEffect(1, name)], seed)
            touched |= {key for key in SETTINGS if not np.array_equal(changed.drives[key], config.drives[key])}
    spared = {"viscous_negative", "presliding_distance", "friction_slip_share", "friction_slip_distance"}
    for key in touched - spared:
        assert np.all(config.drives[key] == SETTINGS[key].neutral), key
    assert np.array_equal(config.drives["viscous_negative"], config.drives["viscous_positive"])


def test_nominal_joint_follows_the_model_every_drive_has():
    """u - tau = I* phi'' + k_c sgn v + k_v v on a nominal plant, from true signals by central differences."""
    config = nominal(PlantConfig.from_file("single_joint_4")).with_settings(torsional_damping=500.0)
    plant = Plant(config)
    torque = 60.0 * np.sin(3.0 * 1e-3 * np.arange(2000)[:, None])
    real = {name: column[:, 0] for name, column in plant.step_many(torque, truth=True).truth.items()}
    p = {name: values[0] for name, values in config.drives.items()}
    acceleration = (real["motor_velocity"][2:] - real["motor_velocity"][:-2]) / 2e-3
    speed, mid = real["motor_velocity"][1:-1], 0.5 * (torque[:-2, 0] + torque[1:-1, 0])
    friction = p["coulomb_torque"] * np.sign(speed) + p["viscous_positive"] * speed
    residual = mid - real["joint_torque"][1:-1] - friction - p["rotor_inertia"] * acceleration
    steady = np.abs(speed) > 0.02
    assert steady.sum() > 1000
    assert np.abs(residual[steady]).max() < 0.05  # ringing of the joint at 25 Hz, differenced over 2 ms


def test_load_share_of_a_hidden_torque_constant():
    """+e on the torque constant accelerates a free rotor and link by 1 + e, while the report stays."""
    config = flywheel()
    changed = apply_hidden(config, [HiddenEffect(0, "torque_constant_error", 2.0)], seed=1)
    error = changed.drives["torque_constant_error"][0]
    assert abs(error) == pytest.approx(0.044)
    plants = [Plant(config), Plant(changed)]
    for plant in plants:
        plant.step_many(np.full((500, 1), 5.0))
    ratio = plants[1].state.motor_velocity[0] / plants[0].state.motor_velocity[0]
    assert ratio == pytest.approx(1.0 + error, rel=1e-6)
    assert plants[1].sample().motor_torque_applied[0] == 5.0


def test_backlash_carries_no_torque_inside_the_gap():
    plant = Plant(flywheel(backlash_half_gap=1e-3, torsional_damping=0.0))
    state = plant.state
    for torsion, torque in ((0.9e-3, 0.0), (-0.9e-3, 0.0), (1.5e-3, 0.5e-3), (-1.5e-3, -0.5e-3)):
        state.motor_position, state.torsion = torsion, torsion
        plant.restore(state)
        expected = torque * plant.config.drives["stiffness_linear"][0]
        assert plant.true_state().joint_torque[0] == pytest.approx(expected, abs=1e-9)


def test_resonance_leaves_the_slow_inertia_and_removes_share_of_the_fast_one():
    """Far below resonance the hanging inertia moves along; a sudden torque feels the rest only."""
    config = flywheel(inertia=1.0, rotor_inertia=1e-3, stiffness_linear=1e-6, torsional_damping=0.0)
    hung = config.with_settings(resonance_inertia=0.3, resonance_frequency=18.0, resonance_damping=0.5)
    first, whole = [], []
    for each in (config, hung):
        plant = Plant(each)
        plant.external_torque(joint=[2.0])
        plant.step([0.0])
        first.append(plant.state.joint_velocity[0])
        for _ in range(3000):
            plant.step([0.0])
        whole.append(plant.state.joint_velocity[0])
    assert first[1] / first[0] == pytest.approx(1.0 / 0.7, rel=0.03)
    assert whole[1] / whole[0] == pytest.approx(1.0, rel=2e-3)


def test_unknown_names_joints_and_strengths_are_refused():
    config = PlantConfig.from_file("arm_a")
    for effect, words in (
        (HiddenEffect(0, "backlashes"), "did you mean 'backlash'"),
        (HiddenEffect(7, "backlash"), r"outside \[0, 6\]"),
        (HiddenEffect(0, "backlash", -1.0), "not a number >= 0"),
        (HiddenEffect(0, "backlash", float("nan")), "not a number >= 0"),
    ):
        with pytest.raises(ConfigError, match=words):
            apply_hidden(config, [effect], 0)


def test_stribeck_needs_coulomb_friction():
    with pytest.raises(ConfigError, match="no Coulomb friction"):
        apply_hidden(flywheel(), [HiddenEffect(0, "stribeck_friction")], 0)


def test_truth_says_what_changed_and_the_seal_keeps_it(tmp_path):
    config = nominal(PlantConfig.from_file("arm_a"))
    truth = truth_of(config, [HiddenEffect(2, "backlash", 0.5), HiddenEffect("joint_1", "cable_torque")], seed=3)
    assert [effect["joint"] for effect in truth["effects"]] == ["joint_3", "joint_1"]
    assert [effect["outside_vocabulary"] for effect in truth["effects"]] == [False, True]
    assert truth["effects"][0]["settings"]["backlash_half_gap"] == {"before": 0.0, "after": 2e-5}
    path = tmp_path / "truth.seal"
    write_seal(path, truth)
    assert open_seal(path) == json.loads(json.dumps(truth))
    assert stat.S_IMODE(path.stat().st_mode) == 0o600
    assert not any(word in path.read_text() for word in ("backlash", "cable", "joint_3"))
    with pytest.raises(ConfigError, match="truth.seal: exists already"):
        write_seal(path, truth)
    with pytest.raises(ConfigError, match="truth.seal: cannot be written"):
        write_seal(tmp_path / "nowhere" / "truth.seal", truth)


def test_a_changed_seal_is_noticed(tmp_path):
    path = tmp_path / "truth.seal"
    write_seal(path, {"effects": []})
    sealed = json.loads(path.read_text())
    sealed["sha256"] = "0" * 64
    path.write_text(json.dumps(sealed))
    with pytest.raises(ConfigError, match="broken"):
        open_seal(path)


@given(st.binary(max_size=200))
def test_no_file_makes_the_seal_reader_crash(data):
    import tempfile
    from pathlib import Path

    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "x.seal"
        path.write_bytes(data)
        with pytest.raises(ConfigError):
            open_seal(path)
