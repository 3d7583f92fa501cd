"""Zhu's remarks and theorem: algebraic loop, delay, adaptation inside its bounds, Lyapunov function, link model.

Theorem 1 and remark 3.1 are checked on an ideal drive under the compiled law, the link model against Pinocchio, the
rest in the whole chain.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from hd_control.core.arrays import FloatArray
from hd_control.core.blocks import Block
from hd_control.core.robot import Robot
from hd_control.laws import torque
from hd_control.laws.motion import rigid_torque
from hd_control.papers.rows import Row, load_constants
from hd_control.papers.zhu_options import IMPROVED, OPEN, PLAIN, STARTS, Case, plant_of, setup_of
from hd_control.papers.zhu_runs import Outcome
from hd_control.papers.zhu_table import JOINTS, PAPER, chosen, describe, experiments, geometric_mean, table_cases

# ---- The ideal drive -------------------------------------------------------------------------------
#
# The drive is the paper's own, (1)-(4): no kinematic error, no hysteresis, no sensors' counts; the law differentiates
# without filter (infinite cut-off) in steps of 20 us, so that it is close to the continuous one of the proof.
# Letters inside formulas are the paper's; e = phi_d - phi, s = phi_r' - phi'.


UNLIMITED = 1e12
IDEAL_CASE = Case("single_joint_7", ("slow",))
"""Whose drive and law the ideal runs have."""
LOOP_TICKS, LOOP_RESOLUTION = 3000, 2e-3
RANDOM_STATES = 200
ERRORS = ("velocity_error", "position_error", "rate_error", "torque_error")


@dataclass(frozen=True)
class IdealRun:
    """Samples (k,): time s, V1 J; `ratios`: left over right side of (15)-(18)."""

    time: FloatArray
    lyapunov: FloatArray
    ratios: dict[str, float]

    @property
    def rebound(self) -> float:
        """How far V1 ever stood above its lowest value so far, over its first value. 0 in continuous time."""
        return float((self.lyapunov - np.minimum.accumulate(self.lyapunov)).max() / self.lyapunov[0])


def law_of(step: float, rate_gain: float | None = None) -> Block:
    """The paper's law, `literal`, undamped differences. `rate_gain` may break k_f d lambda_tau < 1."""
    values = setup_of(IDEAL_CASE).node_values("torque_node")
    values |= {"compliance_derivative": "literal", "derivative_cutoff": 1.0 / step, "motor_torque_limit": [UNLIMITED]}
    params = torque.configure(values, None, step)
    params.derivative_cutoff = math.inf
    if rate_gain is not None:
        params.torque_rate_gain = rate_gain
    return params


class IdealDrive:
    """One drive, Zhu (1)-(4), semi-implicit steps; the link moves as given."""

    def __init__(self, friction: bool) -> None:
        drives = plant_of(IDEAL_CASE).drives
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


def ideal_run(disturbed: bool = False) -> IdealRun:
    """The law on the ideal drive, from 0.1 rad beside the desired rotor angle, with or without u_d in L2."""
    constants = load_constants("zhu")
    dt = constants["ideal_step"]
    size, fade, pitch = constants["ideal_disturbance"]
    drive, params = IdealDrive(True), law_of(dt)
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
    return IdealRun(dt * np.arange(ticks), rows[:, 1], _ratios(params, drive.k_f, rows, dt))


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


def loop_grows(gain: float) -> bool:
    """Whether the algebraic loop of remark 3.1 with gain k_f d lambda_tau grows: no delay, no filter, no friction."""
    dt = load_constants("zhu")["loop_step"]
    drive = IdealDrive(False)
    params = law_of(dt, gain / drive.k_d)
    params.adapt_friction = params.adapt_compliance = 0.0
    state, sample, reference = torque.initial_state(params), torque.new_sample(1), torque.new_reference(1)
    seen = np.empty(LOOP_TICKS)
    drive.phi = -1e-6
    for k in range(LOOP_TICKS):
        sample.joint_torque = tau = drive.torque(0.0, 0.0)
        sample.motor_position, sample.motor_velocity = drive.phi, drive.v
        output, state = torque.step(params, state, sample, reference, dt)
        u = seen[k] = float(output.motor_torque[0])
        drive.advance(u, tau, dt)
        if not abs(u) < 1e9:
            return True
    swing = np.abs(np.diff(seen, 2))
    tenth = LOOP_TICKS // 10
    return bool(swing[-tenth:].max() > swing[tenth : 2 * tenth].max())


