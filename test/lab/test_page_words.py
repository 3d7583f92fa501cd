"""The answer of a diagnosis in sentences that say its numbers."""

from __future__ import annotations

from dataclasses import replace

import pytest
from report_case import diagnosis

from hd_control.lab.diagnosis.verdict import ADEQUATE, CANNOT_TELL, MISSING_AND_UNKNOWN, UNKNOWN, VERDICTS, Rival
from hd_control.lab.page.model_figures import confidence_figure
from hd_control.lab.page.words import BADGES, confidence_bars, headline, plain_name, reasons


def test_answers_without_a_probability_are_bars_too() -> None:
    bars = confidence_bars(diagnosis())
    assert [(bar.name, bar.probability) for bar in bars] == [("motor_cogging", 0.93), ("unknown", None)]
    assert bars[0].note == "runner-up: gauge ripple, would explain 60 % of the gain"
    assert confidence_bars(diagnosis(CANNOT_TELL))[-1].name == "cannot_tell"
    pattern = confidence_figure(bars)["data"][0]["marker"]["pattern"]["shape"]
    assert pattern == ["", "/"]


def test_the_verdict_in_words() -> None:
    assert headline(diagnosis()) == "Motor cogging is missing in the model."
    assert "nothing is missing" in headline(diagnosis(ADEQUATE))
    assert "not in the library" in headline(diagnosis(UNKNOWN))
    assert "does not excite" in headline(diagnosis(CANNOT_TELL))
    first, second = reasons(diagnosis())
    assert "93 % sure" in first and "from 0.22 to 0.05 N m" in first and second.endswith("joint position.")


def test_several_effects_are_listed_in_one_sentence() -> None:
    (one,) = diagnosis().effects
    names = [replace(one, name=name) for name in ("motor_cogging", "payload", "link_friction")]
    two, three = (replace(diagnosis(), effects=tuple(names[:k])) for k in (2, 3))
    assert headline(two) == "Motor cogging and payload are missing in the model."
    assert headline(three) == "Motor cogging, payload and link friction are missing in the model."
    beside = replace(two, verdict=MISSING_AND_UNKNOWN)
    assert headline(beside).endswith("are missing in the model, and beside it something that is not in the library.")


def test_every_verdict_has_a_badge_and_a_headline() -> None:
    assert set(BADGES) == set(VERDICTS) and len(set(BADGES.values())) == len(VERDICTS)
    said = {headline(diagnosis(verdict)) for verdict in VERDICTS}
    assert len(said) == len(VERDICTS)


@pytest.mark.parametrize(("confusable", "says"), [(True, "do not separate it from gauge ripple."), (False, "")])
def test_reasons_name_what_the_data_do_not_separate(confusable: bool, says: str) -> None:
    (one,) = diagnosis().effects
    rival = Rival("gauge_ripple", 1.0 if confusable else 500.0, 0.99, 0.5)
    first, *_ = reasons(replace(diagnosis(), effects=(replace(one, rivals=(rival,)),)))
    assert says in first and ("do not separate" in first) == confusable
    assert "the noise is 0.05 N m" in first and first.endswith("The residual repeats with the motor's turn & <twice>.")


def test_errors_of_angles_are_said_in_microradians() -> None:
    (one,) = diagnosis().effects
    torsion = replace(one, channel="transmission", error_before=2.5e-5, error_after=1e-6)
    first, *_ = reasons(replace(diagnosis(), effects=(torsion,)))
    assert "error of the transmission from 25 to 1 µrad" in first and "the noise is" not in first


def test_a_rival_explains_at_most_everything() -> None:
    (one,) = diagnosis().effects
    bars = confidence_bars(replace(diagnosis(), effects=(replace(one, rivals=(Rival("x", 1.0, 0.5, 1.7),)),)))
    assert bars[0].note == "runner-up: x, would explain 100 % of the gain"
    assert confidence_bars(replace(diagnosis(), effects=(replace(one, rivals=()),), unknown=None))[0].note == ""
    assert plain_name("gauge_gain_error") == "gauge gain error"
