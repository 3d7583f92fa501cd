"""Fusion of one joint in plain floats: derivative, unwrapping, gauge correction, crossover. No code of the law."""

import math


class Joint:
    """`p`: values of one joint by the public parameter names; `a`: pole of D; `w`: crossover weight of one sample."""

    def __init__(self, p, source, a, w, T):
        self.p, self.source, self.a, self.w, self.T = p, source, a, w, T
        self.raw = {"encoder": None, "resolver": None}
        self.turns = {"encoder": 0, "resolver": 0}
        self.last = {"q": None, "phi": None}
        self.rate = {"q": 0.0, "phi": 0.0}
        self.bias = None

    def continuous(self, name, reading):
        period = self.p[f"{name}_period"]
        if period and self.raw[name] is not None:
            while reading - self.raw[name] + 0.0 >= period / 2 and reading > self.raw[name]:
                self.turns[name] -= 1
                self.raw[name] += period
            while self.raw[name] - reading > period / 2:
                self.turns[name] += 1
                self.raw[name] -= period
        self.raw[name] = reading
        return reading + self.turns[name] * period - self.p[f"{name}_offset"]

    def derivative(self, name, x):
        if self.last[name] is not None:
            self.rate[name] = self.a * self.rate[name] + (1 - self.a) * (x - self.last[name]) / self.T
        self.last[name] = x
        return self.rate[name]

    def step(self, theta, q, gauge, temperature):
        p = self.p
        theta, q = self.continuous("encoder", theta), self.continuous("resolver", q)
        beta = theta - p["gauge_joint_turns"] * q + p["gauge_angle_offset"]
        ripple = sum(
            p[f"gauge_cosine_{n}"] * math.cos(n * beta) + p[f"gauge_sine_{n}"] * math.sin(n * beta) for n in (2, 4)
        )
        drift = 0.0 if math.isnan(temperature) else temperature - p["gauge_reference_temperature"]
        tau = (gauge - p["gauge_offset"] - p["gauge_temperature_drift"] * drift - ripple) / p["gauge_gain"]
        phi = theta / p["gear_ratio"]
        error = sum(
            p[f"kinematic_cosine_{n}"] * math.cos(n * theta) + p[f"kinematic_sine_{n}"] * math.sin(n * theta)
            for n in range(1, 5)
        )
        motor_side = phi + error - tau / p["torsional_stiffness"]
        self.bias = q - motor_side if self.bias is None else self.bias + self.w * (q - motor_side - self.bias)
        if self.source == "complementary":
            q = motor_side + self.bias
        return q, self.derivative("q", q), tau, phi, self.derivative("phi", phi)
