"""The topics of a recording with their types, rates and fields; type definitions come from rosbags."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import lru_cache

from hd_control.core.errors import BagError
from hd_control.record.cdr import JOINT_STATE, RUN_ID_LENGTH, TEMPERATURE, VALUES, JointStateCodec, typestore

TICK_NS = 1_000_000
TEXT = "std_msgs/msg/String"
TRAJECTORY = "trajectory_msgs/msg/JointTrajectory"
DIAGNOSTICS = "diagnostic_msgs/msg/DiagnosticArray"
HEADER_FIRST = frozenset({JOINT_STATE, TEMPERATURE, TRAJECTORY, DIAGNOSTICS})


@dataclass(frozen=True)
class Topic:
    """One topic: ROS type, nominal period (0: on demand), JointState fields, and what it carries."""

    name: str
    type_name: str
    period_ns: int
    meaning: str
    fields: tuple[str, ...] = ()
    latched: bool = False
    event: bool = False


def _joints(name: str, meaning: str, *fields: str) -> Topic:
    return Topic(name, JOINT_STATE, TICK_NS, meaning, fields)


TOPICS: dict[str, Topic] = {
    topic.name: topic
    for topic in (
        _joints("encoder", "rotor angle, multi-turn, quantised [rad]", "position"),
        _joints("resolver", "joint angle, quantised [rad]", "position"),
        _joints("gauge_bridge", "torque that the bridge indicates, uncorrected [N·m]", "effort"),
        _joints("motor_torque_applied", "motor torque × gear ratio that the drive applied [N·m]", "effort"),
        Topic("motor_temperature", TEMPERATURE, 100_000_000, "frame_id = joint name [°C]"),
        _joints("joint_states", "joint angle, velocity, flexspline torque", "position", "velocity", "effort"),
        _joints("motor_states", "rotor angle / ratio, velocity, motor torque", "position", "velocity", "effort"),
        Topic("joint_trajectory", TRAJECTORY, 0, "goal", event=True),
        _joints("joint_reference", "desired joint angle and velocity", "position", "velocity"),
        _joints("joint_torque_required", "torque wanted by the motion law [N·m]", "effort"),
        _joints("motor_torque_command", "motor torque after the safety gate [N·m]", "effort"),
        Topic("torque_mode", TEXT, 0, "node and mode of a torque law, on every change", latched=True, event=True),
        Topic("robot_description", TEXT, 0, "URDF", latched=True, event=True),
        Topic("diagnostics", DIAGNOSTICS, 0, "loop statistics, faults, adaptation state", event=True),
    )
}


def base_name(topic: str) -> str:
    """The topic without namespace, `encoder` for `/arm/encoder`; introspection topics keep `<node>/introspection/…`."""
    parts = topic.strip("/").split("/")
    return "/".join(parts[-3:]) if "introspection" in parts[-3:-1] else parts[-1]


def topic_info(topic: str) -> Topic | None:
    """What is known of a topic, in any namespace; None for a foreign one."""
    name = base_name(topic)
    if name.endswith("/introspection/names"):
        return Topic(name, TEXT, 0, "names of the values, one a line", latched=True, event=True)
    if name.endswith("/introspection/values"):
        return Topic(name, VALUES, 0, "every term of the law")
    return TOPICS.get(name)


def joint_state_codec(topic: str, joint_names: Sequence[str], frame_id_length: int = RUN_ID_LENGTH) -> JointStateCodec:
    """The codec of one of the JointState topics above. Raises BagError for any other topic."""
    known = topic_info(topic)
    if known is None or known.type_name != JOINT_STATE:
        raise BagError(f"{topic}: not a JointState topic of this package; see hd_control.record.schema.TOPICS")
    present = {field: field in known.fields for field in ("position", "velocity", "effort")}
    return JointStateCodec(joint_names, frame_id_length, **present)


@lru_cache(maxsize=64)
def message_definition(type_name: str) -> str:
    """The ros2msg text of a type with everything it uses. Raises BagError for a type outside ROS 2 Jazzy."""
    if type_name not in typestore().types:
        raise BagError(f"{type_name}: not a message type of ROS 2 Jazzy; give its definition to add_topic")
    text, _ = typestore().generate_msgdef(type_name, ros_version=2)
    return text


@lru_cache(maxsize=64)
def type_hash(type_name: str) -> str:
    """The RIHS01 hash of a type, as rosbag2 stores it; empty for a type outside ROS 2 Jazzy."""
    return str(typestore().hash_rihs01(type_name)) if type_name in typestore().types else ""
