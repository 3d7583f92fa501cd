"""The worlds of two papers, each in its own signs: a gear joint, a one-link arm, and the gauges on a flexspline.

- `GearJoint`: kinematic error, hysteresis and a load known as a function of time. Gandhi and Ghorbel (8)-(10):
  fourth-order Runge-Kutta, the hysteresis by its exact solution (hd_sim/cpp/gear_joint.hpp). With cubic and quintic
  stiffness it is their full nonlinear model.
- `OneLinkArm`: link free or locked, bristle friction, output side. Hashimoto (15)-(17) (hd_sim/cpp/one_link_arm.hpp).
  The current loop is faster than anything here and left out, as in the paper; command delay belongs to the caller.
- `GaugeBridge`: strain gauges on the diaphragm in a Wheatstone bridge, solved exactly. Hashimoto, section III.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from hd_control.core.arrays import FloatArray
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
    def wind_up(self) -> float:
        """theta of the paper, rad: minus the torsion."""
        return self._joint.wind_up


# ---- One-link arm ----------------------------------------------------------------------------------


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


# ---- Strain gauges ---------------------------------------------------------------------------------
#
# Two gauges at +-45 degrees (R1, R2), a second pair (R3, R4) turned by 90 degrees and its mounting error. The wave
# generator bends each gauge once per half turn; the torque shears the diaphragm. Temperature strains every gauge alike,
# but for a spread between gauges. The bridge is two voltage dividers, not their linearisation.


@dataclass(frozen=True)
class Diaphragm:
    """The radial part of a flexspline: lengths m, shear modulus Pa."""

    thickness: float
    inner_radius: float
    outer_radius: float
    shear_modulus: float

    def gauge_strain(self, torque: float) -> float:
        """Strain of a gauge at 45 degrees under a torque in N m: half the tilt of a radius, by quadrature of (A1)-(A6).

        The shear stress at radius r is torque / (2 pi r^2 t); the twist of a ring is the shear times dr / r.
        """
        count = 20000
        radius = np.linspace(self.inner_radius, self.outer_radius, count + 1)
        middle, width = 0.5 * (radius[1:] + radius[:-1]), np.diff(radius)
        shear = torque / (2.0 * math.pi * middle**2 * self.thickness * self.shear_modulus)
        twist = float(np.sum(shear / middle * width))
        return 0.5 * twist * self.outer_radius / (self.outer_radius - self.inner_radius)


@dataclass(frozen=True)
class GaugeBridge:
    """One bridge. Strains have no unit; angles rad; `apparent_strain` (4,) is the strain per kelvin of each gauge."""

    gauge_factor: float
    resistance: float
    supply_voltage: float
    strain_per_torque: float
    modulation_strain: float
    misalignment: float = 0.0
    fourth_modulation: float = 0.0
    place: float = 0.0
    apparent_strain: tuple[float, float, float, float] = (0.0, 0.0, 0.0, 0.0)

    def pair(self, torque: FloatArray, angle: FloatArray, turned: float) -> tuple[FloatArray, FloatArray]:
        """Strains of two gauges whose pair stands `turned` rad behind the wave generator's `angle`. (1)-(4), (9)."""
        stretch = self.strain_per_torque * torque
        bend = 0.5 * self.modulation_strain * np.sin(2.0 * (angle - turned))
        bend = bend + self.fourth_modulation * np.sin(4.0 * (angle - turned))
        return stretch + bend, -stretch - bend

    def output(self, torque: FloatArray, angle: FloatArray, warming: float = 0.0) -> FloatArray:
        """Voltage between the two dividers, V. `torque` N m and `angle` rad (k,), `warming` K above mounting."""
        torque, angle = np.broadcast_arrays(np.asarray(torque, float), np.asarray(angle, float))
        first = self.pair(torque, angle, self.place)
        second = self.pair(torque, angle, self.place + 0.5 * math.pi + self.misalignment)
        r1, r2, r3, r4 = (
            self.resistance * (1.0 + self.gauge_factor * (strain + warming * apparent))
            for strain, apparent in zip((*first, *second), self.apparent_strain, strict=True)
        )
        return np.asarray(self.supply_voltage * (r1 / (r1 + r2) - r4 / (r3 + r4)))

    def one_pair(self, torque: FloatArray, angle: FloatArray) -> FloatArray:
        """Voltage of the first pair alone in a half bridge with two fixed resistors, V: nothing is cancelled."""
        r1, r2 = (
            self.resistance * (1.0 + self.gauge_factor * strain)
            for strain in self.pair(np.asarray(torque, float), np.asarray(angle, float), self.place)
        )
        return np.asarray(self.supply_voltage * (r1 / (r1 + r2) - 0.5))
