"""Every effect keeps the contract of `hd_control/drive/effect.py`: the tests range over the whole family."""

from __future__ import annotations

import inspect
import re
from dataclasses import replace

import numpy as np
import pytest
from drive.drive_cases import CONTEXT, moving, states_of

from hd_control.drive.effect import (
    BASE_NUMBERS,
    CHANNELS,
    GAUGE,
    JOINT_SENSOR,
    LINK,
    MOTOR,
    TORSION_FAMILY,
    TRANSMISSION,
    Effect,
)
from hd_control.drive.library import base_numbers, library, names_in_every_model, names_that_may_be_missing
from hd_control.drive.needs import VARIED_LOOPS, Covered
from hd_control.drive.predict import rows_of

IN_EVERY_MODEL = {"rotor_inertia", "torsional_stiffness", "coulomb_friction", "viscous_friction", "link_dynamics"}
MAY_BE_MISSING = set(
    "kinematic_error torsional_hysteresis nonlinear_stiffness backlash load_dependent_friction stribeck_friction "
    "asymmetric_friction quadratic_drag temperature_friction presliding motor_cogging torque_constant_error "
    "actuation_delay gauge_ripple gauge_gain gauge_offset joint_sensor_eccentricity payload link_friction "
    "structural_resonance".split()
)
SYMBOLS = {"rad", "N", "m", "s", "kg", "K", "degC", "Hz", "turn", "1"}
"""Of the units; `N m s/K`, `1/(N m)^2` and `-` are made of them."""

RICH = Covered(-50.0, 50.0, 100.0, 3.0, 100.0, 20.0, 0.3, 12.0, 1.8)
POOR = Covered(3.0, 3.1, 100.0, 0.01, 0.1, 0.0, 0.95, 2.0, 0.4)
"""A recording that covers everything, and one that covers nothing."""

every = pytest.mark.parametrize("effect", library().values(), ids=library().keys())


def forms() -> list[tuple[type[Effect], dict[str, float]]]:
    """Every effect with every form of its values."""
    return [(effect, dict(values)) for effect in library().values() for values in effect.examples]


each_form = pytest.mark.parametrize(("effect", "values"), forms(), ids=[f"{e.name}-{len(v)}" for e, v in forms()])


def test_the_vocabulary_stays() -> None:
    """Model files name these; a new effect may join them."""
    assert set(names_in_every_model()) == IN_EVERY_MODEL
    assert set(names_that_may_be_missing()) >= MAY_BE_MISSING


@every
def test_examples_show_every_parameter(effect: type[Effect]) -> None:
    shown = {name for values in effect.examples for name in values}
    assert shown <= {parameter.name for parameter in effect.parameters}
    assert {parameter.name for parameter in effect.parameters if parameter.default is None} <= shown
    assert all(
        parameter.low <= values[parameter.name] <= parameter.high
        for values in effect.examples
        for parameter in effect.parameters
        if parameter.name in values
    )


@every
def test_it_says_what_it_is(effect: type[Effect]) -> None:
    text = inspect.getmodule(effect).__doc__ or ""
    assert "Source:" in text and "    " in text, "equation and source"
    assert any(unit in text for unit in ("N m", "rad", "kg", " s", "-")) and effect.__doc__
    assert effect.title == effect.title.strip() and effect.evidence[0].islower() and not effect.evidence.endswith(".")
    assert getattr(effect, "__final__", False), "mark it final"
    names = [parameter.name for parameter in effect.parameters]
    assert names and len(set(names)) == len(names)
    for parameter in effect.parameters:
        assert parameter.meaning and parameter.low < parameter.high
        symbols = re.sub(r"\^\d", "", parameter.unit).replace("/", " ").replace("(", "").replace(")", "").split()
        assert parameter.unit == "-" or symbols and set(symbols) <= SYMBOLS, f"{parameter.name}: {parameter.unit}"


@every
def test_look_alikes_are_effects_with_an_experiment(effect: type[Effect]) -> None:
    for confusion in effect.confusions:
        assert confusion.effect in library() and confusion.effect != effect.name
        assert len(confusion.experiment) > 30
    assert effect.in_every_model or effect.confusions


@every
def test_reference_cases(effect: type[Effect]) -> None:
    assert effect.references
    for case in effect.references:
        found = effect.columns(states_of(**case.states), case.shape)
        assert set(found) == set(case.columns)
        for channel, expected in case.columns.items():
            np.testing.assert_allclose(found[channel], expected, rtol=case.tolerance, atol=case.tolerance)


@every
def test_shapes_give_finite_columns_of_the_named_width(effect: type[Effect]) -> None:
    states = moving()
    shapes = effect.shapes(states)
    assert len(shapes) > 0
    for shape in shapes:
        columns, names = effect.columns(states, shape), effect.coefficient_names(shape)
        assert columns and set(columns) <= set(CHANNELS) and len(set(names)) == len(names)
        for column in columns.values():
            assert column.shape == (states.time.size, len(names)) and np.isfinite(column).all()
        for entry, (low, high) in effect.shape_bounds(shape, states).items():
            assert low <= shape[entry] <= high, f"{entry} starts outside its bounds"
            for end in (low, high):
                at_end = effect.columns(states, {**shape, entry: end})
                assert all(np.isfinite(column).all() for column in at_end.values()), f"{entry} at {end}"


