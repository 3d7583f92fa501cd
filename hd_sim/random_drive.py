"""Random single-joint robots: drive, link, sensors and heat from a seed, and what the user's data sheet says of them.

Sizes scale with the rated torque of the gear; ranges are in `config/challenge.yaml`. The world of a random drive has
only what every model has; hidden effects are added by `truth.apply_hidden`.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from functools import lru_cache
from typing import Any

import numpy as np

from hd_control.core.arrays import FloatArray
from hd_control.core.resources import config_path
from hd_control.core.robot import Robot
from hd_control.core.strict_yaml import load_yaml
from hd_sim.plant_config import PlantConfig
from hd_sim.sensors import noise_key
from hd_sim.settings import SETTINGS

GRAVITY = 9.81
JOINT = "joint_1"
SMOOTH_SIGN = 0.01
"""rad/s over which a feed-forward of Coulomb friction changes its sign."""


@lru_cache(maxsize=1)
def ranges() -> Mapping[str, Any]:
    """The ranges of `config/challenge.yaml`."""
    table: Mapping[str, Any] = load_yaml(config_path("challenge.yaml"))
    return table


def stream(seed: int, name: str) -> np.random.Generator:
    """A random generator of its own for each purpose, so that one draw does not move another."""
    return np.random.default_rng(noise_key(seed, f"challenge/{name}"))


@dataclass(frozen=True)
class DriveNumbers:
    """Physical numbers of one joint, output side, SI: either the world's or the user's.

    The gravity torque is `gravity_torque * sin(q - zero_angle)`; the link needs `inertia * acceleration + gravity`.
    """

    gear_ratio: float
    rated_torque: float
    torque_limit: float
    rotor_inertia: float
    link_inertia: float
    gravity_torque: float
    zero_angle: float
    stiffness: float
    damping_time: float
    coulomb_torque: float
    viscous: float
    current_time_constant: float = 0.0

    def gravity(self, position: FloatArray) -> FloatArray:
        """Torque N m that holds the link at joint angles in rad."""
        return self.gravity_torque * np.sin(position - self.zero_angle)

    def joint_torque(self, position: FloatArray, acceleration: FloatArray) -> FloatArray:
        """Torque N m that moves the link."""
        return self.link_inertia * acceleration + self.gravity(position)

    def friction(self, velocity: FloatArray) -> FloatArray:
        """Friction torque N m of the rotor, with a smooth sign."""
        return self.coulomb_torque * np.tanh(velocity / SMOOTH_SIGN) + self.viscous * velocity

    def motor_torque(self, position: FloatArray, velocity: FloatArray, acceleration: FloatArray) -> FloatArray:
        """Motor torque N m of a motion without torsion."""
        moving = self.rotor_inertia * acceleration + self.friction(velocity)
        return self.joint_torque(position, acceleration) + moving


@dataclass(frozen=True)
class RandomDrive:
    """A drawn joint. `true` is the world, `nominal` the user's data sheet.

    `config` is the world without hidden effects; `nominal_urdf` is the robot description that the user has.
    """

    seed: int
    true: DriveNumbers
    nominal: DriveNumbers
    config: PlantConfig
    nominal_urdf: str


def draw_drive(seed: int, attempt: int = 0) -> RandomDrive:
    """A random drive with its link. Deterministic in seed and attempt."""
    table, rng = ranges(), stream(seed, f"drive/{attempt}")
    log = {key: float(np.exp(rng.uniform(*np.log(pair)))) for key, pair in table["drive_log"].items()}
    even = {key: float(rng.uniform(*pair)) for key, pair in table["drive_even"].items()}
    tilt = np.deg2rad(even["axis_tilt_deg"]) if rng.random() < table["tilted_share"] else 0.0
    hanging = rng.random() < table["hanging_share"]
    rated = log["rated_torque"]
    true = DriveNumbers(
        gear_ratio=float(round(log["gear_ratio"])),
        rated_torque=rated,
        torque_limit=even["torque_limit"] * rated,
        rotor_inertia=log["rotor_inertia"] * rated,
        link_inertia=log["link_inertia"] * rated,
        gravity_torque=log["gravity_torque"] * rated * float(np.cos(tilt)),
        zero_angle=float(np.deg2rad(even["center_angle_deg"])) + (0.0 if hanging else np.pi),
        stiffness=log["stiffness"] * rated,
        damping_time=log["damping_time"],
        coulomb_torque=log["coulomb_torque"] * rated,
        viscous=log["viscous"] * rated,
    )
    errors = {key: 1.0 + float(rng.uniform(-size, size)) for key, size in table["nominal_error"].items()}
    nominal = replace(true, **{key: getattr(true, key) * factor for key, factor in errors.items()})
    lever = rng.uniform(0.3, 1.0)
    robot = Robot.from_urdf(_urdf(true, tilt, lever))
    config = PlantConfig(robot, _drives(true, log, even), np.zeros(1))
    return RandomDrive(seed, true, nominal, config, _urdf(nominal, tilt, lever))


def with_current_lag(drive: RandomDrive, time_constant: float) -> RandomDrive:
    """The same drive with a first-order current loop, s, which the data sheet knows nearly."""
    size = ranges()["nominal_error"]["current_time_constant"]
    factor = 1.0 + float(stream(drive.seed, "current").uniform(-size, size))
    return replace(
        drive,
        true=replace(drive.true, current_time_constant=time_constant),
        nominal=replace(drive.nominal, current_time_constant=time_constant * factor),
        config=drive.config.with_settings(current_time_constant=time_constant),
    )


def with_heating(drive: RandomDrive, motor_torque: FloatArray, velocity: FloatArray, period: float) -> RandomDrive:
    """The drive with heating sized so that this motion, (n,) N m and rad/s, warms it by the drawn rise."""
    even, rng = ranges()["drive_even"], stream(drive.seed, "heat")
    share, rise = float(rng.uniform(*even["copper_share"])), float(rng.uniform(*even["temperature_rise"]))
    copper = motor_torque**2
    friction = np.abs(drive.true.friction(velocity) * velocity)
    units = {"copper_heating": share / np.mean(copper), "friction_heating": (1.0 - share) / np.mean(friction)}
    warmed = replace(drive, config=drive.config.with_settings(**units))
    factor = rise / expected_rise(warmed, motor_torque, velocity, period)
    return cooled(warmed, factor)


def expected_rise(drive: RandomDrive, motor_torque: FloatArray, velocity: FloatArray, period: float) -> float:
    """Largest rise of the temperature over the ambient one in a motion, K."""
    settings = drive.config.drives
    lost = np.abs(drive.true.friction(velocity) * velocity)
    power = settings["copper_heating"][0] * motor_torque**2 + settings["friction_heating"][0] * lost
    return float(_low_pass(power, float(settings["thermal_time_constant"][0]), period).max())


def cooled(drive: RandomDrive, factor: float) -> RandomDrive:
    """The same drive with its heating multiplied."""
    settings = {name: factor * drive.config.drives[name] for name in ("copper_heating", "friction_heating")}
    return replace(drive, config=drive.config.with_settings(**settings))


def _low_pass(power: FloatArray, time_constant: float, period: float) -> FloatArray:
    """First-order lag of a signal, on blocks of 0.1 s."""
    block = max(1, round(0.1 / period))
    rows = power[: power.size // block * block].reshape(-1, block).mean(axis=1)
    warm, value = np.empty(rows.size), 0.0
    for index, row in enumerate(rows.tolist()):
        value += (row - value) * (block * period / time_constant)
        warm[index] = value
    return warm


def _drives(true: DriveNumbers, log: Mapping[str, float], even: Mapping[str, float]) -> dict[str, FloatArray]:
    """Settings of the world for one joint; everything that is not named is neutral."""
    rated = true.rated_torque
    given = {
        "gear_ratio": true.gear_ratio,
        "rated_torque": rated,
        "torque_limit": true.torque_limit,
        "rotor_inertia": true.rotor_inertia,
        "stiffness_linear": true.stiffness,
        "torsional_damping": true.stiffness * true.damping_time,
        "coulomb_torque": true.coulomb_torque,
        "viscous_positive": true.viscous,
        "viscous_negative": true.viscous,
        "encoder_counts": round(log["encoder_counts"]),
        "resolver_bits": round(even["resolver_bits"]),
        "resolver_noise": log["resolver_noise"],
        "gauge_noise": log["gauge_noise"] * rated,
        "ambient_temperature": even["ambient_temperature"],
        "reference_temperature": even["ambient_temperature"] + even["reference_offset"],
        "thermal_time_constant": log["thermal_time_constant"],
        "brake_torque": true.torque_limit,
        "brake_closing_time": 0.05,
        "presliding_distance": 8.0e-5,
        "friction_slip_share": [0.4, 0.3, 0.2, 0.1],
        "friction_slip_distance": [3.0e-5, 8.0e-5, 1.8e-4, 4.0e-4],
    }
    drives = {}
    for name, setting in SETTINGS.items():
        shape = (1,) if setting.numbers == 1 else (1, setting.numbers)
        drives[name] = np.array(np.broadcast_to(np.asarray(given.get(name, setting.neutral), dtype=float), shape))
    return drives


def _urdf(numbers: DriveNumbers, tilt: float, lever_share: float) -> str:
    """One joint; the axis lies `tilt` rad from the horizontal, gravity torque and inertia about it as in `numbers`.

    The lever takes a share of the longest one at which the link's own inertia stays at 30 % of the whole; it
    does not depend on the user's inertia, so that both descriptions have the same mass and gravity.
    """
    moment = numbers.gravity_torque / (GRAVITY * np.cos(tilt))
    lever = lever_share * min(0.6, 0.6 * numbers.rated_torque * ranges()["drive_log"]["link_inertia"][0] / moment)
    mass = moment / lever
    own = numbers.link_inertia - mass * lever**2
    # Joint frame: z the axis, -y up at tilt 0. The centre hangs (angle 0 means +y) at `zero_angle`.
    x, y = lever * np.sin(numbers.zero_angle), lever * np.cos(numbers.zero_angle)
    limit, side = float(numbers.torque_limit), 0.6 * own
    return f"""<?xml version="1.0"?>
<robot name="random_drive">
  <link name="base"/>
  <joint name="{JOINT}" type="revolute">
    <parent link="base"/>
    <child link="link_1"/>
    <origin xyz="0 0 0" rpy="{float(tilt - 0.5 * np.pi)!r} 0 0"/>
    <axis xyz="0 0 1"/>
    <limit lower="-6.3" upper="6.3" velocity="3.0" effort="{limit!r}"/>
  </joint>
  <link name="link_1">
    <inertial>
      <origin xyz="{float(x)!r} {float(y)!r} 0"/>
      <mass value="{float(mass)!r}"/>
      <inertia ixx="{float(side)!r}" iyy="{float(side)!r}" izz="{float(own)!r}" ixy="0" ixz="0" iyz="0"/>
    </inertial>
  </link>
</robot>
"""
