"""G1 and G2: fault injections, single and in pairs. `HD_INJECTIONS` sets the number, 10 000 by default."""

import os
from concurrent.futures import ProcessPoolExecutor

from fault_cases import run_case, shrink
from results import write_result

from hd_sim.fault_injection import draw_case

SEED = int(os.environ.get("HD_SEED", "20240229"))
COUNT = int(os.environ.get("HD_INJECTIONS", "10000"))
BLOCK = 50


def run_block(first):
    """Index, problems, did it stop, top speed of each case of a block."""
    rows = []
    for index in range(first, min(first + BLOCK, COUNT)):
        case = draw_case(SEED, index)
        verdict = run_case(case)
        rows.append((index, verdict.problems, verdict.stop_tick >= 0, verdict.fastest, len(case.injections)))
    return rows


def test_g1_g2_no_unsafe_sample_and_no_late_stop():
    with ProcessPoolExecutor(os.cpu_count()) as pool:
        rows = [row for block in pool.map(run_block, range(0, COUNT, BLOCK)) for row in block]
    failing = [row for row in rows if row[1]]
    unsafe = [row for row in failing if any(not text.startswith("no stop") for text in row[1])]
    late = [row for row in failing if any(text.startswith("no stop") for text in row[1])]
    runs, stops, pairs = len(rows), sum(row[2] for row in rows), sum(row[4] > 1 for row in rows)
    text = f"{len(unsafe)} unsafe of {runs} runs ({pairs} with two faults, {stops} stopped), seed {SEED}"
    speed = max(row[3] for row in rows)
    write_result("G1", text, not unsafe and runs >= 10_000, runs=runs, unsafe=len(unsafe), fastest_joint_rad_s=speed)
    write_result(
        "G2", f"{len(late)} late stops in {runs} runs, seed {SEED}", not late and runs >= 10_000, late=len(late)
    )
    told = "\n".join(f"{draw_case(SEED, row[0]).text}: {row[1]}" for row in failing[:10])
    shrunk = [shrink(draw_case(SEED, row[0])).text for row in failing[:2]]
    assert not failing, f"{len(failing)} of {runs}\n{told}\nshrunk: {shrunk}"
