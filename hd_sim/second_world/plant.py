"""A random joint of the second world: drive, link, sensors, clocks and controller; its data sheet; its recordings."""

from __future__ import annotations

import zlib
from collections.abc import Mapping
from dataclasses import dataclass, replace

import numpy as np

from hd_control.core.arrays import FloatArray
from hd_sim import _second_world
from hd_sim.second_world.motion import Motion, Room

JOINT = "joint_1"
PERIOD = 1.0e-3
"""s between two samples."""
SUBSTEPS = (24, 48, 96, 192)
"""Runge-Kutta steps per millisecond: the first number that resolves the bristles at full speed."""
FASTEST = 1.4
"""rad/s, of all motions."""
GRAVITY = 9.81
COLUMNS = (
    "motor_shaft_position",
    "joint_position",
    "gauge_torque",
    "motor_torque",
    "temperature",
    "reference_position",
)
"""What a recorder gets, in the order of the compiled readings."""
TRUTHS = (
    "motor_position",
    "motor_velocity",
    "joint_position",
    "joint_velocity",
    "joint_torque",
    "friction",
    "motor_torque",
    "torsion",
    "bouc_wen",
    "bristle",
    "swing",
    "swing_velocity",
    "set_point",
    "temperature",
)
"""What only the world knows, at the instant of the tick."""
NEUTRAL = {
    "bristle_damping": 0.0,
    "hysteresis_travel": 1e-4,
    "hysteresis_shape": 0.75,
    "hysteresis_exponent": 1.5,
    "tooth_width": 0.01,
    "stribeck_velocity": 0.1,
    "churning_exponent": 2.0,
    "over_angle_turns": 1.0,
    "friction_step_time": 1e9,
    "cogging_order": 1.0,
    "swinging_frequency": 10.0,
    "swinging_damping": 0.03,
    "link_bristle_travel": 2e-4,
    "cable_width": 0.2,
    "current_lag": 5e-5,
}
"""Values that change nothing while their effect is off; everything else that is not named is 0."""

Window = tuple[float, float]


def stream(seed: int, purpose: str) -> np.random.Generator:
    """A random generator for one purpose of one seed."""
    return np.random.default_rng([2, seed, zlib.crc32(purpose.encode())])


@dataclass(frozen=True)
class Plant:
    """A joint: values by the names of `_second_world.FIELDS`, times in s during which something touches the link, and
    what the user's data sheet says (`nominal`: rotor_inertia, link_inertia, stiffness, damping_time, coulomb, viscous).
    """

    seed: int
    values: Mapping[str, float]
    nominal: Mapping[str, float]
    windows: tuple[Window, ...] = ()

    def with_values(self, values: Mapping[str, float], windows: tuple[Window, ...] | None = None) -> Plant:
        """The same joint with some values changed. Raises KeyError for a name that does not exist."""
        for name in values:
            self.values[name]
        return replace(self, values={**self.values, **values}, windows=self.windows if windows is None else windows)

    def array(self) -> FloatArray:
        """The values in the order of the compiled world."""
        return np.array([self.values[name] for name, _, _ in _second_world.FIELDS])

    def room(self) -> Room:
        """What motions may use."""
        v = self.values
        static = v["gravity_torque"] + v["coulomb"] + 1.2 * v["viscous"]
        acceleration = (v["torque_limit"] - static) / (v["rotor_inertia"] + v["link_inertia"])
        return Room(max(2.0, 0.7 * acceleration), float(stream(self.seed, "middle").uniform(-0.4, 0.4)), PERIOD)

    def urdf(self) -> str:
        """The robot description of the data sheet: gravity as in the world, inertia as the user believes."""
        return _urdf(self.values, self.nominal["link_inertia"])