def loop_limit() -> float:
    """The largest stable gain of the algebraic loop, by bisection between 0.2 and 5."""
    low, high = 0.2, 5.0
    while high - low > LOOP_RESOLUTION:
        middle = 0.5 * (low + high)
        low, high = (low, middle) if loop_grows(middle) else (middle, high)
    return 0.5 * (low + high)


def regressor_difference(seed: int) -> float:
    """Largest difference of Zhu (36), (39) from Pinocchio's inverse dynamics, N m: arms A, B and C, random states."""
    import pinocchio

    rng, worst = np.random.default_rng(seed), 0.0
    for name in ("arm_a", "arm_b", "arm_c"):
        robot = Robot.from_file(name)
        model: Any = robot.pinocchio_model()
        data = model.createData()
        q, v, a = rng.uniform(-2.0, 2.0, (3, RANDOM_STATES, robot.joints))
        ours = rigid_torque(robot, q, v, a)
        theirs = [pinocchio.rnea(model, data, q[i], v[i], a[i]).copy() for i in range(RANDOM_STATES)]
        worst = max(worst, float(np.abs(ours - np.array(theirs)).max()))
    return worst


# ---- The rows --------------------------------------------------------------------------------------


DELAYS = (0, 1, 2, 3, 4)
UNSTABLE = 2.0
"""An error of more than this times the error without delay is a limit cycle."""
LOOP_JOINT = 7
LOOP_GAINS = (0.0052, 0.02, 0.05, 0.1, 0.2, 0.35, 0.5, 0.7, 0.85, 1.0, 1.2, 1.5, 2.0, 3.0, 4.0, 5.0, 6.0, 8.0, 10.0)
"""k_f d lambda_tau; the first is Table II's for joint 7."""
REBOUND, ROUNDING = 1e-5, 1e-11
"""Share of V1(0) that discrete time may add back; difference of the link model in N m at torques up to 1 kN m."""


def _delay_cases(delay: int, seed: int) -> list[Case]:
    return [case for case in table_cases(options=OPEN, seed=seed, delay=delay) if case.motion[1] == 0.5]


def _loop_cases(delay: int, seed: int) -> list[Case]:
    joint, frequency, amplitude, _ = [line for line in experiments() if line[0] == LOOP_JOINT][1]
    drives = plant_of(Case(f"single_joint_{joint}", ("slow",))).drives
    damping = float(drives["torsional_damping"][0])
    return [
        Case(f"single_joint_{joint}", ("sine", frequency, amplitude), OPEN, seed, delay=delay, rate_gain=gain / damping)
        for gain in LOOP_GAINS
    ]


def cases(quick: bool, seeds: Sequence[int]) -> list[Case]:
    """Every run that the rows below need, besides those of the tables."""
    if quick:
        return table_cases(options=PLAIN, seed=seeds[0])
    seed = seeds[0]
    wanted = [case for delay in DELAYS for case in _delay_cases(delay, seed)]
    wanted += [case for delay in DELAYS for case in table_cases(options=(*IMPROVED, *OPEN), seed=seed, delay=delay)]
    wanted += [case for delay in DELAYS[:3] for case in _loop_cases(delay, seed)]
    return wanted + table_cases(options=PLAIN, seed=seed)


def rows(found: Mapping[Case, Outcome], quick: bool, seeds: Sequence[int]) -> list[Row]:
    """All rows of this part; the quick ones need no further runs."""
    seed = seeds[0]
    made = [*adaptation_rows(found, seed), *proof_rows(ideal_run(), ideal_run(disturbed=True)), loop_row()]
    text = f"arms A, B and C, {RANDOM_STATES} random states each, torque against Pinocchio's inverse dynamics"
    difference = regressor_difference(seed)
    made.append(Row("vdc.regressor.vs_rnea", PAPER, "(33)-(39)", "N m", None, difference, ROUNDING, text))
    if quick:
        return made
    for joint in JOINTS:
        made.append(_tolerance_row(found, joint, seed))
    for delay in DELAYS:
        mean = geometric_mean(found, table_cases(options=(*IMPROVED, *OPEN), seed=seed, delay=delay))
        text = f"our error over the paper's, geometric mean of 8; {describe({'options': IMPROVED, 'delay': delay})}"
        place = f"zhu.delay.{delay}.geomean_ratio"
        made.append(Row(place, PAPER, "Table III", "-", 1.0, mean, None, text, chosen=chosen()))
    return made + [_filtered_row(found, delay, seed) for delay in DELAYS[:3]]


