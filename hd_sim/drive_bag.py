"""Columns of a simulated recording as a bag: what a drive network would publish, and nothing that is hidden."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path

import numpy as np

from hd_control.core.arrays import FloatArray
from hd_control.record.cdr import TemperatureCodec, encode_text
from hd_control.record.schema import joint_state_codec
from hd_control.record.writer import BagWriter

RUN_ID = "simulation_00000"
START_TIME = "2000-01-01T00:00:00Z"
"""Simulated time has no date; a fixed one makes equal runs equal bags."""
TEMPERATURE_PERIOD = 0.1
"""s between two messages of a joint's temperature."""
_TOPICS = {
    "encoder": {"position": "motor_shaft_position"},
    "resolver": {"position": "joint_position"},
    "gauge_bridge": {"effort": "gauge_torque"},
    "motor_torque_applied": {"effort": "motor_torque"},
    "joint_reference": {"position": "reference_position", "velocity": "reference_velocity"},
}


def write_bag(
    path: str | Path,
    joint_names: Sequence[str],
    columns: Mapping[str, FloatArray],
    robot: str,
    period: float,
    metadata: Mapping[str, str],
    force: bool = False,
) -> Path:
    """Writes columns (n,) or (n, joints), named as in `pairs.Pair`, with the user's robot description (URDF text).

    Nothing that `metadata` does not say is added, no seed in particular. Raises BagError.
    """
    joints = len(joint_names)
    tables = {name: np.asarray(values).reshape(len(values), -1) for name, values in columns.items()}
    tables["reference_velocity"] = np.asarray(np.gradient(tables["reference_position"], period, axis=0), np.float64)
    period_ns = round(period * 1e9)
    stamps = np.arange(len(tables["joint_position"]), dtype=np.int64) * period_ns
    with BagWriter(path, live=False, force=force, metadata=metadata, start_time_utc=START_TIME) as writer:
        writer.write("robot_description", None, 0, encode_text(robot))
        writer.attach("robot.urdf", robot, "application/xml")
        for topic, fields in _TOPICS.items():
            values = {field: tables[name] for field, name in fields.items()}
            codec = joint_state_codec(topic, joint_names)
            writer.write_columns(topic, codec, stamps, frame_id=RUN_ID, **values)
        slow = max(1, round(TEMPERATURE_PERIOD / period))
        for joint in range(joints):
            codec_of = TemperatureCodec(joint_names[joint])
            for tick in range(0, len(stamps), slow):
                stamp = int(stamps[tick])
                value = tables["temperature"][tick, joint]
                payload = codec_of.encode(stamp, joint_names[joint], temperature=value)
                writer.write("motor_temperature", stamp, stamp, payload)
        return writer.close()
