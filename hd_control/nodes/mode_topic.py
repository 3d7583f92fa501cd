"""`torque_mode`: each torque node tells its mode when it changes, `torque_node DEGRADED`; the motion node listens.

Modes: INACTIVE, ACTIVE, DEGRADED, STOPPING, HOLDING, STOPPED (docs/safety.md). Latched, so who comes late knows, too.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

from rclpy.qos import DurabilityPolicy, QoSProfile, ReliabilityPolicy
from std_msgs.msg import String

from hd_control.nodes.ros_loop import latched_qos
from hd_control.record.cdr import encode_text
from hd_control.stages import topics
from hd_control.stages.motion_stage import MODES, MotionStage

if TYPE_CHECKING:
    from hd_control.nodes.lifecycle_shell import Shell

NODES = 32
"""Torque nodes that may tell their mode at the same time."""


class ModePublisher:
    """Tells the mode of one torque law; called in the loop, publishes on a change only."""

    def __init__(self, node: Shell) -> None:
        self._name = node.get_fully_qualified_name()
        self._publisher = node.create_publisher(String, topics.MODE, latched_qos())
        self._told = ""

    def tell(self, mode: str) -> None:
        """The mode of this tick."""
        if mode != self._told:
            self._told = mode
            self._publisher.handle.publish_raw(encode_text(f"{self._name} {mode}"))


class ModeInput:
    """Keeps the worst mode of all torque nodes where the motion law looks."""

    def __init__(self, node: Shell, stage: MotionStage) -> None:
        self._stage = stage
        self._modes: dict[str, str] = {}
        latched = DurabilityPolicy.TRANSIENT_LOCAL
        qos = QoSProfile(depth=NODES, reliability=ReliabilityPolicy.RELIABLE, durability=latched)
        node.create_subscription(String, topics.MODE, self._take, qos)

    def _take(self, message: String) -> None:
        name, _, mode = message.data.partition(" ")
        if mode in MODES:
            self._modes[name] = mode
            self._stage.controller_mode = max(self._modes.values(), key=MODES.index)
