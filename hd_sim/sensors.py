"""Gauge bridge on the flexspline and noise keys: what turns data-sheet numbers into the kernel's sensor parameters.

Letters of Hashimoto's paper: beta gauge angle from the long axis of the ellipse, Delta alpha misalignment of the
second gauge pair, Psi_0 strain modulation, eps_R torsional strain at rated torque,
K_gf gauge factor, t, r_1, r_2 thickness and radii of the diaphragm, G shear modulus.
"""

from __future__ import annotations

import hashlib
import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np


@dataclass(frozen=True)
class Ripple:
    """A ripple of the indicated torque, `amplitude * sin(2 beta + phase)`; the amplitude is a share of rated torque."""

    amplitude: float
    phase: float


def misalignment_ripple(misalignment: float, modulation_strain: float, rated_strain: float) -> Ripple:
    """Ripple that a misaligned second gauge pair leaves. Hashimoto (9)-(13).

    misalignment in rad, both strains dimensionless. Amplitude = Psi_0 |sin Delta alpha| / (2 eps_R).
    """
    amplitude = modulation_strain * abs(math.sin(misalignment)) / (2.0 * rated_strain)
    phase = math.atan2(math.sin(2.0 * misalignment), 1.0 - math.cos(2.0 * misalignment))
    return Ripple(amplitude, phase)


def torsional_strain(torque: float, thickness: float, inner: float, outer: float, shear_modulus: float) -> float:
    """Strain of a gauge at 45 degrees for a torque in N m; lengths in m, modulus in Pa. Hashimoto (7)."""
    return torque * (inner + outer) / (8.0 * math.pi * thickness * shear_modulus * inner**2 * outer)


def bridge_gain(gauge_factor: float, supply: float, strain_per_torque: float) -> float:
    """Bridge output in V per N m; supply in V, strain per N m from `torsional_strain(1, ...)`. Hashimoto (8)."""
    return gauge_factor * supply * strain_per_torque


def bridge_output(gauge_factor: float, supply: float, strains: Sequence[float]) -> float:
    """Output in V of an exact four-arm Wheatstone bridge whose arms have resistances R (1 + K_gf strain)."""
    first, second, third, fourth = (1.0 + gauge_factor * strain for strain in strains)
    return supply * (first / (first + second) - fourth / (third + fourth))


def gauge_strains(
    beta: float, strain: float, modulation: float, misalignment: float
) -> tuple[float, float, float, float]:
    """Strains of gauges 1 to 4 for a torsional strain, at gauge angle beta (rad). Hashimoto (3), (9)."""
    ripple_a = 0.5 * modulation * math.sin(2.0 * beta)
    ripple_b = -0.5 * modulation * math.sin(2.0 * (beta - misalignment))
    return strain + ripple_a, -strain - ripple_a, strain + ripple_b, -strain - ripple_b


def noise_key(seed: int, stream: str) -> int:
    """Key of one named noise stream: depends on the seed and its own name only, so other streams do not move it."""
    words = np.frombuffer(hashlib.sha256(stream.encode()).digest()[:16], dtype=np.uint32)
    sequence = np.random.SeedSequence(seed, spawn_key=tuple(int(word) for word in words))
    return int(sequence.generate_state(1, np.uint64)[0])
