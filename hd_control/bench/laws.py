"""Laws, chain and runner: µs per tick for seven joints, and how much faster than real time the whole robot runs."""

from __future__ import annotations

import time
from collections.abc import Callable
from typing import Any

import numpy as np

from hd_control.bench.measure import Result, Timed, summarise, time_each
from hd_control.control.safety_gate import safety_gate_compiled
from hd_control.stages.stage import Bus
from hd_sim.plant_config import PlantConfig
from hd_sim.runner import Runner, RunSetup

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
    step, params, state, dt = stage.law.step, stage.params, stage.state, stage.dt

    def call() -> None:
        for _ in range(REPEAT):
            step(params, state, *given, dt)

    return call


def _gate(runner: Runner) -> Callable[[], None]:
    stage = runner.torque
    command = np.array(stage.gate_state.last_torque)
    ages, ticks = np.zeros(command.size), np.full(command.size, float(runner.tick))
    measured, limits, state = stage.guard.measured, stage.limits.gate, stage.gate_state

    def call() -> None:
        for _ in range(REPEAT):
            safety_gate_compiled(command, measured, ages, ticks, limits, state)

    return call


def _chain(runner: Runner, bus: Bus) -> Callable[[], None]:
    """The three stages with the gate, as a node or the runner calls them, on frozen sensor readings."""
    first = runner.tick

    def call() -> None:
        nonlocal first
        for tick in range(first, first + REPEAT):
            topics = dict(bus)
            for _, stage in runner.stages:
                topics.update(stage.step(tick, topics))
        first += REPEAT

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


def lockstep_row(runs: int, ticks: int = 2000) -> list[Result]:
    """`lockstep_pure`: simulated seconds per s of processor time, full chain and plant, seven joints, no recording."""
    samples = []
    for _ in range(runs):
        runner, _ = warm_runner()
        start = time.process_time()
        for _ in range(ticks):
            runner.step()
        samples.append(ticks * runner.period / (time.process_time() - start))
    return [summarise("lockstep_pure", "x real time", samples)]
