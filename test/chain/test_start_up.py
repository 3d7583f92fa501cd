"""The first ticks of an activation: lateness is no fault until the nodes have found each other."""

from __future__ import annotations

import pytest

from hd_control import _chain
from hd_control.chain.motion_stage import NOT_ARMED, NOT_ARMED_CODE
from hd_control.core import topics
from hd_control.core.errors import GoalError
from hd_control.core.faults import FaultCode
from hd_sim.plant_config import PlantConfig
from hd_sim.runner import Runner, RunSetup

WARM = _chain.WARM_TICKS
HOLE = 40
"""Ticks that are lost at once: four times the limit."""


@pytest.fixture
def runner() -> Runner:
    return Runner(RunSetup(PlantConfig.from_file("single_joint_5")))


def lose(runner: Runner, ticks: int) -> None:
    """The torque law does not see so many ticks of a robot that stands on its brakes."""
    act = runner.torque.act
    runner.torque.act = lambda tick: None  # type: ignore[method-assign]
    for _ in range(ticks):
        runner.step()
    runner.torque.act = act  # type: ignore[method-assign]


@pytest.mark.parametrize("before", [1, 2, WARM - 1])
def test_f01_ticks_that_are_lost_while_nodes_find_each_other_stop_nothing(runner: Runner, before: int) -> None:
    runner.run_on(before)
    lose(runner, HOLE)
    runner.step()
    assert not runner.torque.guard.stopped and runner.torque.mode == "ACTIVE" and runner.torque.native.warm == 0
    runner.run_on(WARM)
    lose(runner, HOLE)
    runner.step()
    assert runner.torque.faults.first_stop is not None
    assert runner.torque.faults.first_stop.code is FaultCode.FRAME_LOST


def test_f01_a_new_activation_is_patient_again(runner: Runner) -> None:
    runner.run_on(3 * WARM)
    runner.torque.start()
    runner.run_on(5)
    lose(runner, HOLE)
    runner.step()
    assert not runner.torque.guard.stopped


def test_a_command_that_is_no_number_stops_from_the_first_tick_on(runner: Runner) -> None:
    runner.run_on(2)
    runner.torque.emergency(RuntimeError("a bug"))
    runner.step()
    assert runner.torque.guard.stopped, "patience is for lateness alone"


def test_the_drives_say_what_they_do_with_commands(runner: Runner) -> None:
    drives, states = runner.world.seam.native, topics.DRIVE_STATES
    assert states[drives.state] == topics.CONNECTING
    runner.run_on(3)
    assert states[drives.state] == topics.WARMING and not runner.world.seam.armed
    runner.run_on(150)
    assert states[drives.state] == topics.ARMED and runner.world.seam.armed
    for _ in range(20):
        runner.world.measure(runner.tick)  # nobody commands any more
        runner.world.advance()
        runner.tick += 1
    assert states[drives.state] == topics.DRIVES_STOPPED


@pytest.mark.parametrize("state", NOT_ARMED)
def test_a_goal_that_starts_at_once_waits_for_the_drives(runner: Runner, state: str) -> None:
    runner.run_on(3)
    runner.motion.drive_state = state
    with pytest.raises(GoalError, match=f"not yet armed: the drives are {state}") as refusal:
        runner.motion.refuse_unless_ready(at_once=True)
    assert refusal.value.code == NOT_ARMED_CODE and NOT_ARMED[state] in str(refusal.value)
    runner.motion.drive_state = topics.ARMED
    runner.motion.refuse_unless_ready(at_once=True)


def test_a_dated_goal_may_find_them_armed_and_only_a_stop_refuses_it(runner: Runner) -> None:
    runner.run_on(3)
    runner.motion.drive_state = topics.WARMING
    runner.motion.refuse_unless_ready()
    runner.motion.drive_state = topics.DRIVES_STOPPED
    with pytest.raises(GoalError, match="Call reset"):
        runner.motion.refuse_unless_ready()


def test_a_robot_whose_drives_say_nothing_takes_goals(runner: Runner) -> None:
    runner.run_on(3)
    assert runner.motion.drive_state == ""
    runner.motion.refuse_unless_ready(at_once=True)
