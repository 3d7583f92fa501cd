"""Recordings under traffic whose node, subscriptions, pump and context end in every order.

A use of what is gone would end the process, so a result is only written by a campaign that came to its end.
"""

from __future__ import annotations

import shutil

import pytest
from counts import count, enough
from results import write_result
from test_recorder_lifetime import ORDERS, end_once, traffic

GOALS = ("ENDS",)

RUNS = 1000


@pytest.mark.process
def test_recordings_end_in_every_order(tmp_path):
    runs = count(RUNS)
    with traffic() as domain:
        for number in range(runs):
            folder = tmp_path / str(number)
            end_once(domain, folder, ORDERS[number % len(ORDERS)], number // len(ORDERS))
            shutil.rmtree(folder)
    words = f"{runs} recordings{enough(runs, RUNS)} ended in {len(ORDERS)} orders under traffic: no crash, all whole"
    write_result("ENDS", words, runs >= RUNS, runs=runs)
