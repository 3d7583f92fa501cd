"""Fault campaign in lock-step, quick lane: no unsafe torque, stops in time, no false stop, restart without a jump."""

import math
import os
from dataclasses import replace

import numpy as np
import pytest
from fault_cases import run_case, shrink
from fault_injection import Case, FaultyRunner, Injection, draw_case, make_runner, start_motion
from healthy_runs import healthy_hours
from restart_runs import restart_cycles

from hd_control.core.errors import ConfigError
from hd_control.core.faults import FaultCode
from hd_sim.plant_config import PlantConfig
from hd_sim.runner import Runner, RunSetup

SEED = int(os.environ.get("HD_SEED", "1"))
CASES = 25


def case(target, kind, length=1000, joint=-1, plant="single_joint_5", distance=0.2, magnitude=1.0, onset=400):
    return Case(SEED, 0, plant, distance, 0.3, (Injection(target, kind, joint, onset, length, magnitude),))


def test_g1_no_unsafe_torque_and_every_stop_in_time():
    """Failing cases print seed and case, and what is left of them after shrinking. The long lane runs 10 000."""
    failing = [each for each in (draw_case(SEED, k) for k in range(CASES)) if run_case(each).problems]
    shown = [f"{each.text}: {run_case(each).problems}\n  shrunk: {shrink(each).text}" for each in failing[:3]]
    assert not failing, f"{len(failing)} of {CASES}\n" + "\n".join(shown)


@pytest.mark.parametrize("target", ["encoder", "resolver", "gauge_bridge", "joint_states", "motor_torque_command"])
def test_f01_f18_ten_lost_samples_stop_nine_do_not(target):
    """The drive side stops in the tenth sample without a command, whoever is silent."""
    stopped, alive = run_case(case(target, "off", 10)), run_case(case(target, "off", 9))
    assert stopped.stop_tick == 410 and stopped.problems == []
    assert alive.stop_tick == -1 and alive.problems == []


@pytest.mark.parametrize("law", ["fusion", "motion", "torque"])
def test_f18_f33_a_dead_law_stops_the_robot(law):
    assert run_case(case(law, "off")).stop_tick == 410
    verdict = run_case(case(law, "exception"))
    assert 400 <= verdict.stop_tick <= 410 and verdict.problems == []


@pytest.mark.parametrize("target", ["encoder", "resolver", "gauge_bridge"])
def test_f04_the_third_bad_reading_stops_two_are_bridged(target):
    assert run_case(case(target, "not_finite", 2)).stop_tick == -1
    assert run_case(case(target, "not_finite", 3)).stop_tick == 402


def test_f04_a_command_that_is_not_finite_stops_at_once():
    """Between law and drive: the drive side sees it when it is due, one sample later."""
    verdict = run_case(case("motor_torque_command", "not_finite", 1, plant="arm_a", joint=3))
    assert verdict.stop_tick == 401 and verdict.problems == []


@pytest.mark.parametrize(
    "name", ["motor_position", "motor_velocity", "joint_position", "joint_velocity", "joint_torque"]
)
def test_f04_an_infinite_input_of_the_torque_law_stops_whatever_the_law_makes_of_it(name):
    """A law that clips its torque would turn infinity into the largest torque."""
    runner = FaultyRunner(RunSetup(PlantConfig.from_file("single_joint_5"), 1), [], 1)
    for _ in range(150):
        runner.step()
    runner.torque.sample.view(name)[0] = math.inf
    runner.torque.act(runner.tick)
    assert runner.torque.guard.stopped and runner.torque.faults.first_stop.code is FaultCode.NOT_FINITE


def test_f05_one_spike_changes_nothing_but_the_report():
    verdict = run_case(case("resolver", "wrong", 1, magnitude=50.0))
    assert verdict.stop_tick == -1 and verdict.problems == []


def test_f05_a_jump_that_stays_stops_with_the_third_reading():
    verdict = run_case(case("resolver", "wrong", 1000, magnitude=50.0))
    assert verdict.stop_tick == 402 and verdict.problems == []


@pytest.mark.parametrize("target", ["encoder", "resolver"])
@pytest.mark.parametrize(("velocity", "onset"), [(0.3, 400), (0.02, 1050)])
def test_f03_f07_a_stuck_position_sensor_stops_a_moving_joint(target, velocity, onset):
    """In the middle of the move. Fast: the disagreement shows first; slow: the readings that repeat."""
    distance = 0.2 if velocity > 0.1 else 0.02
    verdict = run_case(replace(case(target, "stuck", distance=distance, onset=onset), velocity=velocity))
    assert onset < verdict.stop_tick <= onset + 80 and verdict.problems == []
    if velocity < 0.1:
        assert verdict.detected == FaultCode.VALUE_FROZEN.name


