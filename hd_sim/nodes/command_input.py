"""`motor_torque_command` from one torque node or several, merged by joint name."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from rclpy.node import Node
from rclpy.serialization import deserialize_message
from sensor_msgs.msg import JointState

from hd_control.nodes.ros_loop import HandsOff, chain_qos
from hd_control.record.cdr import JointStateCodec
from hd_control.stages import topics


@dataclass
class _Source:
    """One publisher: its layout, its joints in the robot's order, its run id."""

    codec: JointStateCodec
    joints: Any
    run_id: str


class CommandInput:
    """Takes every waiting command. The first publisher of a joint is bound by its run id; another one is foreign.

    `may_rebind()` says when a bound publisher may be replaced: only while the robot is stopped.
    """

    def __init__(self, node: Node, joint_names: Sequence[str], group: HandsOff, may_rebind: Callable[[], bool]) -> None:
        self._names, self._may_rebind = tuple(joint_names), may_rebind
        self.subscription = node.create_subscription(
            JointState, topics.COMMAND, lambda _: None, chain_qos(4 * len(joint_names)), callback_group=group, raw=True
        )
        self._take = self.subscription.handle.take_message
        self._sources: list[_Source] = []
        self.foreign = 0

    def drain(self, use: Callable[[Any, Any, int], None]) -> None:
        """Calls `use(joints, torque, stamp_ns)` for every waiting command of a bound publisher."""
        while (taken := self._take(JointState, True)) is not None:
            data = taken[0]
            source = self._source(data)
            if source is None:
                self.foreign += 1
            else:
                stamp_ns, arrays = source.codec.decode(data)
                use(source.joints, arrays["effort"], stamp_ns)

    def release(self) -> None:
        """Forgets all publishers."""
        self._sources = []

    def _source(self, data: bytes) -> _Source | None:
        for source in self._sources:
            if source.codec.matches(data):
                if source.codec.frame_id(data) == source.run_id:
                    return source
                if self._may_rebind():
                    self._sources.remove(source)
                    break
                return None
        return self._bind(data)

    def _bind(self, data: bytes) -> _Source | None:
        """A new publisher, unless its layout is unusable or one of its joints has a publisher already."""
        message = deserialize_message(data, JointState)
        names, run_id = list(message.name), message.header.frame_id
        if not names or not set(names) <= set(self._names) or len(set(names)) != len(names):
            return None
        fields = {name: len(getattr(message, name)) for name in ("position", "velocity", "effort")}
        if fields["effort"] != len(names) or any(count not in (0, len(names)) for count in fields.values()):
            return None
        joints = [self._names.index(name) for name in names]
        taken = {int(joint) for source in self._sources for joint in np.arange(len(self._names))[source.joints]}
        if taken & set(joints):
            if not self._may_rebind():
                return None
            self._sources = [s for s in self._sources if not set(np.arange(len(self._names))[s.joints]) & set(joints)]
        codec = JointStateCodec(names, len(run_id.encode()), **{name: count > 0 for name, count in fields.items()})
        if not codec.matches(data):
            return None
        source = _Source(codec, slice(None) if joints == list(range(len(self._names))) else joints, run_id)
        self._sources.append(source)
        return source
