"""Fault injections, single and in pairs. hd test --long G1 --count 300"""

import os
from concurrent.futures import ProcessPoolExecutor

from counts import SEED, count, enough
from fault_cases import run_case, shrink
from fault_injection import draw_case
from results import write_result

GOALS = ("G1", "G2", "G19")

COUNT = count(10_000)
BLOCK = 50
BEFORE = 60
"""Ticks that are looked at before the first fault: what is delayed or repeated is taken from them."""


def run_block(first):
    """Index, problems, did it stop, top speed of each case of a block."""
    rows = []
    for index in range(first, min(first + BLOCK, COUNT)):
        case = draw_case(SEED, index)
        verdict = run_case(case, BEFORE)
        rows.append((index, verdict.problems, verdict.stop_tick >= 0, verdict.fastest, len(case.injections)))
    return rows


def test_g1_g2_no_unsafe_sample_and_no_late_stop():
    with ProcessPoolExecutor(os.cpu_count()) as pool:
        rows = [row for block in pool.map(run_block, range(0, COUNT, BLOCK)) for row in block]
    failing = [row for row in rows if row[1]]
    kinds = ("no stop", "black box")
    unsafe = [row for row in failing if any(not text.startswith(kinds) for text in row[1])]
    boxless = [row for row in failing if any(text.startswith("black box") for text in row[1])]
    late = [row for row in failing if any(text.startswith("no stop") for text in row[1])]
    runs, stops, pairs = len(rows), sum(row[2] for row in rows), sum(row[4] > 1 for row in rows)
    asked, found = enough(runs, 10_000), f"{pairs} with two faults, {stops} stopped"
    text = f"{len(unsafe)} unsafe of {runs} runs{asked} ({found}), seed {SEED}"
    speed = max(row[3] for row in rows)
    write_result("G1", text, not unsafe and runs >= 10_000, runs=runs, unsafe=len(unsafe), fastest_joint_rad_s=speed)
    write_result(
        "G2", f"{len(late)} late stops in {runs} runs{asked}, seed {SEED}", not late and not asked, late=len(late)
    )
    whole = not boxless and runs >= 10_000
    text = f"{len(boxless)} of {stops} stops in {runs} runs{asked} without their black box, seed {SEED}"
    write_result("G19", text, whole, stops=stops)
    shown = "\n".join(f"{draw_case(SEED, row[0]).text}: {row[1]}" for row in failing[:10])
    shrunk = [shrink(draw_case(SEED, row[0])).text for row in failing[:2]]
    assert not failing, f"{len(failing)} of {runs}\n{shown}\nshrunk: {shrunk}"
