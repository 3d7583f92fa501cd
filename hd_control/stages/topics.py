"""Names of the chain's topics; types and fields are in `hd_control.record.schema`, which the recorder uses too."""

from __future__ import annotations

from hd_control.record.schema import TOPICS, joint_state_codec

ENCODER, RESOLVER, GAUGE, APPLIED = "encoder", "resolver", "gauge_bridge", "motor_torque_applied"
JOINT_STATES, MOTOR_STATES = "joint_states", "motor_states"
REFERENCE, REQUIRED, COMMAND = "joint_reference", "joint_torque_required", "motor_torque_command"
TEMPERATURE, GOAL, DESCRIPTION, DIAGNOSTICS = (
    "motor_temperature",
    "joint_trajectory",
    "robot_description",
    "diagnostics",
)
MODE = "torque_mode"
PROGRESS, CLOCK = "recorder/progress", "/clock"
SENSORS = (ENCODER, RESOLVER, GAUGE, APPLIED)

__all__ = ["TOPICS", "fields", "joint_state_codec"]


def fields(topic: str) -> tuple[str, ...]:
    """The arrays that a JointState topic of the chain carries."""
    return TOPICS[topic].fields
