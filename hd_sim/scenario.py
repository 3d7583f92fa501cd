"""Scenarios: which trajectory goals a run receives, and when.

A scenario is data: goals by tick. The runner hands them to the control chain, a ROS session publishes the same ones; so
every scenario runs in both, and in lock-step with the same torques.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np

from hd_control.core.arrays import FloatArray
from hd_control.core.errors import ConfigError
from hd_control.laws.trajectory import QUINTIC_PEAK, Goal

# ---- Motions: knots of position, velocity and acceleration that a quintic spline passes through ----


@dataclass(frozen=True)
class Motion:
    """Knots: times (k,) s; positions, velocities, accelerations (k, n). `window`: where errors are quoted, s."""

    times: FloatArray
    positions: FloatArray
    velocities: FloatArray
    accelerations: FloatArray
    duration: float
    window: tuple[float, float]


def _knots(times: list[float], positions: list[FloatArray], duration: float, window: tuple[float, float]) -> Motion:
    """Rest-to-rest knots: zero velocity and acceleration at each."""
    q = np.array(positions)
    return Motion(np.array(times), q, np.zeros_like(q), np.zeros_like(q), duration, window)


def rest(start: FloatArray, duration: float) -> Motion:
    """No motion for `duration` s."""
    none = np.zeros((0, start.size))
    return Motion(np.zeros(0), none, none, none, duration, (0.5 * duration, duration))


def steps(start: FloatArray) -> Motion:
    """Each joint moves by 0.02 rad in 0.15 s, one after the other, with 0.45 s in between."""
    size, time, dwell = 0.02, 0.15, 0.45
    times, points, clock = [1.0], [start], 1.0
    for moved in np.eye(start.size):
        target = points[-1] + size * moved
        times += [clock + time, clock + time + dwell]
        points += [target, target]
        clock += time + dwell
    return _knots(times, points, clock, (1.0, clock))


def coordinated_moves(start: FloatArray, distance: float, peak_velocity: float) -> Motion:
    """All joints +D, -D, +D (rest-to-rest quintics); 1 s hold first, 0.6 s after each move; errors over the third."""
    time, hold = QUINTIC_PEAK * distance / peak_velocity, 0.6
    times, points, clock = [1.0], [start], 1.0
    for target in (start + distance, start, start + distance):
        times += [clock + time, clock + time + hold]
        points += [target, target]
        clock += time + hold
    return _knots(times, points, clock, (clock - time - hold, clock))


def there_and_back(start: FloatArray, distance: float, peak_velocity: float) -> Motion:
    """All joints +D, -D and back to the start (rest-to-rest quintics), 1 s hold first, 0.3 s after each move."""
    times, points, clock, hold = [1.0], [start], 1.0, 0.3
    for target, travel in ((start + distance, 1.0), (start - distance, 2.0), (start, 1.0)):
        time = QUINTIC_PEAK * travel * distance / peak_velocity
        times += [clock + time, clock + time + hold]
        points += [target, target]
        clock += time + hold
    return _knots(times, points, clock, (1.0, clock))


def constant_speed(start: FloatArray, speed: float, duration: float) -> Motion:
    """2 s hold, 1 s blend to `speed` rad/s, cruise, 1 s blend to rest; errors from 5 s to 4 s before the end."""
    cruise = duration - 4.0
    ends = np.array([2.0, 3.0, 3.0 + cruise, 4.0 + cruise])
    travel = speed * np.array([0.0, 0.5, 0.5 + cruise, 1.0 + cruise])
    rates = speed * np.array([0.0, 1.0, 1.0, 0.0])
    ones = np.ones(start.size)
    positions = start + np.outer(travel, ones)
    velocities = np.outer(rates, ones)
    return Motion(ends, positions, velocities, np.zeros_like(velocities), duration, (5.0, duration - 4.0))


def slow_turn(start: FloatArray, distance: float, speed: float) -> Motion:
    """All joints by `distance` rad and back at `speed` rad/s, 1 s holds and 1 s blends: for calibrations."""
    cruise = distance / speed - 1.0
    steps = np.array([0.0, 1.0, cruise, 1.0, 1.0, 1.0, cruise, 1.0])
    rates = speed * np.array([0.0, 1.0, 1.0, 0.0, 0.0, -1.0, -1.0, 0.0])
    ends = 1.0 + np.cumsum(steps)
    travel = np.cumsum(np.concatenate(([0.0], 0.5 * (rates[1:] + rates[:-1]) * steps[1:])))
    velocities = np.outer(rates, np.ones(start.size))
    positions = start + np.outer(travel, np.ones(start.size))
    duration = float(ends[-1]) + 1.0
    return Motion(ends, positions, velocities, np.zeros_like(velocities), duration, (1.0, duration))


def _smooth_step(x: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Quintic 0 to 1 and its first two derivatives, clamped outside [0, 1]."""
    x = np.clip(x, 0.0, 1.0)
    return x**3 * (10 - 15 * x + 6 * x**2), 30 * x**2 * (1 - x) ** 2, 60 * x * (1 - x) * (1 - 2 * x)


