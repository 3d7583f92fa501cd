"""Scores and tables from hand-made answers: right, wrong, grouped, tolerated, unknown, refused; exact intervals."""

import math

import pytest

from hd_sim.puzzles.puzzle import score_joint
from hd_sim.puzzles.tables import confusion, interval, make_table, table_text


def _effect(name, confidence=0.9, confusable=(), runner_up=None, **parameters):
    values = {key: {"value": v, "unit": "", "low": v - 1e-6, "high": v + 1e-6} for key, v in parameters.items()}
    return {
        "name": name,
        "confidence": confidence,
        "parameters": values,
        "confusable_with": list(confusable),
        "runner_up": runner_up,
    }


def _answer(verdict, *effects, unknown=None):
    return {"verdict": verdict, "effects": list(effects), "unknown": unknown, "experiments": []}


def _truth(*names, unknown=(), **parameters):
    return {"names": list(names), "unknown": list(unknown), "parameters": parameters}


def test_the_right_name_alone_is_clean():
    score = score_joint(_answer("missing", _effect("backlash")), _truth("backlash"))
    assert score.top_1 and score.exact and score.clean and score.group and score.correct
    assert not score.confident_wrong and score.false_alarm is None


def test_a_wrong_name_is_wrong_confident_and_may_still_be_of_the_group():
    answer = _answer("missing", _effect("gauge_gain", 0.6, ["torque_constant_error"]))
    score = score_joint(answer, _truth("torque_constant_error"))
    assert score.wrong == ("gauge_gain",) and score.missed == ("torque_constant_error",)
    assert score.confident_wrong and score.group and not score.top_1 and not score.correct
    answer["effects"][0]["confidence"] = 0.4
    assert not score_joint(answer, _truth("torque_constant_error")).confident_wrong
    answer["effects"][0] |= {"confusable_with": [], "runner_up": {"name": "payload"}}
    assert not score_joint(answer, _truth("torque_constant_error")).group


def test_an_extra_name_or_a_needless_flag_is_not_clean():
    extra = score_joint(_answer("missing", _effect("backlash"), _effect("payload")), _truth("backlash"))
    assert extra.top_1 and not extra.exact and not extra.clean
    flag = {"channel": "motor_torque", "variables": ["time"]}
    flagged = score_joint(_answer("missing_and_unknown", _effect("backlash"), unknown=flag), _truth("backlash"))
    assert flagged.exact and not flagged.clean and flagged.confident_wrong


@pytest.mark.parametrize(
    ("verdict", "alarm", "correct"), [("adequate", 0, 1), ("unknown", 1, 0), ("cannot_tell", 0, 0)]
)
def test_nothing_hidden(verdict, alarm, correct):
    score = score_joint(_answer(verdict), _truth())
    assert (score.false_alarm, score.correct) == (bool(alarm), bool(correct))
    assert score.refused == (verdict == "cannot_tell")


def test_tolerated_names_count_neither_way():
    score = score_joint(_answer("missing", _effect("actuation_delay")), _truth(), ("actuation_delay",))
    assert not score.false_alarm and not score.wrong and score.clean and score.tolerated == ("actuation_delay",)
    both = _answer("missing", _effect("actuation_delay"), _effect("payload"))
    assert score_joint(both, _truth("payload"), ("actuation_delay",)).top_1
    assert not score_joint(_answer("unknown"), _truth(), ("unknown",)).false_alarm


@pytest.mark.parametrize(
    ("variables", "right"),
    [
        (["joint_position"], True),
        (["motor_position", "direction"], True),
        (["time"], False),
        (["joint_position", "time", "temperature"], False),
    ],
)
def test_the_variable_of_an_unknown_effect(variables, right):
    answer = _answer("unknown", unknown={"channel": "motor_torque", "variables": variables})
    score = score_joint(answer, _truth(unknown=["friction_over_angle"]))
    assert score.unknown_flagged and score.unknown_channel and score.unknown_variable is right
    assert score.correct is right and score.top_1 is None


