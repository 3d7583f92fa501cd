"""What the analysis gets of a bag: whole, with gaps, with bad stamps, damaged, foreign, long."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from made_bags import NS, joint_topic, motion, standard_bag, ticks

from hd_control.core.errors import BagError
from hd_control.lab.signals.recording import bag_sha256, read_recording
from hd_control.lab.signals.sources import SignalSource, SourceMap
from hd_control.record.cdr import message_class, typestore
from hd_control.record.writer import BagWriter


def test_every_number_of_a_whole_bag_arrives(tmp_path: Path) -> None:
    stamps = ticks(4.0)
    recording = read_recording(standard_bag(tmp_path / "bag", stamps, ("joint_1", "joint_2")))
    assert list(recording.joints) == ["joint_1", "joint_2"]
    assert recording.robot == "<robot/>" and recording.start_ns == stamps[0]
    assert recording.problems == () and recording.notes == ()
    assert recording.sha256 == bag_sha256(next((tmp_path / "bag").glob("*.mcap")))
    for joint in recording.joints.values():
        assert joint.notes == () and joint.valid.all() and joint.period == 1e-3 and joint.time.size == 4000
        for name, expected in motion((stamps - stamps[0]) / NS).items():
            tolerance = 1e-9 if name == "temperature" else 0.0
            inner = slice(0, 3900)  # the last temperature message is 0.1 s before the end
            assert np.abs(getattr(joint, name) - expected)[inner].max() <= tolerance, name


@pytest.mark.parametrize("rate", [125.0, 200.0, 500.0])
def test_other_rates_are_kept(tmp_path: Path, rate: float) -> None:
    joint = read_recording(standard_bag(tmp_path / "bag", ticks(6.0, 1.0 / rate))).joints["joint_1"]
    assert joint.period == pytest.approx(1.0 / rate) and joint.time.size == 6 * rate and joint.valid.all()


def test_short_gaps_are_bridged_and_long_ones_marked(tmp_path: Path) -> None:
    keep = np.ones(3000, dtype=bool)
    keep[[500, 900, 901, 902]] = keep[1500:1504] = keep[2000:2400] = False
    stamps = ticks(3.0)[keep]
    joint = read_recording(standard_bag(tmp_path / "bag", stamps, skip=["temperature"])).joints["joint_1"]
    assert joint.time.size == 3000
    missing = np.flatnonzero(~joint.valid)
    assert missing.tolist() == [*range(1500, 1504), *range(2000, 2400)]
    assert np.isnan(joint.gauge_torque[missing]).all()
    bridged = [500, 900, 901, 902]
    expected = motion(joint.time)
    assert np.abs(joint.joint_position - expected["joint_position"])[bridged].max() < 1e-8
    assert np.abs(joint.gauge_torque - expected["gauge_torque"])[bridged].max() < 1e-4
    assert joint.motor_torque[901] == pytest.approx(joint.motor_torque[899], rel=1e-9), "a held torque stays as it was"
    assert any("2 gaps, 0.404 s" in note for note in joint.notes)


def test_a_topic_with_gaps_of_its_own_marks_only_its_rows(tmp_path: Path) -> None:
    stamps = ticks(2.0)
    path = standard_bag(tmp_path / "bag", stamps, skip=["gauge_torque", "temperature"])
    with BagWriter(tmp_path / "both", live=False) as writer:
        signals = motion((stamps - stamps[0]) / NS)
        for name, topic, field in (
            ("joint_position", "resolver", "position"),
            ("motor_shaft_position", "encoder", "position"),
        ):
            joint_topic(writer, topic, field, stamps, {"a": signals[name]})
        late = np.r_[0:700, 900:2000]
        joint_topic(writer, "gauge_bridge", "effort", stamps[late], {"a": signals["gauge_torque"][late]})
    joint = read_recording(tmp_path / "both").joints["a"]
    assert np.flatnonzero(~joint.valid).tolist() == list(range(700, 900))
    assert np.isfinite(joint.joint_position).all()
    assert read_recording(path).joints["joint_1"].gauge_torque is None


def test_a_slower_topic_is_interpolated_and_said(tmp_path: Path) -> None:
    stamps = ticks(4.0)
    signals = motion((stamps - stamps[0]) / NS)
    with BagWriter(tmp_path / "bag", live=False) as writer:
        joint_topic(writer, "encoder", "position", stamps, {"a": signals["motor_shaft_position"]})
        joint_topic(writer, "gauge_bridge", "effort", stamps[::4], {"a": signals["gauge_torque"][::4]})
        joint_topic(writer, "resolver", "position", stamps[::50], {"a": signals["joint_position"][::50]})
    joint = read_recording(tmp_path / "bag").joints["a"]
    assert np.abs(joint.gauge_torque - signals["gauge_torque"])[4:-4].max() < 5e-3
    assert any("gauge_torque: recorded at 250 Hz and interpolated" in note for note in joint.notes)
    assert joint.joint_position is None
    assert any("joint_position" in note and "50 times slower" in note for note in joint.notes)


def test_the_command_counts_one_sample_later_and_only_without_the_applied_torque(tmp_path: Path) -> None:
    stamps = ticks(2.0)
    signals = motion((stamps - stamps[0]) / NS)
    for name, applied in (("with", True), ("without", False)):
        with BagWriter(tmp_path / name, live=False) as writer:
            joint_topic(writer, "encoder", "position", stamps, {"a": signals["motor_shaft_position"]})
            joint_topic(writer, "motor_torque_command", "effort", stamps, {"a": signals["motor_torque"]})
            if applied:
                joint_topic(writer, "motor_torque_applied", "effort", stamps, {"a": 2.0 * signals["motor_torque"]})
    joint = read_recording(tmp_path / "with").joints["a"]
    assert joint.sources["motor_torque"] == "/motor_torque_applied"
    assert np.array_equal(joint.motor_torque, 2.0 * signals["motor_torque"])
    joint = read_recording(tmp_path / "without").joints["a"]
    assert np.array_equal(joint.motor_torque[1:], signals["motor_torque"][:-1])
    assert joint.period_command_delay == 0 and any("moved 1 sample later" in note for note in joint.notes)


def test_columns_without_numbers_are_not_there_and_constant_ones_are_said(tmp_path: Path) -> None:
    stamps = ticks(2.0)
    change = {"joint_position": np.full(2000, np.nan), "gauge_torque": np.full(2000, 3.5)}
    joint = read_recording(standard_bag(tmp_path / "bag", stamps, change=change)).joints["joint_1"]
    assert joint.joint_position is None and joint.valid.all()
    assert any("joint_position" in note and "no number" in note for note in joint.notes)
    assert "gauge_torque: constant at 3.5" in joint.notes


def test_an_empty_column_falls_back_to_the_next_source(tmp_path: Path) -> None:
    stamps = ticks(2.0)
    signals = motion((stamps - stamps[0]) / NS)
    with BagWriter(tmp_path / "bag", live=False) as writer:
        joint_topic(writer, "encoder", "position", stamps, {"a": signals["motor_shaft_position"]})
        joint_topic(writer, "gauge_bridge", "effort", stamps, {"a": np.full(2000, np.nan)})
        joint_topic(writer, "joint_states", "effort", stamps, {"a": signals["gauge_torque"]})
    joint = read_recording(tmp_path / "bag").joints["a"]
    assert joint.sources["gauge_torque"] == "/joint_states"
    assert np.array_equal(joint.gauge_torque, signals["gauge_torque"])


def test_a_cut_bag_is_read_as_far_as_it_is_whole(tmp_path: Path) -> None:
    path = standard_bag(tmp_path / "bag", ticks(20.0))
    file = next(path.glob("*.mcap"))
    data = file.read_bytes()
    file.write_bytes(data[: int(0.7 * len(data))])
    recording = read_recording(path)
    assert recording.problems and recording.joints["joint_1"].present


@pytest.mark.parametrize(
    ("skip", "says"),
    [
        (["motor_shaft_position", "joint_position"], "no position of a joint"),
        (["gauge_torque", "motor_torque"], "no torque of a joint"),
    ],
)
def test_a_bag_without_the_needed_topics_says_what_is_there(tmp_path: Path, skip: list[str], says: str) -> None:
    path = standard_bag(tmp_path / "bag", ticks(2.0), skip=skip)
    with pytest.raises(BagError, match=says) as error:
        read_recording(path)
    assert "/joint_reference" in str(error.value) and "--map" in str(error.value)


def test_bad_questions_are_one_clear_line(tmp_path: Path) -> None:
    path = standard_bag(tmp_path / "bag", ticks(3.0))
    with pytest.raises(BagError, match="no joint joint_9; there is joint_1"):
        read_recording(path, joints=["joint_9"])
    with pytest.raises(BagError, match=r"the recording is 3.000 s long"):
        read_recording(path, start_s=10.0)
    with pytest.raises(BagError, match="no such bag"):
        read_recording(tmp_path / "none")
    few = standard_bag(tmp_path / "few", ticks(0.005))
    with pytest.raises(BagError, match="at least 10 are needed"):
        read_recording(few)


def test_a_part_of_a_recording(tmp_path: Path) -> None:
    stamps = ticks(6.0)
    recording = read_recording(standard_bag(tmp_path / "bag", stamps), start_s=2.0, seconds=1.5)
    joint = recording.joints["joint_1"]
    assert joint.time.size == 1500 and recording.start_ns == stamps[2000]
    assert np.array_equal(joint.gauge_torque, motion((stamps - stamps[0]) / NS)["gauge_torque"][2000:3500])


def test_a_sealed_truth_beside_the_bag_is_not_opened(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    path = standard_bag(tmp_path / "bag", ticks(2.0))
    for place in (tmp_path / "bag.seal", path / "truth.seal"):
        place.mkdir()  # opening it as a file would fail
    opened: list[str] = []
    original = Path.open

    def watch(self: Path, *words: object, **named: object) -> object:
        opened.append(self.name)
        return original(self, *words, **named)  # type: ignore[arg-type] # the same words

    monkeypatch.setattr(Path, "open", watch)
    read_recording(path)
    assert opened and not any("seal" in name for name in opened)


def test_a_db3_bag_with_foreign_names(tmp_path: Path) -> None:
    from rosbags.rosbag2 import Writer
    from rosbags.rosbag2.enums import StoragePlugin

    store, kind = typestore(), "sensor_msgs/msg/JointState"
    time_class, header = message_class("builtin_interfaces/msg/Time"), message_class("std_msgs/msg/Header")
    stamps = ticks(3.0, 8e-3)
    signals = motion((stamps - stamps[0]) / NS)
    with Writer(tmp_path / "foreign", version=9, storage_plugin=StoragePlugin.SQLITE3) as writer:
        connection = writer.add_connection("/robot/state", kind, typestore=store)
        for k, stamp in enumerate(stamps.tolist()):
            q, tau = signals["joint_position"][k], signals["gauge_torque"][k]
            values = np.array([np.degrees(q), 7.0]), np.zeros(0), np.array([-1000.0 * tau, 8.0])
            message = message_class(kind)(header(time_class(*divmod(stamp, NS)), ""), ["elbow", "wrist"], *values)
            writer.write(connection, stamp, store.serialize_cdr(message, kind))
    sources = {
        "joint_position": (SignalSource("joint_position", "/robot/state", "position", "deg"),),
        "gauge_torque": (SignalSource("gauge_torque", "/robot/state", "effort", "mNm", sign=-1.0),),
    }
    recording = read_recording(tmp_path / "foreign", SourceMap("made", sources, {"joint_4": "elbow"}))
    assert list(recording.joints) == ["joint_4"] and recording.problems == ()
    joint = recording.joints["joint_4"]
    assert joint.period == pytest.approx(8e-3)
    assert joint.joint_position == pytest.approx(signals["joint_position"], abs=1e-12)
    assert joint.gauge_torque == pytest.approx(signals["gauge_torque"], abs=1e-12)


def test_a_known_delay_is_taken_out(tmp_path: Path) -> None:
    stamps = ticks(3.0)
    path = standard_bag(tmp_path / "bag", stamps, skip=["temperature"])
    sources = {
        "joint_position": (SignalSource("joint_position", "resolver", "position"),),
        "gauge_torque": (SignalSource("gauge_torque", "gauge_bridge", "effort", delay=0.0553),),
    }
    joint = read_recording(path, SourceMap("made", sources)).joints["joint_1"]
    early = motion(joint.time + 0.0553)["gauge_torque"]
    inside = joint.time + 0.0553 < 2.99
    assert np.abs(joint.gauge_torque - early)[inside].max() < 1e-5
    assert not joint.valid[-50:].any()


@pytest.mark.slow
def test_more_than_twenty_minutes_are_read_at_a_lower_rate(tmp_path: Path) -> None:
    stamps = ticks(1206.0)
    recording = read_recording(standard_bag(tmp_path / "bag", stamps, skip=["temperature", "reference_position"]))
    joint = recording.joints["joint_1"]
    assert joint.period == pytest.approx(3e-3) and joint.time.size == 402_000
    assert any("decimated by 3" in note for note in recording.notes)
    assert np.abs(joint.gauge_torque - motion(joint.time)["gauge_torque"])[50:-50].max() < 0.02
