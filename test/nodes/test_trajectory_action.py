"""The action of trajectory goals, with stand-ins for the messages and the server that the wheels do not have.

The stand-ins have the fields of control_msgs/action/FollowJointTrajectory and the life of an rclpy goal handle; the
motion stage, the goal check and the conversion of messages are the real ones.
"""

from __future__ import annotations

import sys
import types
from types import SimpleNamespace

import numpy as np
import pytest
from rclpy.serialization import serialize_message
from trajectory_msgs.msg import JointTrajectory, JointTrajectoryPoint

from hd_control.chain.chain import for_joints, shipped_values
from hd_control.chain.motion_stage import MotionStage
from hd_control.core.parameters import ParameterSet
from hd_control.core.robot import Robot
from hd_control.laws import motion
from hd_control.laws.trajectory import quintic_move
from hd_control.nodes import goals
from hd_control.nodes.convert import message_from_goal
from hd_control.nodes.goals import GoalService, TrajectoryAction, serve_trajectory_action

DT = 1e-3
ROBOT = Robot.from_file("arm_a")
REST = np.array([0.2, 0.5, -0.6, 1.0, -0.5, 0.4, 0.3])


class Kind:
    """control_msgs.action.FollowJointTrajectory."""

    class Result(SimpleNamespace):
        """Code and text."""

    class Feedback(SimpleNamespace):
        """Stamp, names, three points."""

        def __init__(self) -> None:
            stamp = SimpleNamespace(sec=0, nanosec=0)
            points = {name: JointTrajectoryPoint() for name in ("desired", "actual", "error")}
            super().__init__(header=SimpleNamespace(stamp=stamp), joint_names=[], **points)


class Handle:
    """A goal handle that keeps what happens to it."""

    def __init__(self, trajectory: JointTrajectory, **tolerances: object) -> None:
        span = SimpleNamespace(sec=0, nanosec=tolerances.pop("patience_ns", 0))
        given = {"path_tolerance": [], "goal_tolerance": [], "goal_time_tolerance": span} | tolerances
        self.request = SimpleNamespace(trajectory=trajectory, **given)
        self.is_cancel_requested, self.ends, self.feedback = False, [], []
        self.result: object = None

    def publish_feedback(self, feedback: object) -> None:
        self.feedback.append(feedback)

    def execute(self, callback) -> None:
        self.result = callback(self)

    def __getattr__(self, name: str):
        assert name in ("succeed", "abort", "canceled"), name
        return lambda: self.ends.append(name)


class Bench:
    """A motion stage that is stepped by hand; the joints follow their reference with a constant `error`."""

    def __init__(self) -> None:
        self.values = _values()
        self.stage = MotionStage(ROBOT, DT, self.values["goal_blend_time"])
        self.stage.adopt(self.stage.prepare(self.values))
        self.active, self.dt_ns, self.robot, self.timers = True, 1_000_000, ROBOT, []
        self.said: list[str] = []
        self.tick, self.error, self.server = 0, np.zeros(ROBOT.joints), {}
        service = GoalService(self, self.stage, lambda: self.values)  # type: ignore[arg-type] - a stand-in for the node
        self.action = TrajectoryAction(self, service, self.stage, Kind, self._make_server)
        self.run(5)

    def _make_server(self, node, kind, name, **callbacks):
        assert (node, kind, name) == (self, Kind, "follow_joint_trajectory")
        self.server = callbacks

    def create_publisher(self, *_: object) -> SimpleNamespace:
        return SimpleNamespace(publish=lambda message: self.said.append(message.data))

    def create_subscription(self, *_: object, raw: bool) -> None:
        assert raw, "what is too large is refused as bytes"

    def create_timer(self, period: float, callback, clock: object) -> None:
        self.timers.append(callback)

    def run(self, ticks: int) -> None:
        """Ticks with a look of the timer after every 50th."""
        for _ in range(ticks):
            follower = self.stage.follower
            wanted = REST if follower is None else follower.at(self.tick).position
            bus = {"joint_states": {"position": wanted - self.error, "velocity": np.zeros(ROBOT.joints)}}
            self.stage.step(self.tick, bus)
            self.tick += 1
            if self.tick % 50 == 0:
                self.timers[0]()

    def send(self, handle: Handle) -> Handle:
        self.server["handle_accepted_callback"](handle)
        return handle


def _values() -> dict:
    parameters: ParameterSet = motion.PARAMETERS
    shipped = {name: value for name, value in shipped_values("motion_node").items() if name in parameters.names}
    return for_joints(shipped, parameters, ROBOT.joint_names) | {"robot": "arm_a"}


def move(delta: float = 0.05, names=ROBOT.joint_names) -> JointTrajectory:
    goal = quintic_move(ROBOT.joint_names, REST, REST + delta, 0.3, "move")
    message = message_from_goal(goal, 1_000_000)
    message.joint_names = list(names)
    return message


def tolerance(name: str, position: float = 0.0, velocity: float = 0.0) -> SimpleNamespace:
    return SimpleNamespace(name=name, position=position, velocity=velocity, acceleration=0.0)


