"""Bags: what was written is read, by this reader, by rosbags and by mcap, in every form of the file."""

from __future__ import annotations

import numpy as np
import pytest
from small_bags import NAMES, RUN, START, T0, TICK, TOPICS, file_of, payload_of, tick_values, write_bag

from hd_control.core.errors import BagError
from hd_control.core.topics import JOINT_STATE_TYPE
from hd_control.record.cdr import JointStateCodec, encode_text
from hd_control.record.reader import BagReader, Gap
from hd_control.record.schema import joint_state_codec
from hd_control.record.writer import BagWriter

TICKS = 25
FORMS = {"compact": {}, "plain": {"compact": False}, "chunks": {"live": False}}
COUNTS = {"/robot_description": 1, "/motor_temperature": 3, **{f"/{topic}": TICKS for topic in TOPICS}}


@pytest.fixture(params=FORMS)
def bag(request, tmp_path):
    return write_bag(tmp_path / "bag", TICKS, **FORMS[request.param])


def test_columns_are_what_was_written(bag):
    reader = BagReader(bag)
    assert reader.counts == COUNTS and reader.complete and reader.problems == []
    expected = np.array([tick_values(k) for k in range(TICKS)])
    for topic in TOPICS:
        columns = reader.columns(topic)
        assert columns.names == tuple(NAMES) and columns.undecodable == 0
        assert set(columns.frame_ids.tolist()) == {RUN.encode()}
        assert np.array_equal(columns.stamps_ns, T0 + TICK * np.arange(TICKS))
        assert np.array_equal(columns.log_times_ns, columns.stamps_ns + 50)
        assert set(columns.values) == set(joint_state_codec(topic, NAMES).fields)
        for value in columns.values.values():
            assert np.array_equal(value, expected)
    assert reader.columns("encoder").effort is None
    assert reader.columns("motor_temperature").values["temperature"][:, 0].tolist() == [20.0, 30.0, 40.0]
    assert [text.data for _, text in reader.messages("robot_description")] == ["<robot/>"]
    assert reader.attachments == {"robot.urdf": b"<robot/>"}
    assert reader.metadata["hd_session"]["seed"] == "7" and reader.metadata["hd_session"]["start_time_utc"] == START
    assert reader.accounting["/encoder"]["written"] == TICKS and reader.accounting["/encoder"]["run_ids"] == [RUN]


def test_rosbags_reads_the_same(bag):
    from rosbags.highlevel import AnyReader
    from rosbags.rosbag2 import Reader

    with Reader(bag) as reader:
        assert {connection.topic: connection.msgcount for connection in reader.connections} == COUNTS
    with AnyReader([bag]) as reader:
        assert reader.message_count == sum(COUNTS.values())
        encoder = [connection for connection in reader.connections if connection.topic == "/encoder"]
        read = [(time, bytes(data)) for _, time, data in reader.messages(encoder)]
        assert read == [(T0 + k * TICK + 50, payload_of("encoder", k)) for k in range(TICKS)]
        message = reader.deserialize(read[3][1], JOINT_STATE_TYPE)
        assert list(message.name) == NAMES and np.array_equal(message.position, tick_values(3))


def test_mcap_reads_the_same(bag):
    from mcap.reader import make_reader

    with file_of(bag).open("rb") as stream:
        reader = make_reader(stream, validate_crcs=True)
        summary = reader.get_summary()
        assert summary.statistics.message_count == sum(COUNTS.values())
        assert {summary.channels[n].topic: c for n, c in summary.statistics.channel_message_counts.items()} == COUNTS
        times = [message.log_time for _, _, message in reader.iter_messages()]
        assert len(times) == sum(COUNTS.values()) and times == sorted(times)
        assert [attachment.name for attachment in reader.iter_attachments()] == ["robot.urdf"]
        assert {schema.encoding for schema in summary.schemas.values()} == {"ros2msg"}
        encoder = [message for _, channel, message in reader.iter_messages() if channel.topic == "/encoder"]
        assert [message.sequence for message in encoder] == list(range(TICKS))
        assert [message.publish_time for message in encoder] == [T0 + k * TICK for k in range(TICKS)]


def test_a_bare_file_is_a_bag(bag):
    reader = BagReader(file_of(bag))
    assert reader.counts == COUNTS and reader.complete


