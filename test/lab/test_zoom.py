"""Windows worth a closer look: the worst stretch, a reversal, constant speed, each where it was put."""

from __future__ import annotations

import numpy as np
import pytest
from report_case import PERIOD

from hd_control.lab.maps.zoom import (
    LARGEST_S,
    PLATEAU_S,
    REVERSAL_S,
    Window,
    largest,
    plateau,
    reversal,
    zoom_windows,
)

TIME = np.arange(7500) * PERIOD
EVERY = np.ones(TIME.size, dtype=bool)


def test_windows_show_what_they_say() -> None:
    time = np.arange(7500) * PERIOD
    velocity = np.where(time < 20.0, 0.3, 0.5 * np.sin(time))
    residual = 0.01 * np.ones(time.size)
    residual[(time > 41.0) & (time < 44.0)] = 1.0
    largest, turn, steady = zoom_windows(time, np.ones(time.size, dtype=bool), residual, velocity, 0.01)
    assert (
        largest.start <= 41.0 and largest.end >= 44.0 and largest.end - largest.start == pytest.approx(5.0, abs=PERIOD)
    )
    inside = velocity[turn.rows(time)]
    assert inside[0] * inside[-1] < 0.0
    assert np.ptp(velocity[steady.rows(time)]) == 0.0 and steady.end <= 20.0 + PERIOD
    assert zoom_windows(time, np.zeros(time.size, dtype=bool), residual, velocity, 0.01) == ()


def test_the_largest_error_is_where_most_of_it_is_not_its_peak() -> None:
    """One sample of 30 against 3 s of 1: 900 against 375 rows of 1."""
    excess = np.full(TIME.size, 0.01)
    excess[1000] = 300.0
    excess[(TIME > 40.0) & (TIME < 43.0)] = 1.0
    found = largest(TIME, excess, PERIOD)
    assert found.start <= 40.0 + PERIOD and found.end >= 43.0 - PERIOD
    assert found.end - found.start == pytest.approx(LARGEST_S, abs=PERIOD)
    short = largest(TIME[:100], excess[:100], PERIOD)
    assert (short.start, short.end) == (0.0, pytest.approx(100 * PERIOD)), "never more than there is"


def test_noise_is_no_error() -> None:
    """Of the squares above the floor: 40 % of the rows with an error of 3 hold more than all rows at the floor of 2."""
    residual, some = np.full(TIME.size, 2.0), EVERY.copy()
    sparse = (TIME > 20.0) & (TIME < 25.0)
    residual[sparse], some[sparse] = 3.0, np.arange(sparse.sum()) % 5 < 2
    first, *_ = zoom_windows(TIME, some, residual, np.sin(TIME), 2.0)
    assert first.start == pytest.approx(20.0, abs=0.05)
    residual = np.full(TIME.size, 2.0)
    residual[(TIME > 10.0) & (TIME < 15.0)] = 2.5
    first, *_ = zoom_windows(TIME, EVERY, residual, np.sin(TIME), 2.0)
    assert (first.start, first.end) == (pytest.approx(10.0, abs=0.02), pytest.approx(15.0, abs=0.03))
    unused = EVERY & ~((TIME > 9.0) & (TIME < 16.0))
    first, *_ = zoom_windows(TIME, unused, residual, np.sin(TIME), 2.0)
    assert not 9.0 < first.start < 11.0, "rows that do not count"


def test_the_reversal_with_the_largest_error_is_shown_whole() -> None:
    velocity = 0.4 * np.sin(2.0 * np.pi * TIME / 6.0)  # turns every 3 s
    excess = np.where(np.abs(TIME - 33.0) < 0.3, 5.0, 1.0)
    found = reversal(TIME, EVERY, excess, velocity, PERIOD)
    assert found is not None
    assert 0.5 * (found.start + found.end) == pytest.approx(33.0, abs=2.0 * PERIOD)
    assert found.end - found.start == pytest.approx(REVERSAL_S, abs=2.0 * PERIOD)
    rows = found.rows(TIME)
    assert np.count_nonzero(np.diff(np.sign(velocity[rows])) != 0) in (1, 2), "one passage through zero"


def test_what_is_no_whole_reversal_is_not_shown() -> None:
    excess = np.ones(TIME.size)
    assert reversal(TIME, EVERY, excess, np.full(TIME.size, 0.3), PERIOD) is None
    trembling = 0.3 * np.sign(np.sin(2.0 * np.pi * TIME / 0.4))
    assert reversal(TIME, EVERY, excess, trembling, PERIOD) is None, "several turns within the window"
    velocity = 0.4 * np.sin(2.0 * np.pi * TIME / 6.0)
    assert reversal(TIME, ~EVERY, excess, velocity, PERIOD) is None, "nothing there counts"
    stop = np.where(TIME < 30.0, 0.4, 0.0)
    assert reversal(TIME, EVERY, excess, stop, PERIOD) is None, "a stop is no turn"


def test_constant_speed_is_found_and_cut_to_what_is_shown() -> None:
    """Within 4 % of the mean of the extremes; the longest, its first 5 s."""
    velocity = 0.3 * np.sin(TIME)
    velocity[(TIME >= 12.0) & (TIME < 14.0)] = 0.2
    velocity[(TIME >= 30.0) & (TIME < 38.0)] = -0.25
    found = plateau(TIME, EVERY, velocity, PERIOD)
    assert found is not None and found.start == pytest.approx(30.0, abs=0.05)
    assert found.end - found.start == pytest.approx(PLATEAU_S[1], abs=0.05)
    half = EVERY & ~((TIME >= 30.0) & (TIME < 38.0))
    other = plateau(TIME, half, velocity, PERIOD)
    assert other is not None and other.start == pytest.approx(12.0, abs=0.05)
    assert other.end == pytest.approx(14.0, abs=0.05)


def test_rest_and_changing_speed_are_no_constant_speed() -> None:
    assert plateau(TIME, EVERY, 0.3 * np.sin(TIME), PERIOD) is None
    rest = np.where(TIME < 30.0, 0.0, 0.3 * np.sin(TIME))
    assert plateau(TIME, EVERY, rest, PERIOD) is None
    drifting = 0.2 * (1.0 + 0.2 * TIME / 60.0)
    found = plateau(TIME, EVERY, drifting, PERIOD)
    assert found is not None
    rows = drifting[found.rows(TIME)]
    assert np.ptp(rows) <= 0.04 * 2.0 * rows.max(), "no more change than that"


def test_a_window_selects_its_rows() -> None:
    window = Window("x", 1.0, 2.0)
    rows = window.rows(TIME)
    np.testing.assert_array_equal(TIME[rows], TIME[(TIME >= 1.0) & (TIME < 2.0)])
    assert zoom_windows(TIME[:2], EVERY[:2], TIME[:2], TIME[:2], 0.0) == ()
