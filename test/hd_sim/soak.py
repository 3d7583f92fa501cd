"""A long run of the whole robot in lock-step, back and forth for ever, recorded and counted."""

from __future__ import annotations

import gc
import hashlib
import os
import sys
import time
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from hd_control.core.arrays import FloatArray
from hd_control.laws.trajectory import quintic_move
from hd_control.record.reader import BagReader
from hd_control.record.recorder import Recorder
from hd_control.record.schema import joint_state_codec
from hd_control.record.writer import BagWriter
from hd_sim.plant_config import PlantConfig
from hd_sim.runner import Runner, RunSetup

MOVE_TICKS, FIRST_MOVE = 4000, 200  # the brakes open at tick 100
AMPLITUDE, SPEED = 0.25, 0.4  # rad, rad/s
DRAIN_TICKS = 10
LOOKS = 100
BLOCK = 200
"""Ticks that are run at once; goals fall between."""
TOPIC, RUN = "motor_torque_command", "0123456789abcdef"
TICK_NS = 1_000_000
PAGE = os.sysconf("SC_PAGE_SIZE")


@dataclass(frozen=True)
class Soak:
    """What one run gave: hash of every number of every topic, samples in the bag, memory over the ticks."""

    sha256: str
    recorded: int
    problems: int
    blocks_per_tick: float
    bytes_per_hour: float
    seconds: float


def resident_bytes(statm: int) -> int:
    """Memory of this process in use, bytes; `statm` is a descriptor kept open, for opening leaves objects behind."""
    return int(os.pread(statm, 200, 0).split()[1]) * PAGE


def soak(bag: Path, ticks: int, seed: int, progress: Callable[[int], None] = lambda tick: None) -> Soak:
    """Runs and records `ticks` ticks of arm_a; memory is looked at `LOOKS` times, fitted behind the first tenth."""
    runner = Runner(RunSetup(PlantConfig.from_file("arm_a"), seed))
    home = runner.world.seam.plant.config.start_position
    names = runner.robot.joint_names
    recorder, codec = Recorder(BagWriter(bag, compact=False)), joint_state_codec(TOPIC, names)
    recorder.add_topic(TOPIC)
    digest, marks = hashlib.sha256(), np.zeros((LOOKS, 3))  # made before, so that looking does not grow
    numbers = (runner.world.seam.readings.array, *(stage.outgoing for _, stage in runner.stages))
    watched = [(each, np.zeros((BLOCK, each.size))) for each in numbers]
    ends = [home + AMPLITUDE, home]
    start, statm = time.monotonic(), os.open("/proc/self/statm", os.O_RDONLY)
    gc.collect()
    gc.freeze()  # what was there before does not grow, and need not be looked through again and again
    for tick in range(ticks):
        if tick % MOVE_TICKS == FIRST_MOVE:
            here, there = ends[tick // MOVE_TICKS % 2 - 1], ends[tick // MOVE_TICKS % 2]
            runner.offer(quintic_move(names, here, there, SPEED, f"move {tick}"))
        if runner.tick == tick:
            _run_block(runner, watched, min(BLOCK - tick % BLOCK, ticks - tick))
            for _, table in watched:
                digest.update(table)
        torque = watched[-1][1][tick % BLOCK]
        recorder.offer(TOPIC, tick * TICK_NS, codec.encode(tick * TICK_NS, RUN, effort=torque))
        if tick % DRAIN_TICKS == 0:
            recorder.tend(tick * TICK_NS)
        look, rest = divmod(tick, ticks // LOOKS)
        if rest == 0 and look < LOOKS:
            gc.collect()
            marks[look] = tick, sys.getallocatedblocks(), resident_bytes(statm)
            progress(tick)
    gc.unfreeze()
    os.close(statm)
    assert recorder.close() == ""
    at, blocks, resident = marks[LOOKS // 10 :].T
    recorded, problems = _read_back(bag)
    return Soak(
        digest.hexdigest(),
        recorded,
        problems,
        float(np.polyfit(at, blocks, 1)[0]),
        float(np.polyfit(at, resident, 1)[0]) * 3_600_000,
        time.monotonic() - start,
    )


def _run_block(runner: Runner, watched: list[tuple[FloatArray, FloatArray]], ticks: int) -> None:
    """Some ticks at once, compiled; every number of every topic goes to its row of the tables."""
    sequence, first = runner._sequence(), runner.tick % BLOCK
    for numbers, table in watched:
        sequence.record(numbers, table[first : first + ticks])
    runner.tick += sequence.run(runner.tick, ticks)
    runner.world.black_box.look()
    runner.torque.black_box.look()


def _read_back(bag: Path) -> tuple[int, int]:
    """Samples in the bag, and how many are missing, doubled, out of order or dropped."""
    reader = BagReader(bag)
    stamps = np.concatenate([columns.stamps_ns for columns in reader.column_blocks(TOPIC)])
    account = reader.accounting[f"/{TOPIC}"]
    wrong = int((np.diff(stamps) != TICK_NS).sum()) + sum(account["drops"].values()) + len(reader.damage)
    return len(stamps), wrong - sum(not problem.loses_data for problem in reader.damage)
