"""The rows of `hd bench`, group by group: live graph, laws and runner, decoding, plant, replay.

Live: ring times at 1 kHz over four processes and lock-step ticks per second, on the wall. Laws and chain: microseconds
per tick for seven joints. Decoding: messages per second from CDR to columns, beside rosbags. Plant: microseconds per
simulated millisecond, beside numpy and MuJoCo. Replay: processor time per joint and second of the recording.
"""

from __future__ import annotations

import subprocess
import sys
import tempfile
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np

from hd_control import _chain as _compiled
from hd_control.bench.measure import Result, Timed, summarise, time_each
from hd_control.bench.peers import compiled_plant, mujoco_peer, numpy_peer
from hd_control.chain.chain import add_stages
from hd_control.chain.replay import complete_values, read_replay_bag, replay
from hd_control.chain.stage import Bus
from hd_control.core.errors import ConfigError
from hd_control.core.topics import TICK_NS
from hd_control.record.reader import BagReader
from hd_control.record.schema import joint_state_codec
from hd_control.record.writer import BagWriter
from hd_control.safety.gate import safety_gate
from hd_sim.plant_config import PlantConfig
from hd_sim.recording import JOINT_TOPICS, RunRecording
from hd_sim.runner import Runner, RunSetup

# ---- Live graph ------------------------------------------------------------------------------------


def ring_rows(runs: int, seconds: float) -> list[Result]:
    """`ring_p50`, `ring_p99`, `ring_missed` with the stock executor: four processes that copy seven numbers."""
    from hd_control.bench.ring import ring, stock_executor_ring

    ours = [ring(seconds) for _ in range(runs)]
    stock = [stock_executor_ring(seconds) for _ in range(runs)]
    found = []
    for name, unit, field in (
        ("ring_p50", "us", "p50"),
        ("ring_p99", "us", "p99"),
        ("ring_missed", "%", "missed_percent"),
    ):
        found.append(summarise(name, unit, [getattr(result, field) for result in ours]))
        found.append(summarise(name, unit, [getattr(result, field) for result in stock], "stock_executor"))
    return found


ROBOT_ROWS = {"four": "robot_ring", "per_joint": "per_joint", "one": "one_process", "one_4khz": "one_process_4khz"}
"""Form of a live run -> beginning of the names of its rows."""


def robot_rows(runs: int, seconds: float, load: bool) -> list[Result]:
    """The real nodes: `..._p50`, `..._p99` of the answer, `..._missed` ticks with a bare loop of the same seconds
    beside them, and `..._stopped`, the share of runs that the safety gate ended.

    With `load` each form runs a second time while ordinary programs keep every processor busy, as `..._loaded_...`.
    """
    from hd_control.bench.robot import live_run

    found = []
    for form, head in ROBOT_ROWS.items():
        for loaded in (False, True) if load else (False,):
            results = [live_run(form, seconds, loaded) for _ in range(runs)]
            name = f"{head}_loaded" if loaded else head
            found += [
                summarise(f"{name}_p50", "us", [result.p50 for result in results]),
                summarise(f"{name}_p99", "us", [result.p99 for result in results]),
                summarise(f"{name}_missed", "%", [result.late for result in results]),
                summarise(f"{name}_missed", "%", [result.bare_late for result in results], "bare_loop"),
                summarise(f"{name}_stopped", "of runs", [float(result.stopped) for result in results]),
            ]
    return found


def recorder_rows(runs: int, seconds: float) -> list[Result]:
    """`recorder_share` in % of a processor and `recorder_lost` in samples: eleven topics at 1 kHz, one recorder.

    The peer takes the messages in Python. `recorder_loaded_…`: while ordinary programs keep every processor busy.
    """
    from hd_control.bench.recording import recorder_run

    ours, theirs, loaded = [], [], []
    for _ in range(runs):
        ours.append(recorder_run(seconds))
        theirs.append(recorder_run(seconds, python=True))
        loaded.append(recorder_run(seconds, loaded=True))
    return [
        summarise("recorder_share", "%", [run.share for run in ours]),
        summarise("recorder_share", "%", [run.share for run in theirs], "in_python"),
        summarise("recorder_lost", "samples", [run.lost for run in ours]),
        summarise("recorder_lost", "samples", [run.lost for run in theirs], "in_python"),
        summarise("recorder_loaded_share", "%", [run.share for run in loaded]),
        summarise("recorder_loaded_lost", "samples", [run.lost for run in loaded]),
    ]


def lockstep_rows(runs: int) -> list[Result]:
    """`lockstep_ros_ticks`: ticks per second over four processes."""
    from hd_control.bench.ring import lockstep_ticks_per_second

    return [summarise("lockstep_ros_ticks", "ticks/s", [lockstep_ticks_per_second() for _ in range(runs)])]


def start_rows(runs: int) -> list[Result]:
    """`cli_start`: s from process start to the end of `hd --help`."""
    samples = []
    for _ in range(runs):
        start = time.perf_counter()
        subprocess.run([sys.executable, "-m", "hd_control.cli.main", "--help"], capture_output=True, check=True)
        samples.append(time.perf_counter() - start)
    return [summarise("cli_start", "s", samples)]


