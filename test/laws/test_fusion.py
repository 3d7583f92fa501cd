"""Fusion law against a plain re-statement, and what it does for a robot: wraps, crossover, lost readings."""

import math

import numpy as np
import pytest
from oracles.derivative import derivative_pole
from oracles.fusion_law import Joint

from hd_control.core.errors import ConfigError
from hd_control.core.resources import config_path
from hd_control.core.strict_yaml import load_params_file
from hd_control.laws import fusion
from hd_control.laws.calibration import joint_count, motor_count, quantise

DT = 1e-3
SAMPLE = ("motor_shaft_position", "joint_position", "gauge_torque", "motor_torque", "motor_temperature")
STATE = ("joint_position", "joint_velocity", "joint_torque", "motor_position", "motor_velocity")


def shipped(**changes):
    return load_params_file(config_path("fusion_node.yaml"), "fusion_node") | changes


def calibrated(seed=1, **changes):
    """Every parameter different from its neutral value, in every joint."""
    rng, values = np.random.default_rng(seed), shipped()
    for name, value in values.items():
        if name.startswith("kinematic"):
            values[name] = list(rng.normal(0, 1e-4, 7))
        elif name.startswith("gauge") and name not in ("gauge_gain", "gauge_joint_turns"):
            values[name] = [v + float(d) for v, d in zip(value, rng.normal(0, 0.5, 7), strict=True)]
        elif name.endswith("_offset"):
            values[name] = list(rng.normal(0, 0.3, 7))
    return (
        values
        | {"gauge_gain": list(rng.uniform(0.9, 1.1, 7)), "gauge_joint_turns": [0.0, 1, -1, 0, 1, -1, 1]}
        | changes
    )


def signals(ticks=300, seed=0):
    rng = np.random.default_rng(seed)
    t = DT * np.arange(ticks)[:, None]
    q = 0.5 * np.sin(rng.uniform(1, 9, 7) * t + rng.uniform(0, 6, 7))
    return {
        "motor_shaft_position": np.array([120, 120, 120, 120, 160, 160, 160]) * (q + 1e-4 * rng.normal(size=q.shape)),
        "joint_position": q,
        "gauge_torque": 30 * np.cos(5 * t) + rng.normal(size=q.shape),
        "motor_torque": rng.normal(size=q.shape),
        "motor_temperature": np.where(np.arange(7) < 3, 35.0, math.nan) + 0 * t,
    }


def run(values, data, dt=DT):
    joints = data["joint_position"].shape[1]
    params = fusion.configure(values, None, dt)
    state, sample, outputs = fusion.initial_state(params), fusion.new_sample(joints), []
    for k in range(len(data["joint_position"])):
        for name in SAMPLE:
            sample.view(name)[...] = data[name][k]
        output, state = fusion.step(params, state, sample, dt)
        outputs.append(output)
    return outputs


def column(outputs, name):
    return np.array([output.view(name).copy() for output in outputs])


@pytest.mark.parametrize("source", ["resolver", "complementary"])
def test_compiled_law_equals_the_plain_one(source):
    values, data = calibrated(joint_position_source=source), signals()
    outputs = run(values, data)
    pole, weight = derivative_pole(200.0, DT), 1 - math.exp(-values["crossover"] * DT)
    for j in range(7):
        one = {n: v[j] for n, v in values.items() if isinstance(v, list)}
        oracle = Joint(one, source, pole, weight, DT)
        names = ("motor_shaft_position", "joint_position", "gauge_torque", "motor_temperature")
        wanted = np.array([oracle.step(*(data[n][k, j] for n in names)) for k in range(len(outputs))])
        for i, name in enumerate(STATE):
            size = np.abs(wanted[:, i]).max()
            # positions lose digits in theta/N - q and the difference quotient divides them by dt
            limit = 1e-10 * size if "velocity" in name else 1e-13 * (size + 1)
            assert np.abs(column(outputs, name)[:, j] - wanted[:, i]).max() <= limit, name
    assert np.array_equal(column(outputs, "motor_torque"), data["motor_torque"])


