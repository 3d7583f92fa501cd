"""A whole diagnosis by innovations on joints that another integration made: the missing effect and its value."""

from __future__ import annotations

from dataclasses import replace
from functools import lru_cache

import numpy as np
import pytest
from oracles.simple_joint import Changes, simulate, with_noise
from plain_joint import NAME, model, recording, signals
from test_effect_columns import CASES

from hd_control.drive.effect import LINK, MOTOR, TRANSMISSION
from hd_control.drive.library import effect_named
from hd_control.lab.diagnosis.by_innovations import GATES, LEAST_DELAY, diagnose_innovations, small_delay, visible
from hd_control.lab.diagnosis.candidates import Group
from hd_control.lab.diagnosis.fit import Interval
from hd_control.lab.diagnosis.verdict import ADEQUATE, CANNOT_TELL, MISSING, UNKNOWN, JointDiagnosis, NamedEffect
from hd_control.lab.models.answers import BALANCES, INNOVATIONS, diagnose_joint, joint_task
from hd_control.lab.signals.joint_signals import JointSignals

SOME = ("asymmetric_friction", "kinematic_error")


def ask(recorded: JointSignals) -> JointDiagnosis:
    return diagnose_innovations(joint_task(recording(recorded), model(), NAME))


@lru_cache(maxsize=1)
def plain() -> JointDiagnosis:
    return ask(signals())


def _load(q: float, w: float) -> float:
    return 3.0 * float(np.cos(q)) + 5.0 * float(np.sin(q))


@lru_cache(maxsize=1)
def loaded() -> JointDiagnosis:
    return ask(signals(Changes(link=_load)))


def named(found: JointDiagnosis) -> list[str]:
    return [effect.name for effect in found.effects]


def test_a_joint_that_the_model_describes_is_adequate() -> None:
    found = plain()
    assert (found.verdict, found.effects, found.unknown, found.notes) == (ADEQUATE, (), None, ())
    assert set(found.channels) == {MOTOR, TRANSMISSION, LINK}, "the balances draw the errors"


def test_errors_of_a_payload_are_in_the_unit_of_the_link_balance() -> None:
    found = loaded()
    assert (found.verdict, named(found), found.unknown) == (MISSING, ["payload"], None)
    (effect,) = found.effects
    assert effect.channel == LINK and effect.error_before > 10.0 * effect.error_after
    cosine, sine = effect.parameters["gravity_cosine"], effect.parameters["gravity_sine"]
    assert (cosine.value, sine.value) == pytest.approx((3.0, 5.0), rel=0.01)
    assert set(found.json()) == set(plain().json())


@pytest.mark.slow
@pytest.mark.parametrize("name", SOME)
def test_the_missing_effect_is_named_alone_with_its_values(name: str) -> None:
    case = CASES[name]
    found = ask(with_noise(simulate(case.changes, tones=case.tones)))
    assert (found.verdict, named(found), found.unknown) == (MISSING, [name], None), found.notes
    (effect,) = found.effects
    for parameter, value in case.values.items():
        interval = effect.parameters.get(parameter)
        if interval is not None:
            width = interval.high - interval.low
            assert interval.low - width <= value <= interval.high + width, (parameter, interval)


def _bump(phi: float, v: float, tau: float, t: float) -> float:
    return 1.5 * float(np.exp(-(((phi + 0.1) / 0.08) ** 2)))


def test_what_no_law_describes_is_unknown_and_its_variable_is_said() -> None:
    found = ask(signals(Changes(rotor=_bump)))
    assert (found.verdict, named(found)) == (UNKNOWN, [])
    assert found.unknown is not None and found.unknown.channel == MOTOR
    assert "joint_position" in found.unknown.variables and "nats held out" in found.unknown.evidence


def test_a_short_recording_is_refused_with_an_experiment() -> None:
    whole = signals()
    rows = slice(0, 2000)
    columns = {name: getattr(whole, name)[rows] for name in whole.present}
    found = ask(replace(whole, time=whole.time[rows], valid=whole.valid[rows], **columns))
    assert (found.verdict, found.effects, found.channels) == (CANNOT_TELL, (), {}) and found.experiments


def test_the_form_is_chosen_by_name() -> None:
    recorded = recording(signals())
    first = diagnose_joint(recorded, model(), NAME, form=INNOVATIONS)
    assert first.verdict == plain().verdict and first.channels == plain().channels
    assert BALANCES != INNOVATIONS
    with pytest.raises(ValueError):
        diagnose_innovations(replace(joint_task(recorded, model(), NAME), given=None))


@pytest.mark.parametrize(
    ("gone", "seen"),
    [
        ((), {MOTOR, TRANSMISSION, LINK}),
        (("motor_torque",), {TRANSMISSION, LINK}),
        (("motor_shaft_position", "motor_torque"), {LINK}),
        (("motor_shaft_position", "gauge_torque"), {MOTOR, LINK}),
        (("joint_position",), {MOTOR}),
    ],
)
def test_signals_say_what_they_show(gone: tuple[str, ...], seen: set[str]) -> None:
    task = joint_task(recording(replace(signals(), **dict.fromkeys(gone))), model(), NAME)
    assert task.given is not None
    given = task.given()
    assert visible(replace(given, link=None if gone == ("joint_position",) else given.link)) == seen


def test_a_delay_below_the_convention_of_sampling_is_no_name() -> None:
    group = Group("actuation_delay", np.array([0]), (MOTOR,), effect_named("actuation_delay"))
    claim = NamedEffect("actuation_delay", "", 1.0, MOTOR, 300.0, 5.0, 1.0, 0.9, {}, {}, "")
    low = LEAST_DELAY * 1e-3
    for start, stands in ((1.01 * low, True), (0.99 * low, False)):
        one = replace(claim, parameters={"delay": Interval(2.0 * low, start, 3.0 * low)})
        assert (small_delay(one, group, 1e-3) is None) == stands
    friction = Group("payload", np.array([0]), (LINK,), effect_named("payload"))
    assert small_delay(claim, friction, 1e-3) is None


def test_gates_are_wider_than_those_of_the_balances() -> None:
    assert GATES.decades < 1.3 and GATES.acceleration < 10.0
