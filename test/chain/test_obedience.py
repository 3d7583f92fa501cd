"""The torque law compares what the drive applies with what it has sent (HD-F48)."""

import numpy as np
import pytest

from hd_control.core.errors import GoalError
from hd_control.core.faults import Action, FaultCode
from hd_control.laws.trajectory import quintic_move
from hd_sim.plant_config import PlantConfig
from hd_sim.runner import Runner, RunSetup

LIMIT = 10


@pytest.fixture
def runner():
    found = Runner(RunSetup(PlantConfig.from_file("single_joint_5")))
    found.run_on(300)
    assert found.torque.mode == "ACTIVE" and np.all(found.torque.native.disobeyed == 0.0)
    return found


def foreign(runner, torque, ticks):
    """Ticks in which the drive gets the command of another program."""
    for _ in range(ticks):
        runner.step()
        runner.world.seam.command[:] = torque


def findings(runner):
    return [f for f in runner.torque.faults.values(runner.robot.joint_names) if "not_obeyed" in f]


def test_f48_a_drive_that_obeys_somebody_else_degrades_and_refuses_goals(runner):
    foreign(runner, 40.0, LIMIT)
    assert runner.torque.mode == "ACTIVE" and not findings(runner)
    foreign(runner, 40.0, 2)
    assert runner.torque.mode == "DEGRADED" and findings(runner)
    found = runner.torque.native.rows
    assert [int(n) for n in found[0][[0, 1, 4]]] == [FaultCode.NOT_OBEYED, 0, Action.DEGRADE] and found[0][2] == 40.0
    here = runner.torque.sample.joint_position.copy()
    runner.motion.controller_mode = runner.torque.mode
    with pytest.raises(GoalError):
        runner.offer(quintic_move(runner.robot.joint_names, here, here + 0.1, 0.5, "move"))


def test_f48_it_ends_when_the_drive_obeys_again(runner):
    foreign(runner, 40.0, LIMIT + 20)
    runner.run_on(560)
    assert runner.torque.mode == "ACTIVE" and np.all(runner.torque.native.disobeyed == 0.0)


def test_a_drive_that_applies_nothing_has_let_go_and_is_no_rival(runner):
    foreign(runner, 0.0, 50)
    assert not findings(runner)


def test_a_late_command_and_one_that_is_nearly_ours_are_ours(runner):
    """Up to sixteen ticks late; reported within a twentieth of the limit, or a tenth of itself."""
    sent = []
    for tick in range(60):
        runner.step()
        sent.append(runner.torque.allowed.copy())
        runner.world.seam.command[:] = sent[max(0, tick - 12)] + 14.0
    assert not findings(runner)


def test_a_replay_compares_nothing(runner):
    runner.torque.native.compares_applied = False
    foreign(runner, 40.0, 3 * LIMIT)
    assert not findings(runner) and np.all(runner.torque.native.disobeyed == 0.0)


def test_a_new_activation_begins_anew(runner):
    foreign(runner, 40.0, LIMIT - 2)
    assert runner.torque.native.disobeyed[0] > 0.0
    runner.torque.start()
    assert runner.torque.native.disobeyed[0] == 0.0
