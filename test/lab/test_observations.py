"""What is said of sensors, delays, friction and lines: every sentence carries the numbers that were measured."""

from __future__ import annotations

import json
from functools import lru_cache

import numpy as np
import pytest
from oracles.simple_joint import NOISE, PERIOD
from plain_joint import NAME, PLAIN, model, recording, signals

from hd_control.lab.maps.friction_curve import Condition, FrictionCurve, FrictionPoint
from hd_control.lab.models.answers import compare_joint
from hd_control.lab.models.observations import (
    Observations,
    delay_sentence,
    friction_sentences,
    sections,
    sensor_sentence,
    size,
    spectrum_sentences,
)
from hd_control.lab.signals.delays import MeasuredDelay
from hd_control.lab.signals.sensors import SensorQuality


@lru_cache(maxsize=1)
def found() -> Observations:
    """The plain joint; its motor torque carries no noise."""
    return compare_joint(recording(signals()), model(), NAME, free_run=False).observations


def test_everything_of_the_plain_joint_is_measured() -> None:
    for name, level in NOISE.items():
        assert found().sensors[name].noise == pytest.approx(level, rel=0.1)
    assert {delay.signal for delay in found().delays} == {"joint_position", "motor_torque", "gauge_torque"}
    assert not any(delay.sure for delay in found().delays)
    between = next(delay for delay in found().delays if delay.signal == "joint_position")
    assert abs(between.seconds) < 0.1 * PERIOD and between.determined
    assert [curve.signal for curve in found().friction] == ["motor_torque", "gauge_torque"]
    assert [spectrum.signal for spectrum in found().spectra] == ["motor_torque", "gauge_torque", "torsion"]


def test_the_json_is_plain_and_complete() -> None:
    document = found().json()
    assert json.loads(json.dumps(document)) == document
    assert set(document) == {"sensors", "delays", "friction", "spectra", "contradictions"}
    points = document["friction"]["motor_torque"]["points"]
    both = [p for p in points if p["direction"] == 0]
    assert all(p["torque"] == pytest.approx(PLAIN.coulomb + PLAIN.viscous * p["speed"], rel=0.05) for p in both)


def test_sections_have_sentences_for_each_part() -> None:
    heads = dict(sections(found()))
    assert [*heads][:3] == ["sensors", "delays", "friction"]
    assert len(heads["sensors"]) == 4 and heads["sensors"][0].startswith("motor_shaft_position: noise 0.2 mrad")
    assert any(text.startswith("motor_torque, both directions: ") for text in heads["friction"])
    assert any(text.startswith("gauge_torque: none, within ") for text in heads["friction"]) or any(
        text.startswith("gauge_torque, both directions") for text in heads["friction"]
    )
    assert not sections(Observations({}, (), (), (), found().checks))


def test_sensor_sentences() -> None:
    good = SensorQuality("gauge_torque", "N m", 0.01, 0.03, 2e-6, np.inf, 0.0, 1000.0)
    assert sensor_sentence(good) == "gauge_torque: noise 30 mN m per sample, count 10 mN m"
    smooth = SensorQuality("motor_torque", "N m", 0.0, np.nan, np.nan, 5.1, 0.5, 125.0)
    text = sensor_sentence(smooth)
    assert "noise " not in text.split("smoothed")[0] and "smoothed above 5.1 Hz" in text and "no count seen" in text
    assert "50 % of the samples repeat" in text


def test_delay_sentences() -> None:
    late = MeasuredDelay("gauge_torque", "the motion", 0.0624, 0.0612, 0.0636, True, True)
    assert delay_sentence(late) == "gauge_torque against the motion: 62.4 ms late (61.2 ... 63.6)"
    early = MeasuredDelay("motor_torque", "the motion", -0.004, -0.005, -0.003, True, True)
    assert delay_sentence(early).endswith("4 ms early (3 ... 5)")
    none = MeasuredDelay("motor_torque", "the motion", 1e-4, -2e-3, 2.2e-3, True, False)
    assert delay_sentence(none).endswith("none within 2.2 ms")
    open_ = MeasuredDelay("motor_torque", "the motion", 1e-4, 0.0, 0.0, False, False, "the joint moves by 0.1 rad only")
    assert delay_sentence(open_).endswith("not determined, the joint moves by 0.1 rad only")
    assert late.json()["sure"] is True and late.error == pytest.approx(1.2e-3)


