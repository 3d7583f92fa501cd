"""Goals: complete validation, one code for each refusal, agreement with a dense oracle that knows nothing of it."""

import copy
import os
from dataclasses import replace

import numpy as np
import pinocchio
import pytest
from chains import shipped_values
from hypothesis import HealthCheck, assume, given, settings
from hypothesis import strategies as st
from oracles.trajectory_dense import DenseGoal

from hd_control.control.goal_check import GoalLimits, check_goal, goal_from_points
from hd_control.control.path import Goal
from hd_control.control.trajectory import TrajectoryFollower, quintic_move
from hd_control.core.errors import GoalError
from hd_control.core.robot import Robot

ARM = Robot.from_file("arm_a")
NAMES, DT = ARM.joint_names, 1e-3
Q0 = np.array([0.2, 0.5, -0.6, 1.0, -0.5, 0.4, 0.3])
LIMITS = GoalLimits.from_values(shipped_values(), ARM)
GOOD = quintic_move(NAMES, Q0, Q0 + 0.2, 0.4)
NONE = np.zeros((2, 7))
GOALS = int(os.environ.get("HD_GOALS", "500"))  # random goals of the property test; 20 000 in long runs


def _follower(position=Q0):
    return TrajectoryFollower(NAMES, DT, position)


def _refused(goal, limits=LIMITS, measured=Q0, tick=0, follower=None):
    """The error of a refusal; the follower must be as it was."""
    follower = follower or _follower()
    before = copy.deepcopy(follower.__dict__)
    with pytest.raises(GoalError) as refusal:
        check_goal(goal, follower, limits, measured, tick)
    for name, value in follower.__dict__.items():
        assert repr(value) == repr(before[name])
    assert str(refusal.value).startswith("HD-F22 goal_bad")
    return refusal.value


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
    error = _refused(goal)
    assert error.code == code
    assert text in str(error)


def test_a_good_goal_is_accepted_and_followed():
    follower = _follower()
    path = check_goal(GOOD, follower, LIMITS, Q0, 0)
    follower.accept(path, 0)
    np.testing.assert_array_equal(follower.sample(path.end_tick)[0], GOOD.positions[-1])


def test_a_goal_may_end_exactly_on_its_limits():
    free = replace(LIMITS, velocity=np.full(7, 9.0), acceleration=np.full(7, 99.0), torque=np.full(7, np.inf))
    check_goal(_with(0, 3.0), _follower(), free, Q0, 0)
    fast = replace(LIMITS, torque=np.full(7, np.inf))
    check_goal(quintic_move(NAMES, Q0, Q0 + 0.5, 1.5), _follower(), fast, Q0, 0)


def test_limits_hold_between_the_points_not_only_at_them():
    """A quintic that leaves and returns: both points are inside, the middle is not."""
    v = np.zeros((2, 7))
    v[0, 2] = 0.09
    limits = replace(LIMITS, position_high=np.r_[LIMITS.position_high[:2], Q0[2] + 0.005, LIMITS.position_high[3:]])
    goal = Goal(NAMES, np.array([0.0, 1.0]), np.tile(Q0, (2, 1)), v, NONE)
    error = _refused(goal, limits)
    assert error.code == "position_limit" and "joint_3" in str(error)
    check_goal(goal, _follower(), LIMITS, Q0, 0)


def test_the_blend_from_the_present_reference_is_checked_too():
    """The first point is reachable in 5 s but not in 0.1 s, though goal and limits are the same."""
    near = Goal(NAMES, np.array([5.0]), Q0[None] + 0.5)
    check_goal(near, _follower(), LIMITS, Q0, 0)
    error = _refused(replace(near, times=np.array([0.1])))
    assert error.code == "velocity_limit" and "before point 0" in str(error)


def test_a_measured_position_far_from_the_reference_refuses_every_goal():
    error = _refused(GOOD, measured=Q0 + np.eye(7)[2] * 0.051)
    assert error.code == "start_position" and "joint_3: measured position 0.051 rad from the reference" in str(error)
    assert _refused(GOOD, measured=np.full(7, np.nan)).code == "start_position"


