"""A degraded robot (A1) follows its path slowly and takes no goal; a stopped one has none."""

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
from oracles.degraded import DegradedOracle
from oracles.stages_law import SLOW_RATE

from hd_control.chain.chain import shipped_values
from hd_control.chain.motion_stage import MODES, NOT_READY, MotionStage
from hd_control.core.errors import GoalError
from hd_control.core.robot import Robot
from hd_control.laws import motion
from hd_control.laws.goals import GoalLimits, check_goal
from hd_control.laws.trajectory import Goal, quintic_move

ARM, DT = Robot.from_file("arm_a"), 1e-3
Q0 = np.array([0.2, 0.5, -0.6, 1.0, -0.5, 0.4, 0.3])
VALUES = {name: value for name, value in shipped_values("motion_node").items() if name in motion.PARAMETERS.names}
LIMITS = replace(GoalLimits.from_values(VALUES, ARM), torque=np.full(7, np.inf))


class Bench:
    """A motion stage whose joints are where its reference wants them, unless `measured` says otherwise."""

    def __init__(self):
        self.stage, self.tick, self.rows = MotionStage(ARM, DT, VALUES["goal_blend_time"]), 0, []
        self.stage.adopt(self.stage.prepare(VALUES))
        self.stage.start()
        self.stage.sample.joint_position = Q0
        self.stage.controller_mode = "ACTIVE"
        self.run(1)

    def path(self, distance=0.5, velocity=1.4):
        """A checked quintic move from rest that starts now."""
        start = self.stage.follower.at(self.tick).position
        return self.checked(quintic_move(ARM.joint_names, start, start + distance, velocity, "move"), 0)

    def led_path(self, distance, seconds, wait):
        """A checked goal of one point, `seconds` after its start in `wait` ticks, from whatever moves then."""
        point = self.stage.follower.at(self.tick + wait).position + distance
        return self.checked(Goal(ARM.joint_names, np.array([seconds]), point[None]), wait)

    def checked(self, goal, wait):
        measured = self.stage.sample.joint_position.copy()
        goal = replace(goal, start_tick=self.tick + wait)
        return check_goal(goal, self.stage.follower.copy(), LIMITS, measured, self.tick - 1)

    def run(self, ticks, mode=None):
        self.stage.controller_mode = mode or self.stage.controller_mode
        for _ in range(ticks):
            self.stage.act(self.tick)
            reference = self.stage.reference
            self.rows.append([reference.desired_position.copy(), reference.desired_velocity.copy(),
                              reference.desired_acceleration.copy()])  # fmt: skip
            self.stage.sample.joint_position = reference.desired_position
            self.tick += 1
        return np.array(self.rows)


def at_full_rate(stage):
    """The path's time is the time."""
    return stage.native.rate == 1.0 and stage.native.lag == 0.0


def consistent(rows):
    """Velocity is the change of position, acceleration that of velocity, at every tick: no jump anywhere."""
    q, v, a = rows[:, 0], rows[:, 1], rows[:, 2]
    np.testing.assert_allclose(np.diff(q, axis=0) / DT, 0.5 * (v[1:] + v[:-1]), atol=2e-3)
    np.testing.assert_allclose(np.diff(v, axis=0) / DT, 0.5 * (a[1:] + a[:-1]), atol=4.0)  # the rate has corners
    assert np.abs(np.diff(v, axis=0)).max() < 0.03


@pytest.mark.parametrize("begin", [50, 300])
def test_a1_the_reference_runs_at_a_quarter_of_its_speed_and_reaches_the_goal_later(begin):
    bench = Bench()
    path = bench.path()
    bench.stage.hand_over(path)
    bench.run(begin)
    oracle = DegradedOracle(VALUES["velocity_limit"])
    for _ in range(700):
        bench.run(1, "DEGRADED")
        oracle.look(bench.tick, "DEGRADED", bench.rows[-1][1], b"")
    assert oracle.found == [] and bench.stage.native.rate == SLOW_RATE
    rows = bench.run(2500, "ACTIVE")
    consistent(rows)
    steady = rows[begin + 220 : begin + 690]
    rises = np.diff(steady[:, 1], axis=0) / DT
    np.testing.assert_allclose(rises, 0.5 * (steady[1:, 2] + steady[:-1, 2]), atol=0.01)
    assert at_full_rate(bench.stage) and not bench.stage.follower.moving(bench.tick)
    np.testing.assert_array_equal(rows[-1, 0], path.end.position)
    late = bench.stage.follower.active.end_tick - path.end_tick
    # 3/4 of a tick is lost in each of 500 ticks, half of that on the two ramps of 200
    assert late == pytest.approx(0.75 * 500 + 2 * 0.375 * 200, abs=3)


def test_a1_without_a_goal_nothing_moves_and_the_next_goal_is_as_ever():
    plain, other = Bench(), Bench()
    plain.run(600)
    other.run(300, "DEGRADED"), other.run(300, "ACTIVE")
    for bench in (plain, other):
        bench.stage.hand_over(bench.path())
        bench.run(800)
    np.testing.assert_array_equal(np.array(plain.rows), np.array(other.rows))


