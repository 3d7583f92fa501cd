"""Laws to compare with, in closed form; their tunings; the shipped file."""

import numpy as np
import pinocchio
import pytest
import yaml
from chains import CONFIG, paper_values, shipped_values

from hd_control.core.parameters import Shape
from hd_control.core.robot import Robot
from hd_control.laws import motion
from hd_control.papers.baselines import BASELINES

ARM = Robot.from_file("arm_a")
DT = 1e-3
Q0 = np.array([0.2, 0.5, -0.6, 1.0, -0.5, 0.4, 0.3])


def _once(law, state=None, scale=1.0, **fields):
    params = motion.configure({**paper_values(), "law": law, "link_parameter_scale": [scale]}, ARM, DT)
    sample, reference = motion.new_sample(7), motion.new_reference(7)
    for name, value in fields.items():
        (sample if name.startswith("joint") else reference).view(name)[...] = value
    out, after = motion.step(params, state or motion.initial_state(params), sample, reference, DT)
    return params, out, after


def _gravity(q):
    model = ARM.pinocchio_model()
    return pinocchio.computeGeneralizedGravity(model, model.createData(), q)


@pytest.mark.parametrize("scale", [1.0, 0.9])
def test_pd_is_gravity_at_the_measured_position_plus_feedback(scale):
    e, de = 0.01 * np.arange(1, 8), 0.1
    params, out, _ = _once(
        "pd", scale=scale, joint_position=Q0, joint_velocity=0.2, desired_position=Q0 + e, desired_velocity=0.2 + de
    )
    expected = scale * _gravity(Q0) + params.velocity_gain * (de + params.position_gain * e)
    np.testing.assert_allclose(out.joint_torque_required, expected, rtol=0, atol=1e-10)
    assert np.abs(_gravity(Q0 + e) - _gravity(Q0)).max() > 1.0, "measured and desired must differ in gravity"


def test_pid_adds_the_integral_until_its_bound():
    e = 0.001
    state, total = None, 0.0
    for _ in range(5):
        params, out, state = _once("pid", state, joint_position=Q0, desired_position=Q0 + e)
        total = total + DT * params.integral_gain * params.position_gain * e
    np.testing.assert_allclose(out.integral, total, rtol=1e-12)
    _, pd, _ = _once("pd", joint_position=Q0, desired_position=Q0 + e)
    np.testing.assert_allclose(out.joint_torque_required, pd.joint_torque_required + total, rtol=0, atol=1e-10)
    _, out, _ = _once("pid", state, joint_position=Q0, desired_position=Q0 - 1e4)
    np.testing.assert_array_equal(out.integral, params.integral_low)


def test_computed_torque_makes_the_error_linear():
    """M(q) a_c + C q' + G + I* a_c with a_c = q''_d + 2 lambda e' + lambda^2 e, against Pinocchio."""
    random = np.random.default_rng(1)
    v, vd, ad, e = (random.uniform(-0.5, 0.5, 7) for _ in range(4))
    fields = {"joint_position": Q0, "joint_velocity": v, "desired_position": Q0 + e, "desired_velocity": vd}
    params, out, _ = _once("computed_torque", **fields, desired_acceleration=ad)
    gain = params.position_gain
    a = ad + 2 * gain * (vd - v) + gain**2 * e
    model = ARM.pinocchio_model()
    expected = pinocchio.rnea(model, model.createData(), Q0, v, a) + params.rotor_inertia * a
    np.testing.assert_allclose(out.joint_torque_required, expected, rtol=0, atol=1e-9)


def test_feed_forward_ignores_what_is_measured():
    wanted = {"desired_position": Q0, "desired_velocity": 0.3, "desired_acceleration": -0.5}
    _, one, _ = _once("feed_forward", **wanted, joint_position=Q0, joint_velocity=0.3)
    _, other, _ = _once("feed_forward", **wanted, joint_position=Q0 + 0.2, joint_velocity=-1.0)
    np.testing.assert_array_equal(one.joint_torque_required, other.joint_torque_required)


@pytest.mark.parametrize("law", motion.LAWS)
def test_a_given_feed_forward_is_added_to_every_law(law):
    fields = {"joint_position": Q0, "desired_position": Q0 + 0.01}
    _, plain, _ = _once(law, **fields)
    _, more, _ = _once(law, **fields, feed_forward_torque=np.arange(7.0))
    difference = more.joint_torque_required - plain.joint_torque_required
    np.testing.assert_allclose(difference, np.arange(7.0), rtol=0, atol=1e-12)


def test_each_baseline_is_reported_at_several_tunings():
    by_name = {baseline.name: baseline for baseline in BASELINES}
    values = shipped_values()
    soft = by_name["pid_soft"].values(values)
    assert soft["law"] == "pid"
    np.testing.assert_allclose(soft["position_gain"], 0.7 * np.array(values["position_gain"]))
    np.testing.assert_allclose(soft["velocity_gain"], 0.7 * np.array(values["velocity_gain"]))
    np.testing.assert_allclose(soft["integral_gain"], 0.5 * np.array(values["integral_gain"]))
    for baseline in BASELINES:
        motion.configure(baseline.values(values), ARM, DT)
    factors = sorted(b.position for b in BASELINES if b.law == "computed_torque")
    assert factors == [0.5, 1.0, 2.0]


def test_the_shipped_file_is_complete_and_its_numbers_are_doubles_for_ros():
    """ROS types `1` as integer and `1e-3` as text; PyYAML's rules for floats are the same."""
    values = yaml.safe_load(CONFIG.read_text())["/**"]["ros__parameters"]
    assert list(values) == list(motion.PARAMETERS.names)
    for name in motion.PARAMETERS.names:
        parameter = motion.PARAMETERS[name]
        items = [values[name]] if parameter.shape is Shape.SCALAR else values[name]
        assert all(type(item) is parameter.kind for item in items), name
    motion.PARAMETERS.check(values, 7)


def test_the_shipped_gains_are_those_of_the_paper():
    values = shipped_values()
    table = {
        "position_gain": (25, 45, 30, 30),
        "velocity_gain": (2000, 500, 100, 80),
        "integral_gain": (25000, 4000, 2000, 2000),
        "integral_high": (400, 200, 100, 50),
        "integral_low": (-400, -200, -100, -50),
        "rotor_inertia": (28, 5, 2.1, 1.0),
    }
    for name, (shoulder, elbow, wrist, last) in table.items():
        assert values[name] == [shoulder] * 3 + [elbow] + [wrist] * 2 + [last], name


def test_every_number_of_the_shipped_file_names_its_source():
    text = CONFIG.read_text().splitlines()
    numbers = [line for line in text if any(c.isdigit() for c in line.split("#")[0]) and "joint_names" not in line]
    assert numbers and all("Zhu" in line or "chosen" in line for line in numbers)
