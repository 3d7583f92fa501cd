"""Messages of other programs: read by joint name, merged by joint, refused as a whole when they do not fit."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from hd_control import _plane
from hd_control.nodes.fast_loop import make_translator
from hd_control.record.cdr import JOINT_STATE_TYPE, JointStateCodec, encode_message, message_class, typestore

PERIOD_NS = 1_000_000
NAMES = ("a", "b", "c")
CODEC = JointStateCodec(NAMES, position=True, velocity=True)


def message(names: list[str], stamp_ns: int, run_id: str, **arrays: list[float]) -> bytes:
    """A JointState of any shape, encoded by a library that shares nothing with what is tested."""
    header = typestore().types["std_msgs/msg/Header"]
    time = typestore().types["builtin_interfaces/msg/Time"]
    columns = {name: np.array(arrays.get(name, []), dtype=float) for name in ("position", "velocity", "effort")}
    stamp = time(*divmod(stamp_ns, 1_000_000_000))
    return encode_message(JOINT_STATE_TYPE, message_class(JOINT_STATE_TYPE)(header(stamp, run_id), names, **columns))


NUMBER = st.floats(allow_nan=False, width=64)


@st.composite
def joint_states(draw: Any) -> tuple[list[str], dict[str, list[float]], int, str]:
    """Names in any order with repetitions and strangers, arrays of any length, stamps and run ids of any kind."""
    names = draw(st.lists(st.sampled_from(["a", "b", "c", "d", "", "a long name of a joint"]), max_size=8))
    length = st.sampled_from([0, len(names), len(names) + 1])
    arrays = {}
    for name in ("position", "velocity", "effort"):
        count = draw(length)
        arrays[name] = draw(st.lists(NUMBER, min_size=count, max_size=count))
    run_id = draw(st.text(st.characters(codec="ascii", exclude_characters="\0"), max_size=24))
    return names, arrays, draw(st.integers(0, 2**31 * 10**9 - 1)), run_id


def expected(names: list[str], arrays: dict[str, list[float]], stamp_ns: int, run_id: str) -> bytes:
    """The rule in plain words: first joint of each name, arrays of another length are not a number, 16 letters."""
    if not set(NAMES) <= set(names):
        return b""
    columns = {
        field: [arrays[field][names.index(name)] if len(arrays[field]) == len(names) else np.nan for name in NAMES]
        for field in ("position", "velocity")
    }
    return CODEC.encode(stamp_ns, f"{run_id:.16}".ljust(16), **columns)


@given(joint_states())
def test_any_joint_state_is_mapped_by_name(given_message: tuple[list[str], dict[str, list[float]], int, str]) -> None:
    names, arrays, stamp_ns, run_id = given_message
    data = message(names, stamp_ns, run_id, **arrays)
    assert make_translator(CODEC).translate(data) == expected(names, arrays, stamp_ns, run_id)


def test_a_message_of_the_other_byte_order_is_mapped_too() -> None:
    names = ["c", "a", "b"]
    data = message(names, 5 * PERIOD_NS, "r" * 16, position=[3.0, 1.0, 2.0])
    big = bytes(
        typestore().serialize_cdr(
            typestore().deserialize_cdr(data, JOINT_STATE_TYPE), JOINT_STATE_TYPE, little_endian=False
        )
    )
    assert big[1] == 0 and data[1] == 1
    nan = [np.nan] * 3
    wanted = CODEC.encode(5 * PERIOD_NS, "r" * 16, position=[1.0, 2.0, 3.0], velocity=nan)
    assert make_translator(CODEC).translate(big) == wanted


@given(st.binary(max_size=300), joint_states(), st.integers(0, 400), st.integers(0, 255))
def test_damaged_bytes_are_refused_or_read_inside_their_length(
    noise: bytes, given_message: tuple[list[str], dict[str, list[float]], int, str], at: int, value: int
) -> None:
    translator = make_translator(CODEC)
    assert translator.translate(noise) == b"" or len(noise) > 40
    names, arrays, stamp_ns, run_id = given_message
    whole = message(names, stamp_ns, run_id, **arrays)
    for end in range(0, len(whole) - 8, 7):
        translator.translate(whole[:end])
    if at < len(whole):
        translator.translate(whole[:at] + bytes([value]) + whole[at + 1 :])


def test_a_count_of_four_billion_names_or_numbers_is_no_message() -> None:
    data = bytearray(message(list(NAMES), 0, "r" * 16, position=[1.0] * 3, velocity=[1.0] * 3))
    for at in range(4, len(data) - 4, 4):
        bad = bytes(data[:at]) + b"\xff\xff\xff\xff" + bytes(data[at + 4 :])
        make_translator(CODEC).translate(bad)


# Commands of one publisher or several, merged by joint.


class Merged:
    """What the drive side sees of commands."""

    def __init__(self) -> None:
        self.table = _plane.CommandTable(len(NAMES))
        self.input = _plane.CommandInput(list(NAMES), PERIOD_NS, self.table)

    def offer(self, names: list[str], tick: int, run_id: str, effort: list[float], **more: list[float]) -> None:
        self.input.offer(message(names, tick * PERIOD_NS, run_id, effort=effort, **more))

    @property
    def ticks(self) -> list[int]:
        return [int(tick) for tick in self.table.ticks]

    @property
    def torque(self) -> list[float]:
        return [float(torque) for torque in self.table.torque]


def test_two_publishers_of_different_joints_fill_one_command() -> None:
    merged = Merged()
    merged.offer(["c", "a"], 1, "one", [3.0, 1.0])
    assert merged.ticks == [1, -1, 1] and merged.torque == [1.0, 0.0, 3.0]
    merged.offer(["b"], 1, "two", [2.0])
    assert merged.ticks == [1, 1, 1] and merged.torque == [1.0, 2.0, 3.0] and merged.input.foreign == 0


def test_f24_the_first_publisher_of_a_joint_stays_until_the_robot_has_stopped() -> None:
    merged = Merged()
    merged.offer(list(NAMES), 1, "one", [1.0] * 3)
    merged.offer(list(NAMES), 2, "two", [9.0] * 3)
    merged.offer(["b"], 2, "three", [9.0])
    assert merged.torque == [1.0] * 3 and merged.input.foreign == 2 and merged.input.unreadable == 0
    assert merged.table.strangers == 2, "the drive side hears of each, and does not arm"
    merged.table.stands = True
    merged.offer(list(NAMES), 3, "two", [9.0] * 3)
    assert merged.torque == [9.0] * 3 and merged.ticks == [3] * 3
    merged.table.stands = False
    merged.offer(list(NAMES), 4, "one", [1.0] * 3)
    assert merged.torque == [9.0] * 3 and merged.input.foreign == 3


def test_a_new_activation_binds_anew() -> None:
    merged = Merged()
    merged.offer(list(NAMES), 1, "one", [1.0] * 3)
    merged.input.release()
    merged.offer(list(NAMES), 2, "two", [2.0] * 3)
    assert merged.torque == [2.0] * 3 and merged.input.foreign == 0


def test_f16_a_command_that_is_not_newer_changes_nothing_and_is_counted() -> None:
    merged = Merged()
    for tick, torque in ((5, 5.0), (5, 6.0), (4, 7.0)):
        merged.offer(list(NAMES), tick, "one", [torque] * 3)
    assert merged.torque == [5.0] * 3 and merged.table.stale == 2


BAD: dict[str, tuple[list[str], str, dict[str, list[float]]]] = {
    "a joint of another robot": (["a", "x"], "one", {"effort": [1.0, 2.0]}),
    "a joint twice": (["a", "a"], "one", {"effort": [1.0, 2.0]}),
    "no run id": (["a"], "", {"effort": [1.0]}),
    "no joint": ([], "one", {}),
    "no torque": (["a"], "one", {"position": [1.0]}),
    "a torque too many": (["a"], "one", {"effort": [1.0, 2.0]}),
    "a position too many": (["a"], "one", {"effort": [1.0], "position": [1.0, 2.0]}),
}


@pytest.mark.parametrize("kind", BAD)
def test_a_command_of_no_use_binds_nobody(kind: str) -> None:
    merged, (names, run_id, arrays) = Merged(), BAD[kind]
    merged.input.offer(message(names, PERIOD_NS, run_id, **arrays))
    assert merged.input.foreign == merged.input.unreadable == 1 and merged.ticks == [-1] * 3
    merged.offer(list(NAMES), 2, "good", [1.0] * 3, position=[0.0] * 3)
    assert merged.ticks == [2] * 3


@given(st.lists(st.binary(max_size=200), max_size=5), joint_states())
def test_no_bytes_bring_a_command_for_a_joint_that_they_do_not_name(
    noise: list[bytes], given_message: tuple[list[str], dict[str, list[float]], int, str]
) -> None:
    merged = Merged()
    names, arrays, stamp_ns, run_id = given_message
    whole = message(names, stamp_ns, run_id, **arrays)
    for data in (*noise, whole[: len(whole) // 2], whole):
        merged.input.offer(data)
    for joint, name in enumerate(NAMES):
        if name not in names:
            assert merged.ticks[joint] == -1 and merged.torque[joint] == 0.0
