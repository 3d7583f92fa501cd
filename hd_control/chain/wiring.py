"""Which topics feed which law: the chain on one page. What each topic carries is said in `core/topics` alone."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field

from hd_control.core import topics as t


@dataclass(frozen=True)
class Wiring:
    """Sample and reference fields of a law by their source, and the arrays of each topic by output field."""

    name: str
    sample: Mapping[str, t.Place]
    outputs: Mapping[str, Mapping[str, str]]
    reference: Mapping[str, t.Place] = field(default_factory=dict)
    optional: tuple[str, ...] = ()
    """Topics that count only once they have been seen: a foreign node may leave them out."""

    slow: Mapping[str, t.Place] = field(default_factory=dict)
    """Sample fields that are updated now and then and held between."""

    @property
    def inputs(self) -> tuple[str, ...]:
        """Topics in the order in which they arrive, the last one worth waiting for."""
        return tuple(dict.fromkeys(topic for topic, _ in (*self.sample.values(), *self.reference.values())))


def _outputs(*topics: str) -> dict[str, dict[str, str]]:
    return {topic: dict(t.TOPICS[topic].quantities) for topic in topics}


FUSION = Wiring(
    "fusion",
    sample=t.quantities(*t.SENSORS),
    slow=t.quantities(t.TEMPERATURE),
    # The motion law waits for joint_states only, so they go first.
    outputs=_outputs(t.JOINT_STATES, t.MOTOR_STATES),
)
MOTION = Wiring(
    "motion",
    sample={name: place for name, place in t.quantities(t.JOINT_STATES).items() if name != "joint_torque"},
    outputs=_outputs(t.REFERENCE, t.REQUIRED),
)
TORQUE = Wiring(
    "torque",
    sample=t.quantities(t.MOTOR_STATES, t.JOINT_STATES),
    reference=t.quantities(t.REFERENCE, t.REQUIRED),
    outputs=_outputs(t.COMMAND),
    optional=(t.REFERENCE,),
)
