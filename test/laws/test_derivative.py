"""Derivative filter D against the closed form of its transfer function, and the error-filter identity."""

import numpy as np
import pytest
from oracles.derivative import derivative_pole, differentiate, low_frequency_delay

from hd_control import _laws


def transfer(pole, dt, w):
    """(1 - a)(1 - 1/z) / (dt (1 - a/z)) at z = exp(i w dt)."""
    back = np.exp(-1j * w * dt)
    return (1 - pole) * (1 - back) / (dt * (1 - pole * back))


def test_the_pole_is_the_papers_at_its_own_rate_and_exact_elsewhere():
    assert derivative_pole(200.0, 1e-3) == 0.8
    assert derivative_pole(800.0, 2.5e-4) == pytest.approx(0.8187, abs=5e-5)
    for cutoff, dt in [(200.0, 1e-3), (800.0, 2.5e-4), (200.0, 5e-4), (50.0, 1e-3)]:
        assert _laws.derivative_pole(cutoff, dt) == derivative_pole(cutoff, dt)


@pytest.mark.parametrize(("cutoff", "dt"), [(200.0, 1e-3), (800.0, 2.5e-4)])
@pytest.mark.parametrize("w", [3.0, 40.0, 400.0])
def test_sine_response_is_the_transfer_function(cutoff, dt, w):
    pole = derivative_pole(cutoff, dt)
    ticks = np.arange(4000)
    seen = differentiate(np.sin(w * dt * ticks), pole, dt)
    wanted = np.imag(transfer(pole, dt, w) * np.exp(1j * w * dt * ticks))
    # the start decays with pole^k: below 1e-30 of w after 400 samples
    assert np.abs(seen - wanted)[400:].max() < 1e-9 * w


def test_a_ramp_gives_its_slope_late_by_the_stated_delay():
    dt, pole = 1e-3, derivative_pole(200.0, 1e-3)
    t = dt * np.arange(500)
    rate = differentiate(0.5 * t**2, pole, dt)
    assert rate[-1] == pytest.approx(t[-1] - low_frequency_delay(pole, dt), abs=1e-12)
    assert low_frequency_delay(pole, dt) == pytest.approx(4.5e-3, abs=1e-15)


def test_error_filter_is_exact_when_the_joint_follows():
    """q = q_d: q_d' - D(q_d - q) is q_d' itself, without the delay that D(q) has."""
    dt, w = 1e-3, 20.0
    t = dt * np.arange(2000)
    q, qd, qd_v = np.sin(w * t), np.sin(w * t), w * np.cos(w * t)
    assert np.array_equal(qd_v - differentiate(qd - q, 0.8, dt), qd_v)
    # D(q) alone is off by the delay: about w^2 * 4.5 ms
    assert np.abs(differentiate(q, 0.8, dt) - qd_v)[200:].max() > 0.9 * w * w * 4.5e-3


def test_error_filter_is_linear_in_the_error():
    """q_d' - D(q_d - q) = D(q) + (q_d' - D(q_d)): same loop, only the reference path changes."""
    dt = 1e-3
    t = dt * np.arange(1000)
    q, qd, qd_v = np.sin(5 * t + 0.1), np.sin(5 * t), 5 * np.cos(5 * t)
    left = qd_v - differentiate(qd - q, 0.8, dt)
    right = differentiate(q, 0.8, dt) + qd_v - differentiate(qd, 0.8, dt)
    assert np.allclose(left, right, atol=1e-11, rtol=0)
