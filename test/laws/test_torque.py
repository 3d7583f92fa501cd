"""Torque law: the compiled form against a plain re-statement of Zhu's equations, and what must not change anything."""

import itertools
import math

import numpy as np
import pytest
from oracles.derivative import derivative_pole
from oracles.torque_law import Joint

from hd_control.core.resources import config_path
from hd_control.core.strict_yaml import load_params_file
from hd_control.laws import torque

DT = 1e-3
SAMPLE = ("joint_position", "joint_velocity", "joint_torque", "motor_position", "motor_velocity")
REFERENCE = ("joint_torque_required", "desired_position", "desired_velocity")
TERMS = (
    "inertia_torque", "coulomb_feedforward", "offset_feedforward", "viscous_feedforward", "velocity_feedback",
    "joint_torque_feedforward", "torque_feedback", "saturation_torque",
)  # fmt: skip
ESTIMATES = ("coulomb_torque", "friction_offset", "viscous_positive", "viscous_negative", "torsional_compliance")


ZHU = {
    "law": "adaptive",
    "compliance_derivative": "stiffness_only",
    "rate_source": "plain",
    "kinematic_feedforward": False,
    "adapt_friction": True,
    "adapt_compliance": True,
    "adaptation_scale": 1.0,
    "coulomb_torque_initial": [0.0] * 7,
    "friction_offset_initial": [0.0] * 7,
    "viscous_positive_initial": [0.0] * 7,
    "viscous_negative_initial": [0.0] * 7,
}


def zhu(**changes):
    """The paper's own switches and start values; tables from the shipped file, which may start otherwise."""
    return load_params_file(config_path("torque_node.yaml"), "torque_node") | ZHU | changes


def with_kinematic_error(values):
    rng = np.random.default_rng(5)
    for kind, n in itertools.product(("cosine", "sine"), range(1, 5)):
        values[f"kinematic_{kind}_{n}"] = list(rng.normal(0, 3e-4 / n, 7))
    return values


def history(ticks=400, joints=7, seed=0):
    """Random but smooth-ish signals: dicts of (ticks, joints) arrays in physical sizes."""
    rng = np.random.default_rng(seed)
    t = DT * np.arange(ticks)[:, None]

    def wave(size, noise):
        f, phase = rng.uniform(1, 30, joints), rng.uniform(0, 6, joints)
        return size * np.sin(f * t + phase) + noise * rng.normal(size=(ticks, joints))

    sample = {
        "joint_position": wave(0.3, 1e-5),
        "joint_velocity": wave(0.5, 1e-3),
        "joint_torque": wave(40.0, 0.5),
        "motor_position": wave(0.3, 1e-5),
        "motor_velocity": wave(0.5, 1e-3),
    }
    reference = {
        "joint_torque_required": wave(40.0, 0.1),
        "desired_position": wave(0.3, 0.0),
        "desired_velocity": wave(0.5, 0.0),
    }
    return sample, reference


def run(values, sample, reference, joints=7, dt=DT):
    """Outputs and states of a whole history, as lists."""
    params = torque.configure(values, None, dt)
    state, block, ref = torque.initial_state(params), torque.new_sample(joints), torque.new_reference(joints)
    outputs, states = [], []
    for k in range(len(sample["joint_position"])):
        for name in SAMPLE:
            block.view(name)[...] = sample[name][k]
        for name in REFERENCE:
            ref.view(name)[...] = reference[name][k]
        output, state = torque.step(params, state, block, ref, dt)
        outputs.append(output)
        states.append(state)
    return outputs, states


def one_joint(values, j):
    """The values of joint j by name, as the oracle wants them."""
    p = {name: v[j] for name, v in values.items() if isinstance(v, list) and len(v) == 7}
    for kind in ("cosine", "sine"):
        p[f"kinematic_{kind}"] = [p[f"kinematic_{kind}_{n}"] for n in range(1, 5)]
    for name in ("coulomb", "viscous", "compliance"):
        p[f"adaptation_gain_{name}"] *= values["adaptation_scale"]
    return p


CASES = list(itertools.product(("literal", "stiffness_only", "filtered"), ("plain", "error_filter"), (False, True)))


