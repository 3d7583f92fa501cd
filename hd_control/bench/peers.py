"""Peers of the compiled plant for `hd bench`: callables that advance one simulated millisecond.

They are the same arm at the same substep, not the same physics in every detail; the docstrings say what each one does.
`SlowPlant` is also the plain form against which the tests check the compiled kernel.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from hd_control.core.arrays import FloatArray
from hd_control.core.errors import ConfigError
from hd_sim.plant import Plant
from hd_sim.plant_config import PlantConfig

# ---- The basic drive once more, slow and plain: numpy arrays and Pinocchio's forward dynamics ------
#
# It shares no code with the compiled kernel and is used to check it and as its peer in benchmarks. Covered: set-valued
# Coulomb friction with offset, load, Stribeck and viscous terms, kinematic error, polynomial spring, exact hysteresis,
# damping, current loop, torque limit. Letters as in Zhu (1)-(4) and Gandhi-Ghorbel (2)-(6): phi, v rotor; q, w link;
# Y slope of the transmission; G Coulomb magnitude; h hysteresis torque; c_t stiffening of the implicit step.


ORDERS = np.arange(1.0, 5.0)
STATE = ("motor_position", "motor_velocity", "joint_position", "joint_velocity", "torsion", "hysteresis_torque",
         "motor_acceleration", "joint_acceleration", "current_torque")  # fmt: skip


class SlowPlant:
    """The plant of a configuration; start it with `set_state`, advance it with `step`."""

    def __init__(self, config: PlantConfig) -> None:
        import pinocchio

        self.aba = pinocchio.aba
        self.model: Any = config.robot.pinocchio_model()
        self.data: Any = self.model.createData()
        self.p = config.drives
        self.substeps, self.dt = config.substeps, config.period / config.substeps
        self.first_order = config.scheme == "first_order"
        lag = self.p["current_time_constant"]
        self.blend = np.where(lag > 0.0, 1.0 - np.exp(-self.dt / np.maximum(lag, 1e-12)), 1.0)
        self.s: dict[str, FloatArray] = {name: np.zeros(config.joints) for name in STATE}

    def set_state(self, **state: ArrayLike) -> None:
        """Sets any of the state arrays, each (n,)."""
        for name, value in state.items():
            self.s[name] = np.array(value, dtype=float)

    def step(self, command: ArrayLike) -> None:
        """One tick with the motor torque (n,) N m held."""
        limit = self.p["torque_limit"]
        u = np.clip(np.asarray(command, dtype=float), -limit, limit)
        for _ in range(self.substeps):
            self.s["current_torque"] = self.s["current_torque"] + (u - self.s["current_torque"]) * self.blend
            self._substep(self.s["current_torque"])

    def _midpoint(self) -> tuple[FloatArray, ...]:
        """Steps 1 to 3: Y, torsion, hysteresis, tau_0, c_t, q at the midpoint."""
        p, s, dt = self.p, self.s, self.dt
        phi = s["motor_position"] + dt / 2 * s["motor_velocity"]
        q = s["joint_position"] + dt / 2 * s["joint_velocity"]
        angle = np.outer(p["gear_ratio"] * phi, ORDERS)
        a, b = p["kinematic_cosine"], p["kinematic_sine"]
        kinematic = (a * np.cos(angle) + b * np.sin(angle)).sum(1)
        Y = 1 + p["gear_ratio"] * (ORDERS * (b * np.cos(angle) - a * np.sin(angle))).sum(1)
        delta = phi + kinematic - q
        D = delta - s["torsion"]
        sign = np.where(D >= 0, 1.0, -1.0)
        A, alpha = p["hysteresis_stiffness"], p["hysteresis_rate"]
        saturated = sign * np.divide(A, alpha, out=np.zeros_like(A), where=alpha > 0)
        h = saturated + (s["hysteresis_torque"] - saturated) * np.exp(-alpha * np.abs(D))
        m1, m2, m3, k_d = p["stiffness_linear"], p["stiffness_cubic"], p["stiffness_quintic"], p["torsional_damping"]
        spring = m1 * delta + m2 * delta**3 + m3 * delta**5
        k_t = m1 + 3 * m2 * delta**2 + 5 * m3 * delta**4 + A - alpha * sign * h
        tau_0 = spring + h + k_d * (Y * s["motor_velocity"] - s["joint_velocity"])
        return Y, delta, h, tau_0, dt * k_t / 4 + k_d / 2, q

    def _substep(self, u: FloatArray) -> None:
        p, s, dt = self.p, self.s, self.dt
        Y, delta, h, tau_0, c_t, q_m = self._midpoint()
        v, w, v_a, w_a = s["motor_velocity"], s["joint_velocity"], s["motor_acceleration"], s["joint_acceleration"]
        v_h, tau_h, w_m = v, tau_0, w
        if not self.first_order:
            v_h = v + dt / 2 * v_a
            v_h = np.where(v_h * v < 0, 0.0, v_h)
            tau_h = tau_0 + c_t * dt * (Y * v_a - w_a)
            w_m = w + dt / 2 * w_a
        stribeck = 1 + (p["stribeck_ratio"] - 1) * np.exp(-((v_h / np.maximum(p["stribeck_velocity"], 1e-12)) ** 2))
        load = 1 + p["load_friction_linear"] * np.abs(tau_h) + p["load_friction_quadratic"] * tau_h**2
        grip = dt * p["coulomb_torque"] * load * stribeck
        e_p, e_n = dt * p["viscous_positive"] / 2, dt * p["viscous_negative"] / 2
        I_e = p["rotor_inertia"] + dt * Y**2 * c_t
        R = p["rotor_inertia"] * v + dt * (u - p["friction_offset"] - Y * (tau_0 - c_t * Y * v))

        def classify(acceleration: FloatArray) -> tuple[FloatArray, NDArray[np.int64], FloatArray]:
            b = R + dt * Y * c_t * dt * acceleration
            if self.first_order:
                return b, np.where(b > grip, 1, np.where(b < -grip, -1, 0)), np.ones_like(b)
            return b, *_modes(b, v, I_e, grip, e_p, e_n)

        b, mode, cross = classify(w_a)
        for solve in range(4):
            o, n = _line(mode, cross, v, I_e, grip, e_p, e_n, self.first_order)
            slides = mode != 0
            torque = tau_0 + c_t * Y * np.where(slides, (R + o) / n - v, -v)
            armature = dt * c_t * np.where(slides, 1 - dt * Y**2 * c_t / n, 1.0)
            self.model.armature = armature
            acceleration = np.array(self.aba(self.model, self.data, q_m, w_m, torque))
            b, mode_new, cross_new = classify(acceleration)
            moved = (np.abs(mode_new) == 2) & (np.abs(cross_new - cross) > 0.02)
            if solve == 3 or not np.any((mode_new != mode) | moved):
                break
            mode, cross = mode_new, cross_new
        v_end = np.where(mode == 0, 0.0, (b + o) / n)
        self._advance(v, v_end, w, acceleration, mode, cross)
        s["torsion"], s["hysteresis_torque"] = delta, h

    def _advance(
        self, v: FloatArray, v_end: FloatArray, w: FloatArray, acceleration: FloatArray, mode: NDArray[np.int64],
        cross: FloatArray,
    ) -> None:  # fmt: skip
        """Step 8."""
        s, dt = self.s, self.dt
        w_end = w + dt * acceleration
        s["joint_position"] = s["joint_position"] + dt / 2 * (w + w_end)
        crossing, rest = np.abs(mode) == 2, 1 - cross
        path = np.where(mode == 0, cross * v, np.where(crossing, cross * v + rest * v_end, v + v_end))
        late = np.divide(v_end, rest * dt, out=np.zeros_like(v), where=rest > 1e-3)
        steady = np.where(v != 0, (v_end - v) / dt, 0.0)
        s["motor_position"] = s["motor_position"] + dt / 2 * path
        s["motor_acceleration"] = np.where(mode == 0, 0.0, np.where(crossing, late, steady))
        s["motor_velocity"], s["joint_velocity"], s["joint_acceleration"] = v_end, w_end, acceleration


def _modes(
    b: FloatArray, v: FloatArray, I_e: FloatArray, grip: FloatArray, e_p: FloatArray, e_n: FloatArray
) -> tuple[NDArray[np.int64], FloatArray]:
    """Mode of every joint (+-1 slides, 0 sticks or stops, +-2 reverses) and where the velocity crosses zero."""
    up, down = v > 0, v < 0
    b_side = np.where(up, b - grip - e_p * v, b + grip - e_n * v)
    keeps = np.where(up, b_side > 0, b_side < 0)
    divisor = np.where(up | down, I_e * v - b_side, 1.0)
    cross = np.where((up | down) & ~keeps, I_e * v / np.where(divisor == 0, 1.0, divisor), 1.0)
    reverses = np.where(up, b - I_e * v + grip < 0, b - I_e * v - grip > 0)
    direction = np.where(up, 1, -1)
    moving = np.where(keeps, direction, np.where(reverses, -2 * direction, 0))
    resting = np.where(b > grip, 1, np.where(b < -grip, -1, 0))
    return np.where(up | down, moving, resting), cross


def _line(
    mode: NDArray[np.int64], cross: FloatArray, v: FloatArray, I_e: FloatArray, grip: FloatArray, e_p: FloatArray,
    e_n: FloatArray, first_order: bool,
) -> tuple[FloatArray, FloatArray]:  # fmt: skip
    """o and n of v+ = (b + o) / n."""
    up = mode > 0
    if first_order:
        return np.where(up, -grip, grip), I_e + 2 * np.where(up, e_p, e_n)
    turn = grip * (2 * cross - 1)
    slides = (np.where(up, -grip - e_p * v, grip - e_n * v), I_e + np.where(up, e_p, e_n))
    reverses = (
        np.where(up, turn - e_n * v * cross, -turn - e_p * v * cross),
        I_e + np.where(up, e_p, e_n) * (1 - cross),
    )
    crossing = np.abs(mode) == 2
    return np.where(crossing, reverses[0], slides[0]), np.where(crossing, reverses[1], slides[1])


# ---- The peers themselves: compiled, numpy, MuJoCo -------------------------------------------------


Advance = Callable[[], None]


def _moving_torque(config: PlantConfig) -> Callable[[int], Any]:
    """Motor torques that keep all joints moving and reversing: gravity plus 6 times Coulomb friction, 1 Hz, phased."""
    gravity = Plant(config).gravity_torque(config.start_position)
    size, phase = 6.0 * config.drives["coulomb_torque"], np.arange(config.joints)
    return lambda tick: gravity + size * np.sin(2.0 * np.pi * 1e-3 * tick + phase)


def _every_millisecond(config: PlantConfig, step: Callable[[Any], None]) -> Advance:
    torque, ticks = _moving_torque(config), [0]
    table = [torque(k) for k in range(1000)]

    def advance() -> None:
        step(table[ticks[0] % 1000])
        ticks[0] += 1

    return advance


def compiled_plant(config: PlantConfig, substeps_per_ms: int) -> Advance:
    """The kernel of this project, driven through `Plant.step`."""
    config = replace(config, period=1e-3, substeps_per_ms=substeps_per_ms)
    return _every_millisecond(config, Plant(config).step)


def numpy_peer(config: PlantConfig, substeps_per_ms: int) -> Advance:
    """The same scheme in numpy with Pinocchio's forward dynamics; basic drive, no sensors."""
    config = replace(config, period=1e-3, substeps_per_ms=substeps_per_ms)
    plant, start = SlowPlant(config), Plant(config).state
    plant.set_state(**{name: getattr(start, name) for name in plant.s})
    return _every_millisecond(config, plant.step)


