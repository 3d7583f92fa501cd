"""From a recording and a model to reports, diagnoses and series: what commands show is what was computed."""

from __future__ import annotations

import json
from dataclasses import replace
from functools import lru_cache

import numpy as np
import pytest
from oracles.simple_joint import Changes
from plain_joint import NAME, model, recording, signals

from hd_control.core.errors import ConfigError
from hd_control.drive.effect import LINK, MOTOR, TRANSMISSION
from hd_control.drive.model import Model
from hd_control.lab.balances.link import LinkSide
from hd_control.lab.diagnosis.verdict import ADEQUATE, CANNOT_TELL
from hd_control.lab.models.answers import (
    WORST,
    JointReport,
    channel_rows,
    checks_of,
    compare_joint,
    contradicted,
    diagnose_joint,
    joint_task,
    notes_of,
    residual_pages,
    residual_series,
)


def _load(q: float, w: float) -> float:
    return 5.0 * float(np.sin(q))


@lru_cache(maxsize=1)
def report() -> JointReport:
    """A joint with a payload that the model does not know."""
    return compare_joint(recording(signals(Changes(link=_load))), model(), NAME)


def test_a_report_says_where_the_error_is_and_carries_what_was_compared() -> None:
    found = report()
    assert found.signals == ("motor_shaft_position", "joint_position", "gauge_torque", "motor_torque")
    assert (
        set(found.comparison.channels) == set(found.sentences) == set(found.order_lines) == {MOTOR, TRANSMISSION, LINK}
    )
    assert "joint torque" in found.sentences[LINK] or "joint angle" in found.sentences[LINK]
    assert found.sentences[TRANSMISSION] == "The error is at the noise floor: nothing is left to explain here."
    worst = found.comparison.channels[LINK].worst
    assert 2 < len(worst) <= WORST == 8 and found.notes == ()
    assert [item["share_of_error"] for item in worst] == sorted((i["share_of_error"] for i in worst), reverse=True)


def test_the_json_of_a_report_is_its_numbers() -> None:
    document = report().json()
    assert json.loads(json.dumps(document)) == document
    link = document["channels"][LINK]
    assert link["rms_error"] == report().comparison.channels[LINK].rms_error
    assert link["sentence"] == report().sentences[LINK] and link["order_lines"] == list(report().order_lines[LINK])
    more = {"sensors", "delays", "friction", "spectra", "contradictions"}
    assert set(document) == {"signals", "channels", "free_run", "notes", *more} and document["free_run"]


def test_without_a_free_run_none_is_made_and_given_noises_are_used() -> None:
    noises = report().comparison.noises
    found = compare_joint(recording(signals(Changes(link=_load))), model(), NAME, noises=noises, free_run=False)
    assert found.horizons.runs == {} and found.json()["free_run"] == {}
    assert found.comparison.noises == noises
    assert found.comparison.channels[LINK].rms_error == pytest.approx(report().comparison.channels[LINK].rms_error)


def test_a_joint_that_is_not_there_is_an_error_with_names() -> None:
    with pytest.raises(ConfigError, match="made: no joint 'joint_9' is recorded; there is joint_1"):
        joint_task(recording(signals()), model(), "joint_9")
    with pytest.raises(ConfigError, match="the model has no joint 'joint_1'"):
        joint_task(recording(signals()), Model(None, {}), NAME)


def test_notes_are_those_of_the_reader_the_checks_and_the_link() -> None:
    """A gauge the wrong way round, a gap that was bridged, and a model without a link."""
    bare = Model(None, {NAME: replace(model().joint(NAME), effects={})})
    spoiled = replace(signals(), gauge_torque=-signals().gauge_torque, notes=("1 gap",))
    there, side = recording(spoiled), LinkSide(bare, {NAME: spoiled})
    checks = checks_of(there, bare, NAME, joint_task(there, bare, NAME, side).equations)
    found = notes_of(there, NAME, side, checks)
    assert checks.contradictions == checks.sentences
    assert found[0] == "1 gap" and "sign of gauge_torque looks flipped" in found[1]
    assert found[-1] == "joint_1: the model knows neither robot description nor link inertia"


