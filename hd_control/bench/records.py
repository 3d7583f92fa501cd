"""Reading bags: messages per second from CDR to columns, beside rosbags raw and deserialised."""

from __future__ import annotations

import tempfile
import time
from collections.abc import Callable
from pathlib import Path

import numpy as np

from hd_control.bench.measure import Result, summarise
from hd_control.record.reader import BagReader
from hd_control.record.schema import TICK_NS, joint_state_codec
from hd_control.record.writer import BagWriter
from hd_sim.plant_config import PlantConfig
from hd_sim.recording import JOINT_TOPICS, RunRecording
from hd_sim.runner import Runner, RunSetup

TICKS = 4000
TOPIC = "encoder"


def decode_rows(runs: int) -> list[Result]:
    """`decode_messages` with its peers, on one recording of seven joints."""
    with tempfile.TemporaryDirectory(prefix="hd_bench_") as folder:
        path = Path(folder) / "bag"
        record_run(path)
        cases: list[tuple[str | None, Callable[[Path], int]]] = [
            (None, _columns),
            ("rosbags_raw", _rosbags_raw),
            ("rosbags_deserialised", _rosbags_deserialised),
        ]
        samples: dict[str | None, list[float]] = {peer: [] for peer, _ in cases}
        for _ in range(runs):
            for peer, read in cases:
                start = time.process_time()
                count = read(path)
                samples[peer].append(count / (time.process_time() - start))
    return [summarise("decode_messages", "messages/s", values, peer) for peer, values in samples.items()]


def record_run(path: Path, plant: str = "arm_a", ticks: int = TICKS) -> None:
    """Records a robot at rest without ROS."""
    config = PlantConfig.from_file(plant)
    runner = Runner(RunSetup(config))
    with RunRecording(path, config.robot, config.period, {}) as recording:
        for tick in range(ticks):
            recording.observe(tick, runner.step())


def bag_of(path: Path, joints: int, messages: int) -> Path:
    """A bag with one topic of so many joints and messages."""
    codec = joint_state_codec(TOPIC, [f"joint_{number}" for number in range(1, joints + 1)])
    stamps = np.arange(messages, dtype=np.int64) * TICK_NS
    with BagWriter(path, live=False) as bag:
        bag.write_columns(TOPIC, codec, stamps, frame_id="0" * 16, position=np.ones((messages, joints)))
    return path


def _columns(path: Path) -> int:
    with BagReader(path) as bag:
        return sum(len(bag.columns(topic)) for topic in JOINT_TOPICS)


def _rosbags_raw(path: Path) -> int:
    from rosbags.rosbag2 import Reader

    with Reader(path) as bag:
        return sum(1 for _ in bag.messages())


def _rosbags_deserialised(path: Path) -> int:
    from rosbags.rosbag2 import Reader

    from hd_control.record.cdr import typestore

    store, count = typestore(), 0
    with Reader(path) as bag:
        for connection, _, data in bag.messages():
            store.deserialize_cdr(data, connection.msgtype)
            count += 1
    return count
