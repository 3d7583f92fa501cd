"""The ladder: effects in the order of what they gain, errors on data that no fit has used, reasons to stop."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from functools import lru_cache

import numpy as np
import pytest
from oracles.simple_joint import Changes, simulate, with_noise
from plain_joint import NAME, model, recording, signals
from report_case import diagnosis
from test_effect_columns import CASES

from hd_control.drive.effect import LINK, MOTOR, TRANSMISSION
from hd_control.drive.model import JointModel, Model
from hd_control.drive.model_file import model_sha256
from hd_control.lab.diagnosis.verdict import ADEQUATE, CANNOT_TELL, MISSING, UNKNOWN
from hd_control.lab.models.ladder import (
    FLOOR_REACHED,
    GIVEN,
    REFIT,
    ROSE,
    JointLadder,
    LadderRung,
    Split,
    _floor,
    _not_better,
    _nothing_to_add,
    _with_possible_floors,
    climb,
    split_recording,
)

MODEL = Model(None, {"joint_1": JointModel(100.0)})


def rung(error: float, floor: float = 0.3, name: str = "x") -> LadderRung:
    errors, floors = {"motor_torque": error, "transmission": 1.0}, {"motor_torque": floor}
    return LadderRung(name, 1, {}, errors, floors, MODEL, None, errors, floors)


def rungs(errors: tuple[float, ...], floor: float = 0.3) -> tuple[LadderRung, ...]:
    return tuple(rung(error, floor, str(k)) for k, error in enumerate(errors))


@pytest.mark.parametrize(("errors", "floor"), [((7.0, 14.0, 0.03), 0.03), ((7.0, 14.0, 0.5), 0.3), ((7.0,), 0.3)])
def test_what_a_rung_leaves_on_held_out_data_bounds_the_noise(errors: tuple[float, ...], floor: float) -> None:
    found = _with_possible_floors(rungs(errors))
    assert [r.floor for r in found] == [{"motor_torque": floor}] * len(errors)
    assert min(r.ratio("motor_torque") for r in found) == pytest.approx(min(errors) / floor)
    assert [r.held_out for r in found] == [r.held_out for r in rungs(errors)]


def test_a_ratio_without_a_floor_is_no_number() -> None:
    assert np.isnan(rung(1.0).ratio("transmission")) and rung(0.6).ratio("motor_torque") == pytest.approx(2.0)


@pytest.mark.parametrize(
    ("verdict", "says"),
    [
        (ADEQUATE, "no further effect is supported by the data"),
        (CANNOT_TELL, "the recording cannot tell what else is missing"),
        (UNKNOWN, "only something unknown is left: motor torque: the residual depends on joint position"),
        (MISSING, ""),
    ],
)
def test_a_verdict_is_a_reason_to_stop_or_to_go_on(verdict: str, says: str) -> None:
    assert _nothing_to_add(diagnosis(verdict)) == says


def test_an_effect_that_raises_the_error_or_cannot_be_judged_does_not_stay() -> None:
    before = rung(1.0)
    assert _not_better(rung(0.5), before, "motor_torque") == ""
    assert _not_better(rung(0.999 * ROSE), before, "motor_torque") == "", "a per cent is no rise"
    assert _not_better(rung(1.001 * ROSE, name="payload"), before, "motor_torque") == (
        "payload raised the held-out error of motor_torque; it was left out"
    )
    blind = _not_better(rung(0.5, name="payload"), before, "link_torque")
    assert blind.startswith("the held-out recording does not show link_torque, so payload cannot be judged")


def test_the_floor_is_reached_when_every_channel_is_there() -> None:
    reached, floor = {"a": FLOOR_REACHED * 0.1, "b": 0.1}, {"a": 0.1, "b": 0.1}
    one = LadderRung("x", 1, {}, {"a": 7.0, "b": 7.0}, floor, MODEL, None, reached, floor)
    assert _floor(one) == "noise floor reached: held-out errors within 5 % of it", "whatever is shown"
    assert _floor(replace(one, stopping={"a": 0.106, "b": 0.1})) == ""
    assert _floor(replace(one, stopping={})) == ""


def test_what_is_shown_decides_nothing() -> None:
    """An effect stays by the part that decides, though the shown part gets worse; and the other way round."""
    before = rung(1.0)
    shown_worse = replace(rung(0.5), held_out={"motor_torque": 3.0, "transmission": 1.0})
    shown_better = replace(rung(1.5, name="payload"), held_out={"motor_torque": 0.1, "transmission": 1.0})
    assert _not_better(shown_worse, before, "motor_torque") == ""
    assert _not_better(shown_better, before, "motor_torque").startswith("payload raised the held-out error")


def test_a_recording_is_split_in_three_parts_in_time() -> None:
    whole = signals()
    noted = replace(whole, notes=("1 gap",))
    found = split_recording(recording(noted), 0.3)
    parts = [part.joints[NAME] for part in (found.train, found.stopping, found.held_out)]
    train, _, held = parts
    assert [part.time.size for part in parts] == [15_750, 5250, 9000]
    assert all(part.time[0] == 0.0 for part in parts), "each counts from its own start"
    np.testing.assert_allclose(np.diff(held.time), 1e-3)
    for name in whole.present:
        np.testing.assert_array_equal(np.concatenate([getattr(part, name) for part in parts]), getattr(whole, name))
    assert held.temperature is None and held.notes == ("1 gap",) and held.period == whole.period


def _load(q: float, w: float) -> float:
    return 3.0 * float(np.cos(q)) + 5.0 * float(np.sin(q))


BOTH = Changes(link=_load, kinematic=CASES["kinematic_error"].changes.kinematic)
"""A payload and a small kinematic error."""
OTHER = tuple((0.25 * (0.09 / f) ** 1.4 + 0.004, f) for f in (0.09 * 1.27**i for i in range(14)))
"""Another motion, for judging."""


@lru_cache(maxsize=1)
def ladder() -> JointLadder:
    """Both effects missing, two recordings with different motion and noise."""
    held = with_noise(simulate(BOTH, tones=OTHER), seed=1)
    return climb(Split.of(recording(signals(BOTH)), recording(held)), model(), NAME)


def test_effects_come_in_the_order_of_what_they_gain_and_each_lowers_its_channel() -> None:
    found = ladder()
    assert [r.effect for r in found.rungs] == [GIVEN, REFIT, "payload", "kinematic_error"], found.stopped_because
    payload, kinematic = found.rungs[2:]
    assert payload.held_out[LINK] < 0.1 * found.rungs[1].held_out[LINK]
    assert kinematic.held_out[TRANSMISSION] < 0.3 * payload.held_out[TRANSMISSION]
    assert found.channel == LINK, "the headline is the channel of the first effect"
    assert found.model is kinematic.model and {"payload", "kinematic_error"} < set(found.model.joint(NAME).effects)
    assert found.diagnosis is not None and found.diagnosis.verdict == ADEQUATE


def test_at_the_end_the_errors_are_the_noise_on_data_that_nothing_was_fitted_to() -> None:
    last = ladder().rungs[-1]
    for name in (TRANSMISSION, LINK):
        assert last.ratio(name) < 1.1
    assert last.ratio(MOTOR) < 1.35, "stops are rounded"
    assert all(r.ratio(name) >= 1.0 for r in ladder().rungs for name in r.held_out)
    assert "noise floor reached" in ladder().stopped_because or "no further effect" in ladder().stopped_because


def test_each_rung_counts_its_parameters_and_keeps_what_was_added() -> None:
    found = ladder()
    counts = [r.parameters_count for r in found.rungs]
    by_hand = [sum(len(v) for v in r.model.joint(NAME).effects.values()) for r in found.rungs]
    assert counts == by_hand and counts == sorted(counts)
    assert found.rungs[0].added is None and found.rungs[2].added is not None
    values = {row.name: row.value for row in found.rungs[2].added.parameters if row.effect == "payload"}
    assert values["gravity_sine"] == pytest.approx(5.0, rel=0.02)


def test_the_json_of_a_ladder_is_that_of_its_rungs() -> None:
    document, found = ladder().json(), ladder()
    assert (document["channel"], document["unit"]) == (LINK, "N m")
    assert document["stopped_because"] == found.stopped_because
    for entry, step in zip(document["rungs"], found.rungs, strict=True):
        assert entry["effect"] == step.effect and entry["error_held_out"] == step.held_out[LINK]
        assert entry["error_train"] == step.train[LINK] and entry["noise_floor"] == step.floor[LINK]
        assert entry["model_sha256"] == model_sha256(step.model)
        assert set(entry["channels"]) == set(step.held_out)
        assert entry["channels"][TRANSMISSION]["unit"] == "rad"
    assert len({entry["model_sha256"] for entry in document["rungs"]}) == len(document["rungs"])


@pytest.mark.slow
def test_a_ladder_ends_at_its_limit() -> None:
    held = with_noise(simulate(BOTH, tones=OTHER), seed=1)
    found = climb(Split.of(recording(signals(BOTH)), recording(held)), model(), NAME, limit=1)
    assert [r.effect for r in found.rungs] == [GIVEN, REFIT, "payload"]
    assert found.stopped_because == "limit of 1 effects reached"


def test_nothing_to_judge_by_leaves_empty_errors() -> None:
    empty: Mapping[str, float] = {}
    found = JointLadder(NAME, (LadderRung("x", 0, empty, empty, empty, model()),), "because", None, "")
    document = found.json()
    assert document["unit"] == "" and document["rungs"][0]["error_held_out"] is None
    assert document["rungs"][0]["channels"] == {}
