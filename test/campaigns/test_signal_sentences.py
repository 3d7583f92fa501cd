"""Sentences on signals of random joints: none on right signals, one on each defect. hd test --long SIGNALS

Prints the tables of docs/signals.md. Right signals are those of every seed; the defects are put into every third one.
"""

from __future__ import annotations

import re
from collections import Counter
from collections.abc import Callable, Iterator
from concurrent.futures import ProcessPoolExecutor
from dataclasses import replace

import numpy as np
from counts import count, enough
from results import write_result
from test_checks import DEFECTS, late, signals_are_limited

from hd_control.lab.signals.checks import check_signals
from hd_control.lab.signals.joint_signals import SIGNALS, JointSignals
from hd_sim.puzzles.recordings import make_pair

GOALS = ("SIGNALS",)
FIRST, JOINTS, EVERY = 71_000, 180, 3
"""Seeds on which nothing was set."""
DELAYS = (("joint_position", 3), ("motor_torque", 3), ("motor_torque", 6), ("motor_torque", 30), ("gauge_torque", 3),
          ("gauge_torque", 6), ("gauge_torque", 20), ("gauge_torque", 50))  # fmt: skip
Defect = tuple[str, Callable[[JointSignals, float], tuple[JointSignals, float]], str]


def defects() -> Iterator[Defect]:
    """Name, what it does to signals and gear ratio, and what must be said."""
    for name, (spoil, says) in DEFECTS.items():
        yield name, lambda s, ratio, spoil=spoil: (spoil(s), ratio), says
    yield "gear ratio wrong by one", lambda s, ratio: (s, ratio + 1.0), "gear ratio"
    before = "torque of the motor itself"
    yield "torque before the gear", lambda s, ratio: (replace(s, motor_torque=s.motor_torque / ratio), ratio), before
    for column, samples in DELAYS:
        yield (
            f"{column} {samples} samples late",
            lambda s, ratio, c=column, n=samples: (replace(s, **{c: late(getattr(s, c), n)}), ratio),
            rf"{column} .*late",
        )


def judged(seed: int) -> dict[str, Counter[str]]:
    """Counts of one joint: sentences on right signals by cause; defects tried and seen, by quality of the recording."""
    pair = make_pair(seed)
    columns = {name: np.asarray(pair.fit[name]) for name in SIGNALS}
    time = np.asarray(pair.fit["time"])
    signals = JointSignals("joint_1", time, pair.period, np.ones(time.size, bool), **columns)
    ratio, rated = float(pair.model["gear_ratio"]), float(pair.model["rated_torque"])
    found: dict[str, Counter[str]] = {"right": Counter(recordings=1), "tried": Counter(), "seen": Counter()}
    for text in check_signals(signals, ratio, rated):
        limit = "saturated" in text and signals_are_limited(signals)
        delay = "shifted in time" in text and "actuation_delay" in pair.case.names
        found["right"]["torque at its limit" if limit else "hidden actuation delay" if delay else "wrong"] += 1
    if seed % EVERY == 0:
        quality = "poor" if pair.case.category == "poor" else "good"
        for name, spoil, says in defects():
            spoiled, wrong_ratio = spoil(signals, ratio)
            found["tried"][f"{name}, {quality}"] += 1
            said = any(re.search(says, text) for text in check_signals(spoiled, wrong_ratio, rated))
            found["seen"][f"{name}, {quality}"] += said
    return found


def test_sentences_on_random_joints():
    joints, total = count(JOINTS), {"right": Counter(), "tried": Counter(), "seen": Counter()}
    with ProcessPoolExecutor() as pool:
        for found in pool.map(judged, range(FIRST, FIRST + joints)):
            for part, counts in found.items():
                total[part] += counts
    right, rows = dict(total["right"]), []
    print(f"\nright signals: {right}")
    for name, _, _ in defects():
        good, poor = (f"{total['seen'][f'{name}, {q}']}/{total['tried'][f'{name}, {q}']}" for q in ("good", "poor"))
        rows.append(f"| {name} | {good} | {poor} |")
    print("\n".join(rows))
    wrong = right.get("wrong", 0)
    words = f"{wrong} wrong sentences on right signals of {joints} joints{enough(joints, JOINTS)}"
    write_result("SIGNALS", words, wrong <= joints // 50 and joints >= JOINTS, right=right, rows=rows)
    assert wrong <= joints // 50  # 2 %: what is allowed of the false alarms of a diagnosis, too
