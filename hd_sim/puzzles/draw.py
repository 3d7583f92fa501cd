"""What a challenge draws from a seed: a drive with link, sensors and heat, effects to hide, excitation, and its world.

A seed determines the case completely. Ranges and shares are in `config/challenge.yaml`.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import asdict, dataclass, field, replace
from functools import lru_cache
from typing import Any

import numpy as np

from hd_control.core.arrays import FloatArray
from hd_control.core.errors import ConfigError
from hd_control.core.resources import config_path
from hd_control.core.robot import Robot
from hd_control.core.strict_yaml import load_yaml
from hd_sim.hidden_effects import VOCABULARY
from hd_sim.plant_config import SETTINGS, PlantConfig
from hd_sim.puzzles.random_motion import POOR
from hd_sim.second_world.hidden import UNNAMED
from hd_sim.sensors import noise_key
from hd_sim.truth import HiddenEffect

# ---- The drive, and what the user's data sheet says of it ------------------------------------------
#
# Sizes scale with the rated torque of the gear. The world of a random drive has only what every model has; hidden
# effects are added by `truth.apply_hidden`.


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


# ---- What is hidden: effects, strengths, excitation, and how the world differs from the model library ----


CATEGORIES = ("none", "one", "two", "unknown", "poor")
STEPS = ("weak", "middle", "strong")


@dataclass(frozen=True)
class Unknown:
    """Right answers for an effect that no library names: channels and variables it depends on; names that also do."""

    channels: tuple[str, ...]
    variables: tuple[str, ...]
    also: tuple[str, ...] = ()


UNKNOWN: Mapping[str, Unknown] = {
    "friction_over_angle": Unknown(("motor_torque",), ("joint_position",)),
    "cable_torque": Unknown(("link_torque",), ("joint_position",)),
    "friction_step": Unknown(("motor_torque",), ("time",)),
    "tooth_defect": Unknown(("transmission",), ("joint_position",)),
    "torque_constant_saturation": Unknown(("motor_torque",), ("motor_torque", "joint_torque")),
    "gauge_zero_drift": Unknown(("motor_torque", "link_torque"), ("time", "temperature")),
    "contact_pulses": Unknown(("link_torque",), ("time",)),
    "gauge_fourth_harmonic": Unknown(
        ("motor_torque", "link_torque", "transmission"), ("motor_shaft_position",), ("gauge_ripple",)
    ),
}
"""The effects of `effects.OUTSIDE` that are unknown to a model, with what a right answer says."""


def unknown_named(name: str) -> Unknown:
    """What a right answer says of an effect that no library names, of either world."""
    if name in UNKNOWN:
        return UNKNOWN[name]
    answer = UNNAMED[name][1]
    return Unknown(answer.channels, answer.variables, answer.also)


SUBSTITUTES = {"torsional_hysteresis": "maxwell_slip_hysteresis", "presliding": "maxwell_slip_friction"}
"""Effects that a judge's world makes with another law; the right name stays that of the library."""
FEATURES = ("scheme", "friction_law", "current_lag", "sampling_jitter", "gauge_lag", "skew", "other_laws", "kinematic")
TOLERATED = {
    "friction_law": ("presliding",),
    "current_lag": ("actuation_delay",),
    "gauge_lag": ("unknown",),
    "kinematic": ("unknown",),
    "skew": ("actuation_delay", "unknown"),
}
"""Answers that a judge's feature also justifies; they count neither as right nor as wrong."""


Neutral = Mapping[str, Mapping[str, tuple[float, float]]]


@dataclass(frozen=True)
class Case:
    """One challenge. `effects` act in the world; `names` are their right names in the vocabulary; `unknown` the hidden
    effects without one; `features` of a judge's world with their sizes; `motion` names the kind of recording; `world`
    who makes it. `neutral`: name -> parameter -> bounds: what this world always has; an answer within is neither right
    nor wrong."""

    seed: int
    category: str
    effects: tuple[HiddenEffect, ...]
    names: tuple[str, ...]
    unknown: tuple[str, ...]
    step: str
    motion: str
    features: Mapping[str, Any]
    world: str = "home"
    neutral: Neutral = field(default_factory=dict)

    @property
    def tolerated(self) -> tuple[str, ...]:
        """Names that count neither as right nor as wrong."""
        also = [name for effect in self.unknown for name in unknown_named(effect).also]
        return tuple(sorted({*also, *(name for key in self.features for name in TOLERATED.get(key, ()))}))

    def to_dict(self) -> dict[str, Any]:
        """The case in plain types."""
        return asdict(self) | {"tolerated": list(self.tolerated), "features": dict(self.features)}


