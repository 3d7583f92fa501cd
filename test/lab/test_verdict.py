"""Verdicts: rivals by what they lose, texts and JSON that say the numbers they were given."""

from __future__ import annotations

import json

import pytest
from report_case import diagnosis
from test_search import search

from hd_control.drive.effect import LINK, MOTOR
from hd_control.lab.diagnosis.fit import Interval
from hd_control.lab.diagnosis.verdict import (
    ADEQUATE,
    CANNOT_TELL,
    RIVALS,
    VERDICTS,
    NamedEffect,
    Rival,
    Unknown,
    rivals,
)


@pytest.mark.parametrize(
    ("loss", "probability", "share", "confusable"),
    [(100.0, 0.99, 0.5, False), (5.0, 0.99, 0.5, True), (100.0, 0.8, 0.5, True), (100.0, 0.99, 0.97, True)],
)
def test_a_rival_is_confusable_by_any_of_three_reasons(
    loss: float, probability: float, share: float, confusable: bool
) -> None:
    assert Rival("x", loss, probability, share).confusable is confusable


def test_a_look_alike_is_the_first_rival_and_loses_what_it_does_not_explain() -> None:
    """The loss of a rival is a difference of held-out losses, its share the part of the gain that it has too."""
    found = search(("one", 40.0))
    (selection,) = [found.run()]
    (group,) = selection
    first, *others = rivals(found, selection, group)
    assert first.name == "near" and 0.0 < first.share < 1.0
    losses = [found.scores.loss(found.index(s)) for s in ((), (group,), (_named(found, "near"),))]
    assert first.loss == pytest.approx(losses[2] - losses[1], rel=1e-6)
    assert first.share == pytest.approx((losses[0] - losses[2]) / (losses[0] - losses[1]), rel=1e-6)
    assert first.probability > 0.95, "better in nearly all draws of blocks"
    assert len(others) + 1 <= RIVALS and len({r.name for r in (first, *others)}) == len(others) + 1
    assert all(other.share < 0.05 and not other.confusable for other in others)
    assert group.name not in {r.name for r in (first, *others)} and "curve" not in {r.name for r in others}


def _named(found, name):  # type: ignore[no-untyped-def] # a helper of this file
    best = max((i for i, g in enumerate(found.groups) if g.name == name), key=lambda i: float(found.ranking(())[i]))
    return found.groups[best]


def test_equal_seeds_draw_equal_probabilities() -> None:
    found = search(("one", 40.0))
    selection = found.run()
    assert rivals(found, selection, selection[0], 1) == rivals(found, selection, selection[0], 1)


EFFECT = NamedEffect(
    "payload", "a payload", 0.9, LINK, 120.0, 6.0, 0.5, 0.1, {"gravity_sine": Interval(5.0, 4.0, 6.0)},
    {"gravity_sine": "N m"}, "depends on the angle", (Rival("gauge_gain", 3.0, 0.7, 0.96), Rival("x", 500.0, 1.0, 0.1)),
    7.0, True,
)  # fmt: skip


def test_the_json_of_an_effect_says_its_numbers() -> None:
    found = EFFECT.json()
    assert found["parameters"] == {"gravity_sine": {"value": 5.0, "unit": "N m", "low": 4.0, "high": 6.0}}
    assert found["runner_up"] == {"name": "gauge_gain", "loss": 3.0, "probability": pytest.approx(0.3),
                                  "share_of_gain": 0.96}  # fmt: skip
    assert found["confusable_with"] == ["gauge_gain"], "of the two only the near one"
    assert (found["error_before"], found["error_after"], found["held_out"]) == (0.5, 0.1, True)
    assert (found["gain_nats"], found["gain_beside_nats"], found["unknown_beside"]) == (120.0, 7.0, True)
    alone = NamedEffect("x", "", 0.5, MOTOR, 1.0, 1.0, 1.0, 1.0, {"p": Interval(0.0, 0.0, 0.0)}, {}, "").json()
    assert alone["runner_up"] is None and alone["confusable_with"] == [] and alone["parameters"]["p"]["unit"] == ""


def test_the_probabilities_of_an_effect_and_its_runner_up_add_up() -> None:
    """Over the same draws: one of both is better."""
    found = search(("one", 40.0))
    selection = found.run()
    first = rivals(found, selection, selection[0])[0]
    as_json = NamedEffect("one", "", 0.9, MOTOR, 1.0, 1.0, 1.0, 1.0, {}, {}, "", (first,)).json()["runner_up"]
    assert first.probability + as_json["probability"] == 1.0


def test_the_json_of_a_diagnosis_holds_every_part_and_can_be_written() -> None:
    found = diagnosis().json()
    assert set(found) == {"verdict", "effects", "unknown", "experiments", "channels", "notes", "contradictions"}
    assert found["unknown"] == {"channel": "motor_torque", "variables": ["joint_position"],
                                "evidence": "motor torque: the residual depends on joint position"}  # fmt: skip
    assert found["channels"]["motor_torque"]["error_explained"] == 0.05
    assert found["experiments"][0]["purpose"] == "cogging against ripple"
    assert found["notes"] == ["only 1 change of direction"]
    assert json.loads(json.dumps(found)) == found
    assert Unknown(MOTOR, ("time",), "x").json()["variables"] == ["time"]


def test_there_are_five_verdicts() -> None:
    assert len(set(VERDICTS)) == 5 and {ADEQUATE, CANNOT_TELL} < set(VERDICTS)
    assert all(diagnosis(verdict).json()["verdict"] == verdict for verdict in VERDICTS)
