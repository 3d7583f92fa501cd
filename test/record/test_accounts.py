"""Counts of a topic: stamps say what is missing, a publisher's numbers say what of it was ever published."""

from __future__ import annotations

import random
import struct

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from small_bags import NAMES, RUN, T0, TICK, payload_of

from hd_control.core.topics import JOINT_STATE_TYPE
from hd_control.record.accounting import TopicAccount, header_of
from hd_control.record.cdr import CLOCK, TemperatureCodec
from hd_control.record.recorder import Recorder
from hd_control.record.schema import joint_state_codec
from hd_control.record.writer import BagWriter

INT64 = st.integers(-(2**63), 2**63 - 1)


@pytest.fixture
def recorder(tmp_path):
    recorder = Recorder(BagWriter(tmp_path / "bag"))
    recorder.add_topic("/encoder")
    recorder.add_topic("/motor_temperature")
    yield recorder
    recorder.close()


def row_of(recorder: Recorder, topic: str = "/encoder") -> dict[str, int]:
    """What is missing on a topic, and why."""
    row = recorder.statistics()[topic]
    return {**{key: row[key] for key in ("missing", "never_published")}, "transport": row["drops"]["transport"]}


def test_a_tick_without_a_missing_number_was_never_published(recorder):
    """The publisher slept through ticks 3 and 4; its messages are numbered without a hole."""
    for number, k in enumerate((0, 1, 2, 5, 6), 1):
        recorder.offer("/encoder", T0, payload_of("encoder", k), number)
    assert row_of(recorder) == {"missing": 2, "never_published": 2, "transport": 0}


def test_a_missing_number_was_lost_on_the_way(recorder):
    for k in (0, 1, 2, 5, 6):
        recorder.offer("/encoder", T0, payload_of("encoder", k), 100 + k)
    assert row_of(recorder) == {"missing": 2, "never_published": 0, "transport": 2}


def test_both_in_one_hole(recorder):
    """Ticks 1 to 9 are missing; four of them were published."""
    recorder.offer("/encoder", T0, payload_of("encoder", 0), 7)
    recorder.offer("/encoder", T0, payload_of("encoder", 10), 12)
    assert row_of(recorder) == {"missing": 9, "never_published": 5, "transport": 4}


def test_without_numbers_every_missing_tick_counts_as_lost_on_the_way(recorder):
    for k in (0, 1, 2, 5, 6):
        recorder.offer("/encoder", T0, payload_of("encoder", k))
    assert row_of(recorder) == {"missing": 2, "never_published": 0, "transport": 2}


def test_a_restarted_publisher_numbers_from_the_beginning(recorder):
    codec = joint_state_codec("encoder", NAMES)
    for run, start in (("a" * 16, 0), ("b" * 16, 5000)):
        for number, k in enumerate(range(start, start + 10), 1):
            recorder.offer("/encoder", T0, codec.encode(T0 + k * TICK, run, position=np.zeros(3)), number)
    assert row_of(recorder) == {"missing": 0, "never_published": 0, "transport": 0}


def test_one_publisher_of_several_streams(recorder):
    """Temperatures: one message per joint every 100 ms from one publisher. The second message of joint_2 is lost."""
    number = 0
    for k in range(4):
        for name in NAMES:
            number += 1
            stamp_ns = T0 + 100 * k * TICK
            if (k, name) == (1, "joint_2"):
                continue
            payload = TemperatureCodec(name).encode(stamp_ns, name, temperature=20.0)
            # One publisher, so one identity: what the pump gets from the middleware.
            recorder.queues.offer(1, stamp_ns, payload, number, b"p")
    assert row_of(recorder, "/motor_temperature") == {"missing": 1, "never_published": 0, "transport": 1}


@pytest.mark.parametrize("seed", range(20))
def test_every_published_message_is_accounted_for(recorder, seed):
    """Any mixture of ticks slept through and messages lost: both counts are exact to the sample."""
    rng = random.Random(seed)
    published = skipped = lost = 0
    for k in range(500):
        if 0 < k < 499 and rng.random() < 0.1:
            skipped += 1
            continue
        published += 1
        if 0 < k < 499 and rng.random() < 0.1:
            lost += 1
            continue
        recorder.offer("/encoder", T0 + k, payload_of("encoder", k), published)
    row = recorder.statistics()["/encoder"]
    assert row_of(recorder) == {"missing": skipped + lost, "never_published": skipped, "transport": lost}
    assert row["published"] == published


def test_numbers_that_repeat_or_go_back_count_nothing(recorder):
    for k, number in enumerate((5, 5, 3, 6, 1, 7)):
        recorder.offer("/encoder", T0, payload_of("encoder", k), number)
    assert row_of(recorder) == {"missing": 0, "never_published": 0, "transport": 0}


def test_a_flood_of_streams_is_bounded(tmp_path):
    """A foreign publisher with a new run id in every message does not make the counts grow for ever."""
    account = TopicAccount(TICK)
    for k in range(3000):
        account.see(T0 + k * TICK, b"%016d" % k)
    account.see(T0 + 5000 * TICK, b"%016d" % 0)
    table = account.as_dict()
    assert table["received"] == 3001 and len(table["run_ids"]) == 1000 and table["missing"] == 4999


@given(st.lists(INT64, max_size=30), st.integers(1, 2**62))
def test_counts_equal_the_obvious_ones(stamps, period):
    """Any stamps: counted by compiled code as by these five lines of exact arithmetic."""
    expected = {"received": len(stamps), "gaps": 0, "missing": 0, "duplicates": 0, "out_of_order": 0}
    for number, stamp in enumerate(stamps[1:], 1):
        last = max(stamps[:number])
        ticks = (2 * (stamp - last) + period) // (2 * period)
        expected["gaps"] += ticks > 1
        expected["missing"] += max(ticks - 1, 0)
        expected["duplicates"] += stamp == last
        expected["out_of_order"] += stamp < last
    one, many = TopicAccount(period), TopicAccount(period)
    for stamp in stamps:
        one.see(stamp, b"x")
    many.see_many(np.array(stamps, np.int64), b"x")
    if expected["missing"] < 2**63:
        assert {key: one.counts()[key] for key in expected} == expected
        assert one.as_dict() == many.as_dict()


@given(st.binary(max_size=64))
def test_any_bytes_have_a_head_or_none(data):
    for type_name, least in ((JOINT_STATE_TYPE, 16), (CLOCK, 12), ("std_msgs/msg/String", 1 << 20)):
        stamp_ns, frame_id = header_of(type_name, data)
        if len(data) < least:
            assert (stamp_ns, frame_id) == (None, b"")
            continue
        seconds, nanoseconds = struct.unpack_from("<iI", data, 4)
        assert stamp_ns == seconds * 1_000_000_000 + nanoseconds
        length = struct.unpack_from("<I", data, 12)[0] if type_name == JOINT_STATE_TYPE else 0
        assert frame_id == (data[16 : 15 + length] if 0 < length <= 1024 else b"")


def test_the_head_of_a_message(tmp_path):
    payload = payload_of("encoder", 3)
    assert header_of(JOINT_STATE_TYPE, payload) == (T0 + 3 * TICK, RUN.encode())
    assert header_of(JOINT_STATE_TYPE, bytearray(payload)) == header_of(JOINT_STATE_TYPE, memoryview(payload))
