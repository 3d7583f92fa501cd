"""One joint with a harmonic drive in plain floats: bristle friction, hysteresis, kinematic error, pendulum load.

The world of the control tables (chosen constants): semi-implicit Euler at 20 kHz, actuator lag 0.3 ms. Written apart
from the compiled plant, and with another friction law. `PendulumMotion` is Zhu's motion law for such a joint.
"""

import math
from math import cos, exp, sin

SUBSTEPS, LAG, G = 20, 3e-4, 9.81


class BristleJoint:
    """`p`: N, k_f, I, kc, c, kv, g1, g2, J, mgl. Output side; k_vn = 1.1 k_vp; Stribeck 1.2 at 0.005 rad/s."""

    def __init__(self, p):
        self.p = p
        self.hysteresis = 0.03e-3 * p["k_f"]
        self.s0 = p["kc"] / 8e-5
        self.s1 = 0.3 * math.sqrt(self.s0 * p["I"])
        self.phi = self.v = self.w = self.h = self.z = self.u = 0.0
        self.q = self.error(0.0)
        self.torsion = self.phi + self.error(0.0) - self.q

    def error(self, theta):
        return 2.909e-4 * sin(2 * theta) + 5.82e-5 * sin(4 * theta + 1)

    def slope(self, theta):
        """1 + N dKE/dtheta."""
        return 1 + self.p["N"] * (2 * 2.909e-4 * cos(2 * theta) + 4 * 5.82e-5 * cos(4 * theta + 1))

    def torque(self):
        rate = self.slope(self.p["N"] * self.phi) * self.v - self.w
        return self.p["k_f"] * (self.torsion + 1e-3 * rate) + self.h

    def advance(self, command, T):
        p, dt = self.p, T / SUBSTEPS
        for _ in range(SUBSTEPS):
            self.u += (command - self.u) * (1 - exp(-dt / LAG))
            theta = p["N"] * self.phi
            torsion = self.phi + self.error(theta) - self.q
            side = math.copysign(self.hysteresis, torsion - self.torsion)
            self.h = side + (self.h - side) * exp(-4000.0 * abs(torsion - self.torsion))
            self.torsion = torsion
            tau = self.torque()
            force = self.friction(tau, dt)
            self.v += dt * (self.u - force - self.slope(theta) * tau) / p["I"]
            self.w += dt * (tau + p["mgl"] * sin(self.q)) / p["J"]
            self.phi += dt * self.v
            self.q += dt * self.w

    def friction(self, tau, dt):
        p, v, old = self.p, self.v, self.z
        load = 1 + p["g1"] * abs(tau) + p["g2"] * tau * tau
        coulomb = p["kc"] * load * (1 + 0.2 * exp(-((v / 0.005) ** 2)))
        if v != 0.0:
            full = math.copysign(coulomb / self.s0, v)
            self.z = full + (old - full) * exp(-self.s0 * abs(v) * dt / coulomb)
        viscous = p["kv"] * v * (1.0 if v > 0 else 1.1)
        return self.s0 * self.z + self.s1 * (self.z - old) / dt + p["c"] + viscous


class PendulumMotion:
    """tau_r = (m r^2 + I_zz) q_r'' - m r g sin q + k_p e + integral, Zhu (31), (39), (40); link values start at 0.9."""

    def __init__(self, J, mgl, gain, k_p, k_i, limit):
        m = mgl / (G * 0.5)
        true = [m * 0.25, J - m * 0.25, m * 0.5]
        self.true, self.rho = true, [2 * x / true[1] for x in true]
        self.link = [0.9 * x for x in true]
        self.gain, self.k_p, self.k_i, self.limit, self.integral = gain, k_p, k_i, limit, 0.0

    def step(self, q, q_v, qd, qd_v, qd_a, T):
        e = qd_v + self.gain * (qd - q) - q_v
        a = qd_a + self.gain * (qd_v - q_v)
        row = [a, a, -G * sin(q)]
        held = (self.integral <= -self.limit and e <= 0) or (self.integral >= self.limit and e >= 0)
        if not held:
            self.integral = min(max(self.integral + T * self.k_i * e, -self.limit), self.limit)
        torque = sum(x * y for x, y in zip(row, self.link, strict=True)) + self.k_p * e + self.integral
        self.link = [
            min(max(x + T * rho * r * e, 0.5 * t), 1.5 * t)
            for x, rho, r, t in zip(self.link, self.rho, row, self.true, strict=True)
        ]
        return torque


def reference(t, amplitude, frequency):
    """q_d, q_d', q_d'': a sine with an envelope that rises over two periods."""
    length, w = 2 / frequency, 2 * math.pi * frequency
    x = min(t / length, 1.0)
    rise, rise_v = x**3 * (10 - 15 * x + 6 * x * x), (30 * x**2 - 60 * x**3 + 30 * x**4) / length
    rise_a = (60 * x - 180 * x**2 + 120 * x**3) / length**2
    s, c = sin(w * t), cos(w * t)
    velocity = amplitude * (rise_v * s + rise * w * c)
    return amplitude * rise * s, velocity, amplitude * (rise_a * s + 2 * rise_v * w * c - rise * w * w * s)
