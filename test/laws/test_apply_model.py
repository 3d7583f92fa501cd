"""Rules, units and signs of a model in the controllers: against the model's own effects, and in the closed loop."""

import math

import numpy as np
import pytest
from oracles.kinematic_error import kinematic_error

from hd_control.chain.chain import shipped_values
from hd_control.core.errors import ConfigError
from hd_control.core.parameters import Shape
from hd_control.drive.model import JointModel, Model, ModelValue
from hd_control.laws import fusion, torque
from hd_control.laws.from_model import PARAMETERS, apply_model
from hd_sim.plant_config import PlantConfig
from hd_sim.runner import Runner, RunSetup
from hd_sim.scenario import find_scenario, make_plan
from hd_sim.truth import HiddenEffect, apply_hidden, nominal

JOINT = "joint_3"
NO_FRICTION = ("coulomb_torque_initial", "friction_offset_initial", "viscous_positive_initial",
               "viscous_negative_initial", "load_friction_linear", "load_friction_quadratic")  # fmt: skip


def fitted(value, width=0.03):
    """A fitted value with an interval of `width` to both sides, relative."""
    ends = sorted(((1 - width) * value, (1 + width) * value))
    return ModelValue(float(value), source="fitted", interval=(ends[0], ends[1]))


def model_of(width=0.03, joint=JOINT, ratio=120.0, **effects):
    """A model of one joint with fitted values."""
    values = {name: {key: fitted(v, width) for key, v in given.items()} for name, given in effects.items()}
    return Model(None, {joint: JointModel(ratio, effects=values)})


def shipped(**changes):
    """Shipped values of both nodes; lists of one number hold for every joint."""
    found = {
        node: {k: v for k, v in shipped_values(node).items() if k in PARAMETERS[node].names} for node in PARAMETERS
    }
    for name, value in changes.items():
        for node, about in PARAMETERS.items():
            if name in about.names:
                found[node][name] = [value] * 7 if about[name].shape is Shape.PER_JOINT else value
    return found


def settings(applied, node):
    """Changed values of joint 3 by parameter."""
    found = applied.changed(node)
    return {name: value[2] if isinstance(value, list) else value for name, value in found.items()}


def reasons(applied):
    return {row.effect: row.note for row in applied.rows if not row.applied}


def test_friction_becomes_start_values_with_slow_adaptation():
    model = model_of(
        coulomb_friction={"coulomb_torque": 20.0},
        viscous_friction={"viscous": 250.0},
        asymmetric_friction={"friction_offset": -3.0, "viscous_asymmetry": -20.0},
        load_dependent_friction={"load_friction_linear": 2e-3},
    )
    applied = apply_model(model, shipped(adaptation_scale=1.0))
    found = settings(applied, "torque_node")
    assert found == {
        "adaptation_scale": 0.1, "coulomb_torque_initial": 18.0, "friction_offset_initial": -3.0,
        "viscous_positive_initial": 230.0, "viscous_negative_initial": 270.0,
        "load_friction_linear": 2e-3, "load_friction_quadratic": 0.0,
    }  # fmt: skip
    assert applied.changed("fusion_node") == {} and applied.changed("torque_node", live=True).keys() == found.keys()
    others = [row for name, value in applied.changed("torque_node").items() if isinstance(value, list)
              for row in (0, 1, 3, 4, 5, 6) if value[row] != applied.before["torque_node"][name][row]]  # fmt: skip
    assert others == [], "other joints keep their values"


def test_a_coulomb_value_brings_its_own_friction_model():
    found = settings(apply_model(model_of(coulomb_friction={"coulomb_torque": 20.0}), shipped()), "torque_node")
    assert found["load_friction_linear"] == found["load_friction_quadratic"] == found["friction_offset_initial"] == 0.0


def test_only_what_the_data_show_is_used():
    wide = model_of(width=1.5, kinematic_error={"cosine_2": 1e-4}, coulomb_friction={"coulomb_torque": 20.0})
    applied = apply_model(wide, shipped())
    assert reasons(applied) == dict.fromkeys(("kinematic_error", "coulomb_friction"), "its 95 % interval holds zero")
    sheet = Model(None, {JOINT: JointModel(120.0, effects={"viscous_friction": {"viscous": ModelValue(2.0)}})})
    assert "no interval" in reasons(apply_model(sheet, shipped()))["viscous_friction"]
    assert all(applied.changed(node) == {} for node in PARAMETERS)
    sure = model_of(gauge_offset={"gauge_offset": 2.0})
    doubt = apply_model(sure, shipped(), ambiguous={JOINT: {"gauge_offset": ["asymmetric_friction"]}})
    assert reasons(doubt) == {"gauge_offset": "its name is not certain: it may be asymmetric_friction"}


