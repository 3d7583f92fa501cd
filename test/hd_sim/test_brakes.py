"""The brakes open for a torque that carries the arm (HD-F46), and close on a joint that moves at once (HD-F47)."""

import numpy as np
import pytest

from hd_control.core.faults import Action, FaultCode
from hd_control.safety.limits import safety_limits
from hd_sim.drive_side import ARMING_SAMPLES, DriveSide
from hd_sim.plant import Plant
from hd_sim.plant_config import PlantConfig
from hd_sim.runner import Runner, RunSetup

PATIENCE, WATCH = 100, 50
"""Samples until a command that does not carry is reported; samples in which no joint may move."""


class Arm:
    """Arm A in front of a controller that sends one torque, tick by tick."""

    def __init__(self, **narrow):
        config = PlantConfig.from_file("arm_a")
        limits = safety_limits("limits.yaml", config.robot.joint_names, config.period)
        for name, value in narrow.items():
            limits.guard.view(name)[...] = value
        self.side, self.tick, self.faults = DriveSide(Plant(config), limits), 0, []
        self.start = config.start_position
        self.gravity = self.side.plant.gravity_torque(self.start)

    def run(self, ticks, command):
        for _ in range(ticks):
            self.faults += self.side.latch(self.tick)[1]
            self.side.sample()
            self.side.advance()
            self.side.offer(slice(None), np.broadcast_to(command, self.gravity.shape).copy(), self.tick)
            self.tick += 1
        return self

    @property
    def fallen(self):
        """Largest motion (rad) of a joint since the start."""
        return float(np.abs(self.side.plant.true_joint_position - self.start).max())

    def found(self, code):
        return [(f.joint, f.action) for f in self.faults if f.code is code]


@pytest.mark.parametrize("share", [0.0, 0.5, -1.0, 1.7])
def test_f46_a_torque_that_does_not_carry_the_arm_opens_no_brake(share):
    """Half of gravity let joint 2 fall by 1.3 rad, 0.1 N m on every joint by 2.1 rad."""
    arm = Arm()
    arm.run(1500, share * arm.gravity + 0.1)
    assert arm.side.armed and arm.side.brake_closed and not arm.side.stopped and arm.fallen < 1e-3
    assert set(arm.found(FaultCode.BRAKE_HELD)) == {(1, Action.REPORT)}


def test_f46_it_opens_as_soon_as_the_command_carries_and_says_nothing_before_that_takes_long():
    arm = Arm()
    arm.run(ARMING_SAMPLES + PATIENCE - 1, 0.1)
    assert arm.side.brake_closed and arm.found(FaultCode.BRAKE_HELD) == []
    arm.run(1, 0.1)
    assert len(arm.found(FaultCode.BRAKE_HELD)) == 1
    arm.run(3, arm.gravity)
    assert not arm.side.brake_closed
    arm.run(300, arm.gravity)
    assert arm.fallen < 1e-3 and not arm.side.stopped


@pytest.mark.parametrize(("beyond", "opens"), [(50.0, True), (-50.0, True), (50.125, False), (-50.125, False)])
def test_f46_both_ends_of_the_tolerance_belong_to_it(beyond, opens):
    arm = Arm(carry_tolerance=50.0)
    command = np.round(arm.gravity)
    arm.run(ARMING_SAMPLES, command)
    arm.side.readings.gauge_torque[:] = command - beyond * (np.arange(7) == 4)
    arm.side.latch(arm.tick)
    assert arm.side.armed and arm.side.brake_closed is not opens


def test_a_command_that_the_guard_limits_opens_no_brake():
    arm = Arm(carry_tolerance=1e9)
    arm.run(400, 1250.0)
    assert arm.side.armed and arm.side.brake_closed


def test_a_reading_that_is_no_number_opens_no_brake():
    arm = Arm()
    arm.run(ARMING_SAMPLES - 1, arm.gravity)
    for _ in range(20):
        arm.side.readings.gauge_torque[3] = np.nan
        arm.run(1, arm.gravity)
    assert arm.side.armed and arm.side.brake_closed
    arm.run(2, arm.gravity)
    assert not arm.side.brake_closed


def test_f47_a_joint_that_moves_as_soon_as_its_brake_is_open_gets_it_back():
    arm = Arm(carry_tolerance=1e9)
    arm.run(ARMING_SAMPLES + 1, 0.1)
    assert not arm.side.brake_closed
    arm.run(WATCH, 0.1)
    assert arm.found(FaultCode.SLIPPED)[0] == (1, Action.CONTROLLED_STOP) and arm.side.brake_closed
    arm.run(1500, 0.1)
    assert arm.side.stopped and arm.fallen < 0.02


def test_f47_after_the_first_50_ms_a_joint_may_move():
    arm = Arm()
    arm.run(ARMING_SAMPLES + WATCH + 2, arm.gravity)
    push = 60.0 * (np.arange(7) == 0)
    arm.run(150, arm.gravity + push)
    assert arm.fallen > 2e-3 and arm.found(FaultCode.SLIPPED) == [] and not arm.side.stopped


def test_another_source_of_commands_keeps_the_drives_from_arming():
    """HD-F24 on the drive side: while two exist nobody is obeyed, whoever was first."""
    arm = Arm()
    for _ in range(20):
        arm.run(50, arm.gravity)
        arm.side.stranger()
    assert not arm.side.armed and arm.side.healthy == 0
    arm.run(1000 + ARMING_SAMPLES - 2, arm.gravity)
    assert not arm.side.armed
    arm.run(3, arm.gravity)
    assert arm.side.armed and not arm.side.brake_closed


@pytest.mark.parametrize("plant", ["arm_a", "single_joint_3", "single_joint_7"])
def test_a_law_that_waits_long_behind_closed_brakes_does_not_wind_up(plant):
    """The friction estimates went to their bounds, 235 N m, and the brakes would never have opened."""
    runner = Runner(RunSetup(PlantConfig.from_file(plant)))
    side = runner.world.seam
    for _ in range(3000):
        side.stranger()
        runner.step()
    assert side.brake_closed
    runner.run_on(1300)
    assert side.armed and not side.brake_closed and not side.stopped
    assert runner.torque.mode == "ACTIVE" and not runner.torque.guard.stopped


def test_once_armed_a_stranger_changes_nothing():
    arm = Arm()
    arm.run(ARMING_SAMPLES + 100, arm.gravity)
    arm.side.stranger()
    arm.run(200, arm.gravity)
    assert arm.side.armed and not arm.side.stopped and not arm.side.brake_closed


def test_before_arming_another_source_may_take_over_from_one_that_is_silent():
    arm = Arm()
    arm.run(50, arm.gravity)
    assert not arm.side.stands
    for _ in range(ARMING_SAMPLES + 1):
        arm.side.latch(arm.tick)
        arm.tick += 1
    assert arm.side.stands
    arm.run(ARMING_SAMPLES + 5, arm.gravity)
    assert arm.side.armed and not arm.side.stands
