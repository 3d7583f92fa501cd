"""Innovations of the plain joint: white where the model is right, a core that comes right, columns from the past."""

from __future__ import annotations

from dataclasses import replace
from functools import lru_cache

import numpy as np
import pytest
from plain_joint import NAME, PLAIN, joint_model, model, recording, signals

from hd_control.drive.effect import COULOMB, GAUGE, LINK, MOTOR, TRANSMISSION
from hd_control.drive.model import Model, ModelValue
from hd_control.lab.diagnosis.corrections import Task
from hd_control.lab.innovations.core import JOINT_SENSOR, MOTOR_SENSOR, SENSORS, TORQUE_SENSOR
from hd_control.lab.innovations.equations import (
    Innovations,
    acting,
    base_columns,
    change_of,
    innovations,
    late,
    readings_of,
)
from hd_control.lab.models.answers import joint_task
from hd_control.lab.signals.joint_signals import JointSignals


def task_for(recorded: JointSignals, about: Model | None = None) -> Task:
    return joint_task(recording(recorded), about or model(), NAME)


def of(recorded: JointSignals, about: Model | None = None) -> Innovations:
    task = task_for(recorded, about)
    assert task.given is not None
    return innovations(task.given(), task.equations)


@lru_cache(maxsize=1)
def plain() -> Innovations:
    return of(signals())


def test_where_the_model_is_right_the_innovations_are_white_and_small() -> None:
    found = plain()
    assert list(found.channels) == list(SENSORS) and found.held
    for channel in found.channels.values():
        left = channel.left[channel.fitted]
        pairs = channel.fitted[1:] & channel.fitted[:-1]
        lag = np.mean(channel.left[1:][pairs] * channel.left[:-1][pairs]) / np.mean(left**2)
        assert abs(lag) < 0.35, channel.name
        expected = float(np.sum(np.square(found.filter_core.taps)))
        assert np.mean(left**2) < 2.0 * expected


def test_the_core_comes_right_from_a_data_sheet_that_is_wrong() -> None:
    about = joint_model()
    wrong = {
        "rotor_inertia": {"rotor_inertia": 1.05 * PLAIN.rotor_inertia},
        "coulomb_friction": {"coulomb_torque": 0.8 * PLAIN.coulomb},
        "torsional_stiffness": {"torsional_stiffness": 1.08 * PLAIN.stiffness, "damping_time": PLAIN.damping_time},
    }
    for effect, values in wrong.items():
        about = about.with_effect(effect, {n: ModelValue(v, "", source="datasheet") for n, v in values.items()})
    numbers = of(signals(), Model(None, {NAME: about})).filter_core.numbers
    assert numbers.rotor_inertia == pytest.approx(PLAIN.rotor_inertia, rel=5e-3)
    assert numbers.stiffness == pytest.approx(PLAIN.stiffness, rel=1e-2)
    assert numbers.coulomb == pytest.approx(PLAIN.coulomb, rel=2e-2)
    assert numbers.link_scale == pytest.approx(1.0, rel=5e-3)


def test_a_torque_that_is_a_sample_at_its_stamp_is_recognised() -> None:
    held = signals()
    assert held.motor_torque is not None
    sampled = 0.5 * (held.motor_torque + np.concatenate([held.motor_torque[:1], held.motor_torque[:-1]]))
    assert not of(replace(held, motor_torque=sampled)).held


@pytest.mark.parametrize(
    ("gone", "left"),
    [
        (("joint_position",), (MOTOR_SENSOR, TORQUE_SENSOR)),
        (("gauge_torque",), (MOTOR_SENSOR, JOINT_SENSOR)),
        (("motor_shaft_position", "motor_torque"), (JOINT_SENSOR, TORQUE_SENSOR)),
        (("motor_shaft_position", "gauge_torque"), (JOINT_SENSOR,)),
        (("motor_torque",), SENSORS),
    ],
)
def test_a_signal_that_is_not_there_drops_out(gone: tuple[str, ...], left: tuple[str, ...]) -> None:
    found = of(replace(signals(), **dict.fromkeys(gone)))
    assert tuple(found.channels) == tuple(left)
    owners = {base.owner for base in next(iter(found.channels.values())).base}
    assert (MOTOR in owners) == ("motor_torque" not in gone)
    for channel in found.channels.values():
        assert np.isfinite(channel.left).all() and np.isfinite(channel.base_matrix).all()


