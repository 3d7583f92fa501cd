"""A stiffness that coarse counts of the encoders do not spoil."""

from __future__ import annotations

import pytest

from hd_control.drive.effect import TRANSMISSION
from hd_control.lab.balances.torsion import BANDS
from hd_control.lab.diagnosis.dictionary import build
from hd_control.lab.diagnosis.fit import Fit
from hd_control.lab.diagnosis.scores import Scores
from hd_control.lab.models.answers import joint_task
from hd_sim.puzzles.campaign import nominal_model, recording
from hd_sim.puzzles.draw import draw_case
from hd_sim.puzzles.recordings import record_pair, set_up


@pytest.mark.parametrize("seed", [4043, pytest.param(4053, marks=pytest.mark.slow)])
def test_coarse_encoders_do_not_spoil_the_stiffness(seed: int) -> None:
    """Their noise comes back through the controller into the torque: the band ends where that begins.

    0.5 % is a quarter of what a claim on the torsion may rest on (`coverage.COMPLIANCE_ERROR`).
    """
    case = draw_case(seed)
    pair, joint = record_pair(case), "joint_1"
    task = joint_task(recording(pair.fit, joint, pair.period), nominal_model(pair.model), joint)
    dictionary = build(task.equations, ())
    stiffness = Fit.of(dictionary, Scores(dictionary), ()).torsional_stiffness
    true = float(set_up(case).world.drives["stiffness_linear"][0])
    assert task.equations.channels[TRANSMISSION].band.zero < BANDS[0][1]
    assert abs(stiffness / true - 1.0) < 5e-3