def test_a_diagnosis_carries_the_notes_of_the_signals_first() -> None:
    noted = replace(signals(), notes=("1 gap",))
    found = diagnose_joint(recording(noted), model(), NAME)
    assert found.verdict == ADEQUATE and found.notes == ("1 gap",)
    rows = slice(0, 2500)
    short = replace(
        noted, time=noted.time[rows], valid=noted.valid[rows],
        **{name: getattr(noted, name)[rows] for name in noted.present},
    )  # fmt: skip
    found = diagnose_joint(recording(short), model(), NAME)
    assert found.verdict == CANNOT_TELL and found.notes[0] == "1 gap" and "usable recording" in found.notes[1]


def test_nothing_is_named_from_signals_that_contradict_the_model() -> None:
    """A gauge the wrong way round on a joint with a payload that would be named."""
    whole = signals(Changes(link=_load))
    assert diagnose_joint(recording(whole), model(), NAME).effects
    found = diagnose_joint(recording(replace(whole, gauge_torque=-whole.gauge_torque)), model(), NAME)
    assert found.verdict == CANNOT_TELL and not found.effects and found.unknown is None
    assert found.contradictions and "sign of gauge_torque" in found.contradictions[0]
    assert found.notes == found.contradictions and found.contradictions[0] in found.experiments[0].how
    assert found.json()["contradictions"] == list(found.contradictions)
    assert contradicted(NAME, ("a", "b")).experiments[0].how == "mend mapping or model: a; b"


def test_floors_do_not_fall_below_the_sensors() -> None:
    """A torque of white noise of 2 N m: the floor of the rotor balance holds at least its part in the band."""
    whole = signals()
    loud = replace(whole, motor_torque=whole.motor_torque + 2.0 * np.random.default_rng(1).standard_normal(30_000))
    found = compare_joint(recording(loud), model(), NAME, free_run=False).comparison.channels[MOTOR]
    band = 2.0 * np.sqrt(2e-3 * 30.0)
    assert 0.7 * band < found.noise_floor and found.noise_floor < 1.3 * found.rms_error_refitted


def test_channel_rows_are_no_numbers_where_a_row_does_not_count() -> None:
    there = recording(signals(Changes(link=_load)))
    ((joint, rows),) = channel_rows(there, model(), [NAME])
    assert joint == NAME and set(rows) == {MOTOR, TRANSMISSION, LINK}
    for name, (time, residual, measured) in rows.items():
        channel = report().comparison.channels[name]
        np.testing.assert_array_equal(time, channel.time)
        np.testing.assert_array_equal(np.isnan(residual), ~channel.used)
        np.testing.assert_array_equal(np.isnan(measured), ~channel.used)
        np.testing.assert_allclose(residual[channel.used], channel.residual[channel.used], rtol=1e-9, atol=1e-12)


def test_series_stand_on_the_clock_of_the_bag() -> None:
    time, residual, measured = np.array([0.0, 0.008, 0.016]), np.array([1.0, np.nan, 3.0]), np.array([4.0, 5.0, 6.0])
    channels = {"joint 1": {LINK: (time, residual, measured)}}
    found = residual_series(channels, 7_000_000_000)
    assert set(found) == {f"measured/joint_1/{LINK}", f"residual/joint_1/{LINK}"}
    stamps, values = found[f"residual/joint_1/{LINK}"]
    assert stamps.tolist() == [7_000_000_000, 7_008_000_000, 7_016_000_000] and stamps.dtype == np.int64
    np.testing.assert_array_equal(values, residual)
    np.testing.assert_array_equal(found[f"measured/joint_1/{LINK}"][1], measured)


def test_pages_show_the_measured_over_the_residual_joint_by_joint() -> None:
    nothing = (np.zeros(0),) * 3
    pages = residual_pages({"a": {LINK: nothing, MOTOR: nothing}, "b": {}})
    names = [f"{kind}/a/{channel}" for channel in (LINK, MOTOR) for kind in ("measured", "residual")]
    assert pages == {"a": [[name] for name in names]}
