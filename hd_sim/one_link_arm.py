"""One-link arm with a harmonic drive, link free or locked, bristle friction. Hashimoto (15)-(17).

The world of the torque-control experiments, output side (hd_sim/cpp/one_link_arm.hpp). The current loop is faster than
anything here and left out, as in the paper; command delay belongs to the caller.
"""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
from numpy.typing import ArrayLike, NDArray

from hd_control.core.blocks import Layout, layout_of
from hd_sim import _single_joints


def one_link_layout() -> Layout:
    """Names, units and meanings of the constants of `OneLinkArm`."""
    return layout_of("OneLinkParams", _single_joints.BLOCKS["OneLinkParams"], 1)


class OneLinkArm:
    """The arm at rest at zero. `values` holds every constant of `one_link_layout()`; a link inertia of 0 locks it.

    `measured` is a live view (6,): joint position, velocity and torque, motor position and velocity, motor torque;
    rad, rad/s, N m, output side. Raises KeyError for a missing constant, ValueError for a wrong shape.
    """

    def __init__(self, values: Mapping[str, ArrayLike]) -> None:
        self._arm = _single_joints.OneLinkArm(one_link_layout().pack(values).array.tolist())
        self.measured: NDArray[np.float64] = self._arm.measured

    def advance(self, motor_torque: float, dt: float, steps: int = 1) -> None:
        """`steps` of `dt` s with the motor torque (N m, output side) held."""
        self._arm.advance(motor_torque, dt, steps)

    @property
    def bristle(self) -> float:
        """Deflection of the friction's bristle, rad."""
        return self._arm.bristle