@pytest.mark.parametrize(
    ("effects", "words"),
    [
        ({"torsional_hysteresis": {"hysteresis_stiffness": 3e4, "hysteresis_rate": 4e3}}, "torque sensor"),
        ({"actuation_delay": {"delay": 1e-3}}, "stability"),
        ({"stribeck_friction": {"stribeck_ratio": 1.4, "stribeck_velocity": 0.05}}, "no Stribeck part"),
        ({"joint_sensor_eccentricity": {"cosine_1": 4e-5, "sine_1": 1e-5}}, "no such correction"),
        ({"kinematic_error": {"cosine_2": 5e-3, "sine_2": 0.0}}, "limit: N dKE/dtheta"),
        ({"torsional_stiffness": {"torsional_stiffness": 1e5}}, "limit: joint_3"),
        ({"motor_cogging": {"cogging_order": 6.0, "cogging_amplitude": 2.0}}, "no such term"),
    ],
)
def test_what_is_not_applied_says_why(effects, words):
    applied = apply_model(model_of(**effects), shipped())
    assert words in reasons(applied)[next(iter(effects))]
    assert all(applied.changed(node) == {} for node in PARAMETERS)


def test_a_start_value_stays_inside_the_bounds_of_its_estimate():
    applied = apply_model(model_of(coulomb_friction={"coulomb_torque": 60.0}), shipped())
    assert settings(applied, "torque_node")["coulomb_torque_initial"] == 35.0
    assert any("limited by coulomb_torque_high" in row.note for row in applied.rows)
    torque.configure(dict(applied.values["torque_node"]), None, 1e-3)


def test_the_papers_laws_take_what_they_have():
    model = model_of(
        coulomb_friction={"coulomb_torque": 20.0},
        torsional_hysteresis={"hysteresis_stiffness": 3e4, "hysteresis_rate": 5e3},
    )
    found = settings(apply_model(model, shipped(law="integral_manifold")), "torque_node")
    assert found == {"rotor_coulomb": 18.0, "hysteresis_stiffness": 3e4, "hysteresis_rate": 5e3}
    assert settings(apply_model(model, shipped(law="torque_feedback")), "torque_node") == {"feedback_friction": 18.0}
    assert "no such term" in reasons(apply_model(model, shipped(law="direct")))["coulomb_friction"]


def test_a_model_of_other_joints_is_refused():
    with pytest.raises(ConfigError, match="no joint in common"):
        apply_model(model_of(joint="elbow", coulomb_friction={"coulomb_torque": 2.0}), shipped())
    with pytest.raises(ConfigError, match="joint_9: the model has joint_3"):
        apply_model(model_of(coulomb_friction={"coulomb_torque": 2.0}), shipped(), joints=["joint_9"])


@pytest.mark.parametrize("turn", [0.0, 1.0, -1.0])
def test_fusion_inverts_the_gauge_of_the_model(turn, rng):
    """tau = tau_s (1 - g/(1+g)) - offset - ripple over theta + turn q, as the model's columns say, with all offsets."""
    ripple = {"cosine_2": 0.9, "sine_2": -0.4, "cosine_4": 0.3, "sine_4": 0.2}
    model = model_of(
        gauge_gain={"gauge_gain_error": 0.03},
        gauge_offset={"gauge_offset": -2.0},
        gauge_ripple={**ripple, "joint_turn": turn},
    )
    given = shipped(encoder_offset=0.7, resolver_offset=-0.2, gauge_angle_offset=0.4)
    values = dict(apply_model(model, given).values["fusion_node"])
    params = fusion.configure(values, None, 1e-3)
    for _ in range(20):
        shaft, joint, indicated = rng.uniform(-50, 50), rng.uniform(-3, 3), rng.uniform(-80, 80)
        sample = fusion.new_sample(7)
        sample.motor_shaft_position, sample.joint_position, sample.gauge_torque = shaft, joint, indicated
        output, _ = fusion.step(params, fusion.initial_state(params), sample, 1e-3)
        beta = shaft + turn * joint
        waves = [ripple[f"cosine_{n}"] * math.cos(n * beta) + ripple[f"sine_{n}"] * math.sin(n * beta) for n in (2, 4)]
        assert output.joint_torque[2] == pytest.approx(indicated / 1.03 + 2.0 - sum(waves), abs=1e-10)


