"""The plant's topics: `motor_torque_command` merged by joint name, sensors out, and what the plant says of itself."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any

import numpy as np
from rclpy.serialization import deserialize_message
from rosgraph_msgs.msg import Clock
from sensor_msgs.msg import JointState, Temperature
from std_msgs.msg import String, UInt64

from hd_control import _messages
from hd_control._messages import COMPLETE, FOREIGN, REPEATED, STALE
from hd_control.core import topics
from hd_control.core.arrays import FloatArray
from hd_control.core.blocks import Block
from hd_control.core.faults import Action, Fault, FaultCode
from hd_control.nodes.fast_loop import add_input, chain_qos, latched_qos
from hd_control.nodes.shell import ERROR, OK, WARN, Shell, foreign_report
from hd_control.nodes.stage_shell import Output
from hd_control.record.cdr import ClockCodec, JointStateCodec, TemperatureCodec
from hd_sim.nodes.plant_turn import PlantTurn
from hd_sim.world import World, sensor_places

# ---- The command, from one torque node or several --------------------------------------------------


class _Source:
    """One publisher, bound by its run id: its joints in the robot's order, and the torque that it sent last."""

    def __init__(self, names: Sequence[str], codec: JointStateCodec, joints: Sequence[int], dt_ns: int) -> None:
        self.taken = set(joints)
        self.joints: Any = slice(None) if list(joints) == list(range(len(names))) else np.array(joints)
        self.torque = np.zeros(len(joints))
        self.join = _messages.Join(dt_ns)
        add_input(self.join, codec, {"effort": [(self.torque, range(len(joints)))]})


class CommandInput:
    """Takes every waiting command. The first publisher of a joint is bound by its run id; another one is foreign.

    `may_rebind()` says when a bound publisher may be replaced: only while the robot is stopped.
    """

    def __init__(self, node: Shell, joint_names: Sequence[str], dt_ns: int, may_rebind: Callable[[], bool]) -> None:
        self._names, self._may_rebind, self._dt_ns = tuple(joint_names), may_rebind, dt_ns
        depth = chain_qos(4 * len(joint_names))
        self.subscription = node.create_subscription(
            JointState, topics.COMMAND, lambda _: None, depth, callback_group=node.group, raw=True
        )
        self._take = self.subscription.handle.take_message
        self._sources: list[_Source] = []
        self.foreign = self.unreadable = 0

    def drain(self, use: Callable[[Any, FloatArray, int], None]) -> None:
        """Calls `use(joints, torque, tick)` for every waiting command of a bound publisher."""
        while (taken := self._take(JointState, True)) is not None:
            source = self._source(taken[0])
            if source is None:
                self.foreign += 1
            else:
                use(source.joints, source.torque, source.join.tick)

    def release(self) -> None:
        """Forgets all publishers."""
        self._sources = []

    def _source(self, data: bytes) -> _Source | None:
        """The publisher of a message, whose torque and tick are then those of the message."""
        for source in self._sources:
            outcome = source.join.offer(0, data)
            if outcome in (COMPLETE, STALE, REPEATED):
                return source
            if outcome == FOREIGN:
                if not self._may_rebind():
                    return None
                self._sources.remove(source)
                break
        return self._bind(data)

    def _bind(self, data: bytes) -> _Source | None:
        """A new publisher, unless its layout is unusable or one of its joints has a publisher already."""
        message = deserialize_message(data, JointState)
        names, run_id = list(message.name), message.header.frame_id
        fields = {name: len(getattr(message, name)) for name in ("position", "velocity", "effort")}
        usable = run_id and names and set(names) <= set(self._names) and len(set(names)) == len(names)
        if not usable or fields["effort"] != len(names) or any(n not in (0, len(names)) for n in fields.values()):
            self.unreadable += 1
            return None
        joints = [self._names.index(name) for name in names]
        others = [source for source in self._sources if source.taken & set(joints)]
        if others and not self._may_rebind():
            return None
        codec = JointStateCodec(names, len(run_id.encode()), **{name: count > 0 for name, count in fields.items()})
        source = _Source(self._names, codec, joints, self._dt_ns)
        if source.join.offer(0, data) != COMPLETE:
            return None
        self._sources = [each for each in self._sources if each not in others] + [source]
        return source


