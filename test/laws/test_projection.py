"""Projection function P, Zhu (11), (12), (38), (40): the inequality that the stability proof needs; a plain form."""

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from oracles.torque_law import P

from hd_control._laws import project

DT = 1e-3
numbers = st.floats(-1e3, 1e3)


def test_the_inequality_holds_with_the_value_after_the_step():
    """(theta - P+)(drive - dP/(gain dt)) <= 0 for theta on the bounds, hence for all between; 20 000 random steps."""
    rng = np.random.default_rng(1)
    n = 20_000
    low = rng.uniform(-5, 0, n)
    high = low + rng.uniform(0.1, 5, n)
    value = low + rng.uniform(0, 1, n) * (high - low)
    value = np.where(rng.uniform(size=n) < 0.2, low, np.where(rng.uniform(size=n) < 0.2, high, value))
    drive, gain = rng.normal(0, 10, n), rng.uniform(1, 1e3, n)
    after = np.array([project(*row, DT) for row in np.stack([value, drive, gain, low, high], axis=1).tolist()])
    cut = drive - (after - value) / (gain * DT)
    worst = max(((low - after) * cut).max(), ((high - after) * cut).max())
    # rounding: the cut drive is a difference of numbers up to 60 divided by up to 1e-3
    assert worst < 1e-10
    before = max(((low - value) * cut).max(), ((high - value) * cut).max())
    assert before > 0.01, "with the value before the step the inequality is known to fail; the test would see that"


def test_inside_the_bounds_it_integrates():
    assert project(0.5, 2.0, 10.0, 0.0, 1.0, DT) == 0.5 + DT * 10.0 * 2.0


@pytest.mark.parametrize(
    ("value", "drive", "after"), [(0.0, -1.0, 0.0), (1.0, 1.0, 1.0), (0.0, 1.0, 0.01), (1.0, -1.0, 0.99)]
)
def test_at_a_bound_only_the_inward_drive_acts(value, drive, after):
    assert project(value, drive, 10.0, 0.0, 1.0, DT) == pytest.approx(after, abs=1e-15)


@given(st.floats(-2, 2), numbers, st.floats(0, 1e6))
def test_it_has_the_bits_of_the_plain_form(value, drive, gain):
    assert project(value, drive, gain, -1.0, 1.0, DT) == P(value, drive, gain, -1.0, 1.0, DT)


@pytest.mark.parametrize("drive", [math.nan, math.inf, -math.inf])
@pytest.mark.parametrize("value", [0.25, math.nan])
def test_the_result_is_bounded_for_any_number(value, drive):
    assert 0.0 <= project(value, drive, 10.0, 0.0, 1.0, DT) <= 1.0


def test_a_drive_that_is_no_number_leaves_the_value():
    assert project(0.25, math.nan, 10.0, 0.0, 1.0, DT) == 0.25