def mujoco_peer(config: PlantConfig, substeps_per_ms: int) -> Advance:
    """MuJoCo with two hinges per joint: a rotor (armature, friction loss, damping) and the link on a linear spring.

    Kinematic error, hysteresis, nonlinear stiffness, load and Stribeck friction are left out; implicit-fast integrator,
    contacts off, friction loss through MuJoCo's constraint solver. Raises ConfigError if `mujoco` is not installed.
    """
    try:
        import mujoco
    except ImportError:
        raise ConfigError("the mujoco package is not installed; pip install mujoco") from None
    model = mujoco.MjModel.from_xml_string(arm_as_mjcf(config, 1e-3 / substeps_per_ms))
    data = mujoco.MjData(model)
    data.qpos[::2] = config.start_position

    def step(torque: Any) -> None:
        data.ctrl[:] = torque
        mujoco.mj_step(model, data, nstep=substeps_per_ms)

    return _every_millisecond(config, step)


def _text(values: Any) -> str:
    return " ".join(f"{float(value):.17g}" for value in np.ravel(values))


def arm_as_mjcf(config: PlantConfig, timestep: float) -> str:
    """The arm as MJCF: body j carries the hinges `motor` (rotor) and `link` (torsion of the flexspline)."""
    robot, p = config.robot, config.drives
    opening, closing, actuators = "", "", ""
    for j in range(robot.joints):
        r = robot.rotation[j]
        inertia = robot.inertia[j][[0, 1, 2, 0, 0, 1], [0, 1, 2, 1, 2, 2]]
        opening += (
            f'<body pos="{_text(robot.origin[j])}" xyaxes="{_text(r[:, 0])} {_text(r[:, 1])}">'
            f'<inertial pos="{_text(robot.center_of_mass[j])}" mass="{_text(robot.mass[j])}" '
            f'fullinertia="{_text(inertia)}"/>'
            f'<joint name="motor_{j}" type="hinge" axis="0 0 1" armature="{_text(p["rotor_inertia"][j])}" '
            f'frictionloss="{_text(p["coulomb_torque"][j])}" damping="{_text(p["viscous_positive"][j])}"/>'
            f'<joint name="link_{j}" type="hinge" axis="0 0 1" stiffness="{_text(p["stiffness_linear"][j])}" '
            f'damping="{_text(p["torsional_damping"][j])}"/>'
        )
        closing += "</body>"
        actuators += f'<motor joint="motor_{j}"/>'
    return (
        f'<mujoco><compiler angle="radian"/><option timestep="{timestep:.17g}" integrator="implicitfast" '
        'gravity="0 0 -9.81"><flag contact="disable"/></option>'
        f"<worldbody>{opening}{closing}</worldbody><actuator>{actuators}</actuator></mujoco>"
    )
