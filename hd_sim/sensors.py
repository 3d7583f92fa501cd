"""Ripple of the gauge bridge and noise keys: what turns data-sheet numbers into the kernel's sensor parameters.

Letters of Hashimoto's paper: beta gauge angle from the long axis of the ellipse, Delta alpha misalignment of the
second gauge pair, Psi_0 strain modulation, eps_R torsional strain at rated torque.
"""

from __future__ import annotations

import hashlib
import math
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


def noise_key(seed: int, stream: str) -> int:
    """Key of one named noise stream: depends on the seed and its own name only, so other streams do not move it."""
    words = np.frombuffer(hashlib.sha256(stream.encode()).digest()[:16], dtype=np.uint32)
    sequence = np.random.SeedSequence(seed, spawn_key=tuple(int(word) for word in words))
    return int(sequence.generate_state(1, np.uint64)[0])