def test_states_are_predicted_from_the_past_alone() -> None:
    found = plain()
    assert found.fitting is not None
    fitting, core, cut = found.fitting, found.filter_core, 20_000
    later = fitting.readings.sensors.copy()
    later[cut:] += 0.1
    moved = replace(fitting, readings=replace(fitting.readings, sensors=later))
    other = moved.at(type(core)(moved.readings, core.numbers, core.share, core.held))
    for name in ("motor_velocity", "motor_position", "joint_torque", "joint_velocity", "motor_acceleration"):
        first, second = getattr(found.states, name), getattr(other.states, name)
        assert np.array_equal(first[:cut], second[:cut]), name
        assert not np.allclose(first[cut + 1 :], second[cut + 1 :]), name


def test_columns_act_where_the_effect_says() -> None:
    columns = {MOTOR: np.ones((3, 1)), LINK: np.full((3, 1), 2.0), TRANSMISSION: np.full((3, 1), 3.0)}
    assert acting(columns, "") is columns
    assert acting(columns, GAUGE) == {GAUGE: columns[LINK]}
    assert acting(columns, JOINT_SENSOR) == {JOINT_SENSOR: columns[TRANSMISSION]}


def test_what_the_gauge_misreads_moves_nothing_before_it_reads() -> None:
    """A step of the gauge is in the torque's innovation at once, in another one's only when the filter believes it."""
    found = plain()
    step = np.zeros((found.states.time.size, 1))
    step[12_000:] = 1.0
    rows = found.rows_of({MOTOR: -step, LINK: step}, GAUGE)
    at = 12_000 // found.filter_core.stride
    assert np.abs(rows[TORQUE_SENSOR][at]).max() > 10.0 * np.abs(rows[MOTOR_SENSOR][at]).max()
    forces = found.rows_of({MOTOR: -step, LINK: step})
    assert not np.allclose(forces[TORQUE_SENSOR], rows[TORQUE_SENSOR])


def test_the_base_names_its_numbers_and_their_values_are_the_cores() -> None:
    found = plain()
    names = {(key, prior) for key, prior, _ in base_columns(found.filter_core, found.states)}
    assert {key for key, _ in names} >= {
        (MOTOR, COULOMB),
        (TRANSMISSION, "torsional_compliance"),
        (LINK, "inertia_correction"),
    }
    assert found.offset(MOTOR, COULOMB) == found.filter_core.numbers.coulomb
    assert found.offset(TRANSMISSION, "torsional_compliance") == 1.0 / found.filter_core.numbers.stiffness
    assert found.offset(MOTOR, "inertia_correction") == 0.0
    assert found.damping_time == found.filter_core.numbers.damping_time
    change = change_of(found)
    assert abs(change[MOTOR, "inertia_correction"]) < 5e-3


def test_states_beside_a_known_effect_are_those_of_the_joint_with_it() -> None:
    """A gauge that reads 2 N m too much: beside it the predicted torque is the joint's own again."""
    recorded = signals()
    assert recorded.gauge_torque is not None
    found = of(replace(recorded, gauge_torque=recorded.gauge_torque + 2.0))
    ones = np.ones((recorded.time.size, 1))
    beside = found.beside({}, [({MOTOR: -2.0 * ones, LINK: 2.0 * ones}, GAUGE)])
    true, use = plain().states.joint_torque, plain().derived.usable
    without = np.abs(found.states.joint_torque - true)[use].mean()
    assert np.abs(beside.states.joint_torque - true)[use].mean() < 0.3 * without


def test_readings_count_from_the_first_angle_and_hold_the_known_delay() -> None:
    task = task_for(signals())
    assert task.given is not None
    readings, origin = readings_of(replace(task.given(), command_delay=1.5e-3), task.equations)
    assert readings.sensors[0, 0] == 0.0 and origin == task.equations.derived.filled["motor_position"][0]
    assert readings.torque is not None and signals().motor_torque is not None
    assert np.allclose(readings.torque, late(signals().motor_torque, 1.5e-3 / signals().period))  # type: ignore[arg-type]
    assert late(np.array([0.0, 1.0, 1.0, 1.0]), 1.5).tolist() == [0.0, 0.0, 0.5, 1.0]
