"""Goals: complete validation, one code for each refusal, agreement with a dense oracle that knows nothing of it."""

from dataclasses import replace

import numpy as np
import pinocchio
import pytest
from goal_cases import ARM, LIMITS, NAMES, Q0, follower_at, refused

from hd_control.core.errors import GoalError
from hd_control.laws.goals import check_goal, goal_from_points
from hd_control.laws.trajectory import Goal, quintic_move

GOOD = quintic_move(NAMES, Q0, Q0 + 0.2, 0.4)
NONE = np.zeros((2, 7))


def _with(column, value, field="positions", point=1):
    table = np.array(getattr(GOOD, field))
    table[point, column] = value
    return replace(GOOD, **{field: table})


CASES = [
    ("size", replace(GOOD, times=np.zeros(0), positions=np.zeros((0, 7))), "no points"),
    ("size", replace(GOOD, times=np.arange(10_001.0)), "10001 points > 10000"),
    ("size", replace(GOOD, times=np.array([0.0, 3601.0])), "duration 3601 s > 3600 s"),
    ("joint_unknown", replace(GOOD, joint_names=(*NAMES[:6], "wrist")), "wrist: unknown joint. Use some of joint_1"),
    ("joint_repeated", replace(GOOD, joint_names=(*NAMES[:6], "joint_1")), "joint_1: named 2 times"),
    (
        "joint_missing",
        Goal(NAMES[:6], GOOD.times, GOOD.positions[:, :6]),
        "joint_7: not in the goal. Name every joint, or set allow_partial_goals",
    ),
    ("length", replace(GOOD, positions=GOOD.positions[:, :6]), "positions of shape (2, 6), expected (2, 7)"),
    ("length", replace(GOOD, velocities=NONE[:1]), "velocities of shape (1, 7)"),
    ("length", replace(GOOD, velocities=None), "accelerations without velocities"),
    ("not_finite", _with(4, np.nan), "joint_5: point 1, positions nan"),
    ("not_finite", _with(2, -np.inf, "accelerations", 0), "joint_3: point 0, accelerations -inf"),
    ("not_finite", replace(GOOD, times=np.array([0.0, np.nan])), "point 1, time nan"),
    ("time", replace(GOOD, times=np.array([-0.1, 1.0])), "point 0, time -0.1 s < 0"),
    ("time", replace(GOOD, times=np.array([1.0, 1.0])), "point 1, 0 s after point 0 < 0.001 s, one sample"),
    ("time", replace(GOOD, times=np.array([1.0, 0.5])), "point 1, -0.5 s after point 0"),
    ("time", Goal(NAMES, np.zeros(1), Q0[None]), "Allow time for the motion"),
    ("start_stamp", replace(GOOD, start_tick=-1), "start 0.001 s in the past"),
    ("start_stamp", replace(GOOD, start_tick=60_001), "start 60.001 s ahead > 60 s"),
    ("start_position", _with(3, Q0[3] + 0.06, point=0), "joint_4: point 0, position 1.06 rad is 0.06 rad from"),
    ("start_speed", _with(1, 0.2, "velocities", 0), "joint_2: point 0, velocity is 0.2 rad/s from the reference > 0.1"),
    ("position_limit", _with(5, 3.001), "joint_6: between points 0 and 1, position 3.001 rad > 3 rad"),
    (
        "velocity_limit",
        quintic_move(NAMES, Q0, Q0 + 0.5, 1.6),
        "joint_1: between points 0 and 1, velocity 1.6 rad/s > 1.5",
    ),
    ("acceleration_limit", quintic_move(NAMES, Q0, Q0 + 0.02, 0.4), "acceleration 13.1"),
    (
        "final_velocity",
        _with(6, 0.01, "velocities"),
        "joint_7: point 1, final velocity 0.01 rad/s is not 0. End at rest",
    ),
]


@pytest.mark.parametrize(("code", "goal", "text"), CASES, ids=[f"{i}-{case[0]}" for i, case in enumerate(CASES)])
def test_f22_each_refusal_has_its_code_and_names_point_joint_value_and_limit(code, goal, text):
    error = refused(goal)
    assert error.code == code
    assert text in str(error)


def test_a_good_goal_is_accepted_and_followed():
    follower = follower_at()
    path = check_goal(GOOD, follower, LIMITS, Q0, 0)
    follower.accept(path, 0)
    np.testing.assert_array_equal(follower.sample(path.end_tick)[0], GOOD.positions[-1])


