"""Replay of a recording through the laws: processor time per joint and second of the recording."""

from __future__ import annotations

import tempfile
import time
from pathlib import Path

from hd_control.bench.measure import Result, summarise
from hd_control.bench.records import record_run
from hd_control.stages.replay import complete_values, replay
from hd_control.stages.replay_bag import read_replay_bag

TICKS = 2000


def replay_rows(runs: int) -> list[Result]:
    """`replay_batch`: fusion, motion, torque and gate over a recording of seven joints, us CPU per joint-second."""
    return [summarise("replay_batch", "us CPU per joint-second", replay_cost("arm_a", runs))]


def replay_cost(plant: str, runs: int) -> list[float]:
    """The cost in each run, us of processor time per joint and second."""
    with tempfile.TemporaryDirectory(prefix="hd_bench_") as folder:
        path = Path(folder) / "bag"
        record_run(path, plant, TICKS)
        bag = read_replay_bag(path)
        values, found = complete_values(bag), []
        for _ in range(runs):
            start = time.process_time()
            replay(bag, values)
            found.append((time.process_time() - start) * 1e6 / (bag.robot.joints * bag.ticks.size * bag.period))
    return found
