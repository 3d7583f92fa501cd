"""Goals become references by tick: exact points, continuity, pre-emption, agreement with a dense oracle."""

import numpy as np
import pytest
from oracles.trajectory_dense import DenseGoal

from hd_control.laws.trajectory import Goal, TrajectoryFollower, moves, quintic_move

NAMES = ("joint_1", "joint_2", "joint_3")
DT = 1e-3
Q0 = np.array([0.3, -0.7, 1.1])


def _goal(random, points=6, order=5, first=0.0, start=Q0, start_tick=None, names=NAMES):
    n = len(names)
    times = first + np.concatenate([[0.0], np.cumsum(random.integers(20, 300, points - 1))]) * DT
    q = start[:n] + random.uniform(-0.3, 0.3, (points, n))
    q[0] = start[:n]
    v, a = random.uniform(-0.5, 0.5, (points, n)), random.uniform(-2, 2, (points, n))
    v[[0, -1]] = a[[0, -1]] = 0.0
    return Goal(names, times, q, v if order > 1 else None, a if order > 3 else None, start_tick)


def _run(follower, ticks):
    return [np.array(x) for x in zip(*(follower.sample(k) for k in ticks), strict=True)]


@pytest.mark.parametrize("order", [3, 5])
def test_points_are_met_exactly_and_the_end_is_held_exactly(order):
    random = np.random.default_rng(1)
    follower = TrajectoryFollower(NAMES, DT, Q0)
    goal = _goal(random, 8, order)
    path = follower.accept(goal, 100)
    for time, q, v in zip(goal.times, goal.positions, goal.velocities, strict=True):
        at = follower.at(100 + round(time / DT))
        if time >= 0.2 or order == 5:  # a cubic from rest has an acceleration step, which fades in over 0.2 s
            np.testing.assert_allclose(at.position, q, rtol=0, atol=1e-15)
            np.testing.assert_allclose(at.velocity, v, rtol=0, atol=1e-15)
    for k in (path.end_tick, path.end_tick + 1, path.end_tick + 10**7):
        q, v, a = follower.sample(k)
        np.testing.assert_array_equal(q, goal.positions[-1])
        np.testing.assert_array_equal([v, a], 0.0)


def test_a_quintic_goal_that_starts_where_the_arm_is_meets_all_points_bit_for_bit():
    random = np.random.default_rng(2)
    follower = TrajectoryFollower(NAMES, DT, Q0)
    goal = _goal(random, 10)
    follower.accept(goal, 7)
    for i, time in enumerate(goal.times):
        q, v, a = follower.sample(7 + round(time / DT))
        np.testing.assert_array_equal(q, goal.positions[i])
        np.testing.assert_array_equal(v, goal.velocities[i])
        np.testing.assert_array_equal(a, goal.accelerations[i])


@pytest.mark.parametrize("first", [0.0, 0.15])
@pytest.mark.parametrize("order", [1, 3, 5])
def test_every_sample_agrees_with_the_dense_oracle(order, first):
    """From rest and from motion, with points on and between ticks. 1e-9: the oracle solves linear systems."""
    random = np.random.default_rng(3)
    for case in range(6):
        follower = TrajectoryFollower(NAMES, DT, Q0, blend_time=0.2)
        start, tick = Q0, 0
        if case % 2:
            follower.accept(_goal(random), 0)
            tick = 60
            start = follower.at(tick).position
        goal = _goal(random, 5, order, first, start + random.uniform(-0.01, 0.01, 3))
        if case >= 3:
            times = goal.times * 1.000377 + (0.0 if first == 0.0 else 0.2 * DT)
            goal = Goal(NAMES, times, goal.positions, goal.velocities, goal.accelerations)
        present = follower.at(tick)
        path = follower.accept(goal, tick)
        ticks = np.arange(tick, path.end_tick + 20)
        q, v, a = _run(follower, ticks)
        tables = [x for x in (goal.positions, goal.velocities, goal.accelerations) if x is not None]
        for j in range(3):
            points = list(zip(*(table[:, j] for table in tables), strict=True))
            state = (present.position[j], present.velocity[j], present.acceleration[j])
            slow = DenseGoal(goal.times, points, state, 0.2)
            expected = np.array([slow((k - tick) * DT) for k in ticks[:-20]])
            inside = np.abs((ticks[:-20] - tick) * DT - goal.times[-1]) > 1e-9
            np.testing.assert_allclose(q[:-20, j], expected[:, 0], rtol=0, atol=1e-9)
            np.testing.assert_allclose(v[:-20, j][inside], expected[inside, 1], rtol=0, atol=1e-8)
            np.testing.assert_allclose(a[:-20, j][inside], expected[inside, 2], rtol=0, atol=1e-6)


