"""How well an effect could be seen: the gain, in nats, of somebody who knows everything but the effect's size.

The linear core of the joint (rotor, spring and damper, link) with the world's own noise levels has a Kalman filter;
what an effect contributes - a torque on rotor or link, an angle in the gear, an error of a sensor - passes through it
and arrives as a signal in white innovations. Half of its energy, after everything that a wrong value of the data sheet
or another hidden effect could explain is projected out, is the log-likelihood that the true effect gains:

    s+ = (A - L C) s + (B - L D) f,   e = C s + D f,   gain = 1/2 min_b |S^-1/2 (e - sum b_i e_i)|^2

Source: docs/equations/innovations.md (K1); Ljung, System Identification (1999), ch. 4 and 7.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from scipy.linalg import expm, solve_discrete_are

from hd_control.core.arrays import FloatArray
from hd_sim import _second_world
from hd_sim.second_world.plant import PERIOD, Plant

ROTOR, LINK, GEAR, ENCODER, RESOLVER, BRIDGE = "rotor", "link", "gear", "encoder", "resolver", "bridge"
KINDS = (ROTOR, LINK, GEAR, ENCODER, RESOLVER, BRIDGE)
"""Where a contribution acts: torque N m that resists rotor or link; angle rad in the gear; error of a reading."""
Columns = Mapping[str, FloatArray]
QUIET = 3e-5
"""Torque on the link that nobody knows, at least; share of rated torque."""


@dataclass(frozen=True)
class Filter:
    """Error dynamics (4, 4) of the predictor, gain of each kind of contribution into them (kinds, 4), and of states and
    contributions into whitened innovations: (3, 4), (kinds, 3)."""

    dynamics: FloatArray
    into: FloatArray
    out: FloatArray
    direct: FloatArray

    def innovations(self, columns: Columns) -> FloatArray:
        """Whitened innovations (3 n,) of contributions given by kind, each (n,)."""
        rows = [(KINDS.index(kind), column) for kind, column in columns.items()]
        parts = [
            _second_world.filtered(self.dynamics, self.into[row], self.out, self.direct[row], column)
            for row, column in rows
        ]
        total: FloatArray = np.sum(parts, axis=0).ravel()
        return total


def core(plant: Plant, truths: Columns) -> tuple[FloatArray, FloatArray, FloatArray, FloatArray, FloatArray]:
    """The linear part of the joint, sample by sample, and its noise: A (4, 4), B (4, 3) of torques on rotor and link
    and of the angle in the gear, C (3, 4), covariances of the state's noise (4, 4) and of the readings (3, 3).

    State: rotor angle and speed, joint angle and speed; readings: rotor angle, joint angle, torque.
    """
    v = plant.values
    inertia = v["link_inertia"] + v["payload_inertia"]
    k, d, rotor = v["stiffness_2"], v["torsional_damping"], v["rotor_inertia"]
    rates = np.array(
        [
            [0.0, 1.0, 0.0, 0.0],
            [-k / rotor, -d / rotor, k / rotor, d / rotor],
            [0.0, 0.0, 0.0, 1.0],
            [k / inertia, d / inertia, -k / inertia, -d / inertia],
        ]
    )
    forces = np.zeros((4, 3))
    forces[1, 0], forces[3, 1] = -1.0 / rotor, -1.0 / inertia
    forces[1, 2], forces[3, 2] = -k / rotor, k / inertia
    both = np.zeros((7, 7))
    both[:4, :4], both[:4, 4:] = rates, forces
    step = expm(both * PERIOD)
    a, b = step[:4, :4], step[:4, 4:]
    c = np.array([[1.0, 0.0, 0.0, 0.0], [0.0, 0.0, 1.0, 0.0], [k, d, -k, -d]])
    q = (b[:, :2] * _process(plant, truths)) @ b[:, :2].T
    return a, b, c, q, np.diag(_reading(plant, truths))


def make_filter(plant: Plant, truths: Columns) -> Filter:
    """The predictor of a joint whose noise is known."""
    a, b, c, q, r = core(plant, truths)
    p = solve_discrete_are(a.T, c.T, q, r)
    s = c @ p @ c.T + r
    gain = a @ p @ c.T @ np.linalg.inv(s)
    white = np.linalg.inv(np.linalg.cholesky(s))
    direct = np.zeros((len(KINDS), 3))
    direct[2, 2] = c[2, 0]
    direct[3:] = np.eye(3)
    into = np.hstack([b, np.zeros((4, 3))]).T - direct @ gain.T
    return Filter(a - gain @ c, into, white @ c, direct @ white.T)


def _process(plant: Plant, truths: Columns) -> FloatArray:
    """Variances of the torque on rotor and link that no signal reports, N^2 m^2 per sample."""
    v = plant.values
    sampled = 0.1 * np.std(np.diff(truths["set_point"], 3)) if v["torque_at_stamp"] else 0.0
    link = v["link_disturbance"] ** 2 + (QUIET * v["rated_torque"]) ** 2
    said = v["torque_noise"] ** 2 + v["torque_step"] ** 2 / 12.0
    return np.array([said + v["torque_disturbance"] ** 2 + sampled**2, link])


def _reading(plant: Plant, truths: Columns) -> FloatArray:
    """Variances of encoder, resolver and bridge: noise, resolution, and jitter times the signal's rate."""
    v, ratio = plant.values, plant.values["gear_ratio"]
    speed = v["jitter"] * np.sqrt(np.mean(truths["motor_velocity"] ** 2))
    rate = v["jitter"] * np.sqrt(np.mean(np.diff(truths["joint_torque"]) ** 2)) / PERIOD
    encoder = (v["encoder_noise"] ** 2 + v["encoder_step"] ** 2 / 12.0) / ratio**2 + speed**2
    resolver = v["resolver_noise"] ** 2 + v["resolver_step"] ** 2 / 12.0 + speed**2
    return np.array([encoder, resolver, v["gauge_noise"] ** 2 + v["gauge_step"] ** 2 / 12.0 + rate**2])


