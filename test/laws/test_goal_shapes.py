"""Ready-made goals: quintic moves, the protocol of the coordinated run, sines with an envelope."""

import numpy as np
import pytest

from hd_control.laws.trajectory import TrajectoryFollower, enveloped_sine, moves, quintic_move, sine_goal

NAMES = ("joint_1", "joint_2", "joint_3")
DT = 1e-3
Q0 = np.array([0.3, -0.7, 1.1])


def _run(follower, ticks):
    return [np.array(x) for x in zip(*(follower.sample(k) for k in ticks), strict=True)]


def test_quintic_move_reaches_its_peak_velocity():
    """T = 1.875 D / v; the peak is in the middle."""
    goal = quintic_move(NAMES, Q0, Q0 + [0.1, -0.2, 0.05], 0.4)
    assert goal.times[-1] == pytest.approx(1.875 * 0.2 / 0.4)
    follower = TrajectoryFollower(NAMES, DT, Q0)
    path = follower.accept(goal, 0)
    _, v, _ = _run(follower, range(path.end_tick))
    assert np.abs(v).max() == pytest.approx(0.4, rel=1e-5)  # the middle lies within half a tick of a sample


def test_moves_follow_the_protocol_of_the_coordinated_run():
    step = np.full(3, np.deg2rad(10.0))
    goal = moves(NAMES, Q0, [step, -step, step], 0.4)
    travel = 1.875 * step[0] / 0.4
    assert goal.times[-1] == pytest.approx(1.0 + 3 * (travel + 0.6))
    follower = TrajectoryFollower(NAMES, DT, Q0)
    path = follower.accept(goal, 0)
    q, v, _ = _run(follower, range(path.end_tick + 1))
    np.testing.assert_allclose(q[-1], Q0 + step, atol=1e-15)
    np.testing.assert_array_equal(q[:1000], np.tile(Q0, (1000, 1)))
    assert np.abs(v).max() == pytest.approx(0.4, rel=1e-4)


def test_sine_goal_is_the_enveloped_sine():
    """Quintics through 80 points a period, against the closed form, until the fade-out begins."""
    goal = sine_goal(NAMES, Q0, [0.1, 0.02, 0.0], 2.0, 6)
    follower = TrajectoryFollower(NAMES, DT, Q0)
    path = follower.accept(goal, 0)
    t = np.arange(3000) * DT
    q, v, a = _run(follower, range(3000))
    for j, size in enumerate((0.1, 0.02, 0.0)):
        exact = enveloped_sine(t, size, 2.0)
        np.testing.assert_allclose(q[:, j] - Q0[j], exact[0], rtol=0, atol=1e-9 * 0.1)
        np.testing.assert_allclose(v[:, j], exact[1], rtol=0, atol=1e-6)
        np.testing.assert_allclose(a[:, j], exact[2], rtol=0, atol=1e-3)
    end = follower.at(path.end_tick)
    np.testing.assert_allclose(end.position, Q0, rtol=0, atol=1e-15)
    np.testing.assert_allclose([end.velocity, end.acceleration], 0.0, atol=1e-12)


def test_enveloped_sine_is_its_own_derivative():
    t, h = np.linspace(0.0, 3.0, 301), 1e-6
    value, rate, second = enveloped_sine(t, 0.1, 2.0)
    later, before = (enveloped_sine(t + s * h, 0.1, 2.0) for s in (1, -1))
    np.testing.assert_allclose((later[0] - before[0]) / (2 * h), rate, atol=1e-8)
    np.testing.assert_allclose((later[1] - before[1]) / (2 * h), second, atol=1e-6)
    assert np.all(value[t == 0.0] == 0.0)
