"""What a report shows, as plain data: from comparisons, diagnosis and ladder to the pictures of one joint."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from oracles.simple_joint import Changes
from plain_joint import NAME, joint_model, model, recording, signals
from report_case import diagnosis
from test_compare import compared

from hd_control.drive.effect import LINK, MOTOR, TRANSMISSION
from hd_control.drive.model import Model
from hd_control.lab.diagnosis.fit import Interval
from hd_control.lab.maps.condition_maps import conditions_of, maps_of
from hd_control.lab.maps.orders import JOINT, WAVE_GENERATOR
from hd_control.lab.models.answers import compare_task, joint_task
from hd_control.lab.models.compare import JointComparison
from hd_control.lab.page.page_data import FLAT, Ladder, channel_pages, joint_page, parameter_rows


def wavy() -> JointComparison:
    """The right model on a joint with a kinematic error of order 2."""
    changes = Changes(kinematic=lambda x: (3e-5 * float(np.cos(2.0 * x)), -6e-5 * float(np.sin(2.0 * x))))
    task = joint_task(recording(signals(changes)), model(), NAME)
    return compare_task(task, model(), NAME, compared().noises)


def test_each_channel_has_every_model_that_has_it() -> None:
    """A model of a recording without motor torque beside one with everything."""
    less = replace(compared(), channels={n: c for n, c in compared().channels.items() if n != MOTOR})
    pages = channel_pages({"whole": compared(), "less": less})
    assert [page.name for page in pages] == [MOTOR, TRANSMISSION, LINK]
    assert list(pages[0].models) == ["whole"] and list(pages[1].models) == ["whole", "less"]
    for page in pages:
        assert list(page.maps) == list(page.spectra) == list(page.models)
        assert page.models["whole"] is compared().channels[page.name]


def test_maps_and_orders_of_a_page_are_those_of_the_residual() -> None:
    found = wavy()
    page = {p.name: p for p in channel_pages({"m": found})}[TRANSMISSION]
    channel = found.channels[TRANSMISSION]
    expected = maps_of(conditions_of(found.dictionary.equations, TRANSMISSION), channel.residual, channel.used)
    assert page.maps["m"].rms == expected.rms == pytest.approx(channel.rms_error)
    assert page.maps["m"].maps["motor_shaft_position"].explained > 0.9
    spectrum, lines = page.spectra["m"]
    assert spectrum.turn == WAVE_GENERATOR and round(lines[0].order) == 2
    assert {window.title for window in page.windows} >= {"largest error above the noise", "one reversal"}
    assert all(0.0 <= window.start < window.end <= 30.1 for window in page.windows)


def test_without_a_gear_ratio_orders_count_joint_turns() -> None:
    """A model whose ratio is 1 stands for one that is not known: encoder and joint turn alike."""
    alike = replace(signals(), motor_shaft_position=signals().motor_shaft_position / 100.0)
    about = Model(None, {NAME: replace(joint_model(), gear_ratio=1.0)})
    found = compare_task(joint_task(recording(alike), about, NAME), about, NAME, compared().noises)
    page = channel_pages({"m": found})[-1]
    assert page.spectra["m"][0].turn == JOINT and page.spectra["m"][0].gear_ratio is None
    assert "motor_shaft_position" not in page.maps["m"].maps


def test_parameters_are_those_of_the_diagnosis_unless_given() -> None:
    rows = parameter_rows(diagnosis())
    assert [(row.effect, row.name, row.unit, row.source) for row in rows] == [
        ("motor_cogging", "cosine_2", "N m", "fitted"), ("motor_cogging", "sine_2", "N m", "fitted")]  # fmt: skip
    assert [row.remark for row in rows] == ["", "flat: the data do not fix it"]
    assert (rows[0].value, rows[0].low, rows[0].high) == (0.3, 0.29, 0.31)
    assert joint_page(NAME, {}, diagnosis()).parameters == rows
    assert joint_page(NAME, {}, diagnosis(), parameters=()).parameters == ()
    assert joint_page(NAME, {}).parameters == () and joint_page(NAME, {}).diagnosis is None


@pytest.mark.parametrize(("low", "high", "flat"), [(0.8, 1.2, False), (0.7, 1.3, True), (-1.0, -0.9, False)])
def test_an_interval_as_wide_as_half_its_value_is_flat(low: float, high: float, flat: bool) -> None:
    (effect,) = diagnosis().effects
    value = 0.5 * (low + high)
    made = replace(effect, parameters={"p": Interval(value, low, high)}, units={})
    (row,) = parameter_rows(replace(diagnosis(), effects=(made,)))
    assert (row.remark != "") == flat == (high - low > FLAT * abs(value)) and row.unit == ""


def test_a_ladder_comes_from_its_document() -> None:
    document = {
        "rungs": [
            {
                "effect": "as given",
                "parameters_count": 7,
                "error_train": 0.2,
                "error_held_out": 0.3,
                "noise_floor": None,
            }
        ],
        "stopped_because": None,
    }
    found = Ladder.of(document, "N m")
    (rung,) = found.rungs
    assert (rung.effect, rung.error_held_out, found.unit, found.stopped_because) == ("as given", 0.3, "N m", "")
    assert np.isnan(rung.noise_floor)
