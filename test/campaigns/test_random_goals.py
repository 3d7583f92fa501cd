"""Random goals with limits just above and just below what a dense oracle finds; and what a check costs."""

from __future__ import annotations

import os
import subprocess
import sys
import time
from pathlib import Path

import numpy as np
from counts import SEED, count, enough
from goal_cases import LIMITS, NAMES, Q0, follower_at
from results import write_result

from hd_control.laws.goals import check_goal
from hd_control.laws.trajectory import Goal

GOALS = ("G15",)

ROOT = Path(__file__).resolve().parents[2]
CASES, REPEATS = 20_000, 20
TEST = "test/laws/test_goal_check_random.py::test_feasible_goals_are_accepted_and_infeasible_ones_are_refused"


def milliseconds_per_thousand_points():
    """CPU time of one check of a goal of 1000 points, the smallest of some: others share the computer."""
    times = 0.01 * np.arange(1, 1001)
    positions = Q0 + 0.05 * (1.0 - np.cos(2.0 * np.pi * times / 10.0))[:, None]
    speeds = 0.05 * 0.2 * np.pi * np.sin(2.0 * np.pi * times / 10.0)[:, None] * np.ones(7)
    speeds[-1] = 0.0
    goal, spent = Goal(NAMES, times, positions, speeds), []
    for _ in range(REPEATS):
        start = time.process_time()
        check_goal(goal, follower_at(), LIMITS, Q0, 0)
        spent.append(time.process_time() - start)
    return 1e3 * min(spent)


def test_g15_goals():
    cases = count(CASES)
    environment = {**os.environ, "HD_GOALS": str(cases), "HD_SEED": str(SEED), "PYTHONPATH": str(ROOT)}
    command = [sys.executable, "-m", "pytest", "-q", "-x", "-p", "no:cacheprovider", TEST]
    done = subprocess.run(command, cwd=ROOT, env=environment, capture_output=True, text=True)
    cost = milliseconds_per_thousand_points()
    right = done.returncode == 0
    words = f"{'0' if right else 'SOME'} wrong answers in {cases} goals{enough(cases, CASES)}; "
    words += f"{cost:.1f} ms of CPU time for 1000 points (5 wanted)"
    write_result("G15", words, right and cost <= 5.0 and cases >= CASES, cases=cases, cost_ms=cost)
    assert right, done.stdout[-3000:]