def test_f06_a_wrapping_encoder_gives_the_state_of_a_multi_turn_one():
    values, data = calibrated(), signals(ticks=2000)
    whole = run(values, data)
    period = {"motor_shaft_position": 2 * math.pi, "joint_position": 0.5}
    wrapped = data | {n: (data[n] + p / 2) % p - p / 2 for n, p in period.items()}
    assert np.abs(np.diff(wrapped["motor_shaft_position"], axis=0)).max() > 6, "the wraps must be there"
    seen = run(values | {"encoder_period": [2 * math.pi] * 7, "resolver_period": [0.5] * 7}, wrapped)
    first = {n: np.round((data[n][0] - wrapped[n][0]) / p) * p for n, p in period.items()}
    gear = np.array(values["gear_ratio"])
    assert (
        np.abs(column(seen, "joint_position") + first["joint_position"] - column(whole, "joint_position")).max() < 1e-9
    )
    shift = first["motor_shaft_position"] / gear
    assert np.abs(column(seen, "motor_position") + shift - column(whole, "motor_position")).max() < 1e-9
    for name in ("joint_velocity", "motor_velocity"):
        # a rounding of 1e-13 rad in a position, divided by dt
        assert np.abs(column(seen, name) - column(whole, name)).max() < 1e-9


def slow_motion(values, speed=0.01, ticks=3000, bits=16, torque=0.0):
    """Constant speed; both position sensors quantised; the true kinematic error is the one in `values`."""
    t = DT * np.arange(ticks)[:, None]
    q = 0.1 + speed * t * np.ones(7)
    gear, stiffness = np.array(values["gear_ratio"]), np.array(values["torsional_stiffness"])
    phi = q + torque / stiffness
    for _ in range(60):
        error = sum(
            np.array(values[f"kinematic_cosine_{n}"]) * np.cos(n * gear * phi)
            + np.array(values[f"kinematic_sine_{n}"]) * np.sin(n * gear * phi)
            for n in range(1, 5)
        )
        phi = 0.5 * (phi + q + torque / stiffness - error)
    data = signals(ticks)
    data["motor_shaft_position"] = quantise(gear * phi, 2 * math.pi / 4000)
    data["joint_position"] = quantise(q, joint_count(bits))
    data["gauge_torque"] = np.full_like(q, torque)
    return q, data


def test_complementary_position_resolves_less_than_a_count():
    values = shipped(kinematic_sine_2=[2.9e-4] * 7, kinematic_cosine_4=[5e-5] * 7, crossover=20.0)
    q, data = slow_motion(values, torque=20.0)
    late = slice(1000, None)
    error = {
        source: column(run(values | {"joint_position_source": source}, data), "joint_position")[late] - q[late]
        for source in ("resolver", "complementary")
    }
    count = joint_count(16)
    assert np.abs(error["resolver"]).max() > 0.49 * count
    # left: the resolver's saw-tooth (104 counts/s) through the 20 rad/s low-pass, and one motor count of 1.3e-5 rad
    assert np.abs(error["complementary"]).max() < 0.35 * count
    assert motor_count(4000, 120.0) < 0.14 * count


def test_complementary_position_at_rest_is_the_resolver():
    """A wrong stiffness or kinematic error may not leave an offset."""
    values = shipped(joint_position_source="complementary", torsional_stiffness=[1e3] * 7)
    _, data = slow_motion(values, speed=0.0, torque=10.0)
    for name in data:
        data[name] = np.repeat(data[name][:1], 3000, axis=0)
    data["gauge_torque"][0] = 0.0
    outputs = run(values, data)
    # the bias starts 10/1e3 rad wrong and decays with exp(-20 t): below 1e-25 rad after 3 s, rounding is 1e-16
    assert np.abs(column(outputs, "joint_position")[-1] - data["joint_position"][0]).max() < 1e-14
    assert np.abs(column(outputs, "joint_position")[1] - data["joint_position"][0]).max() > 9e-3


