"""Laws to compare with, and the settings in which they are reported, so that none is beaten by a bad tuning alone.

The laws themselves are in hd_control/cpp/baselines.hpp: `pd`, `pid`, `computed_torque`, `feed_forward`.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from hd_control.control.compensation import DriveValues, motor_feedforward
from hd_control.control.motion_vdc import rigid_torque
from hd_control.core.arrays import FloatArray
from hd_control.core.robot import Robot


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


def inverse_plant(
    robot: Robot,
    drives: Sequence[DriveValues],
    rotor_inertia: ArrayLike,
    position: ArrayLike,
    velocity: ArrayLike,
    acceleration: ArrayLike,
) -> FloatArray:
    """Feed-forward of the drives for wanted motions (k, n): torque to put into `reference.feed_forward_torque`, (k, n).

    It is the motor torque of the inverse drive model less what the law `feed_forward` supplies itself: the rigid arm
    and `rotor_inertia` (n,) times the acceleration; give zeros for a law that supplies no rotor torque. The change of
    the joint torque with time is neglected.
    """
    q, v, a = (np.atleast_2d(np.asarray(x, dtype=float)) for x in (position, velocity, acceleration))
    torque = rigid_torque(robot, q, v, a)
    columns = [
        motor_feedforward(drive, q[:, j], v[:, j], a[:, j], torque[:, j]).motor_torque for j, drive in enumerate(drives)
    ]
    return np.asarray(np.stack(columns, axis=1) - torque - np.asarray(rotor_inertia) * a)
