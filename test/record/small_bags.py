"""Small recordings with known content, for the tests of this folder."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from hd_control.record.cdr import TemperatureCodec, encode_text
from hd_control.record.schema import joint_state_codec
from hd_control.record.writer import BagWriter

NAMES = [f"joint_{i}" for i in range(1, 4)]
RUN = "0123456789abcdef"
T0 = 1_700_000_000_000_000_000
TICK = 1_000_000
TOPICS = ("encoder", "gauge_bridge", "joint_states")
START = "2024-01-01T00:00:00+00:00"


def tick_values(k: int) -> np.ndarray:
    """The numbers of tick k: different for every tick and joint."""
    return np.array([k + 0.125 * j for j in range(len(NAMES))])


def payload_of(topic: str, k: int) -> bytes:
    """The message of tick k."""
    codec = joint_state_codec(topic, NAMES)
    return codec.encode(T0 + k * TICK, RUN, **dict.fromkeys(codec.fields, tick_values(k)))


def write_bag(path: Path, ticks: int, **options) -> Path:
    """`ticks` ticks of three topics, a description, a temperature every 10 ticks, an attachment."""
    bag = BagWriter(path, start_time_utc=START, metadata={"seed": "7"}, **options)
    bag.attach("robot.urdf", "<robot/>", "application/xml")
    bag.write("/robot_description", None, T0, encode_text("<robot/>"))
    temperature = TemperatureCodec("joint_1")
    for k in range(ticks):
        for topic in TOPICS:
            bag.write(topic, T0 + k * TICK, T0 + k * TICK + 50, payload_of(topic, k))
        if k % 10 == 0:
            stamp = T0 + k * TICK
            bag.write("motor_temperature", stamp, stamp, temperature.encode(stamp, "joint_1", temperature=20.0 + k))
    return bag.close()


def file_of(bag: Path) -> Path:
    """The only MCAP file of a bag."""
    (path,) = bag.glob("*.mcap")
    return path