def test_f08_three_readings_at_the_rail_degrade_twenty_stop():
    """A slow rise, so that the jump itself is no fault: the torque law sees the rail in what fusion gives it."""
    modes, at_rail = [], []
    runner = make_runner(replace(case("gauge_bridge", "ok", distance=0.0), injections=()))
    for tick in range(320):
        gain = max(0.0, min(6.2, 0.1 * (tick - 200)))
        runner.inject([Injection("gauge_bridge", "wrong", -1, tick, 1, gain)])
        reading = abs(float(runner.step()["gauge_bridge"]["effort"][0]))
        at_rail.append(reading >= 0.99 * 600.0)
        modes.append(runner.torque.mode)
    first = at_rail.index(True)
    assert all(at_rail[first:]) and modes[:first] == ["ACTIVE"] * first
    assert modes.index("DEGRADED") == first + 2
    assert next(k for k, mode in enumerate(modes) if mode in ("STOPPING", "HOLDING")) == first + 19


def test_f01_every_second_sample_lost_stops_although_never_ten_in_a_row():
    verdict = run_case(case("encoder", "slow", magnitude=0.1))
    assert 400 < verdict.stop_tick < 450 and verdict.detected == FaultCode.FRAME_LOST.name


def test_the_control_case_runs_through():
    verdict = run_case(case("encoder", "ok"))
    assert verdict.stop_tick == -1 and verdict.problems == [] and verdict.fastest > 0.25


def test_a_random_torque_instead_of_the_controller_stays_inside_the_limits():
    """Layer 1 replaced by a program that sends random torque: the drive side alone keeps the robot safe."""
    verdict = run_case(case("motor_torque_command", "garbage", plant="arm_a", magnitude=1.0))
    assert verdict.problems == [] and verdict.stop_tick >= 400


def test_the_judge_sees_the_torque_that_reaches_the_plant():
    """Of a moving robot, not of one that nothing drives."""
    runner = make_runner(case("encoder", "ok"))
    for tick in range(600):
        if tick == 120:
            start_motion(runner, case("encoder", "ok"))
        runner.step()
        if tick > 150:
            assert runner.given.all() and runner.reached(tick).tolist() == runner.given.tolist()


def test_an_impossible_injection_is_an_error():
    for target, kind in (("encoder", "melted"), ("fusion", "stuck"), ("tea", "off")):
        with pytest.raises(ConfigError, match="cannot inject"):
            Injection(target, kind, 0, 0, 1, 1.0)


def test_the_same_case_gives_the_same_bits():
    def torques():
        runner = FaultyRunner(RunSetup(PlantConfig.from_file("arm_a"), 3), draw_case(7, 9).injections, 3)
        return np.array([(runner.step(), runner.given)[1] for _ in range(800)])

    np.testing.assert_array_equal(torques(), torques())


def test_g3_no_false_stop():
    """A quarter of a minute of healthy motion here, hours in the long lane."""
    assert healthy_hours(SEED, 3.0)[0] == []


def test_g20_restart_without_a_jump():
    assert restart_cycles(3, SEED) == []


def test_a1_freezes_the_estimates_bit_for_bit_and_ends_by_itself():
    fault = Injection("encoder", "off", -1, 900, 4, 1.0)
    runner = FaultyRunner(RunSetup(PlantConfig.from_file("single_joint_5"), 1), [fault], 1)
    seen, modes = [], []
    for tick in range(1600):
        if tick == 500:
            start_motion(runner, case("encoder", "ok"))
        runner.step()
        modes.append(runner.torque.mode)
        seen.append(runner.torque.state.coulomb_torque.copy())
    degraded = [tick for tick, mode in enumerate(modes) if mode == "DEGRADED"]
    assert degraded[0] == 904 and 1390 < degraded[-1] < 1410 and modes[-1] == "ACTIVE"
    assert all(seen[tick].tobytes() == seen[degraded[0]].tobytes() for tick in degraded[1:])
    assert seen[degraded[0] - 5].tobytes() != seen[degraded[0] - 25].tobytes(), "it adapted before"


def test_a_goal_is_dropped_when_the_joint_does_not_follow():
    runner = Runner(RunSetup(PlantConfig.from_file("single_joint_5"), 1))
    for _ in range(150):
        runner.step()
    start_motion(runner, case("encoder", "ok", distance=0.3))  # type: ignore[arg-type]
    for tick in range(1500):
        if tick == 200:
            runner.torque.emergency()
        runner.step()
    assert runner.motion.aborted_goals == 1
    gap = runner.motion.follower.at(runner.motion.tick).position - runner.torque.sample.joint_position
    assert np.all(np.abs(gap) <= 0.05) and math.isfinite(float(gap.sum()))