def test_interpolation_follows_what_the_goal_gives():
    """From 0 to 1 at rest a cubic passes the middle with 1.5 D/T, a quintic with 1.875 D/T."""
    times, q, none = np.array([0.0, 1.0]), np.array([[0.0], [1.0]]), np.zeros((2, 1))
    for goal, peak in ((Goal(("a",), times, q, none), 1.5), (Goal(("a",), times, q, none, none), 1.875)):
        follower = TrajectoryFollower(("a",), DT, [0.0], blend_time=0.2)
        follower.accept(goal, 0)
        assert follower.at(500).position[0] == pytest.approx(0.5, abs=1e-15)
        assert follower.at(500).velocity[0] == pytest.approx(peak, abs=1e-12)
    line = Goal(("a",), np.array([0.0, 0.3, 0.6, 0.9]), np.array([[0.0], [0.1], [0.1], [0.4]]))
    follower = TrajectoryFollower(("a",), DT, [0.0], blend_time=0.2)
    follower.accept(line, 0)
    assert follower.at(450).position[0] == pytest.approx(0.1, abs=1e-15)
    assert follower.at(750).position[0] == pytest.approx(0.25, abs=1e-15)
    assert follower.at(750).velocity[0] == pytest.approx(1.0, abs=1e-12)


def test_a_goal_in_motion_takes_over_without_a_step():
    """Position, velocity and acceleration of the new path at its start are those of the old one."""
    random = np.random.default_rng(4)
    for first in (0.0, 0.3):
        follower = TrajectoryFollower(NAMES, DT, Q0)
        follower.accept(_goal(random), 0)
        old = follower.at(75)
        follower.accept(_goal(random, start=old.position, first=first), 75)
        new = follower.at(75)
        np.testing.assert_allclose(new.position, old.position, rtol=0, atol=1e-15)
        np.testing.assert_allclose(new.velocity, old.velocity, rtol=0, atol=1e-14)
        np.testing.assert_allclose(new.acceleration, old.acceleration, rtol=0, atol=1e-12)
        assert np.abs(old.velocity).max() > 0.01, "the case must be in motion"


def test_references_are_smooth_at_the_sample_rate():
    """Second differences of the sampled position agree with the sampled acceleration, across points and take-over."""
    random = np.random.default_rng(5)
    follower = TrajectoryFollower(NAMES, DT, Q0)
    follower.accept(_goal(random), 0)
    head = _run(follower, range(70))
    follower.accept(_goal(random, start=follower.at(70).position), 70)
    tail = _run(follower, range(70, 1500))
    q, _, a = (np.concatenate(parts) for parts in zip(head, tail, strict=True))
    second = (q[2:] - 2 * q[1:-1] + q[:-2]) / DT**2
    jerk = np.abs(np.diff(a, axis=0)).max()  # largest change of acceleration from one sample to the next
    assert np.abs(second - a[1:-1]).max() < jerk


def test_a_start_tick_in_the_future_leaves_the_present_motion_alone():
    random = np.random.default_rng(6)
    plain, waiting = (TrajectoryFollower(NAMES, DT, Q0) for _ in range(2))
    first, second = _goal(random, 4), _goal(random, 4, start_tick=5000)
    for follower in (plain, waiting):
        follower.accept(first, 0)
    waiting.accept(second, 10)
    for k in (10, 200, 4999):
        np.testing.assert_array_equal(plain.at(k).position, waiting.at(k).position)
        np.testing.assert_array_equal(plain.sample(k), waiting.sample(k))
    assert waiting.moving(4999) and not plain.moving(4999)
    np.testing.assert_array_equal(waiting.sample(5000)[0], first.positions[-1])
    last = 5000 + round(second.times[-1] / DT)
    np.testing.assert_array_equal(waiting.sample(last)[0], second.positions[-1])
    assert not waiting.moving(last)


def test_samples_do_not_depend_on_which_ticks_were_asked_before():
    random = np.random.default_rng(7)
    follower = TrajectoryFollower(NAMES, DT, Q0)
    path = follower.accept(_goal(random, 40), 0)
    in_order = _run(follower.copy(), range(path.end_tick))
    shuffled = random.permutation(path.end_tick)
    jumps = _run(follower.copy(), shuffled)
    for one, other in zip(in_order, jumps, strict=True):
        np.testing.assert_array_equal(one[shuffled], other)


def test_sampling_writes_into_the_given_array():
    follower = TrajectoryFollower(NAMES, DT, Q0)
    out = np.full(9, np.nan)
    q, _, _ = follower.sample(0, out)
    np.testing.assert_array_equal(out, np.r_[Q0, np.zeros(6)])
    assert np.shares_memory(q, out)


