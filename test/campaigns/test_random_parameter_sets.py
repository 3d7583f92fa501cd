"""Random sets of parameters with one wrong value, and right ones; half of each."""

from __future__ import annotations

from counts import SEED, count, enough
from results import write_result
from test_wrong_parameters import judge_right_sets, judge_wrong_sets

from hd_sim.runner import LAWS

GOALS = ("G14",)

CASES = 20_000


def test_g14_parameters():
    cases, problems = count(CASES), []
    each = -(-cases // (2 * len(LAWS)))
    for node in LAWS:
        for judge in (judge_wrong_sets, judge_right_sets):
            try:
                judge(node, f"{SEED} {node}", each)
            except AssertionError as error:
                problems.append(f"{node} {judge.__name__}: {error}")
    done = 2 * len(LAWS) * each
    words = f"{len(problems)} wrong answers in {done} sets{enough(done, CASES)}, half of them with one wrong value"
    write_result("G14", words, not problems and done >= CASES, cases=done)
    assert not problems, problems
