"""One joint with kinematic error, hysteresis and a load known as a function of time. Gandhi and Ghorbel (8)-(10).

The world of their control simulations, in their own signs: fourth-order Runge-Kutta, the hysteresis by its exact
solution (hd_sim/cpp/gear_joint.hpp). With cubic and quintic stiffness it is their full nonlinear model.
"""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
from numpy.typing import ArrayLike, NDArray

from hd_control.core.blocks import Layout, layout_of
from hd_sim import _single_joints


def gear_joint_layout() -> Layout:
    """Names, units and meanings of the constants of `GearJoint`."""
    return layout_of("GearJointParams", _single_joints.BLOCKS["GearJointParams"], 1)


class GearJoint:
    """The joint at rest at zero. `values` holds every constant of `gear_joint_layout()`, motor side, SI units.

    `measured` is a live view (6,), output side: joint position, velocity and torque, motor position and velocity,
    motor torque; rad, rad/s, N m. It has the fields of the torque law's sample for one joint.
    Raises KeyError for a missing constant, ValueError for a wrong shape.
    """

    def __init__(self, values: Mapping[str, ArrayLike]) -> None:
        block = gear_joint_layout().pack(values)
        self._joint = _single_joints.GearJoint(block.array.tolist(), float(block.gear_ratio))
        self.measured: NDArray[np.float64] = self._joint.measured

    def advance(self, motor_torque: float, dt: float, steps: int = 1) -> None:
        """`steps` Runge-Kutta steps of `dt` s with the motor torque (N m, output side) held."""
        self._joint.advance(motor_torque, dt, steps)

    @property
    def hysteresis_torque(self) -> float:
        """q of the paper, N m."""
        return self._joint.hysteresis

    @property
    def wind_up(self) -> float:
        """theta of the paper, rad: minus the torsion."""
        return self._joint.wind_up