# ---- Laws, chain and runner ------------------------------------------------------------------------


WARM_TICKS = 300
REPEAT = 200


def warm_runner() -> tuple[Runner, Bus]:
    """A robot that has settled after its start, and the topics of its last tick."""
    runner = Runner(RunSetup(PlantConfig.from_file("arm_a")))
    bus: Bus = {}
    for _ in range(WARM_TICKS):
        bus = runner.step()
    return runner, {topic: {k: np.array(v) for k, v in arrays.items()} for topic, arrays in bus.items()}


def _law(stage: Any) -> Callable[[], None]:
    """The law's pure step alone, on the stage's present blocks."""
    given = (stage.sample,) if stage.reference is None else (stage.sample, stage.reference)
    step, params, state, dt = stage.law.step, stage.params.copy(), stage.state.copy(), stage.dt

    def call() -> None:
        for _ in range(REPEAT):
            step(params, state, *given, dt)

    return call


def _gate(runner: Runner) -> Callable[[], None]:
    stage = runner.torque
    command = np.array(stage.gate_state.last_torque)
    ages, ticks = np.zeros(command.size), np.full(command.size, float(runner.tick))
    limits, state = stage.limits.gate, stage.gate_state.copy()

    def call() -> None:
        for _ in range(REPEAT):
            safety_gate(command, ages, ticks, limits, state)

    return call


def _chain(runner: Runner, bus: Bus) -> Callable[[], None]:
    """The three stages with monitors, guard and gate, as a loop runs them, on frozen sensor readings."""
    first, sequence = runner.tick, _compiled.Sequence()
    add_stages(sequence, [stage for _, stage in runner.stages], bus)

    def call() -> None:
        nonlocal first
        first += sequence.run(first, REPEAT)

    return call


def law_rows(runs: int) -> list[Result]:
    """`step_fusion`, `step_motion`, `step_torque`, `step_gate`, `chain_compute`."""
    runner, bus = warm_runner()
    found = []
    for name, call in (
        ("step_fusion", _law(runner.fusion)),
        ("step_motion", _law(runner.motion)),
        ("step_torque", _law(runner.torque)),
        ("step_gate", _gate(runner)),
        ("chain_compute", _chain(runner, bus)),
    ):
        found += time_each(name, "us", [Timed(call, REPEAT)], runs)
    return found


def lockstep_row(runs: int) -> list[Result]:
    """`lockstep_pure`: simulated seconds per s of processor time, full chain and plant, seven joints, no recording."""
    samples, ticks = [], 20_000
    for _ in range(runs):
        runner, _ = warm_runner()
        start = time.process_time()
        runner.run_on(ticks)
        samples.append(ticks * runner.period / (time.process_time() - start))
    return [summarise("lockstep_pure", "x real time", samples)]


# ---- Reading bags ----------------------------------------------------------------------------------


RECORD_TICKS = 4000
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


def record_run(path: Path, plant: str = "arm_a", ticks: int = RECORD_TICKS) -> None:
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


# ---- Plant -----------------------------------------------------------------------------------------


def plant_rows(runs: int) -> tuple[list[Result], list[str]]:
    """`plant_5_substeps` and `plant_10_substeps` with their peers; notes say which peer is not installed."""
    config = PlantConfig.from_file("arm_a")
    found, notes = [], []
    for substeps in (5, 10):
        cases = [Timed(_repeat(compiled_plant(config, substeps), 200), 200)]
        cases.append(Timed(_repeat(numpy_peer(config, substeps), 1), 1, "numpy"))
        try:
            cases.append(Timed(_repeat(mujoco_peer(config, substeps), 50), 50, "mujoco"))
        except ConfigError:
            notes.append("mujoco is not installed: no peer row; install the extra `bench`")
        found += time_each(f"plant_{substeps}_substeps", "us per simulated ms", cases, runs)
    return found, notes[:1]


def _repeat(call: Callable[[], None], times: int) -> Callable[[], None]:
    def repeated() -> None:
        for _ in range(times):
            call()

    return repeated


# ---- Replay ----------------------------------------------------------------------------------------


REPLAY_TICKS = 2000


def replay_rows(runs: int) -> list[Result]:
    """`replay_batch`: fusion, motion, torque and gate over a recording of seven joints, us CPU per joint-second."""
    return [summarise("replay_batch", "us CPU per joint-second", replay_cost("arm_a", runs))]


def replay_cost(plant: str, runs: int) -> list[float]:
    """The cost in each run, us of processor time per joint and second."""
    with tempfile.TemporaryDirectory(prefix="hd_bench_") as folder:
        path = Path(folder) / "bag"
        record_run(path, plant, REPLAY_TICKS)
        bag = read_replay_bag(path)
        values, found = complete_values(bag), []
        for _ in range(runs):
            start = time.process_time()
            replay(bag, values)
            found.append((time.process_time() - start) * 1e6 / (bag.robot.joints * bag.ticks.size * bag.period))
    return found
