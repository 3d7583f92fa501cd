"""A long topic, read a few columns at a time, gives exactly what a short one gives, whatever its stamps are like."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from made_bags import NS, joint_topic, ticks

from hd_control.core.topics import JOINT_STATE_TYPE
from hd_control.lab.signals import recording
from hd_control.lab.signals.recording import read_recording
from hd_control.record.cdr import JointStateCodec
from hd_control.record.writer import BagWriter

NAMES = ("joint_1", "joint_2", "joint_3")
TOPICS = (("encoder", "position"), ("resolver", "position"), ("gauge_bridge", "effort"))
APPLIED = ("motor_torque_applied", "effort")


def stamps_of(kind: str, random: np.random.Generator) -> np.ndarray:
    stamps = ticks(4.0)
    if kind == "gaps":
        return np.delete(stamps, [50, 51, 52, *range(1000, 1300)])
    if kind == "back":
        stamps[500:520] = stamps[100:120]
    if kind == "equal":
        stamps[:] = 5 * NS
    if kind == "scattered":
        stamps = np.sort(stamps + random.integers(-200_000, 200_000, stamps.size))
    return stamps


def make_bag(path: Path, kind: str, random: np.random.Generator) -> Path:
    stamps = stamps_of(kind, random)
    with BagWriter(path, live=False) as writer:
        for topic, field in (*TOPICS, APPLIED):
            values = np.cumsum(random.normal(0.0, 0.01, (len(NAMES), stamps.size)), axis=1)
            if kind == "holes":
                values[1, 300:350] = np.nan
            if kind == "alone" and topic == "resolver":  # a message for each joint
                writer.add_topic(topic, JOINT_STATE_TYPE)
                for k, stamp in enumerate(stamps):
                    codec = JointStateCodec([NAMES[k % 3]], 0, position=True, velocity=False, effort=False)
                    data = codec.encode(int(stamp), "", position=[values[k % 3, k]])
                    writer.write(topic, int(stamp), int(stamp), data)
            elif kind == "equal":
                codec = JointStateCodec(list(NAMES), 0, **{n: n == field for n in ("position", "velocity", "effort")})
                writer.add_topic(topic, JOINT_STATE_TYPE)
                writer.write_columns(topic, codec, stamps, ticks(4.0), **{field: values.T})
            else:
                joint_topic(writer, topic, field, stamps, dict(zip(NAMES, values, strict=True)))
    return path


@pytest.mark.parametrize("kind", ["even", "gaps", "back", "equal", "scattered", "holes", "alone"])
def test_long_and_short_topics_give_the_same(tmp_path, monkeypatch, rng, kind):
    bag = make_bag(tmp_path / "bag", kind, rng)
    short = read_recording(bag)
    monkeypatch.setattr(recording, "LONGEST_ROWS", 100)
    monkeypatch.setattr(recording, "MOST_VALUES", 2 * 4000)
    long = read_recording(bag)
    assert (long.notes, long.problems, long.start_ns) == (short.notes, short.problems, short.start_ns)
    assert list(long.joints) == list(short.joints) == list(NAMES)
    for name, joint in short.joints.items():
        other = long.joints[name]
        assert (other.sources, other.notes, other.period) == (joint.sources, joint.notes, joint.period)
        for signal in ("time", "valid", *joint.present):
            np.testing.assert_array_equal(getattr(other, signal), getattr(joint, signal), signal)