def _enveloped(
    times: FloatArray, wave: FloatArray, rate: FloatArray, second: FloatArray, ramp: float
) -> list[FloatArray]:
    """`wave` (k, n) with its two derivatives, faded in and out by quintic envelopes of `ramp` s."""
    up, up1, up2 = _smooth_step((times - times[0]) / ramp)
    down, down1, down2 = _smooth_step((times[-1] - times) / ramp)
    e = (up * down)[:, None]
    e1 = ((up1 * down - up * down1) / ramp)[:, None]
    e2 = ((up2 * down - 2 * up1 * down1 + up * down2) / ramp**2)[:, None]
    return [e * wave, e1 * wave + e * rate, e2 * wave + 2 * e1 * rate + e * second]


def enveloped_sine(start: FloatArray, amplitude: float, frequency: float) -> Motion:
    """A sine with quintic envelope over two periods; 6 periods below 1 Hz, else 12; errors over the last three.

    Two further periods fade out, so that the goal ends at rest. Protocol: Zhu, Table III.
    """
    periods = 6 if frequency < 1.0 else 12
    begin, length = 1.0, (periods + 2) / frequency
    times = np.linspace(0.0, length, round(80 * (periods + 2)) + 1)
    w = 2 * np.pi * frequency
    columns = np.ones((1, start.size))
    waves = [amplitude * f(w * times)[:, None] * columns for f in (np.sin, np.cos, lambda x: -np.sin(x))]
    q, v, a = _enveloped(times, waves[0], w * waves[1], w * w * waves[2], 2 / frequency)
    window = (begin + (periods - 3) / frequency, begin + periods / frequency)
    return Motion(begin + times, start + q, v, a, begin + length, window)


def random_moves(start: FloatArray, velocity_limit: FloatArray, random: np.random.Generator, count: int) -> Motion:
    """Rest-to-rest quintics to random points within 0.5 rad of the start, 0.3 s apart, peak at most half the limit."""
    times, points, clock = [1.0], [start], 1.0
    for _ in range(count):
        target = start + random.uniform(-0.5, 0.5, start.size)
        share = random.uniform(0.2, 0.5)
        time = float(np.max(QUINTIC_PEAK * np.abs(target - points[-1]) / (share * velocity_limit))) + 0.2
        times += [clock + time, clock + time + 0.3]
        points += [target, target]
        clock += time + 0.3
    return _knots(times, points, clock, (1.0, clock))


def excitation(
    start: FloatArray, velocity_limit: FloatArray, random: np.random.Generator, seconds: float = 60.0
) -> Motion:
    """60 s that separate the effects: 25 s triangular velocity, 22 s five sines, 13 s logarithmic chirp.

    Triangular velocity up to 1.1 rad/s (at most 70 % of the limit) over at least 1 rad, sines 0.1 to 2.5 Hz, chirp 0.3
    to 20 Hz with acceleration held below 2.5 rad/s^2. Joints differ in period and phase, so that none mirrors another.
    """
    n, begin, share = start.size, 1.0, seconds / 60.0
    stages = [
        _triangular(25.0 * share, np.minimum(1.1, 0.7 * velocity_limit), random, n),
        _multisine(22.0 * share, random, n),
        _chirp(13.0 * share, random, n),
    ]
    times, parts, clock = [], [], begin
    for stage_times, stage in stages:
        keep = slice(0, None) if stage is stages[-1][1] else slice(0, -1)
        times.append(clock + stage_times[keep])
        parts.append([values[keep] for values in stage])
        clock += stage_times[-1]
    q, v, a = (np.concatenate([part[i] for part in parts]) for i in range(3))
    return Motion(np.concatenate(times), start + q, v, a, clock, (begin, clock))