def test_a_goal_may_end_exactly_on_its_limits():
    free = replace(LIMITS, velocity=np.full(7, 9.0), acceleration=np.full(7, 99.0), torque=np.full(7, np.inf))
    check_goal(_with(0, 3.0), follower_at(), free, Q0, 0)
    fast = replace(LIMITS, torque=np.full(7, np.inf))
    check_goal(quintic_move(NAMES, Q0, Q0 + 0.5, 1.5), follower_at(), fast, Q0, 0)


def test_limits_hold_between_the_points_not_only_at_them():
    """A quintic that leaves and returns: both points are inside, the middle is not."""
    v = np.zeros((2, 7))
    v[0, 2] = 0.09
    limits = replace(LIMITS, position_high=np.r_[LIMITS.position_high[:2], Q0[2] + 0.005, LIMITS.position_high[3:]])
    goal = Goal(NAMES, np.array([0.0, 1.0]), np.tile(Q0, (2, 1)), v, NONE)
    error = refused(goal, limits)
    assert error.code == "position_limit" and "joint_3" in str(error)
    check_goal(goal, follower_at(), LIMITS, Q0, 0)


def test_the_blend_from_the_present_reference_is_checked_too():
    """The first point is reachable in 5 s but not in 0.1 s, though goal and limits are the same."""
    near = Goal(NAMES, np.array([5.0]), Q0[None] + 0.5)
    check_goal(near, follower_at(), LIMITS, Q0, 0)
    error = refused(replace(near, times=np.array([0.1])))
    assert error.code == "velocity_limit" and "before point 0" in str(error)


def test_a_measured_position_far_from_the_reference_refuses_every_goal():
    error = refused(GOOD, measured=Q0 + np.eye(7)[2] * 0.051)
    assert error.code == "start_position" and "joint_3: measured position 0.051 rad from the reference" in str(error)
    assert refused(GOOD, measured=np.full(7, np.nan)).code == "start_position"


def test_corners_of_straight_lines_count_as_accelerations():
    slow = Goal(NAMES, np.array([1.0, 2.0, 3.0]), Q0 + np.outer([0.0, 0.005, 0.0], np.ones(7)))
    check_goal(slow, follower_at(), LIMITS, Q0, 0)  # steps of 0.005 and 0.01 rad/s: 10 rad/s^2 over one sample
    fast = replace(slow, positions=Q0 + np.outer([0.0, 0.0051, 0.0], np.ones(7)))
    error = refused(fast)
    assert error.code == "acceleration_limit" and "corner after 2 s" in str(error)
    assert "Give velocities at the points" in str(error)


def test_required_torque_beyond_the_joint_isrefused():
    """Arm A stretched out: gravity alone asks joint 2 for more than a limit of 600 N m."""
    robot = replace(ARM, effort_limit=np.full(7, 600.0))
    limits = replace(LIMITS, robot=robot, torque=robot.effort_limit)
    stretched = np.array([0.2, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0])
    goal = quintic_move(NAMES, Q0, stretched, 0.2)
    error = refused(goal, limits)
    assert error.code == "torque_limit" and "joint_2" in str(error) and "600 N m" in str(error)
    check_goal(goal, follower_at(), LIMITS, Q0, 0)
    model = ARM.pinocchio_model()
    still = pinocchio.computeGeneralizedGravity(model, model.createData(), stretched)
    assert np.abs(still[1]) > 600.0


def test_goals_may_leave_joints_out_only_if_configured():
    partial = Goal(("joint_6", "joint_2"), np.array([1.0]), np.array([[0.3, 0.6]]))
    assert refused(partial).code == "joint_missing"
    path = check_goal(partial, follower_at(), replace(LIMITS, allow_partial=True), Q0, 0)
    np.testing.assert_array_equal(path.end.position, [0.2, 0.6, -0.6, 1.0, -0.5, 0.3, 0.3])
    assert (
        refused(Goal((), np.array([1.0]), np.zeros((1, 0))), replace(LIMITS, allow_partial=True)).code
        == "joint_missing"
    )


def test_points_of_a_message_become_a_goal_or_a_refusal():
    goal = goal_from_points(NAMES, [0.0, 1.0], [Q0, Q0], [np.zeros(7)] * 2, [(), ()])
    assert goal.order == 3
    for rows, code in (([Q0, Q0[:3]], "length"), ([], "length"), ([Q0], "length")):
        with pytest.raises(GoalError) as refusal:
            goal_from_points(NAMES, [0.0, 1.0], rows)
        assert refusal.value.code == code
    with pytest.raises(GoalError) as refusal:
        goal_from_points(NAMES, [0.0, 1.0], [Q0, Q0], [np.zeros(7), ()])
    assert "point 1, 0 velocities, expected 7" in str(refusal.value)
    with pytest.raises(GoalError) as refusal:
        goal_from_points(NAMES, list(range(10_001)), [])
    assert refusal.value.code == "size"
