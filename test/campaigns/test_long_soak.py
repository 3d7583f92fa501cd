"""An hour of the whole arm twice, 3.6 million ticks each: every sample there once, equal hashes, flat memory.

hd test --long G10 -s --hours 24        # a day; 0.1 for six minutes
"""

from __future__ import annotations

import os
from concurrent.futures import ProcessPoolExecutor

from results import write_result
from soak import soak

GOALS = ("G10",)

SECONDS = round(3600 * float(os.environ.get("HD_HOURS", "1")))
MOST_GROWTH = 1 << 20
"""Bytes per simulated hour, of an hour or more; a shorter run cannot tell a trend from the allocator's steps."""


def one_run(bag):
    """One soak in a process of its own; its recording is removed."""
    found = soak(bag, SECONDS * 1000, 3, lambda tick: print(f"{bag.name} {tick // 1000} s", end=" ", flush=True))
    for path in bag.iterdir():
        path.unlink()
    return found


def test_g10_soak(tmp_path):
    with ProcessPoolExecutor(2) as pool:
        runs = list(pool.map(one_run, [tmp_path / "first", tmp_path / "second"]))
    print("\nG10", *runs, sep="\n")
    equal = runs[0].sha256 == runs[1].sha256
    whole = all((run.recorded, run.problems) == (SECONDS * 1000, 0) for run in runs)
    growth = max(run.bytes_per_hour for run in runs)
    blocks = max(run.blocks_per_tick for run in runs)
    passed = equal and whole and blocks < 0.005 and (growth < MOST_GROWTH or SECONDS < 3600)
    hashes = "equal" if equal else "DIFFERENT"
    asked = "" if SECONDS >= 3600 else " (3600 asked for)"
    words = (
        f"2 x {SECONDS} s simulated{asked}: hashes {hashes}, {'0' if whole else 'SOME'} samples missing or doubled, "
    )
    write_result(
        "G10",
        f"{words}memory {growth / 1e6:+.2f} MB/h",
        passed and SECONDS >= 3600,
        seconds=SECONDS,
        blocks_per_tick=blocks,
    )
    assert passed
