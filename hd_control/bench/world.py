"""The compiled plant beside numpy and MuJoCo: µs per simulated millisecond, seven joints, arm A in motion."""

from __future__ import annotations

from collections.abc import Callable

from hd_control.bench.measure import Result, Timed, time_each
from hd_control.core.errors import ConfigError
from hd_sim.peers import compiled_plant, mujoco_peer, numpy_peer
from hd_sim.plant_config import PlantConfig


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
