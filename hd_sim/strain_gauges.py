"""Strain gauges on the diaphragm of a flexspline in a Wheatstone bridge, solved exactly. Hashimoto, section III.

Two gauges at +-45 degrees (R1, R2), a second pair (R3, R4) turned by 90 degrees and its mounting error. The wave
generator bends each gauge once per half turn; the torque shears the diaphragm. Temperature strains every gauge alike,
but for a spread between gauges. The bridge is two voltage dividers, not their linearisation.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from hd_control.core.arrays import FloatArray


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
