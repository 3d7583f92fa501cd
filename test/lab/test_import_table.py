"""Tables of foreign robots as bags: which column is which signal of which joint, its stamps, its SI values."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path

import numpy as np
import pytest

from hd_control.core.errors import BagError
from hd_control.lab.signals.import_table import TABLE, Imported, import_table
from hd_control.lab.signals.recording import read_recording
from hd_control.lab.signals.sources import SignalSource, SourceMap, TimeSource
from hd_control.record.reader import BagReader

ROWS, PERIOD = 400, 5e-3
TIME = np.arange(ROWS) * PERIOD
Q, TAU = np.sin(3.0 * TIME), 5.0 * np.cos(2.0 * TIME)


def table(path: Path, columns: Mapping[str, np.ndarray]) -> Path:
    """An NPZ file."""
    np.savez(path / "log.npz", **columns)
    return path / "log.npz"


def mapping(joints: Mapping[str, str] | None = None, time: TimeSource | None = None, **more: object) -> SourceMap:
    """Position and torque from columns q and tau."""
    sources = {
        "joint_position": (SignalSource("joint_position", columns="q"),),
        "motor_torque": (SignalSource("motor_torque", columns="tau", **more),),  # type: ignore[arg-type]
    }
    return SourceMap("made", sources, joints or {}, time or TimeSource("t"))


def imported(tmp_path: Path, columns: Mapping[str, np.ndarray], source_map: SourceMap | None) -> Imported:
    """The table as tmp_path/bag."""
    return import_table(table(tmp_path, columns), tmp_path / "bag", source_map)


def test_two_dimensional_columns_are_joints(tmp_path: Path) -> None:
    """Names of the mapping, of the file, or numbers."""
    columns = {"t": TIME, "q": np.stack([Q, 2.0 * Q], axis=1), "tau": np.stack([TAU, 3.0 * TAU], axis=1)}
    for k, (names, extra) in enumerate(
        (
            (("a", "b"), {"joints": np.array(["x", "y"])}),
            (("x", "y"), {"joints": np.array(["x", "y"])}),
            (("joint_1", "joint_2"), {}),
        )
    ):
        source_map = mapping({"a": "a", "b": "b"} if k == 0 else None, held=True)
        place = tmp_path / str(k)
        place.mkdir()
        assert imported(place, {**columns, **extra}, source_map).joints == names
        joints = read_recording(place / "bag").joints
        for scale, name in zip((1.0, 2.0), names, strict=True):
            np.testing.assert_array_equal(joints[name].joint_position, scale * Q)


def test_wrong_widths_and_lengths_are_named(tmp_path: Path) -> None:
    wide = {"t": TIME, "q": np.stack([Q, Q], axis=1), "tau": TAU}
    with pytest.raises(BagError, match="'q' has 2 columns, the mapping names 1 joints"):
        imported(tmp_path, wide, mapping({"a": "a"}))
    with pytest.raises(BagError, match="the columns have different lengths: 390, 400"):
        imported(tmp_path, {"t": TIME, "q": Q[:390], "tau": TAU}, mapping())
    with pytest.raises(BagError, match="400 times for 390 samples"):
        imported(tmp_path, {"t": TIME, "q": Q[:390], "tau": TAU[:390]}, mapping())
    with pytest.raises(BagError, match="no column 'tau'; there is t, q"):
        imported(tmp_path, {"t": TIME, "q": Q}, mapping())
    with pytest.raises(BagError, match="no column 't'; there is q, tau"):
        imported(tmp_path, {"q": Q, "tau": TAU}, mapping())
    with pytest.raises(BagError, match="'t' has 2 columns; name one column per joint"):
        imported(tmp_path, {"t": np.stack([TIME, TIME], axis=1), "q": Q, "tau": TAU}, mapping())
    assert not (tmp_path / "bag").exists()


def test_names_of_joints_come_from_the_pattern(tmp_path: Path) -> None:
    """Of the exported table: `joint.signal`; a name may hold what a regular expression would read as its own."""
    columns = {"time": TIME, "axis(1).joint_position": Q, "axis(1).motor_torque": TAU, "b.joint_position": -Q}
    found = imported(tmp_path, columns, TABLE)
    assert found.joints == ("axis(1)", "b") and set(found.signals) == {"joint_position", "motor_torque"}
    joints = read_recording(tmp_path / "bag").joints
    np.testing.assert_array_equal(joints["b"].joint_position, -Q)
    np.testing.assert_array_equal(joints["axis(1)"].motor_torque, TAU)
    sources = {"joint_position": (SignalSource("joint_position", columns="q[{joint}]"),)}
    bracket = tmp_path / "bracket"
    bracket.mkdir()
    found = imported(bracket, {"t": TIME, "q[a]": Q, "qb": Q}, SourceMap("made", sources, {}, TimeSource("t")))
    assert found.joints == ("a",)


@pytest.mark.parametrize("held", [True, False])
def test_a_measured_torque_is_written_as_what_was_held(tmp_path: Path, held: bool) -> None:
    imported(tmp_path, {"t": TIME, "q": Q, "tau": TAU}, mapping(held=held))
    written = read_recording(tmp_path / "bag").joints["joint_1"].motor_torque
    expected = TAU if held else np.append(0.5 * (TAU[:-1] + TAU[1:]), TAU[-1])
    np.testing.assert_array_equal(written, expected)


@pytest.mark.parametrize("delay", [0.02, -0.02])
def test_a_delayed_signal_gets_earlier_stamps_and_none_is_negative(tmp_path: Path, delay: float) -> None:
    imported(tmp_path, {"t": TIME, "q": Q, "tau": TAU}, mapping(delay=delay, held=True))
    with BagReader(tmp_path / "bag") as bag:
        position, torque = (bag.columns(topic).stamps_ns for topic in ("resolver", "motor_torque_applied"))
    assert min(position.min(), torque.min()) == 0
    np.testing.assert_array_equal(position - torque, round(delay * 1e9))


def test_times_from_a_period_alone_or_rounded_to_it(tmp_path: Path) -> None:
    imported(tmp_path, {"q": Q, "tau": TAU}, mapping(time=TimeSource(period=4e-3)))
    assert read_recording(tmp_path / "bag").joints["joint_1"].period == pytest.approx(4e-3)
    rough = tmp_path / "rough"
    rough.mkdir()
    shaken = TIME + 1e-3 * np.sin(7.0 * np.arange(ROWS))
    found = imported(rough, {"t": shaken, "q": Q, "tau": TAU}, mapping(time=TimeSource("t", 1.0, PERIOD)))
    assert found.samples == ROWS and found.problems == ()
    recording = read_recording(rough / "bag")
    assert recording.notes == (), "even ticks again"
    with pytest.raises(BagError, match="says nothing of the time"):
        imported(tmp_path, {"q": Q, "tau": TAU}, mapping(time=TimeSource()))


def test_times_that_go_back_or_are_missing_cost_their_rows_only(tmp_path: Path) -> None:
    time = 1e3 * TIME + 7e6
    time[[50, 51]], time[200], time[300] = np.nan, time[100], time[299]
    found = imported(tmp_path, {"t": time, "q": Q, "tau": TAU}, mapping(time=TimeSource("t", 1e-3)))
    assert found.samples == ROWS - 4
    assert found.problems == ("4 of 400 rows dropped, their times repeat, go back or are missing",)
    assert found.seconds == pytest.approx(TIME[-1], abs=1e-6)
    joint = read_recording(tmp_path / "bag").joints["joint_1"]
    kept = np.setdiff1d(np.arange(ROWS), [50, 51, 200, 299, 300])  # of two rows at one time either may stay
    np.testing.assert_array_equal(joint.joint_position[kept], Q[kept])


def test_too_few_rows_and_tables_without_signals_are_refused(tmp_path: Path) -> None:
    with pytest.raises(BagError, match="9 samples with a time, at least 10 are needed"):
        imported(tmp_path, {"t": TIME[:9], "q": Q[:9], "tau": TAU[:9]}, mapping())
    with pytest.raises(BagError, match="no column of a signal; there is t, x; a foreign table needs --map"):
        imported(tmp_path, {"t": TIME, "x": Q}, None)


def test_columns_without_numbers_are_noted_and_robot_and_source_are_carried(tmp_path: Path) -> None:
    source = table(tmp_path, {"t": TIME, "q": Q, "tau": np.full(ROWS, np.nan)})
    found = import_table(source, tmp_path / "bag", mapping(), "<robot name='r'/>")
    assert found.notes == ("motor_torque of joint_1 holds no number",)
    with BagReader(tmp_path / "bag") as bag:
        assert bag.attachments["robot.urdf"] == b"<robot name='r'/>"


def test_temperatures_come_one_message_per_joint(tmp_path: Path) -> None:
    warm = {"a": 30.0 + TIME, "b": 40.0 - TIME}
    sources = {
        "joint_position": (SignalSource("joint_position", columns="q_{joint}"),),
        "gauge_torque": (SignalSource("gauge_torque", columns={"a": "tau"}),),
        "temperature": (SignalSource("temperature", columns="warm_{joint}"),),
    }
    source_map = SourceMap("made", sources, {"a": "a", "b": "b"}, TimeSource("t"))
    columns = {"t": TIME, "q_a": Q, "q_b": Q, "tau": TAU, "warm_a": warm["a"], "warm_b": warm["b"]}
    imported(tmp_path, columns, source_map)
    joints = read_recording(tmp_path / "bag").joints
    for name, values in warm.items():
        np.testing.assert_allclose(joints[name].temperature, values, atol=1e-12)
    assert joints["b"].gauge_torque is None and joints["a"].gauge_torque is not None
