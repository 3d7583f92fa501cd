"""Every topic of the chain: its name, type, rate, the quantity in each of its arrays, and the signal that it is.

The one place. Wiring of the laws, recorder, replay, world, import and workbench are made from this table.

A *quantity* is the name of the number in the blocks of the laws (`hd_control.chain.wiring`). A *signal* is the name of
the column that the workbench makes of it (`hd_control.lab.signals`): several topics may carry the same signal, the
first one in the table that a recording has counts.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field

ENCODER, RESOLVER, GAUGE, APPLIED = "encoder", "resolver", "gauge_bridge", "motor_torque_applied"
JOINT_STATES, MOTOR_STATES = "joint_states", "motor_states"
REFERENCE, REQUIRED, COMMAND = "joint_reference", "joint_torque_required", "motor_torque_command"
TEMPERATURE, GOAL, DESCRIPTION, DIAGNOSTICS = (
    "motor_temperature",
    "joint_trajectory",
    "robot_description",
    "diagnostics",
)
MODE, DRIVES = "torque_mode", "drive_state"
PROGRESS, CLOCK = "recorder/progress", "/clock"
SENSORS = (ENCODER, RESOLVER, GAUGE, APPLIED)
TICK_NS = 1_000_000
"""Nominal period of the chain's topics."""
JOINT_STATE_TYPE = "sensor_msgs/msg/JointState"
TEMPERATURE_TYPE = "sensor_msgs/msg/Temperature"
VALUES_TYPE = "std_msgs/msg/Float64MultiArray"
TEXT_TYPE = "std_msgs/msg/String"
TRAJECTORY_TYPE = "trajectory_msgs/msg/JointTrajectory"
DIAGNOSTICS_TYPE = "diagnostic_msgs/msg/DiagnosticArray"
CONNECTING, WARMING, ARMED, DRIVES_STOPPED = DRIVE_STATES = ("CONNECTING", "WARMING", "ARMED", "STOPPED")
"""What `drive_state` says: no command came yet; commands come, but not in time often enough in a row; they are obeyed;
the drives hold a latched stop."""
HEADER_FIRST = frozenset({JOINT_STATE_TYPE, TEMPERATURE_TYPE, TRAJECTORY_TYPE, DIAGNOSTICS_TYPE})
"""Types whose messages begin with a header."""

Place = tuple[str, str]
"""A topic and one of its arrays, `("encoder", "position")`."""


@dataclass(frozen=True)
class Topic:
    """One topic: ROS type, nominal period (0: on demand), what it carries, and which numbers its arrays hold.

    `quantities` and `signals` are by array of the message (`position`, `velocity`, `effort`, `temperature`). `held`: a
    value stays until the next stamp, as a command does; else it was measured at its stamp. `acts_later`: samples
    between stamp and effect. `latched`: late subscribers get the last message. `event`: published when something
    happens, so no rate is expected.
    """

    name: str
    type_name: str
    period_ns: int
    meaning: str
    quantities: Mapping[str, str] = field(default_factory=dict)
    signals: Mapping[str, str] = field(default_factory=dict)
    held: bool = False
    acts_later: int = 0
    latched: bool = False
    event: bool = False

    @property
    def fields(self) -> tuple[str, ...]:
        """The arrays that a JointState topic carries; empty for other types."""
        return tuple(self.quantities) if self.type_name == JOINT_STATE_TYPE else ()


def _joints(
    name: str, meaning: str, quantities: Mapping[str, str], signals: Mapping[str, str] | None = None, **more: int
) -> Topic:
    held, acts_later = bool(more.get("held", 0)), more.get("acts_later", 0)
    return Topic(name, JOINT_STATE_TYPE, TICK_NS, meaning, quantities, signals or {}, held, acts_later)