def test_permuting_the_joints_permutes_the_result():
    values, data, order = calibrated(joint_position_source="complementary"), signals(50), [4, 0, 6, 2, 5, 1, 3]
    outputs = run(values, data)
    turned = {n: [v[i] for i in order] if isinstance(v, list) else v for n, v in values.items()}
    others = run(turned, {n: v[:, order] for n, v in data.items()})
    for a, b in zip(outputs, others, strict=True):
        for name, value in b.as_dict().items():
            assert value.tobytes() == a.view(name)[order].tobytes(), name


@pytest.mark.parametrize("bad", [math.nan, math.inf, -math.inf])
@pytest.mark.parametrize("name", ["motor_shaft_position", "joint_position", "gauge_torque"])
@pytest.mark.parametrize("source", ["resolver", "complementary"])
def test_a_bad_reading_is_shown_and_forgotten(name, bad, source):
    values, data = calibrated(joint_position_source=source), signals(1500)
    clean = run(values, data)
    spoilt = data | {name: data[name].copy()}
    spoilt[name][20, 3] = bad
    outputs = run(values, spoilt)
    assert not np.all(np.isfinite(outputs[20].array))
    others = [0, 1, 2, 4, 5, 6]
    for field in STATE:
        assert np.array_equal(column(outputs, field)[:, others], column(clean, field)[:, others])
        assert np.all(np.isfinite(column(outputs, field)[21:]))
        # D forgets with 0.8^k, the crossover with exp(-20 t): 1500 samples leave nothing but its last few digits
        assert column(outputs, field)[-1, 3] == pytest.approx(column(clean, field)[-1, 3], abs=1e-6)


def test_an_absurd_reading_leaves_the_memory_finite():
    """1e308 is for the spike monitor to refuse; here it may only not turn the memory into infinities."""
    for name in ("motor_shaft_position", "joint_position", "gauge_torque"):
        params = fusion.configure(calibrated(joint_position_source="complementary"), None, DT)
        state, sample = fusion.initial_state(params), fusion.new_sample(7)
        for value in (0.1, 1e308, -1e308, 0.1, 1e308):
            sample.view(name)[...] = value
            _, state = fusion.step(params, state, sample, DT)
            assert np.all(np.isfinite(state.array))


def test_a_bad_first_sample_delays_the_start():
    values, data = calibrated(), signals(20)
    data["joint_position"][0, 2] = math.nan
    outputs = run(values, data)
    assert outputs[1].joint_velocity[2] == 0.0, "the filter starts with its first good sample"
    assert np.all(np.isfinite(column(outputs, "joint_velocity")[1:]))


def test_step_changes_none_of_its_arguments():
    params = fusion.configure(calibrated(), None, DT)
    state, sample = fusion.initial_state(params), fusion.new_sample(7)
    sample.motor_shaft_position, sample.gauge_torque = 3.0, 1.0
    before = [block.array.copy() for block in (params, state, sample)]
    fusion.step(params, state, sample, DT)
    for old, block in zip(before, (params, state, sample), strict=True):
        assert old.tobytes() == block.array.tobytes()


@pytest.mark.parametrize(
    ("change", "text"),
    [
        ({"gauge_joint_turns": [0.5] + [0.0] * 6}, "0.5 is not 0"),
        ({"gauge_gain": [0.0] * 7}, "gauge_gain"),
        ({"derivative_cutoff": 4000.0}, "half the sample rate"),
        ({"joint_position_source": "encoder"}, "one of resolver, complementary"),
        ({"encoder_period": [-1.0] * 7}, "encoder_period"),
    ],
)
def test_bad_values_are_refused(change, text):
    with pytest.raises(ConfigError, match=text):
        fusion.configure(shipped(**change), None, DT)
