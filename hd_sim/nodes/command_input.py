"""`motor_torque_command` from one torque node or several, merged by joint name."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import TYPE_CHECKING, Any

import numpy as np
from rclpy.serialization import deserialize_message
from sensor_msgs.msg import JointState

from hd_control import _messages
from hd_control._messages import COMPLETE, FOREIGN, REPEATED, STALE
from hd_control.core.arrays import FloatArray
from hd_control.nodes.fast_messages import add_input
from hd_control.nodes.ros_loop import chain_qos
from hd_control.record.cdr import JointStateCodec
from hd_control.stages import topics

if TYPE_CHECKING:
    from hd_control.nodes.lifecycle_shell import Shell


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
        self.foreign = 0

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
        if not run_id or not names or not set(names) <= set(self._names) or len(set(names)) != len(names):
            return None
        fields = {name: len(getattr(message, name)) for name in ("position", "velocity", "effort")}
        if fields["effort"] != len(names) or any(count not in (0, len(names)) for count in fields.values()):
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