@every
def test_columns_do_not_change_the_states(effect: type[Effect]) -> None:
    states, before = moving(500), moving(500)
    for shape in effect.shapes(states):
        effect.columns(states, shape)
    for name, value in vars(before).items():
        assert np.array_equal(getattr(states, name), value), name


@each_form
def test_values_survive_split_and_join(effect: type[Effect], values: dict[str, float]) -> None:
    shape, coefficients = effect.split(values, CONTEXT)
    assert coefficients.shape == (len(effect.coefficient_names(shape)),)
    back = effect.join(shape, coefficients, CONTEXT)
    assert {name: back[name] for name in values} == pytest.approx(values, rel=1e-12)
    assert all(value == 0.0 for name, value in back.items() if name not in values), "join adds what split did not get"


@every
def test_what_a_fit_finds_can_be_written_and_read(effect: type[Effect]) -> None:
    """Every shape with any coefficients: values -> shape, coefficients -> the same columns."""
    states = moving(600)
    for shape in effect.shapes(states):
        coefficients = np.linspace(0.5, 1.0, len(effect.coefficient_names(shape))) * 1e-3
        coefficients = _consistent(effect, shape, coefficients)
        values = effect.join(shape, coefficients, CONTEXT)
        assert set(values) <= {parameter.name for parameter in effect.parameters}
        again, found = effect.split(values, CONTEXT)
        for channel, column in effect.columns(states, shape).items():
            expected = column @ coefficients
            scale = np.abs(expected).max() + 1e-300
            np.testing.assert_allclose(
                effect.columns(states, again)[channel] @ found, expected, atol=1e-9 * scale, err_msg=str(shape)
            )


def _consistent(effect: type[Effect], shape: object, coefficients: np.ndarray) -> np.ndarray:
    """Coefficients that a converged fit has where shape and coefficient say the same thing twice."""
    assert isinstance(shape, dict)
    if effect.name == "actuation_delay":
        return np.ones(1)
    if effect.name == "link_dynamics":  # the scale of gravity is 1: a wrong gravity is a payload
        return np.array([1.1, 1.0])
    if effect.name == "nonlinear_stiffness" and shape["form"] == "hardening":
        shape["scale"] = CONTEXT.torque_scale
        return np.array([1.0 / CONTEXT.torsional_stiffness])
    if effect.name == "torsional_hysteresis":  # A / (alpha k) with A = p k, alpha = a k
        return np.array([shape["stiffening"] / shape["torque_rate"] / CONTEXT.torsional_stiffness])
    return coefficients


@each_form
def test_columns_multiply_coefficients_only(effect: type[Effect], values: dict[str, float]) -> None:
    """The same shape gives the same columns whatever the linear values are."""
    linear = {parameter.name for parameter in effect.parameters if parameter.linear}
    doubled = {name: 2.0 * value if name in linear else value for name, value in values.items()}
    one, two = effect.split(values, CONTEXT), effect.split(doubled, CONTEXT)
    assert dict(one[0]) == dict(two[0])
    if linear & set(values) and effect.name not in ("torsional_stiffness", "link_dynamics"):
        np.testing.assert_allclose(two[1], 2.0 * one[1], rtol=1e-12)


@each_form
def test_one_row_or_many_are_the_same(effect: type[Effect], values: dict[str, float]) -> None:
    """An effect without memory sees every instant by itself."""
    states = moving(300)
    shape, _ = effect.split(values, CONTEXT)
    if effect.memory(shape, 1).size or effect.name in ("actuation_delay",):
        pytest.skip("has memory")
    whole = effect.columns(states, shape)
    for row in (0, 57, 299):
        alone = effect.columns(rows_of(states, np.array([row])), shape)
        for channel, column in whole.items():
            np.testing.assert_allclose(alone[channel], column[[row]], rtol=1e-12, atol=1e-15)


@each_form
def test_advance_walks_along_the_columns(effect: type[Effect], values: dict[str, float]) -> None:
    """Step by step and at once agree, also from a start in the middle with the past replayed."""
    states = moving(700)
    shape, coefficients = effect.split(values, CONTEXT)
    whole = {channel: column @ coefficients for channel, column in effect.columns(states, shape).items()}
    scale = {channel: np.abs(column).max() + 1e-300 for channel, column in whole.items()}
    for start in (0, 350):
        rows = np.array([start])
        memory = effect.memory(shape, 1) if start == 0 else effect.memory_along(states, shape, rows)
        for row in range(start, 700):
            columns, memory = effect.advance(rows_of(states, np.array([row])), shape, memory)
            for channel, expected in whole.items():
                error = abs(float((columns[channel] @ coefficients)[0]) - expected[row])
                assert error < 1e-9 * scale[channel], f"{channel}, row {row} from {start}"