def draw_plant(seed: int) -> Plant:
    """The joint of a seed without anything hidden in it."""
    rng = stream(seed, "drive")
    rated, stiffness = _log(rng, 4.0, 300.0), _log(rng, 400.0, 1100.0)
    inertia, coulomb = _log(rng, 0.015, 0.09), _log(rng, 0.03, 0.12)
    values = {name: 0.0 for name, _, _ in _second_world.FIELDS} | NEUTRAL
    values |= {
        "gear_ratio": float(rng.choice([50, 80, 100, 120, 160])),
        "rated_torque": rated,
        "torque_limit": rng.uniform(2.2, 3.5) * rated,
        "rotor_inertia": inertia * rated,
        "link_inertia": _log(rng, 0.03, 0.2) * rated,
        "gravity_torque": _log(rng, 0.2, 0.65) * rated,
        "gravity_angle": rng.uniform(-0.6, 0.6) + (np.pi if rng.random() < 0.35 else 0.0),
        **{name: stiffness * rated for name in ("stiffness_1", "stiffness_2", "stiffness_3")},
        "torsional_damping": stiffness * rated * _log(rng, 3e-4, 2e-3),
        "coulomb": coulomb * rated,
        "bristle_travel": _log(rng, 4e-5, 1.5e-4),
        "breakaway_share": rng.uniform(0.5, 0.85),
        "viscous": _log(rng, 0.15, 0.9) * rated,
    }
    static = values["gravity_torque"] + values["coulomb"] + 1.2 * values["viscous"]
    values["torque_limit"] = max(values["torque_limit"], static + 1.2 * rated)
    values["bristle_damping"] = 0.3 * np.sqrt(values["coulomb"] / values["bristle_travel"] * values["rotor_inertia"])
    values |= _electrics(rng, values) | _sensors(rng, values) | _heat(rng, values)
    values = {name: float(value) for name, value in values.items()}
    nominal = _data_sheet(stream(seed, "data sheet"), values)
    return Plant(seed, values | _controller(stream(seed, "controller"), values), nominal)


def _log(rng: np.random.Generator, low: float, high: float) -> float:
    return float(np.exp(rng.uniform(np.log(low), np.log(high))))


def _electrics(rng: np.random.Generator, v: Mapping[str, float]) -> dict[str, float]:
    """Current loop and how its set-point is reported."""
    limit = v["torque_limit"]
    return {
        "current_lag": _log(rng, 3e-5, 1.2e-4),
        "ripple_share": _log(rng, 3e-4, 3e-3),
        "ripple_order": float(rng.choice([18, 24, 30, 36])),
        "ripple_phase": rng.uniform(0.0, 2.0 * np.pi),
        "torque_at_stamp": float(rng.random() < 0.5),
        "torque_noise": _log(rng, 3e-5, 1e-3) * limit,
        "torque_disturbance": _log(rng, 3e-4, 3e-3) * v["rated_torque"],
        "link_disturbance": _log(rng, 3e-4, 3e-3) * v["rated_torque"],
        "torque_step": limit * 2.0 ** -float(rng.integers(11, 16)),
    }


def _sensors(rng: np.random.Generator, v: Mapping[str, float]) -> dict[str, float]:
    """Steps, noise and clocks; in a third of the joints one channel is late."""
    rated, turn = v["rated_torque"], 2.0 * np.pi
    late = dict.fromkeys(("encoder_late", "resolver_late", "gauge_late", "torque_late"), 0.0)
    age, one = _log(rng, 3e-5, 6e-4), str(rng.choice(list(late)))
    if rng.random() < 1.0 / 3.0:
        late[one] = age
    return late | {
        "encoder_step": turn * 2.0 ** -float(rng.integers(12, 17)),
        "encoder_noise": _log(rng, 1e-5, 2e-4),
        "resolver_step": turn * 2.0 ** -float(rng.integers(18, 24)),
        "resolver_noise": _log(rng, 7e-7, 7e-6),
        "gauge_noise": _log(rng, 2e-4, 2.5e-3) * rated,
        "gauge_step": rated * 2.0 ** -float(rng.integers(11, 15)),
        "gauge_cutoff": _log(rng, 500.0, 2000.0),
        "jitter": _log(rng, 1e-6, 3e-5),
        "clock_drift": rng.uniform(-3e-6, 3e-6),
    }


def _heat(rng: np.random.Generator, v: Mapping[str, float]) -> dict[str, float]:
    """One thermal node; some 8 to 20 K in a lively recording."""
    rise, share, rated = rng.uniform(8.0, 20.0), rng.uniform(0.2, 0.7), v["rated_torque"]
    power = (v["coulomb"] + 0.3 * v["viscous"]) * 0.3
    ambient = rng.uniform(17.0, 29.0)
    return {
        "ambient_temperature": ambient,
        "start_temperature": ambient,
        "reference_temperature": ambient + rng.uniform(2.0, 10.0),
        "copper_heating": 2.0 * share * rise / (0.4 * rated) ** 2,
        "friction_heating": 2.0 * (1.0 - share) * rise / power,
        "thermal_time": _log(rng, 20.0, 90.0),
    }


def _data_sheet(rng: np.random.Generator, v: Mapping[str, float]) -> dict[str, float]:
    """What the user believes, with the errors of a data sheet."""
    true = {
        "rotor_inertia": (v["rotor_inertia"], 0.03),
        "link_inertia": (v["link_inertia"], 0.03),
        "stiffness": (v["stiffness_1"], 0.08),
        "damping_time": (v["torsional_damping"] / v["stiffness_1"], 0.3),
        "coulomb": (v["coulomb"], 0.15),
        "viscous": (v["viscous"], 0.15),
    }
    return {name: value * (1.0 + float(rng.uniform(-size, size))) for name, (value, size) in true.items()}


