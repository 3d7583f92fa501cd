"""Motions: the derivatives are the derivatives, goals start and end at rest, excitation covers what it promises."""

import numpy as np
import pytest
from scipy.interpolate import BPoly

from hd_sim import scenario

START = np.array([0.2, 0.5, -0.6, 1.0, -0.5, 0.4, 0.3])
LIMIT = np.array([1.5, 1.5, 1.5, 2.0, 2.5, 2.5, 3.0])


def _all(seed=3):
    random = np.random.default_rng(seed)
    return {
        "steps": scenario.steps(START),
        "coordinated": scenario.coordinated_moves(START, np.deg2rad(10), 0.4),
        "slow": scenario.constant_speed(START, 0.001, 21.0),
        "sine": scenario.enveloped_sine(START, 0.1, 0.5),
        "fast sine": scenario.enveloped_sine(START, 0.015, 5.0),
        "random": scenario.random_moves(START, LIMIT, random, 10),
        "excitation": scenario.excitation(START, LIMIT, random),
    }


@pytest.mark.parametrize("name", _all())
def test_motion_starts_and_ends_at_rest_inside_its_duration(name):
    motion = _all()[name]
    assert np.all(np.diff(motion.times) >= 0.001 - 1e-12)
    assert motion.times[-1] <= motion.duration + 1e-9
    for end in (0, -1):
        np.testing.assert_allclose(motion.velocities[end], 0.0, atol=1e-12)
    assert 0.0 <= motion.window[0] < motion.window[1] <= motion.duration + 1e-9


@pytest.mark.parametrize(("name", "tolerance"), [("sine", 1e-9), ("fast sine", 1e-8)])
def test_knot_derivatives_belong_to_the_knots(name, tolerance):
    """The quintic through every second knot meets the skipped knots: wrong derivatives would miss by far more."""
    motion = _all()[name]
    use, skip = slice(0, None, 2), slice(1, None, 2)
    values = np.stack([motion.positions[use, 0], motion.velocities[use, 0], motion.accelerations[use, 0]], axis=1)
    spline = BPoly.from_derivatives(motion.times[use], values)
    np.testing.assert_allclose(spline(motion.times[skip]), motion.positions[skip, 0], atol=tolerance)


def test_excitation_derivatives_agree_with_differences():
    motion = _all()["excitation"]
    smooth = (motion.times > 30.0) & (motion.times < 47.5)
    velocity = np.gradient(motion.positions, motion.times, axis=0)[smooth]
    acceleration = np.gradient(motion.velocities, motion.times, axis=0)[smooth]
    np.testing.assert_allclose(velocity, motion.velocities[smooth], atol=2e-3)  # 10 ms knots, 2.5 Hz: w^2 h^2/6
    np.testing.assert_allclose(acceleration, motion.accelerations[smooth], atol=0.03)
    chirp = (motion.times > 48.5) & (motion.times < 55.0)
    acceleration = np.gradient(motion.velocities, motion.times, axis=0)[chirp]
    np.testing.assert_allclose(acceleration, motion.accelerations[chirp], atol=0.12)


def test_excitation_covers_speed_range_and_angle():
    motion = _all()["excitation"]
    speed = np.abs(motion.velocities).max(axis=0)
    assert np.all(speed > 0.9) and np.all(speed < LIMIT)
    assert np.all(np.ptp(motion.positions, axis=0) > 1.0)
    assert np.abs(motion.accelerations).max() < 6.0


def test_constant_speed_travels_at_its_speed():
    motion = _all()["slow"]
    np.testing.assert_allclose(np.diff(motion.positions, axis=0)[1] / np.diff(motion.times)[1], 0.001, rtol=1e-12)


def test_coordinated_moves_peak_at_the_named_velocity():
    motion = _all()["coordinated"]
    spline = BPoly.from_derivatives(
        motion.times, np.stack([motion.positions[:, 2], motion.velocities[:, 2], motion.accelerations[:, 2]], axis=1)
    )
    assert np.abs(spline.derivative()(np.linspace(1.0, motion.duration, 20001))).max() == pytest.approx(0.4, rel=1e-6)
