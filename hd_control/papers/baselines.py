"""Laws to compare with, and the settings in which they are reported, so that none is beaten by a bad tuning alone.

The laws themselves are those of `hd_control/laws/motion.py`: `pd`, `pid`, `computed_torque`, `feed_forward`.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any


@dataclass(frozen=True)
class Baseline:
    """A law with factors on its gains."""

    name: str
    law: str
    position: float = 1.0
    velocity: float = 1.0
    integral: float = 1.0

    def values(self, values: Mapping[str, Any]) -> dict[str, Any]:
        """The parameter values of a motion law, changed to this baseline."""
        factors = {"position_gain": self.position, "velocity_gain": self.velocity, "integral_gain": self.integral}
        scaled = {name: [factor * gain for gain in values[name]] for name, factor in factors.items()}
        return {**values, **scaled, "law": self.law}


BASELINES = (
    Baseline("pd", "pd"),
    Baseline("pid", "pid"),
    Baseline("pid_soft", "pid", position=0.7, velocity=0.7, integral=0.5),
    Baseline("computed_torque", "computed_torque"),
    Baseline("computed_torque_half", "computed_torque", position=0.5),
    Baseline("computed_torque_double", "computed_torque", position=2.0),
    Baseline("feed_forward", "feed_forward"),
)