def test_a_goal_succeeds_with_feedback_on_the_way():
    bench = Bench()
    handle = bench.send(Handle(move(), goal_tolerance=[tolerance("joint_3", 1e-6)]))
    assert handle.ends == []
    bench.run(1000)
    assert handle.ends == ["succeed"] and handle.result.error_code == 0
    assert len(handle.feedback) > 5
    last = handle.feedback[-1]
    np.testing.assert_allclose(last.desired.positions, REST + 0.05, atol=1e-9)
    assert last.joint_names == list(ROBOT.joint_names) and max(np.abs(last.error.positions)) < 1e-9


@pytest.mark.parametrize(
    ("trajectory", "code", "words"),
    [
        (move(names=("joint_x", *ROBOT.joint_names[1:])), -2, "joint_x"),
        (move(9.0), -1, "joint_"),
        (JointTrajectory(joint_names=list(ROBOT.joint_names)), -1, "no positions"),
    ],
)
def test_a_bad_goal_is_aborted_with_the_text_of_the_check(trajectory, code, words):
    handle = Bench().send(Handle(trajectory))
    assert handle.ends == ["abort"] and handle.result.error_code == code
    assert words in handle.result.error_string and "HD-F22" in handle.result.error_string


def test_a_limit_is_named_with_joint_value_and_limit():
    text = Bench().send(Handle(move(9.0))).result.error_string
    assert "joint_" in text and ">" in text and "rad" in text, text


def test_a_path_tolerance_stops_the_motion():
    bench = Bench()
    bench.error[2] = 2e-3
    handle = bench.send(Handle(move(), path_tolerance=[tolerance("joint_3", 1e-3)]))
    bench.run(200)
    assert handle.ends == ["abort"] and handle.result.error_code == -4
    assert "joint_3: position error 0.002 rad > 0.001 rad" in handle.result.error_string
    bench.run(500)
    assert not bench.stage.follower.moving(bench.tick), "it brakes"
    assert np.max(np.abs(bench.stage.follower.at(bench.tick).position - REST)) < 0.05, "short of the goal"


def test_a_cancel_brakes():
    bench = Bench()
    handle = bench.send(Handle(move(0.2)))
    bench.run(150)
    handle.is_cancel_requested = True
    bench.run(60)
    assert handle.ends == ["canceled"]
    bench.run(600)
    follower = bench.stage.follower
    assert not follower.moving(bench.tick) and np.all(follower.at(bench.tick).velocity == 0.0)


def test_a_newer_goal_replaces_an_older_one():
    bench = Bench()
    first = bench.send(Handle(move(0.1)))
    bench.run(100)
    second = bench.send(Handle(move(0.12)))
    assert first.ends == ["abort"] and "replaced" in first.result.error_string and second.ends == []


def test_a_goal_of_the_topic_ends_that_of_the_action():
    bench = Bench()
    handle = bench.send(Handle(move(0.1)))
    bench.run(100)
    bench.action._service._take(serialize_message(move(0.12)))
    bench.run(100)
    assert handle.ends == ["abort"] and "replaced" in handle.result.error_string


def test_a_lost_reference_and_a_deactivation_abort():
    bench = Bench()
    handle = bench.send(Handle(move(0.2)))
    bench.run(150)
    bench.error[0] = 0.06
    bench.run(100)
    assert handle.ends == ["abort"] and handle.result.error_code == -4
    bench = Bench()
    handle = bench.send(Handle(move(0.2)))
    bench.active = False
    bench.run(100)
    assert handle.ends == ["abort"] and "deactivated" in handle.result.error_string


def test_without_control_msgs_there_is_no_action(monkeypatch):
    monkeypatch.setitem(sys.modules, "control_msgs", None)
    assert serve_trajectory_action(object(), object(), object()) is None


def test_with_control_msgs_the_server_is_made(monkeypatch):
    package, action = types.ModuleType("control_msgs"), types.ModuleType("control_msgs.action")
    action.FollowJointTrajectory = Kind
    monkeypatch.setitem(sys.modules, "control_msgs", package)
    monkeypatch.setitem(sys.modules, "control_msgs.action", action)
    made = []
    monkeypatch.setattr(goals, "TrajectoryAction", lambda *given: made.append(given))
    serve_trajectory_action("node", "service", "stage")
    assert made[0][:4] == ("node", "service", "stage", Kind)


def test_f22_a_goal_of_too_many_bytes_is_refused_before_it_is_read(monkeypatch):
    """A million points took 838 MB and stalled the node until the arm stopped."""
    bench, read = Bench(), []
    monkeypatch.setattr(goals, "deserialize_message", lambda data, kind: read.append(len(data)) or move())
    bench.action._service._take(bytes(4_000_001))
    assert read == [] and bench.action._service.refused == 1
    assert bench.said[-1].startswith("refused goal_1 size: HD-F22 goal_bad: 4000001 bytes > 4000000")
    bench.action._service._take(bytes(4_000_000))
    assert read == [4_000_000] and bench.said[-1].startswith("accepted")


def test_a_goal_keeps_its_name_and_one_without_gets_a_number():
    bench = Bench()
    bench.action._service._take(serialize_message(move()))
    assert bench.said[-1].startswith("accepted move start_tick")
    nameless = move(1e3)
    nameless.header.frame_id = ""
    bench.action._service._take(serialize_message(nameless))
    assert bench.said[-1].startswith("refused goal_2 ")
