"""Plant files: shipped ones load, wrong ones are refused with file, key and the nearest known key."""

import shutil

import numpy as np
import pytest

from hd_control.core.errors import ConfigError
from hd_control.core.resources import config_path
from hd_sim.plant import Plant
from hd_sim.plant_config import REQUIRED, SETTINGS, PlantConfig

SHIPPED = sorted(path.stem for path in config_path("plant").glob("*.yaml") if "robot:" in path.read_text())


@pytest.fixture
def files(tmp_path):
    """A copy of arm A's plant and drive files that a test may spoil: function (file, old, new)."""
    for name in ("arm_a.yaml", "drives_s.yaml"):
        shutil.copy(config_path(f"plant/{name}"), tmp_path)

    def spoil(name: str, old: str, new: str) -> str:
        text = (tmp_path / name).read_text()
        assert old in text
        (tmp_path / name).write_text(text.replace(old, new, 1))
        return str(tmp_path / "arm_a.yaml")

    return spoil


@pytest.mark.parametrize("name", SHIPPED)
def test_shipped_plants_load_and_move(name):
    plant = Plant(PlantConfig.from_file(name))
    assert np.isfinite(plant.step_many(np.zeros((20, plant.joints))).samples["gauge_torque"]).all()
    assert np.array_equal(plant.sample().motor_torque_applied, np.zeros(plant.joints))


def test_there_is_a_plant_for_every_rig():
    assert {"arm_a", "arm_b", "arm_c", *(f"single_joint_{j}" for j in (3, 4, 5, 7))} <= set(SHIPPED)


def test_drives_are_those_of_table_one():
    p = PlantConfig.from_file("arm_a").drives
    assert p["gear_ratio"].tolist() == [120] * 4 + [160] * 3
    assert p["rotor_inertia"].tolist() == [28, 28, 28, 5, 2.1, 2.1, 1.0]
    assert p["stiffness_linear"].tolist() == [2.9e5] * 3 + [1.1e5, 5e4, 5e4, 2.6e4]
    assert p["torsional_damping"] == pytest.approx(1e-3 * p["stiffness_linear"])


@pytest.mark.parametrize(("name", "old", "new", "words"), [
    ("arm_a.yaml", "period: 0.001", "perod: 0.001", "'perod'.*did you mean 'period'"),
    ("arm_a.yaml", "period: 0.001", "period: yes please", "period: 'yes please' is not a number"),
    ("arm_a.yaml", "substeps_per_ms: 5", "substeps_per_ms: 2.5", "not a whole number"),
    ("arm_a.yaml", "csf_45, csf_45", "csf_45, csf_54", "unknown drive 'csf_54', did you mean 'csf_45'"),
    ("arm_a.yaml", "csf_45, csf_45", "csf_45", "expected 7 drive types"),
    ("arm_a.yaml", "[0.2, 0.5,", "[0.5,", "expected 7 numbers"),
    ("arm_a.yaml", "robot: arm_a", "robot: arm_x", "arm_x"),
    ("arm_a.yaml", "drives: drives_s.yaml", "drives: nothing.yaml", "nothing.yaml"),
    ("drives_s.yaml", "coulomb_torque: 24", "coulomb_torqe: 24", "'coulomb_torqe', did you mean 'coulomb_torque'"),
    ("drives_s.yaml", "coulomb_torque: 24", "coulomb_torque: -24", r"coulomb_torque: -24 is outside \[0"),
    ("drives_s.yaml", "coulomb_torque: 24", "# none", "coulomb_torque: missing"),
    ("drives_s.yaml", "gear_ratio: 120", "gear_ratio: 0", "gear_ratio: 0 is outside"),
    ("drives_s.yaml", "friction_law: coulomb", "friction_law: tanh", "one of coulomb, bristle, maxwell_slip"),
    ("drives_s.yaml", "[0.0, 2.909e-4, 0.0,", "[2.909e-4, 0.0,", "kinematic_sine: 3 values, expected 4"),
    ("drives_s.yaml", "hysteresis_rate: 4000.0", "hysteresis_rate: 0", "hysteresis_rate: must be positive"),
])  # fmt: skip
def test_wrong_files_are_refused_with_a_reason(files, name, old, new, words):
    with pytest.raises(ConfigError, match=words):
        PlantConfig.from_file(files(name, old, new))


def test_required_settings_have_no_silent_value():
    assert set(REQUIRED) <= set(SETTINGS)
    assert {"coulomb_torque", "stiffness_linear", "rotor_inertia", "gauge_noise", "brake_torque"} <= set(REQUIRED)


def test_settings_can_be_replaced_and_misspelt_ones_are_refused():
    config = PlantConfig.from_file("arm_a").with_settings(friction_law="bristle", gauge_noise=0.0)
    assert config.drives["friction_law"].tolist() == [1.0] * 7
    with pytest.raises(ConfigError, match="did you mean 'gauge_noise'"):
        config.with_settings(gauge_nois=0.0)


def test_a_plant_file_replaces_settings_of_all_its_joints(files):
    """The key `settings` wins over the drive types; a wrong name or value is refused with the file."""
    path = files("arm_a.yaml", "period:", "settings: {resolver_bits: 20}\nperiod:")
    found, plain = PlantConfig.from_file(path), PlantConfig.from_file("arm_a")
    assert set(found.drives["resolver_bits"]) == {20.0}
    np.testing.assert_array_equal(found.drives["coulomb_torque"], plain.drives["coulomb_torque"])
    for old, new, words in (
        ("resolver_bits: 20", "resolver_bit: 20", "resolver_bits"),
        ("resolver_bit: 20", "resolver_bits: -3", "arm_a.yaml: settings: resolver_bits"),
    ):
        with pytest.raises(ConfigError, match=words):
            PlantConfig.from_file(files("arm_a.yaml", old, new))
