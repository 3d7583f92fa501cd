"""G3: healthy simulated running without a stop. `HD_HOURS` sets the simulated hours, 1 by default."""

import os
from concurrent.futures import ProcessPoolExecutor
from functools import partial

from healthy_runs import PLANTS, false_stop
from results import write_result

SEED = int(os.environ.get("HD_SEED", "20240229"))
HOURS = float(os.environ.get("HD_HOURS", "1"))
SECONDS = 60.0


def test_g3_no_false_stop():
    runs = max(1, round(HOURS * 3600.0 / (SECONDS * len(PLANTS))))
    with ProcessPoolExecutor(os.cpu_count()) as pool:
        found = [
            text for texts in pool.map(partial(false_stop, seconds=SECONDS), range(SEED, SEED + runs)) for text in texts
        ]
    hours = runs * SECONDS * len(PLANTS) / 3600.0
    write_result(
        "G3", f"{len(found)} false stops in {hours:.3g} simulated hours, seed {SEED}", not found and hours >= 100
    )
    assert not found, "\n".join(found[:10])