def test_a1_a_goal_that_waits_is_put_off_as_well():
    bench = Bench()
    bench.stage.hand_over(bench.path())
    bench.run(2)
    waiting = bench.led_path(0.1, 1.5, wait=250)
    bench.stage.hand_over(waiting)
    bench.run(100), bench.run(400, "DEGRADED")
    rows = bench.run(2500, "ACTIVE")
    consistent(rows)
    np.testing.assert_array_equal(rows[-1, 0], waiting.end.position)


def test_a1_a_goal_that_was_checked_just_before_is_dropped_not_jumped_to():
    bench = Bench()
    bench.stage.hand_over(bench.path())
    bench.run(100)
    second = bench.led_path(0.1, 1.5, wait=40)
    bench.run(20, "DEGRADED")
    bench.stage.hand_over(second)
    rows = bench.run(3000, "ACTIVE")
    assert bench.stage.late_goals == 1
    consistent(rows)


@pytest.mark.parametrize("mode", list(NOT_READY))
def test_f22_no_goal_while_degraded_or_stopped(mode):
    bench = Bench()
    bench.stage.controller_mode = mode
    with pytest.raises(GoalError, match=f"HD-F22 goal_bad: the torque law is {mode}, goals need ACTIVE") as refusal:
        bench.stage.refuse_unless_ready()
    assert refusal.value.code == "controller_state"


@pytest.mark.parametrize("mode", ["", "INACTIVE", "ACTIVE"])
def test_goals_are_looked_at_otherwise(mode):
    bench = Bench()
    bench.stage.controller_mode = mode
    bench.stage.refuse_unless_ready()


@pytest.mark.parametrize("mode", ["STOPPING", "HOLDING", "STOPPED"])
def test_a2_a3_abort_the_goal(mode):
    bench = Bench()
    bench.stage.hand_over(bench.path())
    bench.run(200)
    moved = bench.stage.sample.joint_position.copy()
    rows = bench.run(50, mode)
    assert bench.stage.aborted_goals == 1 and np.all(rows[-1, 1] == 0.0)
    np.testing.assert_array_equal(rows[-1, 0], moved)


@pytest.mark.parametrize(("gap", "dropped"), [(0.0499, False), (0.0501, True), (np.nan, False)])
def test_a_goal_is_dropped_when_a_joint_has_lost_its_reference(gap, dropped):
    bench = Bench()
    bench.stage.hand_over(bench.path(distance=0.01, velocity=0.05))
    bench.run(20)
    bench.stage.sample.joint_position[3] += gap
    bench.run(1)
    assert bench.stage.aborted_goals == dropped


def test_a_reset_during_slow_motion_starts_anew():
    bench = Bench()
    bench.stage.hand_over(bench.path())
    bench.run(100), bench.run(100, "DEGRADED")
    bench.stage.reset_asked = True
    bench.run(1, "ACTIVE")
    assert bench.stage.reset_answer == [] and at_full_rate(bench.stage)


def test_slow_motion_goes_down_and_up_within_its_time():
    bench = Bench()
    bench.run(200, "DEGRADED")
    rate, lag = bench.stage.native.rate, bench.stage.native.lag
    assert rate == pytest.approx(SLOW_RATE, abs=1e-12) and lag == pytest.approx(0.375 * 201, rel=0.01)
    bench.run(199, "ACTIVE")
    assert 0.99 < bench.stage.native.rate < 1.0 and bench.stage.native.lag == pytest.approx(2 * lag, rel=0.01)
    bench.run(2, "ACTIVE")
    assert at_full_rate(bench.stage)


def test_a_delayed_path_is_the_same_motion_later():
    path, out, later = Bench().path(), np.empty(21), np.empty(21)
    moved = path.delayed(12.25)
    for offset in (0.0, 0.75, 100.5, 333.0, 1e6):
        path.evaluate(path.start_tick + offset, 0, out)
        moved.evaluate(path.start_tick + offset + 12.25, 0, later)
        np.testing.assert_allclose(later, out, rtol=0, atol=1e-12)


def test_the_worst_mode_of_all_torque_nodes_counts():
    from std_msgs.msg import String

    from hd_control.nodes.stop_services import ModeInput

    heard, stage = [], SimpleNamespace(controller_mode="")
    node = SimpleNamespace(create_subscription=lambda kind, topic, function, qos: heard.append((topic, function)))
    ModeInput(node, stage)
    [(topic, take)] = heard
    assert topic == "torque_mode"
    seen = []
    for text in ("/a ACTIVE", "/b DEGRADED", "/a STOPPED", "/b ACTIVE", "nonsense", "/a ACTIVE", "/a MELTED"):
        take(String(data=text))
        seen.append(stage.controller_mode)
    assert seen == ["ACTIVE", "DEGRADED", "STOPPED", "STOPPED", "STOPPED", "ACTIVE", "ACTIVE"]
    assert MODES[0] == "INACTIVE" and MODES[-1] == "STOPPED"
