"""Published = written + reported drops in every run, overload and transport loss at random."""

from __future__ import annotations

import shutil

from counts import SEED, count, enough
from results import write_result
from test_recorder import account_once
from test_recorder_ends import test_five_times_too_many_samples_are_all_accounted_for as five_times

GOALS = ("G8",)

RUNS = 500


def test_g8_every_sample_is_accounted_for(tmp_path):
    runs, wrong = count(RUNS), []
    for number in range(runs):
        folder = tmp_path / str(number)
        folder.mkdir()
        try:
            account_once(folder / "bag", SEED + number)
        except AssertionError as error:
            wrong.append(f"seed {SEED + number}: {error}")
        shutil.rmtree(folder)
    (tmp_path / "five").mkdir()
    five_times(tmp_path / "five")
    words = f"{len(wrong)} of {runs} random runs{enough(runs, RUNS)} not in balance"
    words += "; the one with five times too many samples is"
    write_result("G8", words, not wrong and runs >= RUNS, runs=runs)
    assert not wrong, "\n".join(wrong[:5])
