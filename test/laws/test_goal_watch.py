"""Outcome of a goal with tolerances: closed cases at the edges of the limits."""

import numpy as np
import pytest

from hd_control.laws.goals import GOAL_VIOLATED, PATH_VIOLATED, SUCCESSFUL, GoalWatch, Tolerances

JOINTS = ("joint_1", "joint_2")
ZERO = np.zeros(2)


def watch(patience=0):
    """Path 0.1 rad on joint_2 alone, goal 0.01 rad on both and 0.5 rad/s on joint_1; ticks 100 to 200."""
    path = Tolerances(np.array([np.inf, 0.1]), np.array([np.inf, np.inf]))
    goal = Tolerances(np.array([0.01, 0.01]), np.array([0.5, np.inf]))
    return GoalWatch(JOINTS, 100, 200, path, goal, patience)


@pytest.mark.parametrize(
    ("tick", "position", "velocity", "code"),
    [
        (99, [9.0, 9.0], ZERO, None),
        (100, [9.0, 0.1], ZERO, None),
        (100, [0.0, -0.1001], ZERO, PATH_VIOLATED),
        (199, [9.0, 0.0], [9.0, 9.0], None),
        (200, [0.01, -0.01], [0.5, 9.0], SUCCESSFUL),
        (200, [0.0, 0.0101], ZERO, GOAL_VIOLATED),
        (200, ZERO, [-0.51, 0.0], GOAL_VIOLATED),
    ],
)
def test_the_limits_decide(tick, position, velocity, code):
    outcome = watch().judge(tick, np.array(position), np.array(velocity))
    assert (outcome.code if outcome else None) == code


def test_patience_waits_for_the_goal():
    late = np.array([0.0, 0.02])
    assert watch(50).judge(249, late, ZERO) is None
    assert watch(50).judge(249, ZERO, ZERO).code == SUCCESSFUL
    assert watch(50).judge(250, late, ZERO).code == GOAL_VIOLATED


def test_the_text_names_the_worst_joint_its_error_and_its_limit():
    text = watch().judge(200, np.array([0.02, -0.5]), ZERO).text
    assert text == "goal tolerance: joint_2: position error 0.5 rad > 0.01 rad"


def test_without_tolerances_every_end_is_a_success():
    nothing = Tolerances.none(2)
    assert GoalWatch(JOINTS, 0, 10, nothing, nothing).judge(10, np.full(2, 1e3), np.full(2, 1e3)).code == SUCCESSFUL
