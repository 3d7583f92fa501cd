"""G3: healthy simulated running without a stop. `HD_HOURS` sets the simulated hours, 1 by default."""

import os
from concurrent.futures import ProcessPoolExecutor
from functools import partial

from counts import SEED
from healthy_runs import PLANTS, healthy_hours
from results import write_result

HOURS = float(os.environ.get("HD_HOURS", "1"))
SECONDS, WANTED = 60.0, 100.0


def test_g3_no_false_stop():
    runs = max(1, round(HOURS * 3600.0 / (SECONDS * len(PLANTS))))
    with ProcessPoolExecutor(os.cpu_count()) as pool:
        rows = list(pool.map(partial(healthy_hours, seconds=SECONDS), range(SEED, SEED + runs)))
    found, hours = [text for texts, _ in rows for text in texts], round(sum(part for _, part in rows), 6)
    asked = "" if hours >= WANTED else f" ({WANTED:g} asked for)"
    words = f"{len(found)} false stops in {hours:.3g} simulated hours{asked}, seed {SEED}"
    write_result("G3", words, not found and hours >= WANTED, hours=hours)
    assert not found, "\n".join(found[:10])