def test_rosbags_databases_are_read(tmp_path):
    from rosbags.rosbag2 import StoragePlugin, Writer

    from hd_control.record.cdr import typestore

    with Writer(tmp_path / "old", version=9, storage_plugin=StoragePlugin.SQLITE3) as writer:
        connection = writer.add_connection("/encoder", JOINT_STATE_TYPE, typestore=typestore())
        for k in range(TICKS):
            writer.write(connection, T0 + k * TICK, payload_of("encoder", k))
    for path in (tmp_path / "old", tmp_path / "old" / "old.db3"):
        reader = BagReader(path)
        assert reader.counts == {"/encoder": TICKS} and reader.complete
        assert np.array_equal(reader.columns("encoder").position, [tick_values(k) for k in range(TICKS)])
        assert any("checksums" in str(problem) for problem in reader.problems)


def test_columns_written_at_once_equal_single_messages(tmp_path):
    codec = joint_state_codec("encoder", NAMES)
    stamps, position = T0 + TICK * np.arange(9000), np.random.default_rng(3).standard_normal((9000, 3))
    with BagWriter(tmp_path / "a", live=False, start_time_utc=START) as bulk:
        bulk.write_columns("encoder", codec, stamps, frame_id=RUN, position=position)
    with BagWriter(tmp_path / "b", start_time_utc=START) as single:
        for stamp, row in zip(stamps.tolist(), position, strict=True):
            single.write("encoder", stamp, stamp, codec.encode(stamp, RUN, position=row))
    one, two = BagReader(tmp_path / "a"), BagReader(tmp_path / "b")
    assert list(one.raw("encoder")) == list(two.raw("encoder")) and one.accounting == two.accounting
    assert np.array_equal(one.columns("encoder").position, position)


def test_equal_runs_make_equal_files(tmp_path):
    one = file_of(write_bag(tmp_path / "bag", 12, live=False)).read_bytes()
    (tmp_path / "again").mkdir()
    assert file_of(write_bag(tmp_path / "again" / "bag", 12, live=False)).read_bytes() == one


def test_gaps_duplicates_and_disorder_are_counted(tmp_path):
    ticks = [0, 1, 2, 5, 5, 6, 4, 7, 20]
    with BagWriter(tmp_path / "bag") as bag:
        for k in ticks:
            bag.write("encoder", T0 + k * TICK, T0 + 100 * TICK + len(bag.accounts), payload_of("encoder", k))
    account = BagReader(tmp_path / "bag").accounting["/encoder"]
    counted = {key: account[key] for key in ("received", "written", "gaps", "missing", "duplicates", "out_of_order")}
    assert counted == {"received": 9, "written": 9, "gaps": 2, "missing": 2 + 12, "duplicates": 1, "out_of_order": 1}


def test_gaps_name_the_stamps_around_them(tmp_path):
    with BagWriter(tmp_path / "bag") as bag:
        for k in (0, 1, 4, 5, 15):
            bag.write("encoder", None, T0 + k * TICK, payload_of("encoder", k))
    reader = BagReader(tmp_path / "bag")
    at = [T0 + k * TICK for k in (1, 4, 5, 15)]
    assert reader.gaps("encoder", TICK) == [Gap(at[0], at[1], 2), Gap(at[2], at[3], 9)]


def test_changing_joints_give_nan_where_there_is_no_value(tmp_path):
    first = JointStateCodec(["a", "b"], 3)
    second = JointStateCodec(["b", "c"], 5, position=True, effort=True)
    with BagWriter(tmp_path / "bag") as bag:
        for k, payload in enumerate(
            (
                first.encode(1, "run", position=[1, 2]),
                second.encode(2, "other", position=[3, 4], effort=[5, 6]),
                b"\x00\x01\x00\x00garbage",
                first.encode(3, "run", position=[7, 8]),
            )
        ):
            bag.write("joint_states", k, T0 + k, payload)
    reader = BagReader(tmp_path / "bag")
    columns = reader.columns("joint_states")
    nan = np.nan
    assert columns.names == ("a", "b", "c") and columns.stamps_ns.tolist() == [1, 2, 3]
    np.testing.assert_array_equal(columns.position, [[1, 2, nan], [nan, 3, 4], [7, 8, nan]])
    np.testing.assert_array_equal(columns.effort, [[nan] * 3, [nan, 5, 6], [nan] * 3])
    assert columns.frame_ids.tolist() == [b"run", b"other", b"run"]
    assert columns.undecodable == 1 and not reader.complete