@pytest.mark.parametrize(("variant", "source", "kinematic"), CASES)
@pytest.mark.parametrize(("dt", "cutoff"), [(1e-3, 200.0), (2.5e-4, 800.0)])
def test_compiled_law_equals_the_plain_one(variant, source, kinematic, dt, cutoff):
    """1e-12 of the largest torque: the two differ in nothing but the order of a few additions."""
    values = with_kinematic_error(
        zhu(
            compliance_derivative=variant,
            rate_source=source,
            kinematic_feedforward=kinematic,
            derivative_cutoff=cutoff,
            adaptation_scale=0.5,
            motor_torque_limit=[1e7] * 7,
        )
    )
    sample, reference = history()
    outputs, states = run(values, sample, reference, dt=dt)
    pole = derivative_pole(cutoff, dt)
    for j in range(7):
        oracle = Joint(one_joint(values, j), variant, source, pole, dt, kinematic)
        wanted = [
            oracle.step(*(sample[n][k, j] for n in SAMPLE), *(reference[n][k, j] for n in REFERENCE))
            for k in range(len(outputs))
        ]
        seen = np.array([output.motor_torque[j] for output in outputs])
        assert np.max(np.abs(wanted)) < 1e7, "a saturated torque compares nothing"
        size = max(np.abs([o.inertia_torque[j] for o in outputs]).max(), np.abs(wanted).max())
        assert np.abs(seen - wanted).max() <= 1e-12 * size
        ends = [states[-1].view(name)[j] for name in ESTIMATES]
        assert ends == pytest.approx([*oracle.theta, oracle.zeta], rel=1e-9, abs=1e-12)


def test_the_terms_add_up_to_the_torque():
    values = zhu()
    outputs, _ = run(values, *history(ticks=100))
    assert any(np.any(output.saturation_torque != 0.0) for output in outputs)
    for output in outputs:
        total = sum(output.view(name) for name in TERMS)
        size = np.abs([output.view(name) for name in TERMS]).max(axis=0)
        assert np.all(np.abs(total - output.motor_torque) <= 1e-14 * 8 * (size + 1))
        assert np.all(np.abs(output.motor_torque) <= values["motor_torque_limit"])


@pytest.mark.parametrize("variant", ["stiffness_only", "filtered", "literal"])
def test_one_joint_alone_computes_the_same_bits_as_among_seven(variant):
    values = with_kinematic_error(zhu(compliance_derivative=variant, kinematic_feedforward=True))
    sample, reference = history(ticks=200)
    all_outputs, all_states = run(values, sample, reference)
    one = [{n: v[:, 2:3] for n, v in part.items()} for part in (sample, reference)]
    outputs, states = run(values | {"joints": ["joint_3"]}, *one, joints=1)
    for many, few in zip([*all_outputs, *all_states], [*outputs, *states], strict=True):
        for name, value in few.as_dict().items():
            assert value[0] == many.view(name)[2], name


def test_permuting_the_joints_permutes_the_result():
    values = with_kinematic_error(zhu(rate_source="error_filter", kinematic_feedforward=True))
    order = [4, 0, 6, 2, 5, 1, 3]
    sample, reference = history(ticks=100)
    outputs, states = run(values, sample, reference)
    turned = {n: [v[i] for i in order] if isinstance(v, list) and len(v) == 7 else v for n, v in values.items()}
    moved = [{n: v[:, order] for n, v in part.items()} for part in (sample, reference)]
    new_outputs, new_states = run(turned, *moved)
    for old, new in zip([*outputs, *states], [*new_outputs, *new_states], strict=True):
        for name, value in new.as_dict().items():
            assert np.array_equal(value, old.view(name)[order]), name


def test_mirrored_signs_mirror_the_torque():
    """Bounds symmetric and viscous coefficients equal: the law is odd."""
    values = zhu(coulomb_torque_low=[-5.0] * 7, coulomb_torque_high=[5.0] * 7)
    sample, reference = history(ticks=200)
    outputs, _ = run(values, sample, reference)
    mirrored = [{n: -v for n, v in part.items()} for part in (sample, reference)]
    others, _ = run(values, *mirrored)
    for a, b in zip(outputs, others, strict=True):
        assert np.array_equal(a.motor_torque, -b.motor_torque)


def test_step_changes_none_of_its_arguments():
    params = torque.configure(zhu(), None, DT)
    state, sample, reference = torque.initial_state(params), torque.new_sample(7), torque.new_reference(7)
    sample.joint_position, reference.joint_torque_required = 0.3, 7.0
    before = [block.array.copy() for block in (params, state, sample, reference)]
    torque.step(params, state, sample, reference, DT)
    for old, block in zip(before, (params, state, sample, reference), strict=True):
        assert np.array_equal(old, block.array)


def test_new_gains_in_the_middle_leave_the_state_alone():
    """Changing gains and changing them back at once equals never having touched them, and estimates do not restart."""
    values, (sample, reference) = zhu(), history(ticks=300)
    outputs, states = run(values, sample, reference)
    params = torque.configure(values, None, DT)
    other = torque.configure(values | {"motor_velocity_gain": [7.0] * 7}, None, DT)
    again = torque.configure(values, None, DT)
    assert np.array_equal(params.array, again.array) and not np.array_equal(params.array, other.array)
    block, ref = torque.new_sample(7), torque.new_reference(7)
    for name in SAMPLE:
        block.view(name)[...] = sample[name][200]
    for name in REFERENCE:
        ref.view(name)[...] = reference[name][200]
    changed, state = torque.step(other, states[199], block, ref, DT)
    same, _ = torque.step(again, states[199], block, ref, DT)
    assert np.array_equal(same.motor_torque, outputs[200].motor_torque)
    for name in ESTIMATES:
        assert np.array_equal(changed.view(name), outputs[200].view(name))
    assert np.array_equal(changed.required_motor_velocity, outputs[200].required_motor_velocity)
    assert np.array_equal(changed.velocity_feedback, 7.0 * outputs[200].velocity_error)
    assert not np.array_equal(state.coulomb_torque, np.zeros(7))


