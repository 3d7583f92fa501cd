"""The tracking error of a running robot: reference against measured joint position, RMS over seconds of its ticks."""

from __future__ import annotations

import time
from collections.abc import Iterable, Mapping

import numpy as np
from rclpy.node import Node
from sensor_msgs.msg import JointState

from hd_control.core.errors import HdError
from hd_control.nodes.convert import stamp_ns
from hd_control.nodes.ros_loop import chain_qos
from hd_control.stages import topics

WORSE = 1.05
"""A correction is withdrawn above this ratio of the errors after and before."""
SLOWEST = 20.0
"""Wall seconds allowed for one second of ticks."""


class TrackingWatch:
    """Listens to `joint_reference` and `joint_states`; the node must be spun by another thread."""

    def __init__(self, node: Node) -> None:
        self._positions: dict[str, dict[int, JointState]] = {topics.REFERENCE: {}, topics.JOINT_STATES: {}}
        for topic, kept in self._positions.items():
            node.create_subscription(JointState, topic, self._keeper(kept), chain_qos(1000))

    def _keeper(self, kept: dict[int, JointState]):  # type: ignore[no-untyped-def]
        def keep(message: JointState) -> None:
            kept[stamp_ns(message.header.stamp)] = message

        return keep

    def measure(self, seconds: float) -> dict[str, float]:
        """RMS by joint over the next `seconds` of ticks, rad. Raises HdError if the topics do not carry them."""
        for kept in self._positions.values():
            kept.clear()
        end = time.monotonic() + 5.0 + SLOWEST * seconds
        while time.monotonic() < end:
            both = self._both()
            if len(both) > 1 and both[-1] - both[0] >= seconds * 1e9:
                return self._rms(both)
            time.sleep(0.05)
        raise HdError(f"joint_reference and joint_states did not carry {seconds:g} s of ticks; is the robot active?")

    def _both(self) -> list[int]:
        reference, states = (list(self._positions[name]) for name in (topics.REFERENCE, topics.JOINT_STATES))
        return sorted(set(reference) & set(states))

    def _rms(self, stamps: Iterable[int]) -> dict[str, float]:
        errors, names = [], []
        for stamp in stamps:
            wanted, measured = (self._positions[name][stamp] for name in (topics.REFERENCE, topics.JOINT_STATES))
            names = list(wanted.name)
            found = dict(zip(measured.name, measured.position, strict=True))
            errors.append([w - found[name] for name, w in zip(names, wanted.position, strict=True)])
        rms = np.sqrt(np.mean(np.square(errors), axis=0))
        return dict(zip(names, rms.tolist(), strict=True))


def growth(before: Mapping[str, float], after: Mapping[str, float], joints: Iterable[str]) -> float:
    """Geometric mean over the joints of the errors after over before; 1 without joints."""
    ratios = [after[joint] / before[joint] for joint in joints if before.get(joint, 0.0) > 0.0 and joint in after]
    return float(np.exp(np.mean(np.log(np.maximum(ratios, 1e-12))))) if ratios else 1.0
