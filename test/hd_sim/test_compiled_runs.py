"""Runs of many ticks at once, compiled, against the runner's own ticks: the same bits, the same ends."""

from dataclasses import replace

import numpy as np
import pytest

from hd_control.core.errors import GoalError
from hd_control.core.faults import FaultCode
from hd_control.core.parameters import params_text
from hd_control.core.resources import config_path
from hd_control.core.strict_yaml import load_params_file
from hd_control.laws.goals import check_goal
from hd_control.laws.trajectory import quintic_move
from hd_sim import scenario
from hd_sim.plant_config import PlantConfig
from hd_sim.runner import Runner, RunSetup
from hd_sim.scenario import Scenario, make_plan

TICKS = 1700
RUNS = [
    ("arm_a", {}),
    ("single_joint_3", {}),
    ("single_joint_7", {"torque_node": {"rate_source": "error_filter", "kinematic_feedforward": True}}),
    ("single_joint_4", {"torque_node": {"law": "direct"}, "motion_node": {"law": "computed_torque"}}),
    ("arm_b", {"torque_node": {"law": "direct"}, "motion_node": {"law": "pid"}}),
    ("single_joint_5", {"torque_node": {"law": "torque_feedback"}}),
    ("single_joint_5", {"torque_node": {"law": "integral_manifold"}}),
]


def new_runner(name, prompt=False, **values):
    return Runner(RunSetup(PlantConfig.from_file(name), 5, values), prompt)


def sine_plan(runner):
    """A small sine of every joint."""
    config = runner.world.seam.plant.config
    sine = Scenario("sine", "", "", lambda c: scenario.enveloped_sine(c.start, 0.02, 2.0))
    limit = runner.goal_limits.velocity
    return make_plan(sine, config.robot.joint_names, config.start_position, limit, config.period, 0)


def stepped(runner, goals, ticks):
    """The rows of `Runner.record` from the runner's own ticks; what comes after a stop stays "not a number"."""
    n, size = runner.robot.joints, runner.torque.native.state.size
    true, desired, command = np.full((3, ticks, n), np.nan)
    states, stopped = np.full((ticks, size), np.nan), False
    while runner.tick < ticks and not stopped:
        tick = runner.tick
        if tick in goals:
            runner.offer(goals[tick])
        true[tick] = runner.world.seam.plant.true_joint_position
        bus = runner.step()
        desired[tick], command[tick] = bus["joint_reference"]["position"], bus["motor_torque_command"]["effort"]
        states[tick] = runner.torque.state.array
        stopped = runner.torque.guard.stopped or runner.world.seam.stopped
    return (true, desired, command, states), stopped


def same_rows(found, expected):
    for one, other in zip(
        (found.true_position, found.desired, found.command, found.states), expected, strict=True
    ):  # fmt: skip
        np.testing.assert_array_equal(one, other)


def remembered(runner):
    """Everything that the next ticks depend on, or that somebody may look at later."""
    seam, stages = runner.world.seam, [stage for _, stage in runner.stages]
    blocks = [stage.native.state for stage in stages] + [stage.native.output for stage in stages]
    guards = [
        block.array for guard in (seam.guard, runner.torque.guard) for block in (guard.gate, guard.stop, guard.state)
    ]
    arrays = [seam.plant.state.array, seam.command, seam.velocities, runner.torque.allowed, *blocks, *guards]
    names = runner.robot.joint_names
    books = [book.values(names) for book in (runner.fusion.faults, runner.torque.faults, runner.world.faults)]
    counts = [seam.late, seam.stale, seam.healthy, seam.brake_closed, runner.tick, runner.motion.controller_mode]
    boxes = []
    for box in (runner.torque.black_box, runner.world.black_box):
        for incident in box.take(True):
            tables = {topic: {name: t.tolist() for name, t in arrays.items()} for topic, (_, arrays) in
                      incident.topics.items()}  # fmt: skip
            boxes.append((incident.stop_tick, incident.code, incident.text, incident.ticks.tolist(), str(tables)))
    return [array.tobytes() for array in arrays], books, counts, boxes


@pytest.mark.parametrize(("name", "values"), RUNS)
def test_recorded_rows_are_the_runners_bit_for_bit(name, values):
    twin, runner = new_runner(name, **values), new_runner(name, **values)
    goals = dict(sine_plan(runner).goals)
    expected, stopped = stepped(twin, goals, TICKS)
    found = runner.record(goals, TICKS)
    same_rows(found, expected)
    assert not stopped and not found.stopped and remembered(twin) == remembered(runner)
    assert np.ptp(found.desired[-1000:], axis=0).min() > 0.005, "it moves"


def test_a_prompt_loop_is_the_runners_too_and_differs_from_a_real_one():
    twin, runner, real = (new_runner("single_joint_3", prompt) for prompt in (True, True, False))
    goals = dict(sine_plan(runner).goals)
    expected, _ = stepped(twin, goals, TICKS)
    found = runner.record(goals, TICKS)
    same_rows(found, expected)
    assert np.any(found.command != real.record(goals, TICKS).command)


