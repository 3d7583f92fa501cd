"""The seam in front of the drives: arming, watchdog, brake, partial and stale commands."""

import numpy as np
import pytest

from hd_control.core.faults import FaultCode
from hd_control.safety.limits import safety_limits
from hd_sim.drive_side import ARMING_SAMPLES, DriveSide
from hd_sim.plant import Plant
from hd_sim.plant_config import PlantConfig


@pytest.fixture
def seam():
    config = PlantConfig.from_file("arm_a")
    return DriveSide(Plant(config), safety_limits("limits.yaml", config.robot.joint_names, config.period))


def _gravity(seam):
    return seam.plant.gravity_torque(seam.plant.config.start_position)


def _run(seam, first, last, command):
    """Ticks [first, last) with a fresh command after each; returns the torques given to the drives."""
    given = []
    for tick in range(first, last):
        torque, _ = seam.latch(tick)
        given.append(torque.copy())
        seam.sample()
        seam.advance()
        if command is not None:
            seam.offer(slice(None), command, tick)
    return np.array(given)


def test_the_drives_obey_only_after_a_run_of_healthy_commands(seam):
    before = _run(seam, 0, ARMING_SAMPLES, _gravity(seam))
    assert not seam.armed and seam.brake_closed and np.all(before == 0.0)
    after = _run(seam, ARMING_SAMPLES, ARMING_SAMPLES + 20, _gravity(seam))
    assert seam.armed and not seam.brake_closed
    np.testing.assert_array_equal(after[-1], _gravity(seam))


def test_a_gap_in_the_commands_starts_the_count_again(seam):
    _run(seam, 0, ARMING_SAMPLES - 10, _gravity(seam))
    _run(seam, ARMING_SAMPLES - 10, ARMING_SAMPLES, None)
    assert seam.healthy == 0
    _run(seam, ARMING_SAMPLES, ARMING_SAMPLES + 50, _gravity(seam))
    assert not seam.armed


def test_a_missing_command_is_held_then_stops_all_joints_at_the_age_limit(seam):
    """The command of tick 199 acts in tick 200; from then on its age counts, and the tenth sample stops."""
    _run(seam, 0, 200, _gravity(seam))
    limit = int(seam.limits.gate.age_limit)
    held = _run(seam, 200, 200 + limit, None)
    np.testing.assert_array_equal(held, np.tile(_gravity(seam), (limit, 1)))
    assert not seam.stopped and seam.late == limit - 1
    stopped = _run(seam, 200 + limit, 200 + limit + 1, None)
    assert seam.stopped and seam.brake_closed
    assert np.all(np.abs(stopped[0]) <= np.abs(held[-1]))
    ramp = _run(seam, 200 + limit + 1, 700, None)
    assert np.all(np.abs(np.diff(np.abs(ramp), axis=0).clip(min=0)) == 0.0) and np.all(ramp[-1] == 0.0)


def test_a_stop_stays_when_the_commands_come_back_and_ends_only_by_reset(seam):
    _run(seam, 0, 200, _gravity(seam))
    _run(seam, 200, 260, None)
    _run(seam, 260, 300, _gravity(seam))
    assert seam.stopped
    assert any("healthy" in reason for reason in seam.reset(np.zeros(7)))
    _run(seam, 300, 900, _gravity(seam))
    assert any("moves" in reason for reason in seam.reset(np.full(7, 0.5))) and seam.stopped
    assert seam.reset(np.zeros(7)) == [] and not seam.stopped
    _run(seam, 900, 1000, _gravity(seam))
    assert not seam.brake_closed


def test_joints_may_come_from_several_controllers_and_old_commands_are_dropped(seam):
    seam.latch(5)
    for joint in range(6):
        seam.offer([joint], np.array([1.0 + joint]), 5)
    assert not seam.complete(5)
    seam.offer(np.array([6]), np.array([7.0]), 5)
    assert seam.complete(5)
    np.testing.assert_array_equal(seam.command, np.arange(1.0, 8.0))
    seam.offer([2], np.array([99.0]), 5)
    seam.offer([2], np.array([99.0]), 4)
    seam.offer(slice(None), np.full(7, 99.0), 5)
    assert seam.stale == 3
    np.testing.assert_array_equal(seam.command, np.arange(1.0, 8.0))


