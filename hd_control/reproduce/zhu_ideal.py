"""Zhu's theorem 1 and remark 3.1 on an ideal drive under the compiled law, and the link model against Pinocchio.

The drive is the paper's own, (1)-(4): no kinematic error, no hysteresis, no sensors' counts; the law differentiates
without filter (`derivative_pole` 0) in steps of 20 us, so that it is close to the continuous one of the proof. Letters
inside formulas are the paper's; e = phi_d - phi, s = phi_r' - phi'.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any

import numpy as np

from hd_control.control import torque
from hd_control.control.motion_vdc import rigid_torque
from hd_control.core.arrays import FloatArray
from hd_control.core.blocks import Block
from hd_control.core.robot import Robot
from hd_control.reproduce.constants import load_constants
from hd_control.reproduce.zhu_options import STARTS, Case, plant_of, setup_of

UNLIMITED = 1e12
ERRORS = ("velocity_error", "position_error", "rate_error", "torque_error")


@dataclass(frozen=True)
class IdealRun:
    """Samples (k,): time s, V1 J, disturbance N m, and errors by name; `ratios`: left over right side of (15)-(18)."""

    time: FloatArray
    lyapunov: FloatArray
    disturbance: FloatArray
    errors: dict[str, FloatArray]
    ratios: dict[str, float]

    @property
    def rebound(self) -> float:
        """How far V1 ever stood above its lowest value so far, over its first value. 0 in continuous time."""
        return float((self.lyapunov - np.minimum.accumulate(self.lyapunov)).max() / self.lyapunov[0])


def law_of(joint: int, step: float, rate_gain: float | None = None) -> Block:
    """The paper's law of one joint, `literal`, undamped differences. `rate_gain` may break k_f d lambda_tau < 1."""
    values = setup_of(Case(f"single_joint_{joint}", ("slow",))).node_values("torque_node")
    values |= {"compliance_derivative": "literal", "derivative_cutoff": 1.0 / step, "motor_torque_limit": [UNLIMITED]}
    params = torque.configure(values, None, step)
    params.derivative_pole = 0.0
    if rate_gain is not None:
        params.torque_rate_gain = rate_gain
    return params


class IdealDrive:
    """One drive, Zhu (1)-(4), semi-implicit steps; the link moves as it is told."""

    def __init__(self, joint: int, friction: bool) -> None:
        drives = plant_of(Case(f"single_joint_{joint}", ("slow",))).drives
        self.k_f = float(drives["stiffness_linear"][0])
        self.k_d = float(drives["torsional_damping"][0])
        self.inertia = float(drives["rotor_inertia"][0])
        self.theta = [float(drives[name][0]) if friction else 0.0 for name in STARTS]
        self.load = (float(drives["load_friction_linear"][0]), float(drives["load_friction_quadratic"][0]))
        self.phi = self.v = 0.0

    def torque(self, q: float, q_v: float) -> float:
        """tau of (1)."""
        return self.k_f * (self.phi - q) + self.k_d * (self.v - q_v)

    def advance(self, u: float, tau: float, dt: float) -> None:
        """(2) over dt with motor and disturbance torque u."""
        k_c, c, k_vp, k_vn = self.theta
        g = 1.0 + self.load[0] * abs(tau) + self.load[1] * tau * tau
        friction = k_c * g * ((self.v > 0) - (self.v < 0)) + c + (k_vp if self.v > 0 else k_vn) * self.v
        self.v += dt * (u - friction - tau) / self.inertia
        self.phi += dt * self.v


def prescribed(t: float) -> tuple[float, float, float]:
    """q, q', tau_r of the ideal runs."""
    constants = load_constants("zhu")
    (a, w), (b, v, mean) = constants["ideal_motion"], constants["ideal_torque"]
    return a * math.sin(w * t), a * w * math.cos(w * t), b * math.sin(v * t) + mean


def ideal_run(joint: int = 7, step: float | None = None, disturbed: bool = False) -> IdealRun:
    """The law on the ideal drive, from 0.1 rad beside the desired rotor angle, with or without u_d in L2."""
    constants = load_constants("zhu")
    dt = constants["ideal_step"] if step is None else step
    size, fade, pitch = constants["ideal_disturbance"]
    drive, params = IdealDrive(joint, True), law_of(joint, dt)
    state, sample, reference = torque.initial_state(params), torque.new_sample(1), torque.new_reference(1)
    ticks = round(constants["ideal_duration"] / dt)
    rows = np.empty((ticks, 6))
    q, _, tau_r = prescribed(0.0)
    drive.phi = q + tau_r * float(params.torsional_compliance_initial[0]) - 0.1
    for k in range(ticks):
        q, q_v, tau_r = prescribed(k * dt)
        tau = drive.torque(q, q_v)
        sample.joint_position, sample.joint_velocity, sample.joint_torque = q, q_v, tau
        sample.motor_position, sample.motor_velocity = drive.phi, drive.v
        reference.joint_torque_required = tau_r
        output, state = torque.step(params, state, sample, reference, dt)
        u_d = size * math.exp(-k * dt / fade) * math.sin(pitch * k * dt) if disturbed else 0.0
        rows[k] = (u_d, *proof_terms(params, output, drive, (q, q_v, tau_r, tau)))
        drive.advance(float(output.motor_torque[0]) + u_d, tau, dt)
    errors = dict(zip(ERRORS, rows[:, 2:].T, strict=True))
    return IdealRun(dt * np.arange(ticks), rows[:, 1], rows[:, 0], errors, _ratios(params, drive.k_f, rows, dt))


