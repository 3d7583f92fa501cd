"""One even time base out of stamps as recorders write them: jitter, gaps, repeats, clocks that jump."""

from __future__ import annotations

from itertools import combinations

import numpy as np
import pytest

from hd_control.core.errors import BagError
from hd_control.lab.signals.time_base import (
    EMPTIEST,
    LONGEST_BRIDGE,
    NS,
    Alignment,
    longest_stretch,
    period_of,
    rising,
    time_base,
)

PERIOD_NS = 4_000_000
START = 7 * NS


def even(count: int, period_ns: int = PERIOD_NS) -> np.ndarray:
    """Stamps without any fault."""
    return START + np.arange(count, dtype=np.int64) * period_ns


def test_even_stamps_give_their_own_grid() -> None:
    base = time_base(even(500), "here")
    assert (base.start_ns, base.period, base.count, base.even) == (START, 4e-3, 500, True)
    assert base.jitter < 1e-15, "rounding of the steps in seconds"
    np.testing.assert_array_equal(base.ticks(even(500)), np.arange(500))


@pytest.mark.parametrize(("jitter_ns", "error"), [(100_000, 3e-7), (500_000, 1e-5)])
def test_jitter_is_the_scatter_of_the_steps_and_does_not_move_the_period(jitter_ns: int, error: float, rng) -> None:
    """A step is the difference of two independent stamps: sqrt(2) times their standard deviation, 3 % with 2000 of
    them. The mean of all steps is off by the two outer stamps only, 1e-4 sqrt(2) / 2000 s; of the larger jitter ten
    steps lie beyond half a period and are left out, which moves the mean by 2e-3 sqrt(10) / 2000 s; three times that.
    """
    stamps = even(2000) + np.round(jitter_ns * rng.standard_normal(2000)).astype(np.int64)
    base = time_base(stamps, "here")
    assert not base.even
    assert base.period == pytest.approx(4e-3, abs=error)
    assert base.jitter == pytest.approx(np.sqrt(2.0) * jitter_ns / NS, rel=0.06)


def test_rounded_stamps_have_the_period_of_their_mean() -> None:
    """300 Hz in whole milliseconds: steps of 3 and 4 ms. The median alone would be 3 ms, 10 % wrong."""
    stamps = (np.round(np.arange(900) / 0.3) * 1e6).astype(np.int64)
    assert period_of(stamps) == pytest.approx(1.0 / 300.0, rel=1e-3)
    assert set(np.diff(stamps)) == {3_000_000, 4_000_000}


def test_gaps_neither_stretch_the_period_nor_count_as_jitter() -> None:
    keep = np.ones(1000, dtype=bool)
    keep[[50, 51, 52]] = keep[300:400] = keep[700] = False
    base = time_base(even(1000)[keep], "here")
    assert (base.period, base.count, base.even) == (4e-3, 1000, True)
    assert base.jitter < 1e-15


@pytest.mark.parametrize("count", [0, 1, 9])
def test_too_few_samples_are_an_error_that_says_where_and_how_many(count: int) -> None:
    with pytest.raises(BagError, match=f"^bag: /encoder: {count} usable samples, at least 10"):
        time_base(even(count), "bag: /encoder")


def test_a_window_is_made_of_whole_ticks_and_keeps_what_it_starts_at() -> None:
    base = time_base(even(500), "here")
    window = base.window(0.4, 1.0)
    assert (window.start_ns, window.count, window.period) == (START + 400_000_000, 250, base.period)
    assert base.window(1.9, 5.0).count == 25, "not beyond the end"
    assert base.window(0.0, None) == base
    for start in (1.97, 2.0, 50.0):
        with pytest.raises(BagError, match=r"no samples from .* s on; the recording is 2\.000 s long"):
            base.window(start, None)


def longest_by_trying(stamps: list[int]) -> int:
    """Length of the longest strictly rising part, by trying all of them."""
    for size in range(len(stamps), 0, -1):
        if any(all(a < b for a, b in zip(c, c[1:], strict=False)) for c in combinations(stamps, size)):
            return size
    return 0


@pytest.mark.parametrize("seed", range(20))
def test_as_few_samples_as_possible_are_given_up(seed: int) -> None:
    stamps = np.random.default_rng(seed).integers(0, 12, 9)
    keep = rising(stamps)
    assert (np.diff(keep) > 0).all() and (np.diff(stamps[keep]) > 0).all()
    assert keep.size == longest_by_trying(stamps.tolist())


def test_one_wrong_stamp_costs_one_sample() -> None:
    assert rising(np.array([1, 2, 2, 3])).size == 3
    for wrong in (0, START + 10**15):
        stamps = even(100)
        stamps[40] = wrong
        assert rising(stamps).tolist() == [*range(40), *range(41, 100)]


