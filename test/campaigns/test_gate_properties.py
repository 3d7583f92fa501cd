"""The compiled gate on random numbers of every kind, judged by the oracle's conditions on whole arrays."""

import math
import os

import numpy as np
from counts import count
from oracles import gate_law
from results import write_result

from hd_control.safety import gate as sg
from hd_control.safety.limits import limits_layout

GOALS = ("G4",)

SEED = int(os.environ.get("HD_SEED", "20240229"))
CASES = count(1_000_000)
N = 3
LIMIT, STEP = np.array([100.0, 50.0, 20.0]), np.array([10.0, 4.0, 0.7])
ODD = np.array([math.nan, math.inf, -math.inf, -0.0, 5e-324, 1e308, -1e308, 100.0, -100.0, 10.0, 0.7, 2.0**53])


def odd_numbers(random, size, scale):
    """Ordinary numbers with every kind of odd one among them."""
    numbers = random.normal(0.0, scale, size)
    return np.where(random.random(size) < 0.1, random.choice(ODD, size), numbers)


def test_g4_nothing_unsafe_leaves_the_gate():
    random = np.random.default_rng(SEED)
    values = {"age_limit": 10.0, "rate_excess_limit": 20.0, "reset_samples": 5.0, "standstill_velocity": 0.01}
    limits = limits_layout(N).pack(values | {"torque_limit": LIMIT, "torque_step": STEP})
    state, unsafe = sg.initial_gate_state(N), 0
    tick = 0.0
    for k in range(CASES):
        if k % 50 == 0:
            state = gate_law.activate(sg.initial_gate_state(N), limits, random.uniform(-1.0, 1.0, N) * LIMIT)
            tick, wild = 0.0, random.random() < 0.5
        tick += 1.0
        command = odd_numbers(random, N, 30.0) if wild else state.last_torque + random.normal(0.0, 1.0, N) * STEP
        ages = odd_numbers(random, N, 3.0) if wild and random.random() < 0.1 else np.zeros(N)
        ticks = odd_numbers(random, N, 9.0) if wild and random.random() < 0.1 else np.full(N, tick)
        before = state.last_torque.copy()
        out, state, _ = sg.safety_gate(command, ages, ticks, limits, state)
        slack = 1e-12 * (np.abs(out) + np.abs(before) + STEP)
        safe = (np.abs(out) <= LIMIT) & (np.abs(out - before) <= STEP + slack)
        if state.stopped != 0.0:
            safe &= np.abs(out) <= np.abs(before)
        unsafe += not bool(safe.all())
    write_result(
        "G4", f"{unsafe} unsafe outputs in {CASES} cases, seed {SEED}", unsafe == 0 and CASES >= 1_000_000, cases=CASES
    )
    assert unsafe == 0