def _triangular(
    length: float, peak: FloatArray, random: np.random.Generator, n: int
) -> tuple[FloatArray, list[FloatArray]]:
    """Velocity as a triangle wave: constant acceleration between reversals; the excursion is peak * period / 4."""
    times = np.linspace(0.0, length, 1251)
    period = 4.2 * (1.0 + 0.12 * np.arange(n) / max(1, n - 1)) * random.uniform(0.97, 1.03, n)
    phase = (times[:, None] / period + random.uniform(0.0, 1.0, n)) % 1.0
    triangle = np.where(phase < 0.5, 4 * phase - 1, 3 - 4 * phase)
    slope = np.where(phase < 0.5, 4.0, -4.0) / period
    x = np.where(phase < 0.5, phase, 1 - phase)
    swing = period * np.where(phase < 0.5, 2 * x * x - x, x - 2 * x * x)
    return times, _enveloped(times, peak * swing, peak * triangle, peak * slope, 2.0)


def _multisine(length: float, random: np.random.Generator, n: int) -> tuple[FloatArray, list[FloatArray]]:
    """Five sines from 0.1 to 2.5 Hz of equal velocity amplitude 0.12 rad/s."""
    times = np.linspace(0.0, length, 2201)
    total = [np.zeros((times.size, n)) for _ in range(3)]
    for frequency in np.geomspace(0.1, 2.5, 5):
        w = 2 * np.pi * frequency * random.uniform(0.95, 1.05, n)
        angle = w * times[:, None] + random.uniform(0.0, 2 * np.pi, n)
        for part, value in zip(total, (np.sin(angle) / w, np.cos(angle), -w * np.sin(angle)), strict=True):
            part += 0.12 * value
    return times, _enveloped(times, total[0], total[1], total[2], 2.0)


def _chirp(length: float, random: np.random.Generator, n: int) -> tuple[FloatArray, list[FloatArray]]:
    """Logarithmic chirp 0.3 to 20 Hz: amplitude 0.1 rad at first, then limited by an acceleration of 2.5 rad/s^2."""
    times = np.linspace(0.0, length, 3901)
    growth = np.log(20.0 / 0.3) / length
    w = 2 * np.pi * 0.3 * np.exp(growth * times)[:, None]
    angle = (w - w[0]) / growth + random.uniform(0.0, 2 * np.pi, n)
    limit = 2.5 / w**2
    size = 0.1 * limit / (0.1 + limit)
    share = 0.1 / (0.1 + limit)
    size1 = -2 * growth * size * share
    size2 = -2 * growth * (size1 * share + size * 2 * growth * share * (1 - share))
    wave = size * np.sin(angle)
    rate = size1 * np.sin(angle) + size * w * np.cos(angle)
    second = (size2 - size * w * w) * np.sin(angle) + (2 * size1 * w + size * w * growth) * np.cos(angle)
    return times, _enveloped(times, wave, rate, second, 1.0)


# ---- The scenarios ---------------------------------------------------------------------------------


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
    build: Callable[[Context], Motion]


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


def _sine(frequency: float, amplitude: float) -> Callable[[Context], Motion]:
    return lambda context: enveloped_sine(context.start, amplitude, frequency)


def _arm_scenarios() -> list[Scenario]:
    def scenario(name: str, meaning: str, build: Callable[[Context], Motion]) -> Scenario:
        return Scenario(name, meaning, "arm_a", build)

    return [
        scenario("rest", "hold the start position, 2 s", lambda c: rest(c.start, 2.0)),
        scenario("step", "each joint 0.02 rad in 0.15 s, one after the other", lambda c: steps(c.start)),
        scenario(
            "coordinated",
            "all joints +10, -10, +10 degrees, peak 0.4 rad/s (Zhu, Fig. 3)",
            lambda c: coordinated_moves(c.start, np.deg2rad(10.0), 0.4),
        ),
        scenario("slow", "all joints at 0.001 rad/s (Zhu, Fig. 4)", lambda c: constant_speed(c.start, 0.001, 21.0)),
        scenario(
            "slow_turn",
            "all joints 0.6 rad there and back at 0.12 rad/s, for hd calibrate",
            lambda c: slow_turn(c.start, 0.6, 0.12),
        ),
        scenario(
            "excitation",
            "60 s for identification: triangular velocity, multisine, chirp",
            lambda c: excitation(c.start, c.velocity_limit, c.random),
        ),
        scenario(
            "random",
            "ten random point-to-point moves",
            lambda c: random_moves(c.start, c.velocity_limit, c.random, 10),
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
