"""From a model file to a task: what the model says becomes units, priors, known columns and written coefficients."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from plain_joint import NAME, PLAIN, joint_model, link_of, model, recording, signals
from test_balance_equations import rms

from hd_control.drive.effect import COULOMB, LINK, MOTOR, TRANSMISSION, VISCOUS
from hd_control.drive.model import JointModel, ModelValue
from hd_control.lab.diagnosis.corrections import known_candidates
from hd_control.lab.diagnosis.dictionary import build
from hd_control.lab.diagnosis.fit import RawRows
from hd_control.lab.diagnosis.task import equations_of, known_effects, task_of, written_coefficients
from hd_control.lab.models.answers import joint_task

RIGHT = joint_model()


def with_value(effect: str, name: str, value: ModelValue) -> JointModel:
    """The plain model with one value changed."""
    return RIGHT.with_effect(effect, {**RIGHT.effects.get(effect, {}), name: value})


def prior_of(joint: JointModel, channel: str = MOTOR) -> float:
    """The prior that the balance of a slow motion gives the inertia correction."""
    from test_balance_equations import slow

    recorded = slow()
    time = recorded.states.time
    still = replace(
        signals(),
        time=time,
        valid=np.ones(time.size, bool),
        motor_shaft_position=recorded.derived.filled["motor_position"] * joint.gear_ratio,
        joint_position=recorded.derived.filled["joint_position"],
        gauge_torque=recorded.derived.filled["gauge_torque"],
        motor_torque=recorded.derived.filled["motor_torque"],
    )
    channel_of = equations_of(still, joint, link_of(still)).channels[channel]
    return next(base.prior for base in channel_of.base if base.name == "inertia_correction")


@pytest.mark.parametrize(
    ("value", "prior"),
    [
        (ModelValue(0.8, source="datasheet"), 0.1),
        (ModelValue(0.8, source="measured"), 0.05),
        (ModelValue(0.8, source="fitted"), 0.05),
        (ModelValue(0.8, source="guess"), 1.0),
        (ModelValue(0.8), 0.1),
        (ModelValue(0.8, source="guess", interval=(0.72, 0.88)), 0.05),
        (ModelValue(0.8, source="fitted", interval=(0.8, 0.8)), 1e-3),
    ],
)
def test_how_sure_an_inertia_is_follows_from_its_interval_or_its_source(value: ModelValue, prior: float) -> None:
    """Four standard deviations make a 95 % interval; without one the source counts."""
    assert prior_of(with_value("rotor_inertia", "rotor_inertia", value)) == pytest.approx(prior)


def test_units_of_the_balances_are_those_of_the_model() -> None:
    heavy = with_value("rotor_inertia", "rotor_inertia", ModelValue(1.6))
    found = equations_of(signals(), heavy, link_of(signals()))
    assert found.inertia == 1.6
    bare = joint_model(without=("rotor_inertia",))
    assert equations_of(signals(), bare, None).inertia == 1.0, "without a value the unit is 1 kg m^2"


def test_a_stiffness_of_the_model_stands_in_where_none_is_measured() -> None:
    blind = replace(signals(), joint_position=None)
    assert equations_of(blind, RIGHT, None).states.torsional_compliance == pytest.approx(1.0 / PLAIN.stiffness)
    bare = joint_model(without=("torsional_stiffness",))
    assert equations_of(blind, bare, None).states.torsional_compliance == 0.0
    measured = equations_of(signals(), with_value("torsional_stiffness", "torsional_stiffness", ModelValue(1e4)), None)
    assert measured.states.torsional_compliance == pytest.approx(1.0 / PLAIN.stiffness, rel=1e-3), "measured counts"


def test_a_delay_of_the_model_is_applied_and_not_known_twice() -> None:
    late = with_value("actuation_delay", "delay", ModelValue(2e-3))
    plain, shifted = (equations_of(signals(), joint, None).channels[MOTOR] for joint in (RIGHT, late))
    torque = [-base.column for channel in (plain, shifted) for base in channel.base if base.name == "drive_torque"]
    # u(t) - u(t - D) is D u' to first order; the filter rounds its corners.
    rate = next(base.column for base in plain.base if base.name == "command_delay")
    np.testing.assert_allclose((torque[0] - torque[1])[100:-100], 2e-3 * rate[100:-100], atol=0.1 * 2e-3 * rate.max())
    assert known_effects(late, late.context(10.0)) == ()


def test_known_effects_are_those_beyond_every_model_with_their_values() -> None:
    loaded = RIGHT.with_effect("payload", {"gravity_sine": ModelValue(5.0), "gravity_cosine": ModelValue(1.0)})
    loaded = loaded.with_effect("stribeck_friction", {"stribeck_ratio": ModelValue(1.5),
                                                      "stribeck_velocity": ModelValue(0.1)})  # fmt: skip
    (payload, shape, values), (stribeck, grid, rise) = known_effects(loaded, loaded.context(10.0))
    assert (payload.name, stribeck.name) == ("payload", "stribeck_friction")
    assert dict(zip(payload.coefficient_names(shape), values, strict=True)) == {
        "gravity_cosine": 1.0, "gravity_sine": 5.0}  # fmt: skip
    assert grid == {"stribeck_velocity": 0.1} and rise == pytest.approx([0.5 * PLAIN.coulomb])


def test_the_right_model_written_down_closes_every_balance() -> None:
    """Residuals of its own values, nothing fitted, against the left sides; noise is 1 to 2 %."""
    task = task_of(signals(), RIGHT, link_of(signals()))
    dictionary = build(task.equations, (), known_candidates(task))
    written = written_coefficients(dictionary, RIGHT, task.context)
    for name, residual in RawRows(dictionary, ()).residual(written).items():
        channel = task.equations.channels[name]
        assert rms(residual[channel.fitted]) < 0.03 * channel.left[channel.fitted].std(), name
    by_name = dict(zip(dictionary.base_names, written, strict=False))
    assert by_name[MOTOR, "drive_torque"] == by_name[LINK, "drive_torque"] == 1.0
    assert by_name[MOTOR, COULOMB] == PLAIN.coulomb and by_name[MOTOR, VISCOUS] == PLAIN.viscous
    assert by_name[TRANSMISSION, "torsional_compliance"] == 1.0 / PLAIN.stiffness
    around = task.equations.channels[TRANSMISSION].damping_time
    assert by_name[TRANSMISSION, "torsional_damping"] == pytest.approx((PLAIN.damping_time - around) / PLAIN.stiffness)


def test_a_zero_of_the_joint_sensor_is_a_written_value_too() -> None:
    zero = with_value("torsional_stiffness", "transmission_zero", ModelValue(2e-5))
    task = task_of(signals(), zero, link_of(signals()))
    dictionary = build(task.equations, ())
    written = written_coefficients(dictionary, zero, task.context)
    assert written[dictionary.base_index(TRANSMISSION, "transmission_zero")] == 2e-5


def test_a_task_holds_the_library_the_context_and_the_rated_torque() -> None:
    task = joint_task(recording(signals()), model(), NAME)
    assert task.rated_torque == 40.0 and task.known == ()
    assert task.context.torsional_stiffness == PLAIN.stiffness and task.context.coulomb_torque == PLAIN.coulomb
    assert task.context.torque_scale == task.equations.states.torque_scale
    assert {"payload", "kinematic_error"} < set(task.library)