def test_many_layouts_are_still_read(tmp_path):
    with BagWriter(tmp_path / "bag") as bag:
        for k in range(100):
            bag.write("joint_states", k, T0 + k, JointStateCodec([f"j{k}"], k).encode(k, "x" * k, position=[k]))
    columns = BagReader(tmp_path / "bag").columns("joint_states")
    assert np.array_equal(np.diag(columns.position), np.arange(100.0)) and columns.undecodable == 0


def test_foreign_types_are_listed_and_read_by_their_own_definition(tmp_path):
    with BagWriter(tmp_path / "bag") as bag:
        bag.add_topic("/wheel", "my_msgs/msg/Wheel", "float64 speed\nstring name\n")
        bag.write("/wheel", 5, T0, b"\x00\x01\x00\x00" + np.array([2.5]).tobytes() + b"\x02\x00\x00\x00a\x00")
    reader = BagReader(tmp_path / "bag")
    assert reader.topics == {"/wheel": "my_msgs/msg/Wheel"}
    ((_, message),) = reader.messages("wheel")
    assert message.speed == 2.5 and message.name == "a"
    with pytest.raises(BagError, match="messages"):
        reader.columns("wheel")


def test_introspection_values_carry_their_names(tmp_path):
    from hd_control.record.cdr import ValuesCodec

    with BagWriter(tmp_path / "bag") as bag:
        bag.write("/torque_node/introspection/names", None, T0, encode_text("feedforward\nfeedback"))
        for k in range(3):
            bag.write("/torque_node/introspection/values", None, T0 + k, ValuesCodec(2).encode(data=[k, -k]))
    columns = BagReader(tmp_path / "bag").columns("torque_node/introspection/values")
    assert columns.names == ("feedforward", "feedback")
    assert columns.values["data"].tolist() == [[0, 0], [1, -1], [2, -2]]
    assert columns.stamps_ns.tolist() == [T0, T0 + 1, T0 + 2], "without a stamp the log time counts"


def plain_files_stay_cases():
    def give_up(bag, monkeypatch):
        bag.close(give_up=lambda: True)

    def no_space(bag, monkeypatch):
        def refuse(source, target, give_up):
            target.write_bytes(b"half a file")
            raise OSError(28, "No space left on device")

        monkeypatch.setattr("hd_control.record.compact._write", refuse)
        bag.close()

    def differs(bag, monkeypatch):
        monkeypatch.setattr("hd_control.record.compact._digests", lambda source: {})
        with pytest.raises(BagError, match="differs"):
            bag.close()

    return [give_up, no_space, differs]


@pytest.mark.parametrize("case", plain_files_stay_cases(), ids=lambda case: case.__name__)
def test_the_plain_file_stays_when_the_compact_one_cannot_be_made(tmp_path, monkeypatch, case):
    bag = BagWriter(tmp_path / "bag")
    for k in range(TICKS):
        bag.write("encoder", None, T0 + k * TICK, payload_of("encoder", k))
    case(bag, monkeypatch)
    assert sorted(path.name for path in (tmp_path / "bag").iterdir()) == ["bag_0.mcap", "metadata.yaml"]
    reader = BagReader(tmp_path / "bag")
    assert reader.complete and reader.counts == {"/encoder": TICKS}


def test_namespaces_are_found(tmp_path):
    with BagWriter(tmp_path / "bag") as bag:
        bag.write("/arm/encoder", None, T0, payload_of("encoder", 0))
        bag.write("/left/resolver", None, T0, payload_of("encoder", 0))
        bag.write("/right/resolver", None, T0, payload_of("encoder", 0))
        bag.write("/torque_node/introspection/names", None, T0, encode_text("a\nb"))
    reader = BagReader(tmp_path / "bag")
    assert reader.resolve("encoder") == "/arm/encoder"
    with pytest.raises(BagError, match="ambiguous"):
        reader.resolve("resolver")
    with pytest.raises(BagError, match="not recorded"):
        reader.columns("gauge_bridge")