def proof_terms(
    params: Block, output: Block, drive: IdealDrive, now: tuple[float, float, float, float]
) -> tuple[float, ...]:
    """V1 of the proof, and s, e, e', e_tau, from the true state and the estimates of this sample."""
    q, q_v, tau_r, tau = now
    p = {name: float(params.view(name)[0]) for name in _GAINS}
    zeta, y = float(output.torsional_compliance[0]), float(output.desired_torsion[0])
    e, e_v, e_tau = q + y - drive.phi, q_v + (zeta * tau_r - y) / p["damping_time"] - drive.v, tau_r - tau
    s = e_v + p["motor_position_gain"] * e + p["torque_rate_gain"] * e_tau
    stored = 0.5 * drive.inertia * s * s
    k = (1.0 + p["torque_gain"]) * drive.k_f
    stored += 0.5 * k * (1.0 + p["damping_time"] * p["motor_position_gain"]) * e * e
    for name, true in zip(STARTS, drive.theta, strict=True):
        rho = p["adaptation_gain_" + _RHO.get(name, "viscous")]
        stored += (true - float(output.view(name)[0])) ** 2 / (2.0 * rho)
    stored += drive.k_f * (1.0 / drive.k_f - zeta) ** 2 / (2.0 * p["adaptation_gain_compliance"])
    return stored, s, e, e_v, e_tau


_RHO = {"coulomb_torque": "coulomb", "friction_offset": "offset"}
_GAINS = (
    "damping_time", "motor_position_gain", "torque_rate_gain", "motor_velocity_gain", "torque_gain",
    "adaptation_gain_coulomb", "adaptation_gain_offset", "adaptation_gain_viscous", "adaptation_gain_compliance",
)  # fmt: skip


def _ratios(params: Block, k_f: float, rows: FloatArray, dt: float) -> dict[str, float]:
    """Left over right side of (15)-(18)."""
    p = {name: float(params.view(name)[0]) for name in _GAINS}
    power, start = float((rows[:, 0] ** 2).sum() * dt), float(rows[0, 1])
    k_phi, gain = p["motor_velocity_gain"], 1.0 + p["torque_gain"]
    right = {"velocity_error": power / k_phi**2 + 2.0 * start / k_phi}
    weights = (p["motor_position_gain"] * k_f, p["damping_time"] * k_f, p["torque_rate_gain"])
    for name, weight in zip(ERRORS[1:], weights, strict=True):
        right[name] = (power / (2.0 * k_phi) + start) / (gain * weight)
    return {name: float((rows[:, 2 + i] ** 2).sum() * dt / right[name]) for i, name in enumerate(ERRORS)}


def loop_grows(gain: float, joint: int = 7, ticks: int = 3000) -> bool:
    """Whether the algebraic loop of remark 3.1 with gain k_f d lambda_tau grows: no delay, no filter, no friction."""
    dt = load_constants("zhu")["loop_step"]
    drive = IdealDrive(joint, False)
    params = law_of(joint, dt, gain / drive.k_d)
    params.adapt_friction = params.adapt_compliance = 0.0
    state, sample, reference = torque.initial_state(params), torque.new_sample(1), torque.new_reference(1)
    seen = np.empty(ticks)
    drive.phi = -1e-6
    for k in range(ticks):
        sample.joint_torque = tau = drive.torque(0.0, 0.0)
        sample.motor_position, sample.motor_velocity = drive.phi, drive.v
        output, state = torque.step(params, state, sample, reference, dt)
        u = seen[k] = float(output.motor_torque[0])
        drive.advance(u, tau, dt)
        if not abs(u) < 1e9:
            return True
    swing = np.abs(np.diff(seen, 2))
    tenth = ticks // 10
    return bool(swing[-tenth:].max() > swing[tenth : 2 * tenth].max())


def loop_limit(resolution: float = 2e-3) -> float:
    """The largest stable gain of the algebraic loop, by bisection between 0.2 and 5."""
    low, high = 0.2, 5.0
    while high - low > resolution:
        middle = 0.5 * (low + high)
        low, high = (low, middle) if loop_grows(middle) else (middle, high)
    return 0.5 * (low + high)


def regressor_difference(seed: int, states: int = 200) -> float:
    """Largest difference of Zhu (36), (39) from Pinocchio's inverse dynamics, N m: arms A, B and C, random states."""
    import pinocchio

    rng, worst = np.random.default_rng(seed), 0.0
    for name in ("arm_a", "arm_b", "arm_c"):
        robot = Robot.from_file(name)
        model: Any = robot.pinocchio_model()
        data = model.createData()
        q, v, a = rng.uniform(-2.0, 2.0, (3, states, robot.joints))
        ours = rigid_torque(robot, q, v, a)
        theirs = [pinocchio.rnea(model, data, q[i], v[i], a[i]).copy() for i in range(states)]
        worst = max(worst, float(np.abs(ours - np.array(theirs)).max()))
    return worst
