"""Pairs of recordings of a seven-joint arm under the control chain, with hidden effects on some of its joints."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from hd_control.core import topics
from hd_control.core.arrays import FloatArray
from hd_control.core.errors import ConfigError
from hd_sim.hidden_effects import VOCABULARY
from hd_sim.plant_config import PlantConfig
from hd_sim.puzzles.draw import STEPS, ranges, stream
from hd_sim.puzzles.random_motion import ticks
from hd_sim.runner import Runner, RunSetup
from hd_sim.scenario import Motion, Scenario, excitation, make_plan
from hd_sim.truth import HiddenEffect, apply_hidden, nominal, true_parameters, truth_of

ARMS = ("arm_a", "arm_b")
FIT_S, HELD_OUT_S = 60.0, 24.0
_COLUMNS = ("motor_shaft_position", "joint_position", "gauge_torque", "motor_torque", "reference_position")


@dataclass(frozen=True)
class ArmPair:
    """As `recordings.Pair`, for all joints: columns are (n, joints), `models` and `truth["joints"]` by joint name."""

    seed: int
    arm: str
    joint_names: tuple[str, ...]
    robot: str
    period: float
    fit: Mapping[str, FloatArray]
    held_out: Mapping[str, FloatArray]
    models: Mapping[str, Mapping[str, Any]]
    truth: Mapping[str, Any]


def draw_arm_effects(seed: int, joint_names: tuple[str, ...]) -> list[HiddenEffect]:
    """One effect on each of one to three joints."""
    rng, table = stream(seed, "arm/effects"), ranges()["strength"]
    count = int(rng.integers(1, 4))
    joints = rng.permutation(len(joint_names))[:count]
    found = []
    for joint in joints:
        step = STEPS[int(rng.integers(3))]
        strength = float(np.exp(rng.uniform(*np.log(table[step]))))
        found.append(HiddenEffect(joint_names[joint], str(rng.choice(VOCABULARY)), strength))
    return found


def make_arm_pair(seed: int, effects: list[HiddenEffect] | None = None) -> ArmPair:
    """The arm's pair of a seed; `effects` None: drawn. About 3 s of computing.

    Raises ConfigError if the arm stopped.
    """
    rng = stream(seed, "arm")
    arm = ARMS[int(rng.integers(len(ARMS)))]
    visible = _sensors(nominal(PlantConfig.from_file(arm)), rng)
    names = visible.robot.joint_names
    hidden = draw_arm_effects(seed, names) if effects is None else effects
    world = apply_hidden(visible, hidden, seed)
    fit, held_out = (_run(world, seed, number) for number in (0, 1))
    joints: dict[str, dict[str, Any]] = {name: {"names": [], "unknown": [], "parameters": {}} for name in names}
    for effect in hidden:
        index = names.index(effect.joint) if isinstance(effect.joint, str) else effect.joint
        known = effect.name in VOCABULARY
        joints[names[index]]["names" if known else "unknown"].append(effect.name)
        if known:
            joints[names[index]]["parameters"][effect.name] = true_parameters(effect.name, visible, world, index)
    truth = {"joints": joints, "world": truth_of(visible, hidden, seed)}
    models = {name: _model(visible, index, rng) for index, name in enumerate(names)}
    return ArmPair(seed, arm, names, visible.robot.urdf, visible.period, fit, held_out, models, truth)


def _sensors(config: PlantConfig, rng: np.random.Generator) -> PlantConfig:
    """Random joint sensors and more heat; everything else is what the arm's controller is tuned for."""
    n, table = config.joints, ranges()
    fewest, most = table["arm"]["resolver_bits"]
    bits = np.round(rng.uniform(fewest, most, n))
    low, high = np.log(table["drive_log"]["resolver_noise"])
    heat = {k: table["arm"]["heating_factor"] * config.drives[k] for k in ("copper_heating", "friction_heating")}
    return config.with_settings(resolver_bits=bits, resolver_noise=np.exp(rng.uniform(low, high, n)), **heat)


def _model(config: PlantConfig, joint: int, rng: np.random.Generator) -> dict[str, Any]:
    """What the user believes of one drive."""
    errors = {k: 1.0 + float(rng.uniform(-e, e)) for k, e in ranges()["nominal_error"].items()}
    value = {name: float(config.drives[name][joint]) for name in ("gear_ratio", "rated_torque", "rotor_inertia")}
    stiffness, damping, coulomb, viscous = (
        float(config.drives[name][joint])
        for name in ("stiffness_linear", "torsional_damping", "coulomb_torque", "viscous_positive")
    )
    effects = {
        "rotor_inertia": {"rotor_inertia": value["rotor_inertia"] * errors["rotor_inertia"]},
        "torsional_stiffness": {
            "torsional_stiffness": stiffness * errors["stiffness"],
            "damping_time": damping / stiffness * errors["damping_time"],
        },
        "coulomb_friction": {"coulomb_torque": coulomb * errors["coulomb_torque"]},
        "viscous_friction": {"viscous": viscous * errors["viscous"]},
        "link_dynamics": {},
    }
    return {"gear_ratio": value["gear_ratio"], "rated_torque": value["rated_torque"], "effects": effects}


def _run(world: PlantConfig, seed: int, number: int) -> dict[str, FloatArray]:
    """One recording under the control chain; each number has its own trajectory, pose, noise."""
    seconds, rng = (FIT_S, HELD_OUT_S)[number], stream(seed, f"arm/start/{number}")
    moved = replace(world, start_position=world.start_position + rng.uniform(-0.1, 0.1, world.joints))
    gains = {node: ranges()["arm"][node] for node in ("motion_node", "torque_node")}
    runner = Runner(RunSetup(moved, seed * 100 + number, gains))

    def build(context: Any) -> Motion:
        return excitation(context.start, context.velocity_limit, context.random, seconds)

    scenario = Scenario("excitation", "random excitation", "", build)
    names, limit = world.robot.joint_names, runner.goal_limits.velocity
    plan = make_plan(scenario, names, moved.start_position, limit, world.period, seed * 100 + number)
    columns = {name: np.empty((plan.ticks, world.joints)) for name in _COLUMNS}
    places = {name: topics.signal_places()[name][0] for name in _COLUMNS}
    warm: list[FloatArray] = []

    def observe(tick: int, bus: Any) -> None:
        for name, (topic, array) in places.items():
            columns[name][tick] = bus[topic][array]
        if topics.TEMPERATURE in bus:
            warm.append(bus[topics.TEMPERATURE]["temperature"].copy())

    runner.run(plan, observe)
    stopped, _ = runner.world.report()
    if stopped:
        raise ConfigError(f"seed {seed}: the arm stopped during the recording: {stopped}")
    return _with_time(columns, np.array(warm), world.period)


def _with_time(columns: dict[str, FloatArray], warm: FloatArray, period: float) -> dict[str, FloatArray]:
    count = len(columns["joint_position"])
    time = ticks(count, period)
    slow = time[:: max(1, round(0.1 / period))]
    temperature = np.column_stack([np.interp(time, slow, column) for column in warm.T])
    return {"time": time, **columns, "temperature": temperature}
