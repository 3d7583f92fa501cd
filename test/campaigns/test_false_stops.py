"""Healthy simulated running without a stop. `HD_HOURS` sets the simulated hours, 1 by default.

Hours of the same code add up over runs, each with seeds of its own: `hd test --long G3` night by night.
"""

import os
from concurrent.futures import ProcessPoolExecutor
from functools import partial

from counts import SEED
from healthy_runs import PLANTS, healthy_hours
from results import code_mark, earlier, write_result

GOALS = ("G3",)

HOURS = float(os.environ.get("HD_HOURS", "1"))
SECONDS, WANTED = 60.0, 100.0


def test_g3_no_false_stop():
    runs, before = max(1, round(HOURS * 3600.0 / (SECONDS * len(PLANTS)))), round(earlier("G3", "runs", SEED))
    with ProcessPoolExecutor(os.cpu_count()) as pool:
        seeds = range(SEED + before, SEED + before + runs)
        rows = list(pool.map(partial(healthy_hours, seconds=SECONDS), seeds))
    found = [text for texts, _ in rows for text in texts]
    hours = round(sum(part for _, part in rows) + earlier("G3", "hours", SEED), 6)
    asked = "" if hours >= WANTED else f" ({WANTED:g} asked for)"
    words = f"{len(found)} false stops in {hours:.3g} simulated hours{asked}, seeds {SEED} to {seeds[-1]}"
    done = {"hours": hours, "runs": before + runs, "failures": len(found), "seed": SEED, "code": code_mark()}
    write_result("G3", words, not found and hours >= WANTED, **done)
    assert not found, "\n".join(found[:10])