def draw_case(seed: int, category: str = "mix", judge: bool | None = None) -> Case:
    """A case of one category, or of the mix. `judge`: in a world that differs from the library or not; None: drawn.

    Raises ConfigError for an unknown category.
    """
    table, rng = ranges(), stream(seed, "case")
    shares = [table["mix"][name] for name in CATEGORIES]
    drawn = CATEGORIES[int(rng.choice(len(CATEGORIES), p=np.array(shares) / sum(shares)))]
    category = drawn if category == "mix" else category
    if category not in CATEGORIES:
        raise ConfigError(f"category {category!r}: expected mix or one of {', '.join(CATEGORIES)}")
    step = STEPS[int(rng.integers(3))]
    strengths = [float(np.exp(rng.uniform(*np.log(table["strength"][step])))) for _ in range(2)]
    known = [str(name) for name in rng.permutation(VOCABULARY)[:2]]
    outside = str(rng.choice(list(UNKNOWN)))
    motion = str(rng.choice(list(POOR))) if category == "poor" else "general"
    with_known, with_effect = (rng.random() < table[k] for k in ("unknown_with_known_share", "poor_with_effect_share"))
    count = {"none": 0, "one": 1, "two": 2, "unknown": int(with_known), "poor": int(with_effect)}[category]
    names = tuple(known[:count])
    hidden = [*names, outside] if category == "unknown" else list(names)
    step = step if hidden else ""
    features = draw_features(seed, names, judge)
    effects = [
        HiddenEffect(0, SUBSTITUTES.get(name, name) if "other_laws" in features else name, strength)
        for name, strength in zip(hidden, strengths, strict=False)
    ]
    unknown = (outside,) if category == "unknown" else ()
    return Case(seed, category, tuple(effects), names, unknown, step, motion, features)


def chosen_case(seed: int, effects: Mapping[str, float], motion: str = "general") -> Case:
    """A case with given effects and strengths; unknown ones by their name in `hd_sim.hidden_effects`."""
    names = tuple(name for name in effects if name in VOCABULARY)
    unknown = tuple(name for name in effects if name in UNKNOWN)
    missing = [name for name in effects if name not in (*names, *unknown)]
    if missing:
        raise ConfigError(f"unknown effect {missing[0]!r}; there is {', '.join((*VOCABULARY, *UNKNOWN))}")
    category = "poor" if motion != "general" else "unknown" if unknown else ("none", "one", "two")[min(len(names), 2)]
    hidden = tuple(HiddenEffect(0, name, strength) for name, strength in effects.items())
    return Case(seed, category, hidden, names, unknown, "", motion, draw_features(seed, names, False))


def draw_features(seed: int, names: tuple[str, ...], judge: bool | None) -> dict[str, Any]:
    """What is different in this world, feature by feature with its size; empty in a clean world."""
    table, rng = ranges(), stream(seed, "judge")
    wanted = rng.random() < table["judge_share"] if judge is None else judge
    present = {name: rng.random() < table["judge_feature_share"] for name in FEATURES}
    sizes = {key: float(np.exp(rng.uniform(*np.log(pair)))) for key, pair in table["judge"].items()}
    law, channel = str(rng.choice(["bristle", "maxwell_slip"])), str(rng.choice(list(SKEWED)))
    if not wanted:
        return {}
    values: dict[str, Any] = {
        "scheme": "first_order",
        "friction_law": {"law": law, "distance": sizes["friction_distance"]},
        "current_lag": sizes["current_lag"],
        "sampling_jitter": sizes["sampling_jitter"],
        "gauge_lag": sizes["gauge_lag"],
        "skew": {"channel": channel, "delay": sizes["skew"]},
        "other_laws": True,
        "kinematic": {"growth": sizes["kinematic_growth"], "modulation": sizes["kinematic_modulation"]},
    }
    useful = {"other_laws": bool(set(names) & set(SUBSTITUTES)), "kinematic": "kinematic_error" in names}
    if "presliding" in names:
        useful["friction_law"] = False
    return {name: values[name] for name in FEATURES if useful.get(name, True) and (present[name] or name in useful)}


SKEWED = ("motor_shaft_position", "joint_position", "gauge_torque", "motor_torque")
"""Channels that a recorder may deliver late."""
