"""The system clock jumps by a second or an hour at random ticks: every number of the control stays."""

from clock_jumps import FakeClock, hash_of_run, put_in_place, random_jumps, wall_ticks
from counts import SEED, count, enough
from results import write_result

GOALS = ("G13",)

JUMPS, PER_RUN = 200, 50


def test_g13_clock_jumps(monkeypatch):
    jumps, plain, different = count(JUMPS), hash_of_run(), 0
    with monkeypatch.context() as patch:
        for number in range(-(-jumps // PER_RUN)):
            clock = FakeClock()
            put_in_place(patch, clock)
            different += hash_of_run(clock, random_jumps(SEED + number, min(PER_RUN, jumps))) != plain
    sent = wall_ticks(random_jumps(SEED, min(jumps, 200)), 800)
    steady = all(after[0] - before[0] == 1 for before, after in zip(sent[:-1], sent[1:], strict=True))
    words = f"{different} runs differ after {jumps} jumps{enough(jumps, JUMPS)}; ticks of the wall clock "
    words += "rise one by one" if steady else "DO NOT rise one by one"
    write_result("G13", words, not different and steady and jumps >= JUMPS, jumps=jumps)
    assert not different and steady