def test_running_on_comes_to_the_same_as_stepping():
    """In parts of any length, with a goal in one of them, and longer than a look for stops."""
    twin, runner = new_runner("arm_a"), new_runner("arm_a")
    plan = sine_plan(runner)
    twin.run(replace(plan, ticks=TICKS), observe=lambda tick, bus: None)
    goals, parts = dict(plan.goals), [1, 2, 97, 100, 300, 1200]
    runner_end = 0
    for part in parts:
        end = min(runner_end + part, TICKS)
        while runner.tick < end:
            if runner.tick in goals:
                runner.offer(goals[runner.tick])
            runner.run_on(min([end, *(tick for tick in goals if tick > runner.tick)]) - runner.tick)
        runner_end = end
    assert runner.tick == TICKS and remembered(twin) == remembered(runner)
    whole = new_runner("arm_a")
    whole.run(replace(plan, ticks=TICKS))
    assert remembered(whole) == remembered(new_stepped(plan))


def new_stepped(plan):
    """A runner stepped through a plan."""
    runner = new_runner("arm_a")
    runner.run(replace(plan, ticks=TICKS), observe=lambda tick, bus: None)
    return runner


def limits_with(path, **changes):
    """The shipped limits with some changed, as a file."""
    values = load_params_file(config_path("limits.yaml"), "limits")
    file = path / "limits.yaml"
    file.write_text(params_text({**values, **changes}))
    return {"limits": {"file": str(file)}}


@pytest.mark.parametrize(
    ("changes", "code"),
    [
        ({"motor_torque_rate_limit": [2e3] * 7}, FaultCode.RATE_PERSISTENT),
        ({"twist_limit": [1e-6] * 7}, FaultCode.POSITION_DISAGREE),
        ({"residual_limit": [0.2] * 7}, FaultCode.GAUGE_DRIFT),
    ],
)
def test_a_stop_ends_the_recording_in_its_tick(tmp_path, changes, code):
    values = limits_with(tmp_path, **changes)
    twin, runner = new_runner("single_joint_3", **values), new_runner("single_joint_3", **values)
    start = runner.world.seam.plant.config.start_position
    goals = {1: quintic_move(runner.robot.joint_names, start, start + 0.2, 0.2)}
    expected, stopped = stepped(twin, goals, TICKS)
    found = runner.record(goals, TICKS)
    same_rows(found, expected)
    assert found.stopped and stopped and runner.tick == twin.tick < TICKS and remembered(twin) == remembered(runner)
    assert np.isnan(found.command[runner.tick :]).all() and np.isfinite(found.true_position[: runner.tick]).all()
    books = (runner.fusion.faults, runner.torque.faults, runner.world.faults)
    assert code in {book.first_stop.code for book in books if book.first_stop is not None}


@pytest.mark.parametrize("side", ["control", "drive"])
def test_the_stop_of_either_side_ends_the_recording(side):
    """A latched stop on one side alone: the next recorded tick is the last."""
    runner = new_runner("single_joint_3")
    runner.run_on(300)
    guard = runner.torque.guard if side == "control" else runner.world.seam.guard
    guard.gate.stopped = 1.0
    guard.native.look()
    found = runner.record({}, 600)
    assert found.stopped and runner.tick == 301 and np.isfinite(found.command[300]).all()


def test_running_on_goes_through_a_stop_and_keeps_its_incidents(tmp_path):
    """More than a look away from the end of the run: the rows around the stop are kept all the same."""
    values = limits_with(tmp_path, twist_limit=[2e-4] * 7)
    twin, runner = new_runner("single_joint_3", **values), new_runner("single_joint_3", **values)
    start = runner.world.seam.plant.config.start_position
    for each in (twin, runner):
        each.step()
        each.offer(quintic_move(each.robot.joint_names, start, start + 0.2, 0.3))
    for _ in range(7000):
        twin.step()
    runner.run_on(7000)
    one, other = remembered(twin), remembered(runner)
    assert one == other and runner.torque.guard.stopped
    [incident] = [box for box in other[3] if box[1] == "HD-F04"]
    assert len(incident[3]) > 1000 and incident[0] in incident[3], "of the control side, which sees no torque any more"


def test_a_reference_that_is_lost_is_dropped_as_the_runner_drops_it():
    runners = [new_runner("single_joint_3"), new_runner("single_joint_3")]
    for runner in runners:
        runner.run_on(200)
        start, follower = runner.torque.sample.joint_position.copy(), runner.motion.follower.copy()
        goal = replace(quintic_move(runner.robot.joint_names, start, start + 0.1, 0.2), start_tick=runner.tick)
        path = check_goal(goal, follower, runner.goal_limits, start, runner.motion.tick)
        shifted = path.coefficients.copy()
        shifted[:, :, 0] += 0.06
        runner.motion.hand_over(replace(path, coefficients=shifted))
    for _ in range(100):
        runners[0].step()
    runners[1].run_on(100)
    assert [runner.motion.aborted_goals for runner in runners] == [1, 1]
    assert remembered(runners[0]) == remembered(runners[1])


def test_a_refused_goal_ends_the_recording_with_its_reason():
    runner = new_runner("single_joint_3")
    start = runner.world.seam.plant.config.start_position
    far = quintic_move(runner.robot.joint_names, start, start + 9.0, 0.2)
    with pytest.raises(GoalError, match="HD-F22"):
        runner.record({50: far}, 100)
    assert runner.tick == 50
