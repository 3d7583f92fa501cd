"""The live graph: ring times at 1 kHz over four processes, lock-step ticks per second, start of the command line."""

from __future__ import annotations

import subprocess
import sys
import time

from hd_control.bench.measure import Result, summarise


def ring_rows(runs: int, seconds: float) -> list[Result]:
    """`ring_p50`, `ring_p99`, `ring_missed` with the stock executor, and `one_process_p50`.

    The peer pair is the same ring of four processes that copy seven numbers; `robot_…` rows are the real nodes.
    """
    from hd_control.nodes.ring_bench import ring, robot_ring, stock_executor_ring

    ours = [ring(seconds) for _ in range(runs)]
    stock = [stock_executor_ring(seconds) for _ in range(runs)]
    robot = [robot_ring(seconds) for _ in range(runs)]
    one = [robot_ring(seconds, one_process=True) for _ in range(runs)]
    found = []
    for name, unit, field in (
        ("ring_p50", "us", "p50"),
        ("ring_p99", "us", "p99"),
        ("ring_missed", "%", "missed_percent"),
    ):
        found.append(summarise(name, unit, [getattr(result, field) for result in ours]))
        found.append(summarise(name, unit, [getattr(result, field) for result in stock], "stock_executor"))
        found.append(summarise(f"robot_{name}", unit, [getattr(result, field) for result in robot]))
    return [*found, summarise("one_process_p50", "us", [result.p50 for result in one])]


def lockstep_rows(runs: int) -> list[Result]:
    """`lockstep_ros_ticks`: ticks per second over four processes."""
    from hd_control.nodes.ring_bench import lockstep_ticks_per_second

    return [summarise("lockstep_ros_ticks", "ticks/s", [lockstep_ticks_per_second() for _ in range(runs)])]


def start_rows(runs: int) -> list[Result]:
    """`cli_start`: s from process start to the end of `hd --help`."""
    samples = []
    for _ in range(runs):
        start = time.perf_counter()
        subprocess.run([sys.executable, "-m", "hd_control.cli.main", "--help"], capture_output=True, check=True)
        samples.append(time.perf_counter() - start)
    return [summarise("cli_start", "s", samples)]
