"""Recordings whose content is known exactly, with any stamps and any joint names."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path

import numpy as np

from hd_control.core.topics import JOINT_STATE_TYPE
from hd_control.record.cdr import JointStateCodec, TemperatureCodec, encode_text
from hd_control.record.writer import BagWriter

NS = 1_000_000_000
RATIO = 100.0
FIELDS = ("position", "velocity", "effort")


def motion(time: np.ndarray) -> dict[str, np.ndarray]:
    """Smooth signals of a joint at any times, SI, band limited to 7 Hz."""
    joint = 0.8 * np.sin(1.7 * time) + 0.1 * np.sin(13.0 * time)
    gauge = 20.0 * np.cos(2.3 * time) + 3.0 * np.sin(40.0 * time)
    return {
        "motor_shaft_position": RATIO * (joint + 1e-4 * gauge),
        "joint_position": joint,
        "gauge_torque": gauge,
        "motor_torque": gauge + 5.0 * np.sin(3.0 * time),
        "temperature": 30.0 + 0.1 * time,
        "reference_position": joint + 1e-3,
    }


TOPIC_OF = {
    "motor_shaft_position": ("encoder", "position"),
    "joint_position": ("resolver", "position"),
    "gauge_torque": ("gauge_bridge", "effort"),
    "motor_torque": ("motor_torque_applied", "effort"),
    "reference_position": ("joint_reference", "position"),
}


def joint_topic(
    writer: BagWriter, topic: str, field: str, stamps_ns: np.ndarray, columns: Mapping[str, np.ndarray]
) -> None:
    """One JointState topic: joint name -> (n,) values of one field."""
    codec = JointStateCodec(list(columns), 0, **{name: name == field for name in FIELDS})
    writer.add_topic(topic, JOINT_STATE_TYPE)
    table = np.column_stack(list(columns.values()))
    logs = np.maximum(0, np.asarray(stamps_ns))
    writer.write_columns(topic, codec, stamps_ns, logs, **{field: table})


def ticks(seconds: float, period: float = 1e-3, start_ns: int = 5 * NS) -> np.ndarray:
    """Even stamps in ns."""
    return start_ns + np.arange(round(seconds / period), dtype=np.int64) * round(period * NS)


def standard_bag(
    path: Path,
    stamps_ns: np.ndarray,
    joints: Sequence[str] = ("joint_1",),
    skip: Sequence[str] = (),
    change: Mapping[str, np.ndarray] | None = None,
    robot: str = "<robot/>",
) -> Path:
    """All topics of the project with `motion` at the stamps; `skip` leaves signals out, `change` replaces them."""
    time = (np.asarray(stamps_ns) - int(stamps_ns[0])) / NS
    signals = {**motion(time), **(change or {})}
    with BagWriter(path, live=False) as writer:
        writer.write("robot_description", None, int(stamps_ns[0]), encode_text(robot))
        for name, (topic, field) in TOPIC_OF.items():
            if name not in skip:
                joint_topic(writer, topic, field, stamps_ns, dict.fromkeys(joints, signals[name]))
        for joint in joints if "temperature" not in skip else ():
            rows = slice(None, None, 100)
            values = signals["temperature"][rows, None]
            codec = TemperatureCodec(joint)
            writer.write_columns("motor_temperature", codec, stamps_ns[rows], frame_id=joint, temperature=values)
        return writer.close()
