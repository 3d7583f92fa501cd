"""Which topic feeds which field of which law: the chain on one page."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field

from hd_control.stages import topics as t

Source = tuple[str, str]
"""Topic and the array of its JointState."""


@dataclass(frozen=True)
class Wiring:
    """Sample and reference fields of a law by their source, and the arrays of each topic by output field."""

    name: str
    sample: Mapping[str, Source]
    outputs: Mapping[str, Mapping[str, str]]
    reference: Mapping[str, Source] = field(default_factory=dict)
    optional: tuple[str, ...] = ()
    """Topics that count only once they have been seen: a foreign node may leave them out."""

    slow: Mapping[str, Source] = field(default_factory=dict)
    """Sample fields that are updated now and then and held between."""

    @property
    def inputs(self) -> tuple[str, ...]:
        """Topics in the order in which they arrive, the last one worth waiting for."""
        return tuple(dict.fromkeys(topic for topic, _ in (*self.sample.values(), *self.reference.values())))


FUSION = Wiring(
    "fusion",
    sample={
        "motor_shaft_position": (t.ENCODER, "position"),
        "joint_position": (t.RESOLVER, "position"),
        "gauge_torque": (t.GAUGE, "effort"),
        "motor_torque": (t.APPLIED, "effort"),
    },
    slow={"motor_temperature": (t.TEMPERATURE, "temperature")},
    outputs={
        # The motion law waits for joint_states only, so they go first.
        t.JOINT_STATES: {"position": "joint_position", "velocity": "joint_velocity", "effort": "joint_torque"},
        t.MOTOR_STATES: {"position": "motor_position", "velocity": "motor_velocity", "effort": "motor_torque"},
    },
)
MOTION = Wiring(
    "motion",
    sample={"joint_position": (t.JOINT_STATES, "position"), "joint_velocity": (t.JOINT_STATES, "velocity")},
    outputs={
        t.REFERENCE: {"position": "desired_position", "velocity": "desired_velocity"},
        t.REQUIRED: {"effort": "joint_torque_required"},
    },
)
TORQUE = Wiring(
    "torque",
    sample={
        "motor_position": (t.MOTOR_STATES, "position"),
        "motor_velocity": (t.MOTOR_STATES, "velocity"),
        "motor_torque": (t.MOTOR_STATES, "effort"),
        "joint_position": (t.JOINT_STATES, "position"),
        "joint_velocity": (t.JOINT_STATES, "velocity"),
        "joint_torque": (t.JOINT_STATES, "effort"),
    },
    reference={
        "desired_position": (t.REFERENCE, "position"),
        "desired_velocity": (t.REFERENCE, "velocity"),
        "joint_torque_required": (t.REQUIRED, "effort"),
    },
    outputs={t.COMMAND: {"effort": "motor_torque"}},
    optional=(t.REFERENCE,),
)
