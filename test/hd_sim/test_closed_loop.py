"""The compiled closed loop against the runner, bit for bit, and how it ends when something is not ordinary."""

import numpy as np
import pytest

from hd_control.core.errors import ConfigError
from hd_sim import scenario
from hd_sim.closed_loop import ready, run_on
from hd_sim.plant_config import PlantConfig
from hd_sim.runner import Runner, RunSetup
from hd_sim.scenario import Scenario, make_plan

START, TICKS = 700, 1500


def moving(name, **values):
    """A robot that rests, 0.3 s before its sine begins."""
    config = PlantConfig.from_file(name)
    runner = Runner(RunSetup(config, 5, values))
    sine = Scenario("sine", "", "", lambda c: scenario.enveloped_sine(c.start, 0.02, 2.0))
    plan = make_plan(
        sine, config.robot.joint_names, config.start_position, runner.goal_limits.velocity, config.period, 0
    )
    goals = dict(plan.goals)
    while runner.tick < START:
        if runner.tick in goals:
            runner.offer(goals[runner.tick])
        runner.step()
    assert START > max(goals) and ready(runner) and runner.motion.follower.pending is not None
    return runner


def stepped(runner, ticks):
    """The same rows from the runner's own ticks."""
    true, desired, command, states = [], [], [], []
    for _ in range(ticks):
        true.append(runner.world.seam.plant.true_joint_position)
        bus = runner.step()
        desired.append(bus["joint_reference"]["position"].copy())
        command.append(bus["motor_torque_command"]["effort"].copy())
        states.append(runner.torque.state.array.copy())
    return tuple(map(np.array, (true, desired, command, states)))


@pytest.mark.parametrize(
    ("name", "values"),
    [
        ("arm_a", {}),
        ("single_joint_3", {}),
        ("single_joint_7", {"torque_node": {"rate_source": "error_filter", "kinematic_feedforward": True}}),
        ("single_joint_4", {"torque_node": {"law": "direct"}, "motion_node": {"law": "computed_torque"}}),
        ("arm_b", {"torque_node": {"law": "direct"}, "motion_node": {"law": "pid"}}),
    ],
)
def test_every_tick_is_the_runners_bit_for_bit(name, values):
    expected, found = stepped(moving(name, **values), TICKS), run_on(moving(name, **values), TICKS)
    assert not found.stopped and found.first == START
    assert np.abs(found.desired[-1] - found.desired[0]).max() > 1e-4, "it moves"
    for one, other in zip(expected, (found.true_position, found.desired, found.command, found.states), strict=True):
        assert one.tobytes() == other.tobytes()


@pytest.mark.parametrize("side", ["control", "drive"])
def test_a_joint_that_is_too_fast_ends_the_run_before_the_tick_of_the_stop(side):
    def limited():
        runner = moving("single_joint_3")
        guard = runner.torque.guard if side == "control" else runner.world.seam.guard
        guard._speed[:] = guard.bounds[2] = 0.05
        return runner

    found, twin = run_on(limited(), TICKS), limited()
    while not (twin.torque.guard.stopped or twin.world.seam.stopped):
        twin.step()
    assert found.stopped and 300 < len(found.command) == twin.tick - 1 - START


@pytest.mark.parametrize(("row", "value"), [(0, 9.0), (1, -9.0)])
@pytest.mark.parametrize("side", ["control", "drive"])
def test_a_joint_outside_its_range_is_not_ordinary(side, row, value):
    runner = moving("single_joint_3")
    guard = runner.torque.guard if side == "control" else runner.world.seam.guard
    guard.bounds[row] = value
    found = run_on(runner, TICKS)
    assert found.stopped and len(found.command) == 0


def test_a_gate_that_stops_ends_the_run():
    runner = moving("single_joint_3")
    runner.torque.limits.gate.torque_step = 1e-6
    found = run_on(runner, TICKS)
    assert found.stopped and len(found.command) < TICKS


def test_a_lost_reference_ends_the_run():
    runner = moving("single_joint_3")
    path = runner.motion.follower.pending
    path.coefficients[:, :, 0] += 0.06
    assert run_on(runner, TICKS).stopped


def test_only_ordinary_motion_is_run_on():
    runner = Runner(RunSetup(PlantConfig.from_file("single_joint_3")))
    runner.step()
    with pytest.raises(ConfigError, match="only ordinary motion"):
        run_on(runner, 10)
    feedback = moving("single_joint_3", torque_node={"law": "torque_feedback"})
    with pytest.raises(ConfigError, match="adaptive or direct"):
        run_on(feedback, 10)