@every
def test_independent_runs_do_not_meet(effect: type[Effect]) -> None:
    """Two runs advanced together are the two runs advanced apart."""
    states = moving(400)
    values = effect.examples[-1]
    shape, _ = effect.split(values, CONTEXT)
    both, apart = effect.memory(shape, 2), [effect.memory(shape, 1), effect.memory(shape, 1)]
    for k in range(100):
        columns, both = effect.advance(rows_of(states, np.array([k, 200 + 2 * k])), shape, both)
        for i, row in enumerate((k, 200 + 2 * k)):
            alone, apart[i] = effect.advance(rows_of(states, np.array([row])), shape, apart[i])
            for channel, column in columns.items():
                np.testing.assert_allclose(column[i], alone[channel][0], rtol=1e-12, atol=1e-300)


@every
def test_a_gap_stays_where_it_is(effect: type[Effect]) -> None:
    """NaN in the signals never reaches rows that are seconds away, and nothing warns or raises."""
    states = moving(2000)
    gap = slice(900, 910)
    arrays = {n: v.copy() for n, v in vars(states).items() if isinstance(v, np.ndarray) and v.ndim == 1 and n != "time"}
    for array in arrays.values():
        array[gap] = np.nan
    holed = replace(states, **arrays)
    for shape in effect.shapes(states):
        for column in effect.columns(holed, shape).values():
            assert np.isfinite(column[:880]).all() and np.isfinite(column[930:]).all()


@every
def test_a_rich_recording_meets_the_needs_and_a_poor_one_none(effect: type[Effect]) -> None:
    for need in effect.needs():
        assert need.unmet(RICH) == ""
        assert need.unmet(POOR) and need.purpose and len(need.how) > 30
    if effect.family == TORSION_FAMILY:
        assert VARIED_LOOPS in effect.needs()


def test_needs_turn_at_their_limits() -> None:
    """A rich recording with one number changed: that need alone turns, just beyond its limit."""
    cases: dict[str, list[tuple[dict[str, float | None], bool]]] = {
        "torsional_hysteresis": [
            ({"torque_low": 0.0, "torque_high": 9.9}, False),
            ({"torque_low": 0.0, "torque_high": 10.1}, True),
            ({"torque_low": 0.0, "torque_high": 0.1, "rated_torque": None}, True),
            ({"repetition": 0.63, "speed_variety": 5.9}, False),
            ({"repetition": 0.61, "speed_variety": 5.9}, True),
            ({"repetition": 0.63, "speed_variety": 6.1}, True),
        ],
        "backlash": [({"torque_low": 0.1}, False), ({"torque_high": -0.1}, False), ({"torque_low": -0.1}, True)],
        "kinematic_error": [({"motor_turns": 0.99}, False), ({"motor_turns": 1.0}, True)],
        "temperature_friction": [({"temperature_span": 5.9}, False), ({"temperature_span": 6.1}, True)],
        "quadratic_drag": [({"speed_decades": 1.29}, False), ({"speed_decades": 1.31}, True)],
        "joint_sensor_eccentricity": [({"joint_range": 0.78}, False), ({"joint_range": 0.79}, True)],
    }
    for name, many in cases.items():
        for change, met in many:
            unmet = [need for need in library()[name].needs() if need.unmet(replace(RICH, **change))]
            assert len(unmet) == (not met), f"{name}: {change}"


@each_form
def test_what_a_sensor_misreads_is_in_every_balance_alike(effect: type[Effect], values: dict[str, float]) -> None:
    """The gauge on rotor and link with opposite signs, the joint sensor in the transmission alone: one column each."""
    shape, _ = effect.split(values, CONTEXT)
    columns = effect.columns(moving(), shape)
    opposite = {MOTOR, LINK} <= set(columns) and np.array_equal(columns[MOTOR], -columns[LINK])
    assert (effect.reads == GAUGE) == opposite
    if effect.reads == JOINT_SENSOR:
        assert set(columns) == {TRANSMISSION}
    assert effect.reads in ("", GAUGE, JOINT_SENSOR)


@every
def test_what_a_diagnosis_decides_names_parameters_of_the_effect(effect: type[Effect]) -> None:
    parameters = {parameter.name: parameter for parameter in effect.parameters}
    assert 0.0 < effect.law_error < 1.0
    if effect.shifts_command:
        assert parameters[effect.shifts_command].unit == "s"
    assert not effect.base or effect.in_every_model
    for one in effect.base:
        assert one.parameter in parameters and one.channel in CHANNELS and (one.sure_as or one.parameter) in parameters
    test = effect.near_reversals
    if test is not None:
        assert {test.entry, test.amplitude} <= set(parameters) and parameters[test.amplitude].unit == "N m"
        states = moving(300)
        for value in test.grid:
            shape = {test.entry: value}
            assert effect.coefficient_names(shape) == (test.amplitude,)
            assert set(effect.columns(states, shape)) == {MOTOR}
            low, high = effect.shape_bounds(shape, states)[test.entry]
            assert low <= value <= high


def test_each_number_of_the_base_belongs_to_one_parameter() -> None:
    assert [one.number for _, one in base_numbers()] == list(BASE_NUMBERS)