def test_a_clock_that_jumps_leaves_its_longer_stretch() -> None:
    short, long = even(40), even(100) + 10**18
    assert longest_stretch(np.concatenate([short, long])) == slice(40, 140)
    assert longest_stretch(np.concatenate([short[:5], short[5:] + 10**17, long + 10**18])) == slice(40, 140)
    gap = np.concatenate([even(100), even(100)[-1] + (EMPTIEST - 2) * 100 * PERIOD_NS + even(100) - START])
    assert longest_stretch(gap) == slice(0, 200), "a long pause is no jump"
    assert longest_stretch(even(1)) == slice(0, 1)


def wave(ticks: np.ndarray) -> np.ndarray:
    """5 Hz at 250 Hz, as a function of the tick number."""
    return np.sin(2.0 * np.pi * 5.0 * 4e-3 * ticks)


def test_samples_on_the_grid_arrive_bit_for_bit_wherever_they_begin() -> None:
    base = time_base(even(500), "here")
    for first, last in ((0, 500), (100, 300), (-50, 600)):
        stamps = START + np.arange(first, last, dtype=np.int64) * PERIOD_NS
        column = Alignment(base, stamps).column(wave(np.arange(first, last)), held=False)
        inside = np.arange(max(first, 0), min(last, 500))
        np.testing.assert_array_equal(column[inside], wave(inside))
        assert np.isnan(column[np.setdiff1d(np.arange(500), inside)]).all(), "nothing is invented beyond the ends"


def test_a_delay_is_taken_off_the_stamps() -> None:
    """Half a tick late: the spline's error is 5/384 h^4 f'''' for cubic splines, here 0.013 * 0.126^4."""
    base = time_base(even(500), "here")
    column = Alignment(base, even(500), PERIOD_NS // 2).column(wave(np.arange(500)), held=False)
    inside = slice(10, -10)
    error = np.abs(column[inside] - wave(np.arange(500) + 0.5)[inside]).max()
    assert error < 0.014 * 0.126**4


def test_missing_samples_are_bridged_up_to_a_limit_and_marked_beyond() -> None:
    base = time_base(even(500), "here")
    for missing in range(1, LONGEST_BRIDGE + 3):
        keep = np.ones(500, dtype=bool)
        keep[200 : 200 + missing] = False
        column = Alignment(base, even(500)[keep]).column(wave(np.arange(500))[keep], held=False)
        bridged = np.isfinite(column[200 : 200 + missing])
        assert bridged.all() if missing <= LONGEST_BRIDGE else not bridged.any()
        assert np.isfinite(column).sum() == (500 if missing <= LONGEST_BRIDGE else 500 - missing)


def test_samples_without_a_number_are_missing_samples() -> None:
    base, values = time_base(even(500), "here"), wave(np.arange(500))
    values[[100, 101, *range(300, 310)]] = np.nan
    column = Alignment(base, even(500)).column(values, held=False)
    assert np.flatnonzero(np.isnan(column)).tolist() == list(range(300, 310))
    assert np.abs(column - wave(np.arange(500)))[[100, 101]].max() < 1e-4
    assert np.isnan(Alignment(base, even(500)).column(np.full(500, np.nan), held=False)).all()


def test_a_held_value_is_the_mean_of_what_was_held_during_the_tick() -> None:
    """Stamps a quarter of a tick after the grid: 0.25 of a tick the value before, 0.75 of it the new one."""
    base = time_base(even(100), "here")
    values = np.arange(100.0) ** 2
    column = Alignment(base, even(100) + PERIOD_NS // 4).column(values, held=True)
    expected = 0.25 * values[:-1] + 0.75 * values[1:]
    np.testing.assert_allclose(column[1:], expected, rtol=1e-12)
    # A command at half the rate stays for two ticks.
    slow = Alignment(base, even(50, 2 * PERIOD_NS)).column(values[:50], held=True)
    np.testing.assert_allclose(slow[:98], np.repeat(values[:49], 2), rtol=1e-12)


def test_what_is_slow_goes_in_straight_lines_and_stays_at_its_ends() -> None:
    base = time_base(even(400), "here")
    stamps = START + np.array([100, 200, 300], dtype=np.int64) * PERIOD_NS
    column = Alignment(base, stamps).slow_column(np.array([20.0, 30.0, 10.0]))
    assert (column[:101] == 20.0).all() and (column[300:] == 10.0).all()
    np.testing.assert_allclose(column[100:201], np.linspace(20.0, 30.0, 101), rtol=1e-12)
    with_hole = Alignment(base, stamps).slow_column(np.array([20.0, np.nan, 10.0]))
    assert with_hole[200] == pytest.approx(15.0)
    assert np.isnan(Alignment(base, stamps).slow_column(np.full(3, np.nan))).all()


def test_spacing_says_how_much_slower_a_topic_is() -> None:
    base = time_base(even(400), "here")
    assert Alignment(base, even(40, 10 * PERIOD_NS)).spacing == pytest.approx(10.0)
    assert Alignment(base, even(400)).on_grid
    assert not Alignment(base, even(40, 10 * PERIOD_NS)).on_grid and not Alignment(base, even(400) + 100_000).on_grid
