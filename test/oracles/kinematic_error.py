"""The kinematic error and its slopes once more, straight from Gandhi and Ghorbel (2), in numpy."""

import numpy as np


def kinematic_error(angle, cosine, sine):
    """(KE, KE', KE'') at rotor angle `angle` rad, a float or an array; the slopes are over the rotor angle.

    KE = sum over n = 1 ... of cosine[n-1] cos(n angle) + sine[n-1] sin(n angle), rad at the output; no harmonics: 0.
    """
    angle = np.asarray(angle, dtype=float)
    a, b = np.asarray(cosine, dtype=float), np.asarray(sine, dtype=float)
    n = np.arange(1, len(a) + 1)
    c, s = np.cos(angle[..., None] * n), np.sin(angle[..., None] * n)
    in_phase = a * c + b * s
    return in_phase.sum(-1), (n * (b * c - a * s)).sum(-1), -(n * n * in_phase).sum(-1)
