"""F33: an exception in any callback of a node is reported, stops the robot, and the node lives on."""

from __future__ import annotations

import secrets
import time
from collections.abc import Callable
from typing import Any

import pytest
import rclpy
from rclpy.executors import SingleThreadedExecutor
from rclpy.node import Node
from rclpy.parameter import Parameter
from rclpy.signals import SignalHandlerOptions
from std_srvs.srv import Trigger
from trajectory_msgs.msg import JointTrajectory

from hd_control.nodes.chain import ChainNode
from hd_control.nodes.process import prepare_environment, spin_guarded
from hd_control.nodes.shell import ERROR

WORDS = "a bug in a callback"


def _raise(*_: Any, **__: Any) -> Any:
    raise RuntimeError(WORDS)


class Bench:
    """A chain in this process, configured, and a client that calls what a test asks for."""

    def __init__(self) -> None:
        self.chain, self.client = ChainNode(), Node("client")
        self.executor = SingleThreadedExecutor()
        for node in (self.chain, self.client):
            self.executor.add_node(node)
        self.chain.trigger_configure()

    def spin_until(self, done: Callable[[], bool]) -> bool:
        """Callbacks until something holds, for 10 s at most."""
        end = time.monotonic() + 10.0
        while not done() and time.monotonic() < end:
            spin_guarded(self.chain, self.executor, 0.05)
        return done()

    def call(self, service: str) -> None:
        """Asks a Trigger service of the chain and does not wait for the answer."""
        client = self.client.create_client(Trigger, f"/chain/{service}")
        assert self.spin_until(client.service_is_ready)
        client.call_async(Trigger.Request())

    def send_goal(self) -> None:
        """Publishes an empty goal."""
        publisher = self.client.create_publisher(JointTrajectory, "joint_trajectory", 10)
        assert self.spin_until(lambda: publisher.get_subscription_count() > 0)
        publisher.publish(JointTrajectory())

    def close(self) -> None:
        """Takes everything down."""
        self.executor.shutdown(0.2)
        self.chain.leave()
        for node in (self.chain, self.client):
            node.destroy_node()


@pytest.fixture
def bench():
    prepare_environment()
    rclpy.init(args=["--ros-args", "--log-level", "fatal"], signal_handler_options=SignalHandlerOptions.NO,
               domain_id=1 + secrets.randbelow(100))  # fmt: skip
    made = Bench()
    yield made
    made.close()
    rclpy.shutdown()


def _goal(bench: Bench, patch: pytest.MonkeyPatch) -> None:
    patch.setattr("hd_control.nodes.goals.goal_from_message", _raise)
    bench.send_goal()


def _reset(bench: Bench, patch: pytest.MonkeyPatch) -> None:
    patch.setattr("hd_control.nodes.stop_services.time.sleep", _raise)
    bench.call("reset")


def _black_box(bench: Bench, patch: pytest.MonkeyPatch) -> None:
    patch.setattr(bench.chain.black_boxes, "collect", _raise)
    bench.call("black_box")


def _diagnostics(bench: Bench, patch: pytest.MonkeyPatch) -> None:
    patch.setattr(bench.chain, "status", _raise)


def _activate(bench: Bench, patch: pytest.MonkeyPatch) -> None:
    patch.setattr(bench.chain, "begin", _raise)
    bench.chain.trigger_activate()


def _loop(bench: Bench, patch: pytest.MonkeyPatch) -> None:
    bench.chain.loop.error = RuntimeError(WORDS)  # what the loop's own thread leaves; the next callback reports it


CALLBACKS = (_goal, _reset, _black_box, _diagnostics, _activate, _loop)


@pytest.mark.parametrize("trigger", CALLBACKS, ids=lambda trigger: trigger.__name__.strip("_"))
def test_f33_a_callback_that_raises_stops_the_robot_and_the_node_lives_on(
    bench: Bench, monkeypatch: pytest.MonkeyPatch, trigger: Callable[[Bench, pytest.MonkeyPatch], None]
) -> None:
    assert bench.chain.torque.exception is None and not bench.chain.fault
    trigger(bench, monkeypatch)
    assert bench.spin_until(lambda: bool(bench.chain.fault)), "nothing was reported"
    expected = "a lifecycle transition raised" if trigger is _activate else WORDS
    assert bench.chain.fault == f"HD-F33 exception: RuntimeError: {expected}"
    assert bench.chain.torque.exception is not None, "the next tick of the torque law stops"
    monkeypatch.undo()
    said: list[Any] = []
    monkeypatch.setattr(bench.chain._diagnostics, "publish", said.append)
    assert bench.spin_until(lambda: bool(said)), "the node is dead"
    status = said[0].status[0]
    assert status.level == ERROR and expected in status.message


def test_f33_a_parameter_check_that_raises_refuses_and_stops(bench: Bench, monkeypatch: pytest.MonkeyPatch) -> None:
    bench.chain.trigger_activate()
    monkeypatch.setattr(bench.chain.service, "_prepare", _raise)
    before = bench.chain.get_parameter("motion.position_gain").value
    changed = Parameter("motion.position_gain", value=[0.9 * gain for gain in before])
    with pytest.raises(RuntimeError, match=WORDS):
        bench.chain.set_parameters([changed])
    assert bench.chain.get_parameter("motion.position_gain").value == before