@pytest.mark.parametrize("lead", [1, 2, 1_000_000])
def test_f44_a_command_stamped_in_the_future_does_not_keep_the_watchdog_quiet(seam, lead):
    _run(seam, 0, 200, _gravity(seam))
    seam.offer(slice(None), _gravity(seam), 199 + lead)
    limit, faults = int(seam.limits.gate.age_limit), []
    for tick in range(200, 201 + limit):
        faults += seam.latch(tick)[1]
    assert seam.ahead == 1 and seam.stopped and seam.brake_closed
    assert [(fault.code, fault.value, fault.action) for fault in faults][0] == (FaultCode.STAMP_AHEAD, lead, 1)
    assert [fault.code for fault in faults].count(FaultCode.STAMP_AHEAD) == 1


def test_f44_no_command_is_taken_before_the_first_tick_nor_for_the_next_one(seam):
    seam.offer(slice(None), _gravity(seam), 0)
    seam.latch(0)
    seam.offer([3], np.array([1.0]), 1)
    assert seam.ahead == 2 and not seam.complete(0) and np.all(seam.command == 0.0)
    seam.offer(slice(None), _gravity(seam), 0)
    assert seam.complete(0) and not seam.complete(1)


def test_nobody_has_asked_for_a_reset_at_the_start(seam):
    seam.measure(0)
    assert not seam.native.reset_asked and seam.native.resets == 0
    seam.native.reset_asked = True
    seam.measure(1)
    assert not seam.native.reset_asked and seam.native.resets == 1 and seam.native.refusals.size == 0


def test_the_state_says_what_the_drives_do(seam):
    """Connecting, warming, armed with open brakes, stopped; armed again only once the brakes are open again."""
    seen = [seam.native.state]
    for first, last, command in ((0, 1, 0.0), (1, 110, 0.1), (110, 115, _gravity(seam)), (115, 200, None)):
        _run(seam, first, last, None if command is None else np.zeros(7) + command)
        seen.append(seam.native.state)
        if last == 110:
            assert seam.armed and seam.brake_closed, "they obey, but the torque does not carry the arm"
    assert seen == [0, 1, 1, 2, 3]


def test_commands_of_another_time_are_forgotten_when_time_goes_back(seam):
    _run(seam, 10_000, 10_200, _gravity(seam))
    seam.latch(50)
    assert not seam.complete(0)
    _run(seam, 51, 60, _gravity(seam))
    assert seam.stale == 0 and seam.complete(59)


def test_f41_a_moving_joint_that_gets_exactly_no_torque_three_times_gets_the_brakes(seam):
    _run(seam, 0, 200, _gravity(seam))
    faults = []
    for tick in range(200, 206):
        seam.guard.measured.joint_velocity[2] = 0.06
        faults += seam.latch(tick)[1]
        command = _gravity(seam)
        command[2] = 0.0
        seam.offer(slice(None), command, tick)
    stops = [(fault.code, fault.joint, fault.value) for fault in faults if fault.code is FaultCode.LET_GO]
    assert stops[0] == (FaultCode.LET_GO, 2, 3.0) and seam.stopped and seam.brake_closed


def test_f41_a_joint_at_rest_may_get_no_torque(seam):
    _run(seam, 0, 200, _gravity(seam))
    seam.sample()
    seam.guard.measured.joint_velocity[:] = 0.05
    seam.guard.measured.motor_velocity[:] = -0.05
    seam.command[2] = 0.0
    given = [seam.latch(tick) for tick in range(200, 205)]
    assert not any(fault.code is FaultCode.LET_GO for _, faults in given for fault in faults) and not seam.stopped
    assert all(torque[2] == 0.0 for torque, _ in given)


def test_a_command_that_is_not_finite_never_reaches_the_drives(seam):
    _run(seam, 0, 200, _gravity(seam))
    bad = _gravity(seam)
    bad[3] = np.nan
    seam.latch(200)
    seam.offer(slice(None), bad, 200)
    given = _run(seam, 201, 240, _gravity(seam))
    assert seam.stopped and np.all(np.isfinite(given))
