"""Zhu's results beside ours: rows and figures of `hd reproduce zhu`. What each means: docs/papers_zhu.md."""

from __future__ import annotations

from typing import Any

from hd_control.reproduce import zhu_arms, zhu_figures, zhu_limits, zhu_table
from hd_control.reproduce.rows import Progress, Row
from hd_control.reproduce.zhu_runs import play_all

PARTS = (zhu_table, zhu_arms, zhu_limits)


def rows(quick: bool, seed: int, progress: Progress, seeds: int = 3) -> list[Row]:
    """All rows; `quick` leaves out 4 kHz single joints, slow motions, delay and options, and uses one seed."""
    several = list(range(seed, seed + (1 if quick else seeds)))
    found = play_all([case for part in PARTS for case in part.cases(quick, several)], progress)
    return [row for part in PARTS for row in part.rows(found, quick, several)]


def figures(quick: bool, seed: int, progress: Progress) -> list[tuple[str, Any]]:
    """Figs. 3 and 4 and Table III as pictures, adaptation histories, the Lyapunov function."""
    return zhu_figures.figures(quick, seed, progress)
