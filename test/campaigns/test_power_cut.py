"""The power goes at every turn of the recording loop; what was not forced to the disk is gone."""

from __future__ import annotations

from counts import SEED, count, enough
from results import write_result
from test_recorder_ends import power_cuts

GOALS = ("G6",)

CUTS = 1000


def test_g6_power_cuts(tmp_path, monkeypatch):
    """A thousand turns of 5 ms: the recording is 5 s long and each of them is the last one once."""
    cuts = count(CUTS)
    lost = power_cuts(tmp_path, monkeypatch, SEED, 5 * cuts, cuts)
    words = f"{len(lost)} cuts{enough(len(lost), CUTS)}: at most {max(lost)} ms lost, simulated time"
    write_result("G6", words, max(lost) < 1000 and len(lost) >= CUTS, worst_ms=max(lost))
    assert max(lost) < 1000
