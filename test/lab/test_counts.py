"""Counts of an angle: where they are no noise, and a stiffness that coarse counts do not spoil."""

from __future__ import annotations

import numpy as np
import pytest

from hd_control.drive.effect import TRANSMISSION
from hd_control.lab.balances.states import count_tone, few_counts, quantum
from hd_control.lab.balances.torsion import BANDS
from hd_control.lab.diagnosis.dictionary import build
from hd_control.lab.diagnosis.fit import Fit
from hd_control.lab.diagnosis.scores import Scores
from hd_control.lab.models.answers import joint_task
from hd_sim.puzzles.campaign import nominal_model, recording
from hd_sim.puzzles.draw import draw_case
from hd_sim.puzzles.recordings import record_pair, set_up

PERIOD = 1e-3


def test_the_count_is_found_and_noise_has_none(rng: np.random.Generator) -> None:
    angle = np.cumsum(rng.standard_normal(5000)) * 1e-4
    assert quantum(3e-5 * np.round(angle / 3e-5)) == pytest.approx(3e-5)
    assert quantum(angle) == 0.0


def test_slow_motion_and_its_beats_are_tones() -> None:
    count = 1e-4
    speed = np.array([0.0, 0.005, 0.02, 0.05, 0.1, 0.102, 0.15])  # rad/s: counts per sample 0 to 1.5
    expected = [True, True, False, False, True, True, False]
    assert count_tone(speed, count, PERIOD, 60.0).tolist() == expected
    assert count_tone(speed, count, PERIOD, 60.0, (1, 2)).tolist() == [*expected[:3], True, *expected[4:6], True]
    assert not count_tone(speed, 0.0, PERIOD, 60.0).any()


def test_motion_over_a_few_counts_repeats_their_error() -> None:
    time, count = np.arange(4000) * PERIOD, 1e-5
    small, wide = (size * count * np.sin(2.0 * np.pi * 20.0 * time) for size in (3.0, 30.0))
    assert few_counts(small, count, PERIOD).all() and not few_counts(wide, count, PERIOD).any()
    assert not few_counts(small, 0.0, PERIOD).any()


@pytest.mark.parametrize("seed", [4043, 4053])
def test_coarse_encoders_do_not_spoil_the_stiffness(seed: int) -> None:
    """Their noise comes back through the controller into the torque: the band ends where that begins.

    0.5 % is a quarter of what a claim on the torsion may rest on (`gates.COMPLIANCE_ERROR`).
    """
    case = draw_case(seed)
    pair, joint = record_pair(case), "joint_1"
    task = joint_task(recording(pair.fit, joint, pair.period), nominal_model(pair.model), joint)
    dictionary = build(task.equations, ())
    stiffness = Fit.of(dictionary, Scores(dictionary), ()).torsional_stiffness
    true = float(set_up(case).world.drives["stiffness_linear"][0])
    assert task.equations.channels[TRANSMISSION].band.zero < BANDS[0][1]
    assert abs(stiffness / true - 1.0) < 5e-3