def _controller(rng: np.random.Generator, v: Mapping[str, float]) -> dict[str, float]:
    """A cascade as one tunes it: quiet enough for the encoder, slow enough for the joint's resonance."""
    inertia = v["rotor_inertia"] + v["link_inertia"]
    resonance = np.sqrt(v["stiffness_1"] * (1.0 / v["rotor_inertia"] + 1.0 / v["link_inertia"]))
    cutoff = rng.uniform(350.0, 800.0)
    bandwidth = min(rng.uniform(25.0, 60.0), 0.25 * resonance, 0.35 * cutoff * v["rotor_inertia"] / inertia)
    position = rng.uniform(0.15, 0.3) * bandwidth
    return {
        "position_gain": position,
        "velocity_gain": bandwidth * inertia,
        "integral_gain": rng.uniform(0.1, 0.3) * position * position * bandwidth * inertia,
        "velocity_cutoff": cutoff,
        "feed_gravity": rng.uniform(0.7, 1.0) * v["gravity_torque"],
    }


def _urdf(v: Mapping[str, float], inertia: float) -> str:
    """One joint about a horizontal axis; at angle 0 the link's y axis points down."""
    lever = min(0.5, 0.4 * inertia * GRAVITY / v["gravity_torque"])
    mass = v["gravity_torque"] / (GRAVITY * lever)
    own = inertia - mass * lever**2
    x, y = lever * np.sin(v["gravity_angle"]), lever * np.cos(v["gravity_angle"])
    half = 0.6 * own
    return f"""<?xml version="1.0"?>
<robot name="second_world">
  <link name="base"/>
  <joint name="{JOINT}" type="revolute">
    <parent link="base"/>
    <child link="link_1"/>
    <origin xyz="0 0 0" rpy="{-0.5 * np.pi!r} 0 0"/>
    <axis xyz="0 0 1"/>
    <limit lower="-6.3" upper="6.3" velocity="3.0" effort="{float(v["torque_limit"])!r}"/>
  </joint>
  <link name="link_1">
    <inertial>
      <origin xyz="{float(x)!r} {float(y)!r} 0"/>
      <mass value="{float(mass)!r}"/>
      <inertia ixx="{float(half)!r}" iyy="{float(half)!r}" izz="{float(own)!r}" ixy="0" ixz="0" iyz="0"/>
    </inertial>
  </link>
</robot>
"""


def substeps_of(plant: Plant) -> int:
    """Substeps per sample: a sliding bristle settles at speed over deflection, 1/s, and a step of the Runge-Kutta
    scheme must be shorter than 2 of these times (its limit is 2.78)."""
    v = plant.values
    weakest = (
        (1.0 - abs(v["coulomb_asymmetry"]))
        * (1.0 - abs(v["coulomb_over_angle"]))
        * (1.0 + min(0.0, v["friction_step"]))
    )
    needed = PERIOD * FASTEST / (2.0 * v["bristle_travel"] * max(weakest, 1e-3))
    return next((n for n in SUBSTEPS if n >= needed), SUBSTEPS[-1])


def simulate(
    plant: Plant, motion: Motion, number: int = 0, substeps: int = 0
) -> tuple[dict[str, FloatArray], dict[str, FloatArray]]:
    """Recording `number` of a motion: columns (n,) as `COLUMNS` and `time`, and true columns as `TRUTHS`.

    substeps: per sample, a multiple of 4; 0 for as many as the joint needs.
    """
    count = motion.position.size
    draws = stream(plant.seed, f"noise/{number}").standard_normal((count, _second_world.DRAWS))
    windows = [list(window) for window in plant.windows]
    readings, truths = _second_world.record(
        plant.array(), windows, motion.position, motion.velocity, draws, PERIOD, substeps or substeps_of(plant)
    )
    columns = {name: np.ascontiguousarray(readings[:, i]) for i, name in enumerate(COLUMNS)}
    columns["time"] = np.arange(count, dtype=np.float64) * PERIOD
    columns["temperature"] = _slow(columns["temperature"])
    return columns, {name: np.ascontiguousarray(truths[:, i]) for i, name in enumerate(TRUTHS)}


def _slow(temperature: FloatArray, every: int = 100, step: float = 0.05) -> FloatArray:
    """The temperature as a thermometer reports it: ten times a second, in steps of 0.05 K."""
    ticks = np.arange(temperature.size)
    slow: FloatArray = np.interp(ticks, ticks[::every], step * np.round(temperature[::every] / step))
    return slow