def test_frozen_estimates_keep_their_bits():
    values, (sample, reference) = zhu(), history(ticks=200)
    _, states = run(values, sample, reference)
    frozen = torque.configure(values | {"adapt_friction": False, "adapt_compliance": False}, None, DT)
    state, block, ref = states[-1], torque.new_sample(7), torque.new_reference(7)
    block.motor_position, ref.joint_torque_required = 0.2, 30.0
    for _ in range(50):
        _, state = torque.step(frozen, state, block, ref, DT)
    for name in ESTIMATES:
        assert np.array_equal(state.view(name), states[-1].view(name))


def test_estimates_stay_inside_their_bounds():
    values, (sample, reference) = zhu(), history(ticks=1000, seed=3)
    _, states = run(values | {"adaptation_scale": 10.0}, sample, reference)
    bounds = {n: n if n.startswith(("c", "f", "t")) else "viscous" for n in ESTIMATES}
    touched = 0
    for state, (name, bound) in itertools.product(states, bounds.items()):
        value, low, high = state.view(name), np.array(values[f"{bound}_low"]), np.array(values[f"{bound}_high"])
        assert np.all((low <= value) & (value <= high)), name
        touched += np.sum((value == low) | (value == high))
    assert touched > 1000, "the histories must push against the bounds, or this test says nothing"


@pytest.mark.parametrize("bad", [math.nan, math.inf, -math.inf, 1e308])
@pytest.mark.parametrize("name", [*SAMPLE, *REFERENCE])
def test_bad_numbers_never_enter_the_state(bad, name):
    """The torque of that joint is not finite or limited, its memory stays finite, the other joints do not notice."""
    values, (sample, reference) = zhu(rate_source="error_filter", law="adaptive"), history(ticks=30)
    clean, _ = run(values, sample, reference)
    part = sample if name in sample else reference
    part[name] = part[name].copy()
    part[name][10, 2] = bad
    outputs, states = run(values, sample, reference)
    others = [0, 1, 3, 4, 5, 6]
    for output, good, state in zip(outputs, clean, states, strict=True):
        assert np.array_equal(output.motor_torque[others], good.motor_torque[others])
        assert np.all(np.isfinite(state.array))
        assert not np.any(np.abs(output.motor_torque) > values["motor_torque_limit"])
    assert math.isfinite(outputs[-1].motor_torque[2])


def test_bumpless_start_has_no_rates():
    """First sample at rest under load: the torque is the load and the friction of the wanted velocity, nothing else."""
    params = torque.configure(zhu(torsional_compliance_initial=zhu()["torsional_compliance_low"]), None, DT)
    sample, reference = torque.new_sample(7), torque.new_reference(7)
    load = np.array([100.0, 100.0, 100.0, 50.0, 20.0, 20.0, 10.0])
    sample.joint_torque = reference.joint_torque_required = load
    sample.motor_position = params.torsional_compliance_initial * load
    for variant in (0, 1, 2):
        params.compliance_derivative = variant
        output, state = torque.step(params, torque.initial_state(params), sample, reference, DT)
        assert np.allclose(output.motor_torque, load, atol=1e-9)
        output, _ = torque.step(params, torque.restarted(state), sample, reference, DT)
        assert np.allclose(output.motor_torque, load, atol=1e-9)


def test_the_derived_acceleration_of_the_reference_is_second_order():
    """(3 d_k - d_{k-1})/2 on q_d' = cos: the error falls with dt squared."""
    errors = []
    for dt in (2e-3, 1e-3):
        params = torque.configure(zhu(), None, dt)
        state, sample, reference = torque.initial_state(params), torque.new_sample(7), torque.new_reference(7)
        worst = 0.0
        for k in range(400):
            reference.desired_velocity = math.cos(10 * k * dt)
            output, state = torque.step(params, state, sample, reference, dt)
            if k > 2:
                worst = max(worst, abs(output.desired_acceleration[0] + 10 * math.sin(10 * k * dt)))
        errors.append(worst)
    assert errors[0] / errors[1] == pytest.approx(4.0, abs=0.3)


def test_direct_law_passes_the_torque_on():
    values = zhu(law="direct")
    outputs, states = run(values, *history(ticks=20))
    _, reference = history(ticks=20)
    for k, output in enumerate(outputs):
        assert np.array_equal(output.motor_torque, reference["joint_torque_required"][k])
    for name in ESTIMATES:
        assert np.array_equal(states[-1].view(name), values[f"{name}_initial"])
