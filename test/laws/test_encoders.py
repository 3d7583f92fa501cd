"""Counts, quantisation, unwrapping."""

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays

from hd_control.laws.calibration import joint_count, motor_count, quantise, unwrap, unwrap_step


def test_counts_of_the_papers_sensors():
    assert motor_count(4000, 120) == pytest.approx(1.309e-5, abs=1e-8)
    assert joint_count(16) == pytest.approx(9.587e-5, abs=1e-8)
    assert joint_count(20) == pytest.approx(5.99e-6, abs=1e-8)


@given(st.floats(-100, 100), st.sampled_from([1e-5, 9.6e-5, 0.25]))
def test_quantisation_is_to_the_nearest_count(angle, count):
    reading = quantise(angle, count)
    assert abs(reading - angle) <= count / 2 * (1 + 1e-9)
    assert abs(reading / count - round(float(reading / count))) < 1e-6


@given(arrays(float, 60, elements=st.floats(-1.5, 1.5)), st.floats(-50, 50), st.integers(-5, 5))
def test_unwrapping_undoes_wrapping(steps, start, turns):
    """P3: unwrap(wrap(x)) - x is constant for steps below a quarter turn, whatever the start turn."""
    x = start + 2 * math.pi * turns + np.cumsum(steps)
    wrapped = (x + math.pi) % (2 * math.pi) - math.pi
    offset = unwrap(wrapped, 2 * math.pi) - x
    assert np.ptp(offset) < 1e-12 * (1 + np.abs(x).max())


@pytest.mark.parametrize("bits", [8, 12, 16, 32])
def test_counters_unwrap_exactly(bits):
    """Whole numbers: not one count is lost over many wraps in both directions."""
    rng = np.random.default_rng(bits)
    period = 2.0**bits
    path = np.cumsum(np.floor(rng.uniform(-0.2, 0.3, 500) * period))
    counter = path % period
    turns, last, seen = 0.0, counter[0], []
    for reading in counter:
        value, turns = unwrap_step(reading, period, last, turns)
        last = reading
        seen.append(value)
    assert np.array_equal(np.array(seen) - seen[0], path - path[0])
    assert np.array_equal(unwrap(counter, period), seen)


def test_no_period_means_no_unwrapping():
    assert unwrap_step(100.0, 0.0, 0.0, 0.0) == (100.0, 0.0)
