"""Balances as data: which rows a sample touches, filtered columns, units in which the scales are one."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from plain_joint import equations

from hd_control.drive.effect import LINK, MOTOR, TRANSMISSION
from hd_control.lab.balances.channels import Base, Channel, shown_unit
from hd_control.lab.signals.filters import Band, Spectral

PERIOD, SAMPLES = 1e-3, 4000


def channel(step: int = 8) -> Channel:
    """A channel of random rows."""
    spectral, random = Spectral(SAMPLES, PERIOD), np.random.default_rng(0)
    rows = -(-SAMPLES // step)
    base = (Base("one", np.ones(rows)), Base("two", random.standard_normal(rows), 0.5))
    time, valid = np.arange(SAMPLES)[::step] * PERIOD, random.random(rows) > 0.1
    left = random.standard_normal(rows)
    return Channel(MOTOR, Band(38.0, 60.0, step), spectral, time, valid, left, base, 0, 100.0)


@pytest.mark.parametrize("step", [1, 8])
def test_blurred_rows_are_those_within_the_support_of_a_sample(step: int) -> None:
    there = channel(step)
    samples = np.zeros(SAMPLES, bool)
    samples[[0, 1000, 1003, 3999]] = True
    reach = round(there.band.support_s / PERIOD)
    by_hand = [bool(samples[max(0, i - reach) : i + reach + 1].any()) for i in range(0, SAMPLES, step)]
    assert there.blurred(samples).tolist() == by_hand
    assert not there.blurred(np.zeros(SAMPLES, bool)).any() and there.blurred(np.ones(SAMPLES, bool)).all()


def test_what_a_row_sees_of_one_sample_outside_of_the_blur_is_little() -> None:
    """A tenth of the largest answer: the side lobes of the taper."""
    there, samples = channel(), np.zeros((SAMPLES, 1))
    samples[2000] = 1.0
    answer = np.abs(there.rows_of(samples)[:, 0])
    touched = there.blurred(samples[:, 0] > 0.0)
    assert answer[~touched].max() < 0.1 * answer.max() and answer[touched].max() == answer.max()


def test_columns_are_filtered_as_the_left_side_is() -> None:
    there = channel()
    column = np.sin(np.arange(SAMPLES) * PERIOD * 30.0)
    np.testing.assert_allclose(
        there.rows_of(column[:, None])[:, 0], there.spectral.filter(column, there.band), atol=2e-5
    )
    np.testing.assert_array_equal(there.base_matrix, np.stack([b.column for b in there.base], axis=1))


def test_noisy_rows_stay_valid_but_are_not_fitted() -> None:
    there = channel()
    np.testing.assert_array_equal(there.fitted, there.valid)
    noisy = np.arange(there.time.size) % 3 == 0
    np.testing.assert_array_equal(replace(there, noisy=noisy).fitted, there.valid & ~noisy)


def test_in_the_units_of_a_fit_the_next_scales_are_one() -> None:
    """left = -a (u - tau) + ..., so left / a has the scale 1, and the inertia I0 / a."""
    plain = equations()
    scaled = plain.with_scales({MOTOR: 1.25, LINK: 0.8})
    np.testing.assert_allclose(scaled.channels[MOTOR].left, plain.channels[MOTOR].left / 1.25)
    np.testing.assert_allclose(scaled.channels[LINK].left, plain.channels[LINK].left / 0.8)
    assert scaled.channels[TRANSMISSION].left is plain.channels[TRANSMISSION].left or np.array_equal(
        scaled.channels[TRANSMISSION].left, plain.channels[TRANSMISSION].left
    )
    assert scaled.inertia == pytest.approx(plain.inertia / 1.25)
    assert scaled.link_scale == pytest.approx(plain.link_scale / 0.8)
    assert scaled.channels[MOTOR].base is plain.channels[MOTOR].base


def test_small_angles_are_shown_in_microradians() -> None:
    assert shown_unit("rad") == (1e6, "µrad") and shown_unit("N m") == (1.0, "N m")
    assert shown_unit("deg C") == (1.0, "deg C"), "what is not known stays as it is"
