"""Gandhi and Ghorbel's composite law and plant once more, in their letters and signs, motor side, in plain floats."""

import math

import numpy as np


class Joint:
    """Constants J_m, B_m, J_l, B_l, N, K, A, alpha, K_1, Lambda, k_d, K_D and Fourier coefficients a, b of theta_p."""

    def __init__(self, **constants):
        self.__dict__.update(constants)

    def theta_p(self, m, order=0):
        """theta_p or one of its derivatives with respect to theta_m."""
        n = np.arange(1, len(self.a) + 1)
        # d/dx (a cos nx + b sin nx) turns (a, b) into n (b, -a).
        a, b = np.array(self.a, float), np.array(self.b, float)
        for _ in range(order):
            a, b = n * b, -n * a
        return float(a @ np.cos(n * m) + b @ np.sin(n * m))

    def Y_p(self, m):
        return 1.0 / self.N - self.theta_p(m, 1)

    def theta(self, m, link):
        return link - m / self.N + self.theta_p(m)

    def tau_0(self, m, link, rate, want):
        """(50); `want` is r, r', r'', tau_l."""
        r, r1, r2, load = want
        Y, p2 = self.Y_p(m), self.theta_p(m, 2)
        D = self.J_m / Y**2 + self.J_l
        e, e1 = link - r, rate - r1
        coriolis = self.J_m * p2 * rate / Y**4 + self.B_l
        inside = D * (r2 - self.Lambda * e1) + coriolis * (r1 - self.Lambda * e)
        return Y * (inside - self.k_d * (e1 + self.Lambda * e) + load)

    def h_0(self, m, link, rate, q, want):
        """(49)."""
        Y, p2 = self.Y_p(m), self.theta_p(m, 2)
        J1 = self.J_m / (Y * self.J_l) + Y
        share = self.J_m / (Y * self.J_l)
        inside = share * self.B_l * rate + share * want[3] - self.J_m * p2 / Y**3 * rate**2
        return (inside + self.tau_0(m, link, rate, want)) / J1 + q

    def slow_rates(self, m, link, rate, q, want, h1):
        """Rates of theta_m, theta_l, theta_l' and q on the manifold, where z = h_0 has the rate h1."""
        Y, p2 = self.Y_p(m), self.theta_p(m, 2)
        # The rigid limit (22) under tau_0.
        D = self.J_m / Y**2 + self.J_l
        push = self.tau_0(m, link, rate, want) / Y - want[3] - self.B_l * rate
        accel = (push - self.J_m * p2 / Y**4 * rate**2) / D
        wind = -h1 / self.K
        return np.array([rate / Y, rate, accel, self.A * wind - self.alpha * abs(wind) * q])

    def fast(self, m, m_rate, rate):
        """tau_f of (27)."""
        eps = math.sqrt(self.K_1 / self.K)
        return self.K_D * eps * self.K * (rate - self.Y_p(m) * m_rate)

    def slow(self, m, rate, h1, h2):
        """epsilon tau_1, epsilon^2 tau_2, epsilon^4 tau_4 of (28)-(30)."""
        eps2, Y = self.K_1 / self.K, self.Y_p(m)
        c, C1 = self.J_m * self.theta_p(m, 2) / Y**3, self.K_1 * Y / self.J_m
        one = math.sqrt(eps2) * self.K_D * h1
        two = eps2 * (c * 2.0 * rate / self.K_1 * h1 + h2 / C1)
        return one, two, eps2**2 * c * h1**2 / self.K_1**2

    def plant_rates(self, state, torque, load, spring):
        """(8)-(10): rates of theta_m, its rate, theta_l, its rate, q. `spring(theta)` is f."""
        m, m_rate, link, rate, q = state
        Y = self.Y_p(m)
        H = spring(self.theta(m, link)) + q
        wind = rate - Y * m_rate
        return np.array(
            [
                m_rate,
                (torque + H * Y - self.B_m * m_rate) / self.J_m,
                rate,
                -(H + load + self.B_l * rate) / self.J_l,
                self.A * wind - self.alpha * abs(wind) * q,
            ]
        )