def loop_row() -> Row:
    """The limit of remark 3.1 in the setting of the remark."""
    text = "largest stable k_f d lambda_tau by bisection; ideal drive of joint 7, raw difference, no delay, 10 us"
    return Row(
        "zhu.algebraic_loop.limit", PAPER, "Remark 3.1", "-", 1.0, loop_limit(), 1.0, text, better="near",
        tolerance=0.02, chosen=load_constants(PAPER).chosen("loop_step"),
    )  # fmt: skip


def _filtered_row(found: Mapping[Case, Outcome], delay: int, seed: int) -> Row:
    runs = [found[case] for case in _loop_cases(delay, seed)]
    most = float(plant_of(Case(f"single_joint_{LOOP_JOINT}", ("slow",))).drives["torque_limit"][0])
    errors = [float(run.error[0]) if run.torque_step[0] < most else math.inf for run in runs]
    stable = _first_run(errors, UNSTABLE * errors[0])
    text = f"largest k_f d lambda_tau of {LOOP_GAINS[0]:g} ... {LOOP_GAINS[-1]:g} in the search with an error below "
    text += f"{UNSTABLE:g} x that of the first and no torque step of {most:g} N m in a sample; "
    text += f"joint {LOOP_JOINT}, 5 Hz, filter 200 rad/s; {describe({'delay': delay})}"
    place = f"zhu.algebraic_loop.limit.filtered.delay_{delay}"
    ours = LOOP_GAINS[stable] if stable >= 0 else math.nan
    return Row(place, PAPER, "Remark 3.1", "-", None, ours, None, text, chosen=chosen())


def _tolerance_row(found: Mapping[Case, Outcome], joint: int, seed: int) -> Row:
    place = JOINTS.index(joint)
    errors = [float(found[_delay_cases(delay, seed)[place]].error[0]) for delay in DELAYS]
    stable = _first_run(errors, UNSTABLE * errors[0])
    text = f"most samples of delay (0 to {DELAYS[-1]}) with an error below {UNSTABLE:g} x that without; 0.5 Hz, 1 kHz; "
    return Row(
        f"zhu.delay.tolerance.joint_{joint}", PAPER, "section V", "samples", None, float(stable), None,
        text + describe({"options": PLAIN}), chosen=chosen(),
    )  # fmt: skip


def _first_run(values: Sequence[float], limit: float) -> int:
    """Index of the last value before the first one that is above the limit or no number; -1 for none."""
    for index, value in enumerate(values):
        if not value <= limit:
            return index - 1
    return len(values) - 1


def adaptation_rows(found: Mapping[Case, Outcome], seed: int) -> list[Row]:
    """Estimates of the paper's law stay inside their bounds, and how often they stand on one."""
    runs = [found[case] for case in table_cases(options=PLAIN, seed=seed)]
    outside, held = max(run.outside for run in runs), max(run.held for run in runs)
    text = f"5 estimates, every sample of the 8 runs of Table III; {describe({'options': PLAIN})}"
    return [
        Row("zhu.adaptation.outside_bounds", PAPER, "(11), (12)", "-", 0.0, outside, 0.0,
            f"largest excess over the distance of the bounds; {text}", chosen=chosen()),
        Row("zhu.adaptation.at_bound", PAPER, "(11), (12)", "-", None, held, None,
            f"largest share of samples in which an estimate stands on a bound; {text}", chosen=chosen()),
    ]  # fmt: skip


def proof_rows(calm: IdealRun, disturbed: IdealRun) -> list[Row]:
    """V1 falls, and the left sides of (15)-(18) stay below the right ones, with a disturbance in L2."""
    constants = load_constants(PAPER)
    named = constants.chosen("ideal_step", "ideal_duration", "ideal_disturbance", "ideal_motion", "ideal_torque")
    text = (
        f"ideal drive of joint 7, exact rates, {constants['ideal_duration']:g} s in {constants['ideal_step']:g} s steps"
    )
    made = [
        Row("zhu.lyapunov.rebound", PAPER, "Theorem 1", "-", 0.0, calm.rebound, REBOUND,
            f"how far V1 stands above its lowest value so far, over V1(0); {text}; u_d = 0", chosen=named),
        Row("zhu.lyapunov.end", PAPER, "Theorem 1", "-", None, float(calm.lyapunov[-1] / calm.lyapunov[0]), None,
            f"V1 at the end over V1(0); {text}; u_d = 0", chosen=named),
    ]  # fmt: skip
    for number, (name, ratio) in enumerate(disturbed.ratios.items(), 15):
        row = f"left over right side; {text}; u_d in L2"
        made.append(Row(f"zhu.l2.{name}", PAPER, f"({number})", "-", 1.0, ratio, 1.0, row, chosen=named))
    return made
