"""Publishes the sensor topics of a recording: in real time, or tick by tick as the chain answers.

Ticks keep their numbers, so the nodes compute what they would have computed. The plant must not run at the same time.
"""

from __future__ import annotations

import threading
import time
from collections.abc import Callable
from types import TracebackType

import rclpy
from rclpy.executors import SingleThreadedExecutor
from sensor_msgs.msg import JointState, Temperature

from hd_control.chain.replay import ReplayBag
from hd_control.core import topics
from hd_control.core.errors import HdError
from hd_control.nodes.fast_loop import chain_qos
from hd_control.nodes.process import prepare_environment
from hd_control.record.cdr import TemperatureCodec
from hd_control.record.schema import joint_state_codec

RUN_ID = "replay_000000000"
LISTENER_TIMEOUT, ANSWER_TIMEOUT = 10.0, 3.0
FIRST_TRIES = 3


class ReplayPublisher:
    """The sensor side of a recorded robot. Use as a context manager."""

    def __init__(self, bag: ReplayBag, namespace: str = "", domain: int | None = None) -> None:
        self.bag, self.topics = bag, topics.SENSORS
        prepare_environment()
        self._context = rclpy.Context()
        rclpy.init(args=[], context=self._context, domain_id=domain)
        self._node = rclpy.create_node(
            "replay", context=self._context, namespace=f"/{namespace.strip('/')}", enable_rosout=False
        )
        self._codecs = {name: joint_state_codec(name, bag.robot.joint_names) for name in self.topics}
        depth = chain_qos(100)
        self._publishers = {name: self._node.create_publisher(JointState, name, depth) for name in self.topics}
        self._warmth = self._node.create_publisher(Temperature, topics.TEMPERATURE, depth)
        self._answered, self._answers = threading.Event(), 0
        self._awaited = -1
        self._node.create_subscription(JointState, topics.COMMAND, self._answer, depth)
        self._executor = SingleThreadedExecutor(context=self._context)
        self._executor.add_node(self._node)
        self._closing = False
        self._thread = threading.Thread(target=self._spin, name="replay", daemon=True)
        self._thread.start()

    def run(self, rate: float = 1.0, stepped: bool = False, progress: Callable[[int], None] = lambda row: None) -> int:
        """Publishes every tick; returns how many were answered with a command.

        `rate`: ticks per period on the clock. `stepped`: the next tick goes out when the present one is answered.
        Raises HdError without an answer in `ANSWER_TIMEOUT` s, or if nobody listens within `LISTENER_TIMEOUT`. The
        first tick is asked again up to `FIRST_TRIES` times: a graph that has just met may lose it.
        """
        self._wait_for_listener()
        begin, step = time.monotonic(), self.bag.period / rate
        first = int(self.bag.ticks[0])
        for row, tick in enumerate(self.bag.ticks.tolist()):
            if not stepped:
                time.sleep(max(0.0, begin + (tick - first) * step - time.monotonic()))
            self._awaited = tick * round(self.bag.period * 1e9)
            self._answered.clear()
            self._publish(row, self._awaited)
            answered = not stepped or self._answered.wait(ANSWER_TIMEOUT)
            tries = 0 if row else FIRST_TRIES
            while not answered and tries > 0:
                self._publish(row, self._awaited)
                answered, tries = self._answered.wait(ANSWER_TIMEOUT), tries - 1
            if not answered:
                raise HdError(
                    f"tick {tick}: no motor_torque_command within {ANSWER_TIMEOUT:g} s; start the chain with "
                    "hd up --nodes fusion_node motion_node torque_node"
                )
            if row % 100 == 0:
                progress(row)
        if not stepped:
            self._answered.wait(ANSWER_TIMEOUT)
        return self._answers

    def _publish(self, row: int, stamp_ns: int) -> None:
        if row in self.bag.temperatures:
            for name, value in zip(self.bag.robot.joint_names, self.bag.temperatures[row], strict=True):
                self._warmth.handle.publish_raw(TemperatureCodec(name).encode(stamp_ns, name, temperature=value))
        for name, publisher in self._publishers.items():
            values = {field: table[row] for field, table in self.bag.topics[name].items()}
            publisher.handle.publish_raw(self._codecs[name].encode(stamp_ns, RUN_ID, **values))

    def _wait_for_listener(self) -> None:
        end = time.monotonic() + LISTENER_TIMEOUT
        while not all(publisher.get_subscription_count() for publisher in self._publishers.values()):
            if time.monotonic() > end:
                raise HdError(
                    f"nobody listens to {', '.join(self.topics)}; start hd up --nodes fusion_node motion_node "
                    "torque_node, or check --namespace and ROS_DOMAIN_ID"
                )
            time.sleep(0.02)
        time.sleep(0.2)

    def _answer(self, message: JointState) -> None:
        stamp = message.header.stamp
        self._answers += 1
        if stamp.sec * 1_000_000_000 + stamp.nanosec == self._awaited:
            self._answered.set()

    def _spin(self) -> None:
        while not self._closing:
            self._executor.spin_once(timeout_sec=0.2)

    def __enter__(self) -> ReplayPublisher:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self._closing = True
        self._executor.wake()
        self._thread.join(2.0)
        self._executor.shutdown(0.2)
        self._node.destroy_node()
        rclpy.shutdown(context=self._context)