def test_the_kinematic_error_follows_the_encoder_offset():
    given, offset = {"cosine_1": 1e-5, "sine_2": -2e-5, "cosine_4": 3e-6, "sine_4": 4e-6}, 1.1
    model = model_of(kinematic_error=given)
    found = settings(apply_model(model, shipped(encoder_offset=offset)), "torque_node")
    new = [[found.get(f"kinematic_{kind}_{n}", 0.0) for n in range(1, 5)] for kind in ("cosine", "sine")]
    old = [[given.get(f"{kind}_{n}", 0.0) for n in range(1, 5)] for kind in ("cosine", "sine")]
    raw = np.linspace(0.0, 6.0, 50)
    np.testing.assert_allclose(kinematic_error(raw - offset, *new)[0], kinematic_error(raw, *old)[0], atol=1e-18)


def track(config, values, scenario):
    """RMS and largest true joint error in the scenario's window, rad."""
    runner = Runner(RunSetup(config, 0, values))
    start, limit = runner.world.seam.plant.config.start_position, runner.goal_limits.velocity
    plan = make_plan(find_scenario(scenario), runner.robot.joint_names, start, limit, runner.period)
    first, last = (round(time * 1e3) for time in plan.window)
    run = runner.record(dict(plan.goals), last)
    assert not run.stopped
    window = (run.desired - run.true_position)[first:last]
    return float(np.sqrt(np.mean(window**2))), float(np.abs(window).max())


def friction_of(config):
    """The true Coulomb and viscous friction of joint 0 as fitted effects."""
    drives = config.drives
    return {"coulomb_friction": {"coulomb_torque": drives["coulomb_torque"][0]},
            "viscous_friction": {"viscous": drives["viscous_positive"][0]}}  # fmt: skip


def after(config, values, model):
    """Values by node with the model applied."""
    setup = RunSetup(config, 0, values)
    applied = apply_model(model, {node: setup.node_values(node) for node in PARAMETERS})
    return {node: dict(found) for node, found in applied.values.items()}


@pytest.mark.parametrize("scenario", ["sine_joint_3_0p5hz", "sine_joint_5_0p5hz", "sine_joint_7_0p5hz"])
def test_the_same_goal_with_identified_friction_has_half_the_error(scenario):
    name = scenario[5:12]
    config = nominal(PlantConfig.from_file(f"single_{name}"))
    before = {"torque_node": {key: [0.0] * 7 for key in NO_FRICTION}}
    model = model_of(joint=name, ratio=float(config.drives["gear_ratio"][0]), **friction_of(config))
    rms, largest = track(config, before, scenario)
    better_rms, better_largest = track(config, after(config, before, model), scenario)
    print(f"{scenario}: RMS {1e6 * rms:.3g} -> {1e6 * better_rms:.3g} microrad")
    assert better_rms < 0.5 * rms and better_largest < 0.5 * largest


@pytest.mark.parametrize(
    ("scenario", "share"), [("sine_joint_3_0p5hz", 0.5), ("sine_joint_5_0p5hz", 0.5), ("sine_joint_7_0p5hz", 0.8)]
)
def test_the_same_goal_with_the_kinematic_error_has_a_smaller_error(scenario, share):
    """Friction is known before and after; with the wrong sign the error grows, so the sign is the right one.

    Half the error on joints 3 and 5; on joint 7 quantisation and the noise of its small drive stay.
    """
    name = scenario[5:12]
    plain = nominal(PlantConfig.from_file(f"single_{name}"))
    config = apply_hidden(plain, [HiddenEffect(0, "kinematic_error", 4.0)], 3)
    ratio = float(config.drives["gear_ratio"][0])
    before = after(config, {}, model_of(joint=name, ratio=ratio, **friction_of(config)))
    waves = {f"{kind}_{n}": config.drives[f"kinematic_{kind}"][0][n - 1] for kind in ("cosine", "sine") for n in (2, 4)}
    rms, _ = track(config, before, scenario)
    found = {}
    for sign in (1.0, -1.0):
        model = model_of(joint=name, ratio=ratio, kinematic_error={key: sign * w for key, w in waves.items()})
        found[sign] = track(config, after(config, before, model), scenario)[0]
    print(f"{scenario}: RMS {1e6 * rms:.3g} -> {1e6 * found[1.0]:.3g} microrad")
    assert found[1.0] < share * rms
    assert found[-1.0] > 1.5 * rms
