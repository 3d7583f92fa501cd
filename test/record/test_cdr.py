"""CDR codecs: the same bytes as ROS serialises, and exact round trips."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from hd_control.core import topics
from hd_control.record import cdr
from hd_control.record.cdr import ClockCodec, JointStateCodec, TemperatureCodec, ValuesCodec, codec_of

NAMES = [f"joint_{i}" for i in range(1, 8)]
RUN = "0123456789abcdef"
FIELD_SETS = [(p, v, e) for p in (0, 1) for v in (0, 1) for e in (0, 1)]

names = st.lists(st.text("abcdefgh_1é", min_size=0, max_size=9), min_size=1, max_size=9, unique=True)
stamps = st.integers(-(2**31) * 10**9, 2**31 * 10**9 - 1)
numbers = st.floats(allow_nan=True, allow_infinity=True, width=64)


def joint_values(codec: JointStateCodec, seed: int = 0) -> dict[str, np.ndarray]:
    random = np.random.default_rng(seed)
    return {name: random.standard_normal(number) for name, number in codec.fields.items()}


@pytest.mark.parametrize("fields", FIELD_SETS)
@pytest.mark.parametrize("joint_names", [NAMES, ["a"], ["a", "bbb", "cc"]])
def test_joint_state_equals_ros_serialisation(fields, joint_names):
    serialization = pytest.importorskip("rclpy.serialization")
    from sensor_msgs.msg import JointState

    codec = JointStateCodec(joint_names, len(RUN), *map(bool, fields))
    values = joint_values(codec)
    message = JointState(name=joint_names, **{name: list(value) for name, value in values.items()})
    message.header.frame_id, message.header.stamp.sec, message.header.stamp.nanosec = RUN, 17, 999_999_999
    reference = serialization.serialize_message(message)
    ours = codec.encode(17_999_999_999, RUN, **values)

    assert codec.matches(reference)
    keep = np.frombuffer(padding_mask(codec, joint_names), np.uint8)
    assert np.array_equal(np.frombuffer(reference[: codec.size], np.uint8) * keep, np.frombuffer(ours, np.uint8))
    assert serialization.deserialize_message(ours, JointState) == message


def padding_mask(codec, joint_names) -> bytes:
    """1 where a byte carries meaning, written out from the CDR rules, apart from the codec."""
    keep = bytearray(b"\x01" * 12 + b"\x01" * (4 + 17))

    def align(size):
        keep.extend(b"\x00" * (-(len(keep) - 4) % size))

    align(4)
    keep.extend(b"\x01" * 4)
    for name in joint_names:
        align(4)
        keep.extend(b"\x01" * (4 + len(name) + 1))
    for field in cdr.JOINT_FIELDS:
        align(4)
        keep.extend(b"\x01" * 4)
        if field in codec.fields:
            align(8)
            keep.extend(b"\x01" * (8 * len(joint_names)))
    return bytes(keep)


def test_other_types_equal_ros_serialisation():
    serialization = pytest.importorskip("rclpy.serialization")
    from rosgraph_msgs.msg import Clock
    from sensor_msgs.msg import Temperature
    from std_msgs.msg import Float64MultiArray, String

    temperature = Temperature(temperature=31.5, variance=0.25)
    temperature.header.frame_id, temperature.header.stamp.sec = "joint_1", 5
    ours = TemperatureCodec("joint_1").encode(5 * 10**9, "joint_1", temperature=31.5, variance=0.25)
    assert serialization.deserialize_message(ours, Temperature) == temperature
    assert len(serialization.serialize_message(temperature)) == len(ours)

    values = Float64MultiArray(data=[1.0, -2.0, 3.5])
    assert serialization.deserialize_message(ValuesCodec(3).encode(data=[1.0, -2.0, 3.5]), Float64MultiArray) == values

    clock = Clock()
    clock.clock.sec, clock.clock.nanosec = 3, 4
    assert ClockCodec().encode(3_000_000_004) == serialization.serialize_message(clock)

    for text in ("", "a", "é name\nnext"):
        assert cdr.encode_text(text) == serialization.serialize_message(String(data=text))


@given(names, stamps, st.sampled_from(FIELD_SETS), st.data())
@settings(max_examples=200, deadline=None, derandomize=True)
def test_round_trip_is_exact(joint_names, stamp, fields, data):
    codec = JointStateCodec(joint_names, len(RUN), *map(bool, fields))
    values = {name: np.array(data.draw(st.lists(numbers, min_size=n, max_size=n))) for name, n in codec.fields.items()}
    payload = codec.encode(stamp, RUN, **values)
    assert len(payload) == codec.size and codec.matches(payload)
    assert codec.columns([payload]).frame_ids.tolist() == [RUN.encode()]
    got_stamp, got = codec.decode(payload)
    assert got_stamp == stamp == codec.stamp_ns(payload)
    for name, value in values.items():
        assert got[name].tobytes() == value.tobytes() and got[name].flags.aligned
    again = codec_of(topics.JOINT_STATE_TYPE, payload)
    assert again is not None and again.size == codec.size and again.fields == codec.fields
    assert list(again.joint_names) == joint_names
    message = cdr.typestore().deserialize_cdr(payload, topics.JOINT_STATE_TYPE)
    assert list(message.name) == joint_names and message.header.frame_id == RUN
    assert cdr.encode_message(topics.JOINT_STATE_TYPE, message) == payload


def test_columns_equal_single_messages_and_invert():
    codec = JointStateCodec(NAMES, len(RUN), position=True, effort=True)
    random = np.random.default_rng(1)
    stamps_ns = np.array([-1, 0, 1_500_000_000, 2**31 * 10**9 - 1])
    position, effort = random.standard_normal((2, 4, 7))
    rows = codec.encode_columns(stamps_ns, RUN, position=position, effort=effort)
    ticks = zip(stamps_ns.tolist(), position, effort, strict=True)
    single = [codec.encode(t, RUN, position=p, effort=e) for t, p, e in ticks]
    assert [row.tobytes() for row in rows] == single
    for source in (rows, single, np.pad(rows, ((0, 0), (0, 8)))):
        columns = codec.columns(source)
        assert np.array_equal(columns.stamps_ns, stamps_ns)
        assert np.array_equal(columns.values["position"], position) and np.array_equal(columns.values["effort"], effort)
        assert set(columns.frame_ids) == {RUN.encode()}
        assert all(codec.matches(row.tobytes() if hasattr(row, "tobytes") else row) for row in source)


@pytest.mark.parametrize("at", range(4))
def test_a_change_of_layout_is_seen(at):
    codec = JointStateCodec(NAMES, len(RUN), position=True)
    payload = codec.encode(1, RUN, position=np.arange(7.0))
    others = [
        JointStateCodec(NAMES[::-1], len(RUN), position=True).encode(1, RUN, position=np.arange(7.0)),
        JointStateCodec(NAMES, len(RUN), position=False, velocity=True).encode(1, RUN, velocity=np.arange(7.0)),
        payload[:-1],
        b"\x00\x00" + payload[2:],
    ]
    assert codec.matches(payload) and not codec.matches(others[at])


@given(st.binary(max_size=300))
@settings(max_examples=300, deadline=None, derandomize=True)
def test_no_bytes_raise(data):
    codec = JointStateCodec(NAMES, len(RUN), position=True)
    assert codec.matches(data) in (True, False)
    for type_name in (
        topics.JOINT_STATE_TYPE,
        topics.TEMPERATURE_TYPE,
        topics.VALUES_TYPE,
        cdr.CLOCK,
        "std_msgs/msg/String",
    ):
        for candidate in (data, cdr.ENCAPSULATION + data):
            found = codec_of(type_name, candidate)
            assert found is None or found.matches(candidate)


def test_every_cut_message_is_refused():
    codec = JointStateCodec(NAMES, len(RUN), position=True, velocity=True, effort=True)
    payload = codec.encode(1, RUN, **joint_values(codec))
    for length in range(len(payload)):
        assert not codec.matches(payload[:length])
        assert codec_of(topics.JOINT_STATE_TYPE, payload[:length]) is None
        with pytest.raises(ValueError):
            codec.decode(payload[:length])


def test_wrong_values_are_refused():
    codec = JointStateCodec(NAMES, len(RUN), position=True)
    with pytest.raises(ValueError, match="effort"):
        codec.encode(1, RUN, effort=np.zeros(7))
    with pytest.raises(ValueError):
        codec.encode(1, RUN, position=np.zeros(6))
    with pytest.raises(ValueError, match="frame_id"):
        codec.encode(1, "short", position=np.zeros(7))


def test_run_ids_have_the_fixed_length():
    assert len(cdr.new_run_id()) == cdr.RUN_ID_LENGTH and cdr.new_run_id() != cdr.new_run_id()