def test_corners_of_straight_lines_count_as_accelerations():
    slow = Goal(NAMES, np.array([1.0, 2.0, 3.0]), Q0 + np.outer([0.0, 0.005, 0.0], np.ones(7)))
    check_goal(slow, _follower(), LIMITS, Q0, 0)  # steps of 0.005 and 0.01 rad/s: 10 rad/s^2 over one sample
    fast = replace(slow, positions=Q0 + np.outer([0.0, 0.0051, 0.0], np.ones(7)))
    error = _refused(fast)
    assert error.code == "acceleration_limit" and "corner after 2 s" in str(error)
    assert "Give velocities at the points" in str(error)


def test_required_torque_beyond_the_joint_is_refused():
    """Arm A stretched out: gravity alone asks joint 2 for more than a limit of 600 N m."""
    robot = replace(ARM, effort_limit=np.full(7, 600.0))
    limits = replace(LIMITS, robot=robot, torque=robot.effort_limit)
    stretched = np.array([0.2, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0])
    goal = quintic_move(NAMES, Q0, stretched, 0.2)
    error = _refused(goal, limits)
    assert error.code == "torque_limit" and "joint_2" in str(error) and "600 N m" in str(error)
    check_goal(goal, _follower(), LIMITS, Q0, 0)
    model = ARM.pinocchio_model()
    still = pinocchio.computeGeneralizedGravity(model, model.createData(), stretched)
    assert np.abs(still[1]) > 600.0


