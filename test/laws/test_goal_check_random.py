"""Random goals: feasible ones are accepted, infeasible ones refused, judged by a dense oracle and by Pinocchio."""

import os
from dataclasses import replace

import numpy as np
import pinocchio
from goal_cases import ARM, DT, LIMITS, NAMES, Q0, follower_at, refused
from hypothesis import HealthCheck, assume, given, settings
from hypothesis import strategies as st
from oracles.trajectory_dense import DenseGoal

from hd_control.core.errors import GoalError
from hd_control.laws.goals import check_goal
from hd_control.laws.trajectory import Goal, quintic_move

GOALS = int(os.environ.get("HD_GOALS", "500"))  # random goals of the property test; 20 000 in long runs


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
def test_feasible_goals_are_accepted_and_infeasible_ones_are_refused(seed, order, first, kind, joint, slack):
    """Limits are set around the dense oracle's extremes, one of them tight.

    160 samples a segment see a peak to about 1e-4 of it, so between 0.9995 and 1 of the limit either answer is right.
    """
    random = np.random.default_rng(seed)
    follower = follower_at()
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
        error = refused(goal, limits, present.position, tick, follower)
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
            return check_goal(wanted, follower_at(), LIMITS, Q0, 0).coefficients.tobytes()
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
        follower = follower_at()
        path = follower.plan(goal, 0)
        follower.accept(path, 0)
        peak = np.max([np.abs(pinocchio.rnea(model, data, *follower.sample(k))) for k in range(path.end_tick)], axis=0)
        check_goal(goal, follower_at(), replace(wide, torque=peak * 1.01 + 0.1), Q0, 0)
        tight = np.full(7, np.inf)
        tight[1] = 0.98 * peak[1]
        assert refused(goal, replace(wide, torque=tight)).code == "torque_limit"
