"""The strain-gauge bridge on the flexspline once more: four resistors, strains of the diaphragm. Hashimoto (3)-(9).

beta gauge angle from the long axis of the ellipse, misalignment of the second gauge pair, modulation Psi_0; K_gf gauge
factor, t, r_1, r_2 thickness and radii of the diaphragm, G shear modulus.
"""

import math


def torsional_strain(torque, thickness, inner, outer, shear_modulus):
    """Strain of a gauge at 45 degrees for a torque in N m; lengths in m, modulus in Pa. Hashimoto (7)."""
    return torque * (inner + outer) / (8.0 * math.pi * thickness * shear_modulus * inner**2 * outer)


def bridge_gain(gauge_factor, supply, strain_per_torque):
    """Bridge output in V per N m; supply in V, strain per N m from `torsional_strain(1, ...)`. Hashimoto (8)."""
    return gauge_factor * supply * strain_per_torque


def bridge_output(gauge_factor, supply, strains):
    """Output in V of an exact four-arm Wheatstone bridge whose arms have resistances R (1 + K_gf strain)."""
    first, second, third, fourth = (1.0 + gauge_factor * strain for strain in strains)
    return supply * (first / (first + second) - fourth / (third + fourth))


def gauge_strains(beta, strain, modulation, misalignment):
    """Strains of gauges 1 to 4 for a torsional strain, at gauge angle beta (rad). Hashimoto (3), (9)."""
    ripple_a = 0.5 * modulation * math.sin(2.0 * beta)
    ripple_b = -0.5 * modulation * math.sin(2.0 * (beta - misalignment))
    return strain + ripple_a, -strain - ripple_a, strain + ripple_b, -strain - ripple_b