# ---- What is between two joints at the same states -------------------------------------------------


def contributions(plant: Plant, without: Plant, truths: Columns) -> dict[str, FloatArray]:
    """What `plant` has at its true states and `without` would not: columns (n,) by kind; only those that differ."""
    parts = [_friction(plant, without, truths), _motor(plant, without, truths), _gear(plant, without, truths)]
    parts += [_link(plant, without, truths), _readings(plant, without, truths)]
    found: dict[str, FloatArray] = {}
    for part in parts:
        for kind, column in part.items():
            if np.any(column):
                found[kind] = found[kind] + column if kind in found else column
    return found


def _time(truths: Columns) -> FloatArray:
    time: FloatArray = np.arange(truths["joint_position"].size, dtype=np.float64) * PERIOD
    return time


def _friction(plant: Plant, without: Plant, t: Columns) -> dict[str, FloatArray]:
    states = (t["motor_velocity"], t["joint_torque"], t["joint_position"], t["temperature"], _time(t))
    (slide, fluid), (slide_0, fluid_0) = (_second_world.friction(p.array(), *states) for p in (plant, without))
    v = plant.values
    bristle = v["coulomb"] / v["bristle_travel"] * t["bristle"]
    column = bristle * (1.0 - slide_0 / slide) + fluid - fluid_0
    if v["bristle_travel"] != without.values["bristle_travel"]:
        column = column + bristle - slide_0 * np.sign(t["motor_velocity"])
    return {ROTOR: column}


def _motor(plant: Plant, without: Plant, t: Columns) -> dict[str, FloatArray]:
    torque, torque_0 = _air_gap(plant.values, t), _air_gap(without.values, t)
    return {ROTOR: torque_0 - torque}


def _air_gap(v: Mapping[str, float], t: Columns) -> FloatArray:
    """Torque on the rotor, N m, after delay and lag, with ripple and cogging."""
    late = v["transport_delay"] + v["torque_late"] + (0.0 if v["torque_at_stamp"] else v["current_lag"])
    time, theta = _time(t), v["gear_ratio"] * t["motor_position"]
    current = np.interp(time - late, time, t["set_point"]) if late else t["set_point"]
    torque = current * (1.0 + v["torque_constant_error"]) * (1.0 - v["saturation"] * (current / v["torque_limit"]) ** 2)
    torque = torque * (1.0 + v["ripple_share"] * np.sin(v["ripple_order"] * theta + v["ripple_phase"]))
    angle = v["cogging_order"] * theta + v["cogging_phase"]
    total: FloatArray = torque + v["cogging"] * (np.sin(angle) + v["cogging_second"] * np.sin(2.0 * angle))
    return total


def _gear(plant: Plant, without: Plant, t: Columns) -> dict[str, FloatArray]:
    """Angle in the gear: kinematic error, and torque of spring and hysteresis over the stiffness."""
    v, v_0 = plant.values, without.values
    error, slope = _kinematic(v, t)
    error_0, slope_0 = _kinematic(v_0, t)
    wound = t["torsion"]
    torque = _second_world.elastic(plant.array(), wound) + v["hysteresis_torque"] * t["bouc_wen"]
    torque_0 = _second_world.elastic(without.array(), wound) + v_0["hysteresis_torque"] * t["bouc_wen"]
    angle = error - error_0 + (torque - torque_0) / v["stiffness_2"]
    return {GEAR: angle, ROTOR: t["joint_torque"] * (slope - slope_0)}


