"""Stop and reset, again and again."""

import os
from concurrent.futures import ProcessPoolExecutor
from functools import partial

from counts import SEED, count, enough
from restart_runs import restart_cycles
from results import write_result

GOALS = ("G20",)

CYCLES = min(50, count(1000))
RUNS = count(1000) // CYCLES


def test_g20_a_thousand_restarts_without_a_jump():
    with ProcessPoolExecutor(os.cpu_count()) as pool:
        found = [
            text for texts in pool.map(partial(restart_cycles, CYCLES), range(SEED, SEED + RUNS)) for text in texts
        ]
    write_result(
        "G20",
        f"{len(found)} problems in {RUNS * CYCLES} cycles{enough(RUNS * CYCLES, 1000)}, seed {SEED}",
        not found and RUNS * CYCLES >= 1000,
        cycles=RUNS * CYCLES,
    )
    assert not found, "\n".join(found[:10])