TOPICS: dict[str, Topic] = {
    topic.name: topic
    for topic in (
        _joints(
            ENCODER,
            "rotor angle, multi-turn, quantised [rad]",
            {"position": "motor_shaft_position"},
            {"position": "motor_shaft_position"},
        ),
        _joints(
            RESOLVER, "joint angle, quantised [rad]", {"position": "joint_position"}, {"position": "joint_position"}
        ),
        _joints(
            GAUGE,
            "torque that the bridge indicates, uncorrected [N·m]",
            {"effort": "gauge_torque"},
            {"effort": "gauge_torque"},
        ),
        _joints(
            APPLIED,
            "motor torque × gear ratio that the drive applied [N·m]",
            {"effort": "motor_torque"},
            {"effort": "motor_torque"},
            held=True,
        ),
        Topic(
            TEMPERATURE,
            TEMPERATURE_TYPE,
            100_000_000,
            "frame_id = joint name [°C]",
            {"temperature": "motor_temperature"},
            {"temperature": "temperature"},
        ),
        _joints(
            JOINT_STATES,
            "joint angle, velocity, flexspline torque",
            {"position": "joint_position", "velocity": "joint_velocity", "effort": "joint_torque"},
            {"position": "joint_position", "velocity": "joint_velocity", "effort": "gauge_torque"},
        ),
        _joints(
            MOTOR_STATES,
            "rotor angle / ratio, velocity, motor torque",
            {"position": "motor_position", "velocity": "motor_velocity", "effort": "motor_torque"},
        ),
        Topic(GOAL, TRAJECTORY_TYPE, 0, "goal", event=True),
        _joints(
            REFERENCE,
            "desired joint angle and velocity",
            {"position": "desired_position", "velocity": "desired_velocity"},
            {"position": "reference_position", "velocity": "reference_velocity"},
        ),
        _joints(REQUIRED, "torque wanted by the motion law [N·m]", {"effort": "joint_torque_required"}),
        _joints(
            COMMAND,
            "motor torque after the safety gate [N·m]",
            {"effort": "motor_torque"},
            {"effort": "motor_torque"},
            held=True,
            acts_later=1,
        ),
        Topic(MODE, TEXT_TYPE, 0, "node and mode of a torque law, on every change", latched=True, event=True),
        Topic(DRIVES, TEXT_TYPE, 0, "what the drives do with commands, on every change", latched=True, event=True),
        Topic(DESCRIPTION, TEXT_TYPE, 0, "URDF", latched=True, event=True),
        Topic(DIAGNOSTICS, DIAGNOSTICS_TYPE, 0, "loop statistics, faults, adaptation state", event=True),
    )
}


def fields(topic: str) -> tuple[str, ...]:
    """The arrays that a JointState topic of the chain carries."""
    return TOPICS[topic].fields


def quantities(*names: str) -> dict[str, Place]:
    """Every quantity that these topics carry, with its place; of two topics with the same quantity the first counts."""
    found: dict[str, Place] = {}
    for name in names:
        for array, quantity in TOPICS[name].quantities.items():
            found.setdefault(quantity, (name, array))
    return found


def signal_places() -> dict[str, tuple[Place, ...]]:
    """Every signal of the workbench with the places that may carry it, the most direct one first."""
    found: dict[str, tuple[Place, ...]] = {}
    for topic in TOPICS.values():
        for array, signal in topic.signals.items():
            found[signal] = (*found.get(signal, ()), (topic.name, array))
    return found


def base_name(topic: str) -> str:
    """The topic without namespace, `encoder` for `/arm/encoder`; introspection topics keep `<node>/introspection/…`."""
    parts = topic.strip("/").split("/")
    return "/".join(parts[-3:]) if "introspection" in parts[-3:-1] else parts[-1]


def topic_info(topic: str) -> Topic | None:
    """What is known of a topic, in any namespace; None for a foreign one."""
    name = base_name(topic)
    if name.endswith("/introspection/names"):
        return Topic(name, TEXT_TYPE, 0, "names of the values, one a line", latched=True, event=True)
    if name.endswith("/introspection/values"):
        return Topic(name, VALUES_TYPE, 0, "every term of the law")
    return TOPICS.get(name)
