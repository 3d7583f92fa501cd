"""The noise floor of a ladder is a bound that no rung can be below on data that it was not fitted to."""

import pytest

from hd_control.drive.model import JointModel, Model
from hd_control.lab.models.ladder import LadderRung, _with_possible_floors

MODEL = Model(None, {"joint_1": JointModel(100.0)})


def rungs(errors, floor=0.3):
    return tuple(
        LadderRung(str(k), k, {}, {"motor_torque": error, "transmission": 1.0}, {"motor_torque": floor}, MODEL)
        for k, error in enumerate(errors)
    )


@pytest.mark.parametrize(("errors", "floor"), [((7.0, 14.0, 0.03), 0.03), ((7.0, 14.0, 0.5), 0.3), ((7.0,), 0.3)])
def test_what_a_rung_leaves_on_held_out_data_bounds_the_noise(errors, floor):
    found = _with_possible_floors(rungs(errors))
    assert [rung.floor for rung in found] == [{"motor_torque": floor}] * len(errors)
    assert min(rung.ratio("motor_torque") for rung in found) == pytest.approx(min(errors) / floor)
    assert [rung.held_out for rung in found] == [rung.held_out for rung in rungs(errors)]