def _kinematic(v: Mapping[str, float], t: Columns) -> tuple[FloatArray, FloatArray]:
    """Error rad in the gear and its slope over the rotor angle, output side."""
    theta = v["gear_ratio"] * t["motor_position"]
    error, slope = np.zeros(theta.size), np.zeros(theta.size)
    for n in (1, 2, 4):
        a, b = v[f"kinematic_cosine_{n}"], v[f"kinematic_sine_{n}"]
        error += a * np.cos(n * theta) + b * np.sin(n * theta)
        slope += n * (b * np.cos(n * theta) - a * np.sin(n * theta))
    load = 1.0 + v["kinematic_load"] * t["joint_torque"] / v["rated_torque"]
    r = (t["joint_position"] - v["tooth_angle"]) / v["tooth_width"]
    return error * load + v["tooth_height"] * np.exp(-0.5 * r**2), v["gear_ratio"] * slope * load


def _link(plant: Plant, without: Plant, t: Columns) -> dict[str, FloatArray]:
    return {LINK: _load(plant, t) - _load(without, t)}


def _load(plant: Plant, t: Columns) -> FloatArray:
    """Torque N m that resists the link beyond its data sheet."""
    v, q, rate, time = plant.values, t["joint_position"], t["joint_velocity"], _time(t)
    total = v["payload_gravity"] * np.sin(q - v["payload_angle"])
    total = total + v["payload_inertia"] * np.gradient(rate, PERIOD) + v["link_viscous"] * rate
    total = total + v["link_coulomb"] * np.tanh(rate / 0.002)
    total = total + v["cable_torque"] * np.tanh((q - v["cable_angle"]) / v["cable_width"])
    soft = v["swinging_share"] * (v["link_inertia"] + v["payload_inertia"])
    total = total + soft * np.gradient(t["swing_velocity"], PERIOD)
    touched = np.zeros(q.size, dtype=bool)
    for start, end in plant.windows:
        touched |= (time >= start) & (time < end)
    column: FloatArray = total + v["contact_torque"] * np.tanh(rate / 0.005) * touched
    return column


def _readings(plant: Plant, without: Plant, t: Columns) -> dict[str, FloatArray]:
    one, other = _errors(plant.values, t), _errors(without.values, t)
    return {kind: one[kind] - other[kind] for kind in one}


def _errors(v: Mapping[str, float], t: Columns) -> dict[str, FloatArray]:
    """Errors of the three readings."""
    q, torque = t["joint_position"], t["joint_torque"]
    a = q - v["eccentricity_angle"]
    disc = np.arctan2(v["eccentricity"] * np.sin(a), 1.0 + v["eccentricity"] * np.cos(a))
    disc = disc + v["ellipticity"] * np.sin(2.0 * (q - v["ellipticity_angle"]))
    beta = v["gear_ratio"] * t["motor_position"] - v["gauge_turns"] * q
    bridge = v["gauge_gain"] * torque + v["gauge_offset"]
    bridge = bridge + v["gauge_drift"] * (t["temperature"] - v["ambient_temperature"])
    for n in (2, 4):
        bridge = bridge + v[f"gauge_cosine_{n}"] * np.cos(n * beta) + v[f"gauge_sine_{n}"] * np.sin(n * beta)
    return {
        ENCODER: -v["encoder_late"] * t["motor_velocity"],
        RESOLVER: disc - v["resolver_late"] * t["joint_velocity"],
        BRIDGE: bridge - v["gauge_late"] * np.gradient(torque, PERIOD),
    }


# ---- The gain --------------------------------------------------------------------------------------


def data_sheet_columns(plant: Plant, t: Columns) -> list[Columns]:
    """What wrong values of the data sheet contribute; always estimated, never news."""
    v, torque, rate = plant.values, t["joint_torque"], np.gradient(t["joint_torque"], PERIOD)
    bristle = v["coulomb"] / v["bristle_travel"] * t["bristle"]
    ones = np.ones(torque.size)
    return [
        {ROTOR: np.gradient(t["motor_velocity"], PERIOD)},
        {ROTOR: bristle / v["coulomb"]},
        {ROTOR: t["motor_velocity"]},
        {LINK: np.gradient(t["joint_velocity"], PERIOD)},
        {GEAR: torque / v["stiffness_2"]},
        {GEAR: rate / v["stiffness_2"]},
        {RESOLVER: ones},
        {RESOLVER: t["joint_velocity"]},
        {BRIDGE: rate},
    ]


def oracle_gain(predictor: Filter, effect: Columns, others: list[Columns]) -> float:
    """nats that the effect of known shape gains beside the others, whose sizes are free."""
    if not effect:
        return 0.0
    signal = predictor.innovations(effect)
    known = [predictor.innovations(column) for column in others if column]
    if known:
        matrix = np.column_stack([column / (np.linalg.norm(column) or 1.0) for column in known])
        basis, _ = np.linalg.qr(matrix)
        signal = signal - basis @ (basis.T @ signal)
    return 0.5 * float(signal @ signal)
