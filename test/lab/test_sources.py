"""Where signals come from: topics of this project, mapping files of foreign ones; units, signs, counters that wrap."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from hd_control.core.errors import ConfigError
from hd_control.core.strict_yaml import parse_yaml
from hd_control.lab.signals.joint_signals import SIGNALS
from hd_control.lab.signals.sources import (
    QUANTITIES,
    STANDARD,
    UNITS,
    SignalSource,
    held_from_measured,
    load_mapping,
    parse_mapping,
)

GOOD = """
joints: {j1: axis_a, j2: axis_b}
time: {column: stamp, unit: ms, period: 4e-3}
signals:
  joint_position: {topic: /state, field: position, unit: deg, sign: {j2: -1}, offset: {j1: 0.5}, wrap: 360}
  motor_torque: {columns: "i_{joint}", unit: mNm, scale: {j1: 100, j2: 50}}
  gauge_torque: {columns: {j1: tau}, delay: 0.05}
"""


def parsed(text: str):  # type: ignore[no-untyped-def] # a helper of this file
    return parse_mapping(parse_yaml(text, "map.yaml"), "map.yaml")


def test_a_mapping_says_what_the_file_says() -> None:
    mapping = parsed(GOOD)
    assert mapping.joints == {"j1": "axis_a", "j2": "axis_b"} and mapping.ours("axis_b") == "j2"
    assert mapping.ours("axis_c") is None
    assert (mapping.time.column, mapping.time.unit, mapping.time.period) == ("stamp", 1e-3, 4e-3)
    position = mapping.signals["joint_position"][0]
    assert (position.topic, position.field, position.held) == ("/state", "position", False)
    raw = np.array([170.0, 179.0, -179.0, -170.0])
    assert position.convert("j1", raw) == pytest.approx(np.deg2rad([170.0, 179.0, 181.0, 190.0]) + 0.5)
    assert position.convert("j2", raw) == pytest.approx(-np.deg2rad([170.0, 179.0, 181.0, 190.0]))
    torque = mapping.signals["motor_torque"][0]
    assert torque.held and torque.columns == "i_{joint}"
    assert torque.convert("j2", np.array([2000.0])) == pytest.approx([100.0])
    assert mapping.signals["gauge_torque"][0].delay == 0.05


def test_joints_may_keep_their_names() -> None:
    mapping = parsed("joints: [a, b]\nsignals: {joint_position: {topic: s, field: position}}")
    assert mapping.joints == {"a": "a", "b": "b"}
    assert parsed("signals: {joint_position: {topic: s, field: position}}").ours("any") == "any"


@pytest.mark.parametrize(
    ("signal", "unit", "raw", "value"),
    [
        ("joint_position", "deg", 180.0, np.pi),
        ("motor_shaft_position", "turn", 2.0, 4.0 * np.pi),
        ("gauge_torque", "Ncm", 250.0, 2.5),
        ("gauge_torque", "lbf in", 10.0, 1.129848290276),
        ("temperature", "K", 300.0, 26.85),
        ("temperature", "degF", 212.0, 100.0),
        ("temperature", "degF", 32.0, 0.0),
        ("joint_velocity", "rpm", 60.0, 2.0 * np.pi),
    ],
)
def test_units(signal: str, unit: str, raw: float, value: float) -> None:
    assert SignalSource(signal, unit=unit).convert("j", np.array([raw])) == pytest.approx([value], abs=1e-12)


def test_every_signal_has_units_and_si_changes_nothing() -> None:
    values = np.array([1.0, np.nan, -3.0])
    for signal, quantity in QUANTITIES.items():
        si = next(iter(UNITS[quantity]))
        assert np.array_equal(SignalSource(signal, unit=si).convert("j", values), values, equal_nan=True)


def test_a_measured_torque_becomes_the_mean_over_each_tick() -> None:
    assert held_from_measured(np.array([0.0, 2.0, 6.0])).tolist() == [1.0, 4.0, 6.0]


@pytest.mark.parametrize(
    ("text", "says"),
    [
        ("signals: {}", "at least one is needed"),
        ("signal: {}", "did you mean 'signals'"),
        ("signals: {joint_angle: {topic: s, field: position}}", "unknown key 'joint_angle'"),
        ("signals:\n  gauge_torque: {topic: s, feild: effort}", "line 2: unknown key 'feild', did you mean 'field'"),
        ("signals: {gauge_torque: {topic: s}}", "field '' is not one of"),
        ("signals: {gauge_torque: {topic: s, field: effort, unit: deg}}", "unit 'deg' is not one of Nm"),
        ("signals: {gauge_torque: {unit: Nm}}", "name a topic"),
        ("signals: {gauge_torque: {columns: t, sign: 2}}", "expected 1 or -1"),
        ("signals: {gauge_torque: {columns: t, scale: big}}", "expected a number, got 'big'"),
        ("signals: {gauge_torque: {columns: t, wrap: -1}}", "of at least 0"),
        ("signals: {gauge_torque: {columns: t, held: 1}}", "expected true or false"),
        ("joints: [a, a]\nsignals: {gauge_torque: {columns: t}}", "named twice"),
        ("joints: 3\nsignals: {gauge_torque: {columns: t}}", "expected a list of names"),
        ("joints: [a]\nsignals: {gauge_torque: {columns: t, sign: {b: -1}}}", "unknown key 'b'"),
        ("time: {unit: s}\nsignals: {gauge_torque: {columns: t}}", "name a column"),
        ("time: {column: t, unit: h}\nsignals: {gauge_torque: {columns: t}}", "unit 'h' is not one of s, ms"),
        ("signals: {gauge_torque: {columns: t}, gauge_torque: {columns: t}}", "duplicate key"),
    ],
)
def test_mistakes_are_named(text: str, says: str) -> None:
    with pytest.raises(ConfigError) as error:
        parsed(text)
    assert says in str(error.value) and "map.yaml" in str(error.value) and "\n" not in str(error.value)


@pytest.mark.parametrize("name", ["iiwa", "ur10"])
def test_the_shipped_mappings_load(name: str) -> None:
    assert load_mapping(name).signals


def test_an_unknown_mapping_names_the_shipped_ones(tmp_path: Path) -> None:
    with pytest.raises(ConfigError, match=r"iiwa\.yaml"):
        load_mapping("kuka")
    with pytest.raises(ConfigError, match="no such file"):
        load_mapping(tmp_path / "none.yaml")


@pytest.mark.parametrize(("wrap", "unit"), [(360.0, "deg"), (2.0 * np.pi, "rad"), (1.0, "turn"), (16384.0, "")])
@pytest.mark.parametrize("per_sample", [0.02, 0.3, 0.49])
def test_a_counter_that_wraps_becomes_the_angle_it_counts(wrap: float, unit: str, per_sample: float) -> None:
    """To and fro over several turns; a step of less than half the range is not ambiguous."""
    turns = np.cumsum(per_sample * np.sign(np.sin(0.05 * np.arange(400))))
    raw = np.mod(turns * wrap, wrap)
    found = SignalSource("motor_shaft_position", unit=unit, wrap=wrap, scale=1.0 if unit else 1.0 / wrap)
    factor = UNITS["angle"][unit][0] * wrap if unit else 1.0
    angle = found.convert("j", raw)
    np.testing.assert_allclose(angle - angle[0], (turns - turns[0]) * factor, atol=1e-9 * factor)


def test_a_counter_with_holes_is_unwrapped_across_them() -> None:
    raw = np.array([350.0, np.nan, 355.0, 2.0, np.nan, 8.0, 358.0])
    found = np.rad2deg(SignalSource("joint_position", unit="deg", wrap=360.0).convert("j", raw))
    np.testing.assert_allclose(found, [350.0, np.nan, 355.0, 362.0, np.nan, 368.0, 358.0], atol=1e-9)
    assert raw[3] == 2.0, "the raw values stay as they were"


def test_sign_and_scale_stand_before_the_offset() -> None:
    """SI value = sign * scale * raw + offset: a zero is given in SI, as it is read from the robot."""
    source = SignalSource("gauge_torque", unit="mNm", sign=-1.0, scale=100.0, offset=3.0)
    assert source.convert("j", np.array([2000.0])) == pytest.approx([-197.0])
    celsius = SignalSource("temperature", unit="K", scale=0.1)
    assert celsius.convert("j", np.array([300.0])) == pytest.approx([2.685]), "scale acts on what the unit made"


def test_the_projects_own_topics_are_in_si_and_the_measured_ones_come_first() -> None:
    assert list(STANDARD.signals) == list(SIGNALS)
    for name, sources in STANDARD.signals.items():
        assert all(s.signal == name and (s.unit, s.sign, s.scale, s.offset) == ("", 1.0, 1.0, 0.0) for s in sources)
    torque = STANDARD.signals["motor_torque"]
    assert [(s.topic, s.acts_later) for s in torque] == [("motor_torque_applied", 0), ("motor_torque_command", 1)]
    assert all(s.held for s in torque), "a command acts until the next one"
    assert [s.topic for s in STANDARD.signals["gauge_torque"]] == ["gauge_bridge", "joint_states"]
