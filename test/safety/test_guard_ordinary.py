"""The guard's compiled look at an ordinary sample against its readable judgement, bit for bit, over random samples."""

from functools import lru_cache

import numpy as np
import pytest

from hd_control.core.faults import Action, Fault, FaultCode
from hd_control.core.resources import config_path
from hd_control.core.strict_yaml import load_params_file
from hd_control.safety.guard import Guard
from hd_control.safety.limits import configure, select

N, LOW, HIGH, SPEED = 2, np.array([-3.0, -2.0]), np.array([3.0, 2.0]), np.array([1.5, 2.5])
ODD = [np.nan, np.inf, -np.inf, 0.0, -0.0, 1e308, 2.0**53 + 2.0, -1.0, 9.0, 10.0]
FIELDS = ("motor_position", "motor_velocity", "joint_position", "joint_velocity")


@lru_cache
def limits():
    return configure(select(load_params_file(config_path("limits.yaml"), "limits"), ["joint_3", "joint_5"]), 1e-3)


def new_guard():
    guard = Guard(limits(), LOW, HIGH, SPEED, 1e-3)
    guard.activate(np.zeros(N))
    return guard


def memory(guard):
    """Everything that the next sample depends on, as bytes."""
    arrays = (guard.gate.array, guard.stop.array, guard._mean, guard._tick)
    return [array.tobytes() for array in arrays], guard.healthy, guard.controlled, guard.mode, guard.stopped


@pytest.mark.parametrize("seed", range(40))
def test_the_short_way_comes_to_the_same_as_the_long_one(seed, monkeypatch):
    random, short, long = np.random.default_rng(seed), new_guard(), new_guard()
    monkeypatch.setattr(long, "_quiet", lambda *_: False)
    command, quiet = np.zeros(N), 0
    for tick in range(1, 400):
        command = command + random.normal(0.0, 0.5, N)
        measured = {name: random.normal(0.0, 0.3, N) for name in FIELDS}
        measured["joint_position"] += random.choice([0.0, 2.0, 2.9])
        given = [command.copy(), np.zeros(N), np.full(N, float(tick))]
        if random.random() < 0.01:
            given[random.integers(3)][random.integers(N)] = random.choice(ODD)
        if random.random() < 0.01:
            measured[FIELDS[random.integers(4)]][random.integers(N)] = random.choice(ODD)
        demands = [Fault(FaultCode.GAUGE_DRIFT, 0, 2.0, 1.0, Action.REPORT)] if random.random() < 0.01 else []
        quiet += short._emitting and short._quiet(*given)
        outcomes = []
        for guard in (short, long):
            for name, value in measured.items():
                guard.measured.view(name)[:] = value
            out, faults = guard.step(*(each.copy() for each in given), demands)
            outcomes.append((out.tobytes(), str(faults), memory(guard)))
        assert outcomes[0] == outcomes[1], f"tick {tick}"
        if short.stopped and random.random() < 0.05:
            command = np.zeros(N)
            for guard in (short, long):
                guard.measured.array[:] = 0.0
                guard.healthy = 10_000
                guard.reset()
    assert quiet > 0, "the short way was taken"
