"""Torque law: which values are refused, with which words, and what the shipped file holds."""

import copy
import re

import numpy as np
import pytest
import yaml

from hd_control.core.errors import ConfigError
from hd_control.core.parameters import Shape
from hd_control.core.resources import config_path
from hd_control.core.strict_yaml import load_params_file
from hd_control.laws import torque
from hd_control.laws.torque import PARAMETERS
from hd_control.laws.torque_adaptive import loop_gains, warnings

DT = 1e-3


@pytest.fixture
def values():
    return copy.deepcopy(load_params_file(config_path("torque_node.yaml"), "torque_node"))


def test_shipped_values_are_zhus_tables(values):
    assert values["motor_velocity_gain"] == [500, 500, 500, 200, 100, 100, 25]
    assert values["torque_gain"] == [0, 0, 0, 0.8, 0.75, 0.75, 1.0]
    assert values["rotor_inertia"] == [28, 28, 28, 5, 2.1, 2.1, 1.0]
    middle = (np.array(values["torsional_compliance_low"]) + values["torsional_compliance_high"]) / 2
    assert values["torsional_compliance_initial"] == pytest.approx(list(middle), rel=1e-12)
    assert loop_gains(values) == pytest.approx([0.058, 0.058, 0.058, 0.022, 0.010, 0.010, 0.0052], rel=1e-9)
    assert warnings(values) == []
    assert torque.configure(values, None, DT).joints == 7


@pytest.mark.parametrize("file", ["torque_node.yaml", "fusion_node.yaml", "limits.yaml"])
def test_ros_reads_every_number_of_the_shipped_files_as_meant(file):
    """ROS's parser knows YAML 1.1 numbers: `1e-3` would be text there, and `28` a whole number in a list of floats."""
    raw = yaml.safe_load(config_path(file).read_text())["/**"]["ros__parameters"]
    strict = load_params_file(config_path(file), file.removesuffix(".yaml"))
    assert raw == strict
    for name, value in raw.items():
        kinds = {type(item) for item in value} if isinstance(value, list) else set()
        assert kinds <= {float} or kinds == {str}, f"{name}: {kinds}"


def test_every_parameter_has_unit_meaning_and_value(values):
    assert set(PARAMETERS.names) == set(values)
    for parameter in PARAMETERS.parameters:
        assert parameter.meaning and parameter.unit
        if parameter.shape is Shape.PER_JOINT:
            assert len(values[parameter.name]) == 7


def test_an_algebraic_loop_is_refused_with_the_remedy(values):
    values["torque_rate_gain"][0] = 0.004
    text = "joint_1: k_f·d·λ_τ = 1.16 ≥ 1 (Zhu, Remark 3.1): lower torque_rate_gain below 0.00345"
    with pytest.raises(ConfigError, match=re.escape(text)):
        torque.configure(values, None, DT)
    values["torque_rate_gain"][0] = 0.0034
    torque.configure(values, None, DT)
    (warning,) = warnings(values)
    assert warning.startswith("joint_1: k_f·d·λ_τ = 0.986 ≥ 0.5")
    values["torque_rate_gain"][0] = 0.0017
    assert warnings(values) == []


@pytest.mark.parametrize(
    ("name", "joint", "value", "text"),
    [
        ("coulomb_torque_initial", 2, 36.0, "joint_3: coulomb_torque_initial 36 is outside [-35, 35]"),
        ("viscous_negative_initial", 0, 701.0, "joint_1: viscous_negative_initial 701 is outside [0, 700]"),
        ("friction_offset_low", 4, 20.0, "joint_5: friction_offset_low 20 is not below friction_offset_high 20"),
        ("torsional_compliance_low", 0, 0.0, "torsional_compliance_low[0]: 0 is outside (0, inf)"),
        ("torsional_stiffness", 6, 2.0e4, "joint_7: 1 / torsional_stiffness = 5e-05 rad/(N m) is outside the bounds"),
        ("motor_position_gain", 1, 0.0, "motor_position_gain[1]: 0 is outside (0, inf)"),
        ("torque_gain", 1, -0.1, "torque_gain[1]: -0.1 is outside [0, inf)"),
        ("rotor_inertia", 3, float("nan"), "rotor_inertia[3]: nan is outside"),
        ("motor_torque_limit", 3, -480.0, "motor_torque_limit[3]: -480 is outside"),
    ],
)
def test_bad_values_are_named_with_value_and_bounds(values, name, joint, value, text):
    values[name][joint] = value
    with pytest.raises(ConfigError) as caught:
        torque.configure(values, None, DT)
    assert text in str(caught.value)


def test_bad_combinations_are_refused(values):
    cases = [
        ({"compliance_derivative": "literal", "damping_time": [0.0] * 7}, "divides by damping_time"),
        ({"derivative_cutoff": 3142.0}, "half the sample rate"),
        ({"compliance_derivative": "exact"}, "is not one of literal, stiffness_only, filtered"),
        ({"joints": ["joint_8"]}, "joints: 'joint_8' is not one of joint_1"),
        ({"joints": ["joint_1", "joint_1"]}, "joints: a joint is named twice"),
        ({"motor_velocity_gain": [1.0] * 6}, "motor_velocity_gain: 6 values, expected 7"),
    ]
    for change, text in cases:
        with pytest.raises(ConfigError, match=re.escape(text)):
            torque.configure(values | change, None, DT)
    del values["torque_gain"]
    with pytest.raises(ConfigError, match="torque_gain: missing"):
        torque.configure(values, None, DT)


def test_f25_the_robot_must_have_the_joints(values):
    class Robot:
        joint_names = tuple(f"joint_{i}" for i in range(1, 7))

    with pytest.raises(ConfigError, match="HD-F25 model_mismatch .*the robot has no joint joint_7"):
        torque.configure(values, Robot(), DT)


def test_none_named_means_all_joints(values):
    for none in ([], [""]):
        assert torque.selected_joints(values | {"joints": none}) == values["joint_names"]
    params = torque.configure(values | {"joints": ["joint_7", "joint_4"]}, None, DT)
    assert list(params.motor_velocity_gain) == [25.0, 200.0]
