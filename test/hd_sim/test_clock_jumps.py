"""Goal G13: the system clock jumps by seconds and hours at random ticks; no number of the control changes."""

import os

from clock_jumps import FakeClock, hash_of_run, put_in_place, random_jumps, wall_ticks

SEED = int(os.environ.get("HD_SEED", "1"))


def test_f15_g13_a_jump_of_the_clock_changes_no_number(monkeypatch):
    plain = hash_of_run()
    clock = FakeClock()
    put_in_place(monkeypatch, clock)
    assert hash_of_run(clock, random_jumps(SEED, 20)) == plain
    assert clock.offset_ns != 0


def test_f15_g13_the_plant_on_the_wall_clock_counts_ticks_by_the_steady_clock():
    """The number of the first tick is taken from the system clock, once; no jump makes, loses or repeats a tick."""
    sent = wall_ticks(random_jumps(SEED, 20))
    first = sent[0][0]
    assert first == 1_700_000_000_000 + 10**6 + 20
    assert sent == [(first + k, (first + k) * 1_000_000) for k in range(len(sent))]