def test_goals_may_leave_joints_out_only_if_configured():
    partial = Goal(("joint_6", "joint_2"), np.array([1.0]), np.array([[0.3, 0.6]]))
    assert _refused(partial).code == "joint_missing"
    path = check_goal(partial, _follower(), replace(LIMITS, allow_partial=True), Q0, 0)
    np.testing.assert_array_equal(path.end.position, [0.2, 0.6, -0.6, 1.0, -0.5, 0.3, 0.3])
    assert (
        _refused(Goal((), np.array([1.0]), np.zeros((1, 0))), replace(LIMITS, allow_partial=True)).code
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


def _random_goal(random, order, first):
    points = int(random.integers(2, 6))
    times = first + np.concatenate([[0.0], np.cumsum(random.uniform(0.05, 1.0, points - 1))])
    q = Q0 + np.cumsum(random.uniform(-0.2, 0.2, (points, 7)), axis=0)
    q[0] = Q0 + random.uniform(-0.01, 0.01, 7)
    v, a = random.uniform(-0.4, 0.4, (points, 7)), random.uniform(-2, 2, (points, 7))
    v[0] *= 0.2
    v[-1] = 0.0
    if random.random() < 0.5:
        times = np.round(times, 3)
    if order == 1:  # nearly straight, so that a corner may pass
        q = q[0] + np.outer(times - times[0], random.uniform(-0.01, 0.01, 7)) + random.uniform(-1e-4, 1e-4, q.shape)
    return Goal(NAMES, times, q, v if order > 1 else None, a if order > 3 else None)


def _dense_extremes(goal, present, blend_time):
    tables = [x for x in (goal.positions, goal.velocities, goal.accelerations) if x is not None]
    found = []
    for j in range(7):
        points = list(zip(*(table[:, j] for table in tables), strict=True))
        state = (present.position[j], present.velocity[j], present.acceleration[j])
        found.append(DenseGoal(goal.times, points, state, blend_time).extremes(DT))
    return np.array(found).T


@settings(
    max_examples=int(os.environ.get("HD_GOALS", "500")), deadline=None, suppress_health_check=[HealthCheck.too_slow]
)
@given(
    seed=st.integers(0, 2**32 - 1),
    order=st.sampled_from([1, 3, 5]),
    first=st.sampled_from([0.0, 0.3]),
    kind=st.integers(0, 3),
    joint=st.integers(0, 6),
    slack=st.sampled_from([0.5, 0.9, 0.999, 1.0, 1.0005, 1.01, 2.0]),
)
def test_feasible_goals_are_accepted_and_infeasible_ones_refused(seed, order, first, kind, joint, slack):
    """Limits are set around the dense oracle's extremes, one of them tight.

    160 samples a segment see a peak to about 1e-4 of it, so between 0.9995 and 1 of the limit either answer is right.
    """
    random = np.random.default_rng(seed)
    follower = _follower()
    follower.accept(quintic_move(NAMES, Q0, Q0 + random.uniform(0.0, 0.03, 7), 0.05), 0)
    tick = int(random.integers(0, 800))
    present = follower.at(tick)
    goal = _random_goal(random, order, first)
    goal = replace(goal, positions=goal.positions + present.position - Q0)
    low, high, speed, acceleration = _dense_extremes(goal, present, follower.blend_time)
    middle, half = 0.5 * (low + high), 0.5 * (high - low)
    exact = (half, half, speed, acceleration)[kind][joint]
    assume(exact > 1e-4)  # so that a slack of 0.0005 is far above the allowance for rounding
    widths = [1.1 * extent + 1e-6 for extent in (half, half, speed, acceleration)]
    widths[kind][joint] = slack * exact
    limits = replace(
        LIMITS,
        position_low=middle - widths[0],
        position_high=middle + widths[1],
        velocity=widths[2],
        acceleration=widths[3],
        torque=np.full(7, np.inf),
        start_tolerance=np.full(7, 0.1),
        start_speed_tolerance=np.full(7, 10.0),
    )
    code = ("position_limit", "position_limit", "velocity_limit", "acceleration_limit")[kind]
    if slack > 1.0:
        check_goal(goal, follower, limits, present.position, tick)
    elif slack < 1.0:
        error = _refused(goal, limits, present.position, tick, follower)
        assert error.code == code
        assert NAMES[joint] in str(error)


@settings(max_examples=60, deadline=None)
@given(seed=st.integers(0, 2**32 - 1), order=st.permutations(range(7)))
def test_permuted_joints_give_the_same_answer(seed, order):
    random = np.random.default_rng(seed)
    goal = _random_goal(random, 5, 0.0)
    mixed = Goal(
        tuple(NAMES[i] for i in order),
        goal.times,
        goal.positions[:, order],
        goal.velocities[:, order],
        goal.accelerations[:, order],
    )

    def answer(wanted):
        try:
            return check_goal(wanted, _follower(), LIMITS, Q0, 0).coefficients.tobytes()
        except GoalError as error:
            return error.code

    assert answer(goal) == answer(mixed)


def test_torque_check_agrees_with_pinocchio_along_random_paths():
    """Largest torque at every tick: a limit 1 % above it passes, one 2 % below it refuses.

    The checker looks at 41 places of each of these segments, which see the peak of a smooth torque to 2 %.
    """
    random, model = np.random.default_rng(11), ARM.pinocchio_model()
    data = model.createData()
    wide = replace(LIMITS, velocity=np.full(7, 99.0), acceleration=np.full(7, 999.0))
    for _ in range(10):
        goal = quintic_move(NAMES, Q0, Q0 + random.uniform(-0.5, 0.5, 7), 1.0)
        goal = replace(goal, positions=np.vstack([goal.positions, goal.positions[-1] + random.uniform(-0.3, 0.3, 7)]))
        goal = replace(goal, times=np.append(goal.times, goal.times[-1] + 0.6), velocities=np.zeros((3, 7)))
        goal = replace(goal, accelerations=np.zeros((3, 7)))
        follower = _follower()
        path = follower.plan(goal, 0)
        follower.accept(path, 0)
        peak = np.max([np.abs(pinocchio.rnea(model, data, *follower.sample(k))) for k in range(path.end_tick)], axis=0)
        check_goal(goal, _follower(), replace(wide, torque=peak * 1.01 + 0.1), Q0, 0)
        tight = np.full(7, np.inf)
        tight[1] = 0.98 * peak[1]
        assert _refused(goal, replace(wide, torque=tight)).code == "torque_limit"