def test_a_library_name_that_fits_an_unknown_effect_is_right_too():
    answer = _answer("missing", _effect("gauge_ripple"))
    score = score_joint(answer, _truth(unknown=["gauge_fourth_harmonic"]), ("gauge_ripple",))
    assert score.unknown_flagged and score.unknown_variable and score.correct


def test_an_unknown_effect_that_is_overlooked_is_not_correct():
    score = score_joint(_answer("adequate"), _truth(unknown=["cable_torque"]))
    assert score.unknown_flagged is False and score.unknown_variable is False and not score.correct


def test_waves_are_judged_by_their_amplitude():
    truth = _truth("gauge_ripple", gauge_ripple={"cosine_2": 0.0, "sine_2": 2.0})
    answer = _answer("missing", _effect("gauge_ripple", cosine_2=0.02, sine_2=2.0))
    errors = {p["name"]: p for p in score_joint(answer, truth).parameters}
    assert errors["cosine_2"]["relative_error"] == pytest.approx(0.01)
    assert errors["sine_2"]["covered"] and not errors["cosine_2"]["covered"]


def test_exact_intervals():
    """Known values: 0 of 48 has the upper end 1 - 0.025^(1/48); 109 of 114 lies in 90.1 to 98.6 %."""
    assert interval(0, 48) == (0.0, pytest.approx(1.0 - 0.025 ** (1.0 / 48.0)))
    low, high = interval(109, 114)
    assert (low, high) == (pytest.approx(0.9006, abs=5e-4), pytest.approx(0.9856, abs=5e-4))
    assert interval(0, 0) == (0.0, 1.0)


def _record(category, score, step="", names=(), **more):
    return {"category": category, "step": step, "names": list(names), "score": score.to_dict(), **more}


def test_the_table_counts_and_leaves_out_what_was_not_asked():
    wrong = _answer("missing", _effect("payload"))
    records = [
        _record("none", score_joint(_answer("adequate"), _truth()), cpu_seconds=1.0, answer=_answer("adequate")),
        _record("none", score_joint(wrong, _truth()), cpu_seconds=3.0, answer=wrong),
        _record(
            "one",
            score_joint(_answer("missing", _effect("backlash")), _truth("backlash")),
            "weak",
            ["backlash"],
            answer=_answer("missing", _effect("backlash")),
        ),
        _record("poor", score_joint(_answer("cannot_tell"), _truth("backlash"))),
    ]
    rows = {row.name: row for row in make_table(records)}
    assert (rows["no effect: false alarm"].hits, rows["no effect: false alarm"].count) == (1, 2)
    assert rows["one effect, weak: top 1"].share == 1.0
    assert rows["poor recording: refused"].share == 1.0
    assert rows["computing time, median"].value == 2.0
    assert "two effects: exact" not in rows and "one effect, strong: top 1" not in rows
    assert "| no effect: false alarm | 1/2 | 50.0 % | 1.3–98.7 % |" in table_text(rows.values())
    assert confusion(records) == [("backlash", "backlash", 1)]
    assert all(math.isfinite(row.low) for row in rows.values() if row.low is not None)


def test_confidence_is_compared_with_the_share_of_right_names():
    """Two names at 0.9, one of them wrong: right in half the cases, 0.4 apart; shuffled truths give no hit."""
    records = []
    for name, said in (("backlash", "backlash"), ("payload", "quadratic_drag")):
        answer = _answer("missing", _effect(said))
        records.append(_record("one", score_joint(answer, _truth(name)), "weak", [name], answer=answer))
    rows = {row.name: row for row in make_table(records)}
    assert rows["calibration error of the confidence"].value == pytest.approx(0.4)
    assert (rows["named effects: right"].hits, rows["named effects: right"].count) == (1, 2)
    assert rows["control: one effect, top 1 against another joint's truth"].hits == 0
