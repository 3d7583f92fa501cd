"""Strain-gauge bridge on the flexspline: what it indicates, and the way back. Hashimoto (3)-(13).

    indicated = gain tau + offset + drift (temperature - reference) + sum_{n = 2, 4} a_n cos n beta + b_n sin n beta

beta is the angle from the long axis of the wave generator to the gauge, rad. The second harmonic comes from the angle
error between two gauge pairs that should stand at 90 degrees; the fourth is not cancelled by such pairs at all.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any

import numpy as np


@dataclass(frozen=True)
class GaugeModel:
    """Parameters of one bridge. Torques N m, temperature degC, `offset_drift` N m/K, `gain` without unit."""

    gain: float = 1.0
    offset: float = 0.0
    cosine_2: float = 0.0
    sine_2: float = 0.0
    cosine_4: float = 0.0
    sine_4: float = 0.0
    offset_drift: float = 0.0
    reference_temperature: float = 20.0


def ripple(model: GaugeModel, gauge_angle: Any) -> Any:
    """The part of the indicated torque that follows the wave generator, N m; floats or arrays."""
    return (
        model.cosine_2 * np.cos(2.0 * gauge_angle)
        + model.sine_2 * np.sin(2.0 * gauge_angle)
        + model.cosine_4 * np.cos(4.0 * gauge_angle)
        + model.sine_4 * np.sin(4.0 * gauge_angle)
    )


def indicate(model: GaugeModel, torque: Any, gauge_angle: Any, temperature: float = math.nan) -> Any:
    """What the bridge indicates for a joint torque, N m. An unknown temperature (not a number) means no drift."""
    return model.gain * torque + _zero(model, temperature) + ripple(model, gauge_angle)


def correct(model: GaugeModel, indicated: Any, gauge_angle: Any, temperature: float = math.nan) -> Any:
    """The joint torque behind an indicated one, N m; the exact inverse of `indicate`."""
    return (indicated - _zero(model, temperature) - ripple(model, gauge_angle)) / model.gain


def _zero(model: GaugeModel, temperature: float) -> float:
    warm = temperature - model.reference_temperature
    return model.offset + (model.offset_drift * warm if math.isfinite(warm) else 0.0)


def misalignment_ripple(
    misalignment: float, modulation_strain: float, rated_strain: float, rated_torque: float
) -> tuple[float, float]:
    """(cos 2 beta, sin 2 beta) coefficients in N m of two pairs at 90 degrees + `misalignment` rad. Hashimoto (9)-(13).

    `modulation_strain` is Psi_0 of one pair, `rated_strain` the torsional strain at `rated_torque` N m. The ripple is
    E_R rated_torque sin(2 beta + gamma) with E_R = Psi_0 |sin m| / (2 rated_strain) and
    gamma = atan2(sin 2m, 1 - cos 2m).
    """
    size = rated_torque * modulation_strain * abs(math.sin(misalignment)) / (2.0 * rated_strain)
    phase = math.atan2(math.sin(2.0 * misalignment), 1.0 - math.cos(2.0 * misalignment))
    return size * math.sin(phase), size * math.cos(phase)


def bridge_gain(
    gauge_factor: float, supply_voltage: float, thickness: float, inner_radius: float, outer_radius: float, shear: float
) -> float:
    """Output of the bridge per joint torque, V/(N m). Hashimoto (8); lengths m, shear modulus Pa, supply V."""
    both = inner_radius + outer_radius
    return gauge_factor * supply_voltage * both / (8.0 * math.pi * thickness * shear * inner_radius**2 * outer_radius)