# ---- All topics ------------------------------------------------------------------------------------


class TopicSeam:
    """The plant's topics."""

    def __init__(self, node: Shell, world: World, lockstep: bool) -> None:
        names = world.joint_names
        self._node, self._world, self._dt_ns = node, world, node.dt_ns
        places = sensor_places(world.seam.sample())
        self._outputs = [Output(node, topic, names, places[topic]) for topic in topics.SENSORS]
        self.sensor_publishers = [output.publisher for output in self._outputs]
        self._temperature = node.create_publisher(Temperature, topics.TEMPERATURE, chain_qos(2 * len(names)))
        self._temperature_codecs = [TemperatureCodec(name) for name in names]
        self._clock = node.create_publisher(Clock, topics.CLOCK, chain_qos()) if lockstep else None
        self._clock_codec = ClockCodec()
        self._progress = node.create_publisher(UInt64, "~/progress", latched_qos())
        self._description = node.create_publisher(String, topics.DESCRIPTION, latched_qos())
        self._description.publish(String(data=node.robot.urdf))
        self.commands = CommandInput(node, names, node.dt_ns, lambda: world.seam.stopped)
        self._behind = node.create_subscription(
            UInt64, topics.PROGRESS, lambda _: None, latched_qos(), callback_group=node.group
        )
        self._recorded = -1

    def send(self, tick: int, stamp_ns: int, sample: Block) -> None:
        for output in self._outputs:
            output.publish(stamp_ns, sample.array)
        if self._clock is not None:
            self._clock.handle.publish_raw(self._clock_codec.encode(stamp_ns))

    def send_temperature(self, stamp_ns: int, temperature: Any) -> None:
        for codec, name, value in zip(self._temperature_codecs, self._world.joint_names, temperature, strict=True):
            self._temperature.handle.publish_raw(codec.encode(stamp_ns, name, temperature=value))

    def collect(self, timeout_ns: int) -> None:
        if timeout_ns > 0:
            self._node.loop.waiter.wait((self.commands.subscription.handle,), timeout_ns)
        self.commands.drain(self._world.command)

    def recorded(self) -> int:
        while (taken := self._behind.handle.take_message(UInt64, False)) is not None:
            self._recorded = taken[0].data
        return self._recorded

    def progress(self, tick: int) -> None:
        self._progress.publish(UInt64(data=tick))

    def foreign_report(self) -> dict[str, str]:
        """For diagnostics: who may have sent commands of another run id."""
        return foreign_report(self._node, {topics.COMMAND: self.commands.foreign - self.commands.unreadable})

    def destroy(self) -> None:
        """Removes the topics."""
        for publisher in (*self.sensor_publishers, self._temperature, self._progress, self._description):
            self._node.destroy_publisher(publisher)
        for subscription in (self.commands.subscription, self._behind):
            self._node.destroy_subscription(subscription)
        if self._clock is not None:
            self._node.destroy_publisher(self._clock)


def plant_status(turn: PlantTurn, world: World, seam: TopicSeam) -> tuple[bytes, str, dict[str, Any]]:
    """Level, one line and values for diagnostics."""
    stop, values = world.report()
    turn.statistics.foreign = seam.commands.foreign
    values = turn.statistics.summary() | values | {"tick": turn.tick, "skipped": turn.skipped}
    values |= seam.foreign_report()
    if late := world.seam.late + turn.skipped:
        values["overrun"] = Fault(FaultCode.OVERRUN, -1, late, 0.0, Action.REPORT).text()
    if stop or turn.fault:
        return ERROR, "; ".join(filter(None, [turn.fault, stop])), values
    return (
        (WARN, "late or foreign commands", values) if world.seam.late or turn.statistics.foreign else (OK, "", values)
    )
