"""Scenarios: which trajectory goals a run receives, and when.

A scenario is data: goals by tick. The runner hands them to the control chain, a ROS session publishes the same ones; so
every scenario runs in both, and in lock-step with the same torques.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np

from hd_control.control.trajectory import Goal
from hd_control.core.arrays import FloatArray
from hd_control.core.errors import ConfigError
from hd_sim import motions

ACCEPT_TICK_S = 0.1
"""Goals are handed over at this time, s; they start later, at their own start tick."""


@dataclass(frozen=True)
class Plan:
    """A scenario made concrete: goals with the time at which the chain receives them.

    `window` is the time interval, s, over which a tracking error is quoted.
    """

    goals: tuple[tuple[int, Goal], ...]
    ticks: int
    window: tuple[float, float]


@dataclass(frozen=True)
class Scenario:
    """A named run. `plant` is the shipped plant file it is meant for; `build(context)` makes its motion."""

    name: str
    meaning: str
    plant: str
    build: Callable[[Context], motions.Motion]


@dataclass(frozen=True)
class Context:
    """What a motion may depend on: start position (n,) rad, velocity limit (n,) rad/s and a random generator."""

    start: FloatArray
    velocity_limit: FloatArray
    random: np.random.Generator


_TABLE_3 = {  # Zhu, Table III: joint -> ((frequency Hz, amplitude rad), ...)
    3: ((0.5, 0.1), (2.0, 0.02)),
    4: ((0.5, 0.1), (2.0, 0.02)),
    5: ((0.5, 0.1), (2.0, 0.02)),
    7: ((0.5, 0.15), (5.0, 0.015)),
}


def _sine(frequency: float, amplitude: float) -> Callable[[Context], motions.Motion]:
    return lambda context: motions.enveloped_sine(context.start, amplitude, frequency)


def _arm_scenarios() -> list[Scenario]:
    def scenario(name: str, meaning: str, build: Callable[[Context], motions.Motion]) -> Scenario:
        return Scenario(name, meaning, "arm_a", build)

    return [
        scenario("rest", "hold the start position, 2 s", lambda c: motions.rest(c.start, 2.0)),
        scenario("step", "each joint 0.02 rad in 0.15 s, one after the other", lambda c: motions.steps(c.start)),
        scenario(
            "coordinated",
            "all joints +10, -10, +10 degrees, peak 0.4 rad/s (Zhu, Fig. 3)",
            lambda c: motions.coordinated_moves(c.start, np.deg2rad(10.0), 0.4),
        ),
        scenario(
            "slow", "all joints at 0.001 rad/s (Zhu, Fig. 4)", lambda c: motions.constant_speed(c.start, 0.001, 21.0)
        ),
        scenario(
            "slow_turn",
            "all joints 0.6 rad there and back at 0.12 rad/s, for hd calibrate",
            lambda c: motions.slow_turn(c.start, 0.6, 0.12),
        ),
        scenario(
            "excitation",
            "60 s for identification: triangular velocity, multisine, chirp",
            lambda c: motions.excitation(c.start, c.velocity_limit, c.random),
        ),
        scenario(
            "random",
            "ten random point-to-point moves",
            lambda c: motions.random_moves(c.start, c.velocity_limit, c.random, 10),
        ),
    ]


def _single_joint_scenarios() -> list[Scenario]:
    return [
        Scenario(
            f"sine_joint_{joint}_{frequency:g}hz".replace(".", "p"),
            f"single joint {joint}, {amplitude:g} rad at {frequency:g} Hz (Zhu, Table III)",
            f"single_joint_{joint}",
            _sine(frequency, amplitude),
        )
        for joint, cases in _TABLE_3.items()
        for frequency, amplitude in cases
    ]


SCENARIOS = {scenario.name: scenario for scenario in (*_arm_scenarios(), *_single_joint_scenarios())}


def find_scenario(name: str) -> Scenario:
    """The scenario of that name. Raises ConfigError that lists the known ones."""
    if name not in SCENARIOS:
        raise ConfigError(f"unknown scenario {name!r}; there is {', '.join(SCENARIOS)}")
    return SCENARIOS[name]


def make_plan(
    scenario: Scenario,
    joint_names: Sequence[str],
    start: FloatArray,
    velocity_limit: FloatArray,
    period: float,
    seed: int = 0,
) -> Plan:
    """The goals of a scenario for a robot at `start` (n,) rad; deterministic in all arguments."""
    random = np.random.default_rng([seed, 0x5CE7A410])
    motion = scenario.build(Context(np.asarray(start, dtype=float), velocity_limit, random))
    ticks = round(motion.duration / period)
    if motion.times.size == 0:
        return Plan((), ticks, motion.window)
    goal = Goal(
        joint_names=tuple(joint_names),
        times=np.round((motion.times - motion.times[0]) * 1e9) / 1e9,  # whole nanoseconds, as a message gives them
        positions=motion.positions,
        velocities=motion.velocities,
        accelerations=motion.accelerations,
        start_tick=round(float(motion.times[0]) / period),
        identifier=scenario.name,
    )
    return Plan(((round(ACCEPT_TICK_S / period), goal),), ticks, motion.window)
