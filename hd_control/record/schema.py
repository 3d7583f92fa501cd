"""Message types of a recording: the codec of a topic of the chain, definitions and hashes (from rosbags)."""

from __future__ import annotations

from collections.abc import Sequence
from functools import lru_cache

from hd_control.core.errors import BagError
from hd_control.core.topics import JOINT_STATE_TYPE, topic_info
from hd_control.record.cdr import RUN_ID_LENGTH, JointStateCodec, typestore


def joint_state_codec(topic: str, joint_names: Sequence[str]) -> JointStateCodec:
    """The codec of one of the chain's JointState topics. Raises BagError for any other topic."""
    known = topic_info(topic)
    if known is None or known.type_name != JOINT_STATE_TYPE:
        raise BagError(f"{topic}: not a JointState topic of this package; see hd_control.core.topics.TOPICS")
    present = {field: field in known.fields for field in ("position", "velocity", "effort")}
    return JointStateCodec(joint_names, RUN_ID_LENGTH, **present)


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