def test_joints_left_out_stop_and_stay():
    random = np.random.default_rng(8)
    follower = TrajectoryFollower(NAMES, DT, Q0)
    follower.accept(_goal(random), 0)
    before = follower.at(60)
    partial = Goal(("joint_2",), np.array([0.4, 0.9]), np.array([[0.0], [0.1]]), np.zeros((2, 1)))
    path = follower.accept(partial, 60)
    q, v, _ = _run(follower, range(60, path.end_tick + 1))
    others = [0, 2]
    np.testing.assert_allclose(v[0], before.velocity, rtol=0, atol=1e-14)
    assert np.ptp(q[400:, others], axis=0).max() < 1e-14
    expected = before.position + 0.2 * before.velocity
    np.testing.assert_allclose(q[-1, others], expected[others], rtol=0, atol=1e-15)
    assert q[-1, 1] == 0.1


def test_permuted_joints_give_the_same_path():
    random = np.random.default_rng(9)
    goal, order = _goal(random), [2, 0, 1]
    mixed = Goal(
        tuple(NAMES[i] for i in order),
        goal.times,
        goal.positions[:, order],
        goal.velocities[:, order],
        goal.accelerations[:, order],
    )
    paths = [TrajectoryFollower(NAMES, DT, Q0).plan(g, 0) for g in (goal, mixed)]
    np.testing.assert_array_equal(paths[0].coefficients, paths[1].coefficients)


def test_stop_brings_every_joint_to_rest_within_the_limit():
    random = np.random.default_rng(10)
    for tick in range(30, 400, 37):
        follower = TrajectoryFollower(NAMES, DT, Q0)
        follower.accept(_goal(random, 5), 0)
        before = follower.at(tick)
        limit = np.array([3.0, 4.0, 5.0])
        path = follower.stop(tick, limit)
        after = follower.at(tick)
        np.testing.assert_allclose(after.position, before.position, rtol=0, atol=1e-15)
        np.testing.assert_allclose(after.velocity, before.velocity, rtol=0, atol=1e-15)
        _, v, a = _run(follower, range(tick, path.end_tick + 2))
        assert np.all(np.abs(a) <= np.maximum(limit, np.abs(before.acceleration)) * (1 + 1e-6))
        assert np.abs(v[-3]).max() < 1e-2  # the sample before the end is nearly at rest, the end is
        np.testing.assert_array_equal(v[-2:], 0.0)


def test_stop_at_rest_stays():
    follower = TrajectoryFollower(NAMES, DT, Q0)
    follower.stop(5, [1.0, 1.0, 1.0])
    np.testing.assert_array_equal(_run(follower, range(5, 9))[0], np.tile(Q0, (4, 1)))


def test_f23_after_the_end_nothing_moves_whatever_the_last_point_says():
    """A checked goal ends at rest; a follower that is given another one still holds still after it."""
    times, q, ones = np.array([0.0, 0.5]), np.stack([Q0, Q0 + 0.1]), np.ones((2, 3))
    follower = TrajectoryFollower(NAMES, DT, Q0)
    path = follower.accept(Goal(NAMES, times, q, ones, ones), 0)
    at, after = follower.at(path.end_tick), follower.at(path.end_tick + 1)
    np.testing.assert_array_equal([at.position, at.velocity, at.acceleration], [q[1], ones[1], ones[1]])
    np.testing.assert_array_equal([after.position, after.velocity, after.acceleration], [q[1], 0 * q[1], 0 * q[1]])


def test_extrema_of_segments_are_exact():
    """Against the roots that numpy finds as eigenvalues; 1e-9 of values of order one is their accuracy.

    Segments of all kinds: random quintics, cubics, rest-to-rest moves (triple roots at the ends), lines and constants.
    """
    random = np.random.default_rng(12)
    follower = TrajectoryFollower(NAMES, DT, Q0)
    goals = [_goal(random, 30, order) for order in (1, 3, 5) for _ in range(3)]
    goals += [quintic_move(NAMES, Q0, Q0 + [0.1, 0.0, -0.3], 0.4), moves(NAMES, Q0, [[0.1, 0.0, 0.2]], 0.4)]
    for goal in goals:
        path = follower.plan(goal, 0)
        found, lengths = path.extrema(), np.diff(path.knots) * DT
        for segment, T in enumerate(lengths):
            for j in range(3):
                position = np.polynomial.Polynomial(path.coefficients[segment, j])
                for d in range(3):
                    wave = position.deriv(d)
                    turns = [t.real for t in wave.deriv().roots() if abs(t.imag) < 1e-5 and 0 < t.real < T]
                    values = wave(np.array([0.0, T, *turns]))
                    np.testing.assert_allclose(found[segment, j, 2 * d], values.min(), rtol=1e-9, atol=1e-9)
                    np.testing.assert_allclose(found[segment, j, 2 * d + 1], values.max(), rtol=1e-9, atol=1e-9)