def curve(offset: float = 0.0) -> FrictionCurve:
    """4 N m at three speeds, forward more than backward by twice the offset; more friction under load."""
    points = tuple(
        FrictionPoint(d, v, 4.0 + d * offset, 3.9 + d * offset, 4.1 + d * offset, 5.0)
        for v in (0.1, 0.3, 1.0)
        for d in (-1, 0, 1)
    )
    light, heavy = Condition("load", "N m", 0.0, 10.0), Condition("load", "N m", 20.0, 30.0)
    groups = {light: (FrictionPoint(0, 0.3, 3.0, 2.9, 3.1, 5.0),), heavy: (FrictionPoint(0, 0.3, 5.0, 4.9, 5.1, 5.0),)}
    return FrictionCurve("motor_torque", points, ("inertia fitted",), 0.3, groups)


def test_friction_sentences() -> None:
    texts = list(friction_sentences(curve()))
    assert texts[0].startswith("motor_torque, both directions: 4 N m (3.9 ... 4.1) at 0.1 rad/s")
    assert texts[1] == (
        "by load: 3 N m (2.9 ... 3.1) at 0.3 rad/s for 0 ... 10 N m, 5 N m (4.9 ... 5.1) at 0.3 rad/s for 20 ... 30 N m"
    )
    assert texts[2:] == ["inertia fitted", "a delay of the torque by one ms would move it by 0.3 N m"]
    assert "forward is 1 N m above backward" in list(friction_sentences(curve(0.5)))
    assert "forward is 1 N m below backward" in list(friction_sentences(curve(-0.5)))
    lost = FrictionCurve("gauge_torque", (FrictionPoint(0, 1.0, -2.0, -3.0, -1.0, 5.0),), ("x",), 0.0)
    assert "which friction cannot be" in list(friction_sentences(lost))[1]
    no_friction = FrictionCurve("gauge_torque", (FrictionPoint(0, 0.1, 0.01, -0.02, 0.02, 5.0),), ("x",), 0.0)
    assert list(friction_sentences(no_friction)) == ["gauge_torque: none, within 10 mN m", "x"]
    few = FrictionCurve("gauge_torque", (FrictionPoint(1, 0.1, 2.0, np.nan, np.nan, 0.3),), ("x",), 0.0)
    assert next(iter(friction_sentences(few))) == (
        "gauge_torque, forward only: 2 N m (too little for an interval) at 0.1 rad/s"
    )


def test_lines_of_a_smoothed_signal_are_said_to_be_too_small() -> None:
    from hd_control.lab.maps.signal_spectra import HertzLine, SignalSpectrum

    spectrum = found().spectra[1]
    lines = tuple(HertzLine(10.0 + i, 0.2, 0.01, 0.001) for i in range(9))
    many = SignalSpectrum(
        "gauge_torque", "N m", spectrum.orders, (), spectrum.frequency, spectrum.density, spectrum.floor, lines
    )
    smooth = SensorQuality("gauge_torque", "N m", 0.0, np.nan, np.nan, 8.0, 0.0, 200.0)
    texts = spectrum_sentences(many, {"gauge_torque": smooth})
    assert len(texts) == 8 and texts[-2] == "and 3 weaker ones" and "too small" in texts[-1]
    assert len(spectrum_sentences(many, {})) == 7


def test_sizes_read_well() -> None:
    assert [size(x, "N m") for x in (2.0, 0.02, 2e-5, 0.0)] == ["2 N m", "20 mN m", "20 uN m", "0 uN m"]
