"""Random reference motions of one joint on the tick grid: good excitation of many kinds, and poor ones.

A motion is drawn as a velocity, with its ends at rest; position and acceleration follow on the same grid. Amplitudes
stay below what the drive's torque limit allows, except where saturation is the point.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from hd_control.core.arrays import FloatArray

Generator = np.random.Generator
RAMP_S = 1.0


@dataclass(frozen=True)
class Reference:
    """Desired position rad, velocity rad/s and acceleration rad/s^2, each (n,) at ticks. `torque` N m is added to the
    controller's in an open-loop run, whose gains are multiplied by `stiffness_share`."""

    period: float
    position: FloatArray
    velocity: FloatArray
    acceleration: FloatArray
    torque: FloatArray | None = None
    stiffness_share: float = 1.0


@dataclass(frozen=True)
class Room:
    """What a motion may use: the largest acceleration rad/s^2 within the torque limit, and the tick s."""

    acceleration: float
    period: float = 1e-3


def _from_velocity(velocity: FloatArray, start: float, period: float) -> Reference:
    """Position by the trapezoid rule, acceleration by central differences."""
    steps = 0.5 * period * (velocity[1:] + velocity[:-1])
    position = start + np.concatenate([[0.0], np.cumsum(steps)])
    return Reference(period, position, velocity, np.gradient(velocity, period))


def _time(seconds: float, room: Room) -> FloatArray:
    return ticks(round(seconds / room.period), room.period)


def ticks(count: int, period: float) -> FloatArray:
    """Times of `count` ticks, s."""
    time: FloatArray = np.arange(count, dtype=np.float64) * period
    return time


def _fade(time: FloatArray, ramp: float = RAMP_S) -> FloatArray:
    """1 inside, 0 at both ends, cosine ramps."""
    edge = np.minimum(time - time[0], time[-1] - time) / ramp
    fade: FloatArray = 0.5 - 0.5 * np.cos(np.pi * np.clip(edge, 0.0, 1.0))
    return fade


def triangular(seconds: float, rng: Generator, room: Room) -> FloatArray:
    """Velocity as a triangle wave of 0.9 to 1.15 rad/s; the joint swings over 1 to 2 rad."""
    time, peak = _time(seconds, room), rng.uniform(0.9, 1.15)
    period = 4.0 * rng.uniform(1.05, 2.0) / peak
    phase = (time / period + rng.choice([0.25, 0.75])) % 1.0
    triangle = np.where(phase < 0.5, 4.0 * phase - 1.0, 3.0 - 4.0 * phase)
    velocity: FloatArray = peak * triangle * _fade(time, 0.3)
    fade = _fade(time, 0.3)
    return velocity - fade * float(velocity.mean() / fade.mean())


def plateaus(seconds: float, rng: Generator, room: Room) -> FloatArray:
    """Constant speeds from 0.03 to 1.1 rad/s in both directions, in random order, over at least 1 rad."""
    speeds = np.geomspace(0.03, 1.1, 8) * rng.uniform(0.9, 1.1, 8)
    travel = np.minimum(rng.uniform(1.0, 1.5), 1.3 * speeds)
    legs = [(sign * speeds[i], travel[i] / speeds[i]) for i in rng.permutation(8) for sign in (1.0, -1.0)]
    scale = (seconds - 1.5) / sum(length for _, length in legs)
    return _plateau_train([(v, d * scale) for v, d in legs], seconds, min(6.0, 0.5 * room.acceleration), room)


def _plateau_train(legs: list[tuple[float, float]], seconds: float, slope: float, room: Room) -> FloatArray:
    """Velocity through the legs (rad/s, s) with acceleration `slope`, at rest at both ends."""
    time = _time(seconds, room)
    ends = np.cumsum([length for _, length in legs])
    wanted = np.array([velocity for velocity, _ in legs])[np.searchsorted(ends, time).clip(max=len(legs) - 1)]
    wanted = np.where(time > time[-1] - 1.5 / slope, 0.0, wanted)
    velocity, now, step = np.empty(time.size), 0.0, slope * room.period
    for index, target in enumerate(wanted.tolist()):
        now += min(max(target - now, -step), step)
        velocity[index] = now
    return velocity


def multisine(seconds: float, rng: Generator, room: Room, low: float = 0.1, high: float = 2.5) -> FloatArray:
    """Five sines from `low` to `high` Hz with random phases, equal velocity amplitudes of 0.08 to 0.16 rad/s."""
    time = _time(seconds, room)
    size = rng.uniform(0.08, 0.16)
    velocity = np.zeros(time.size)
    for frequency in np.geomspace(low, high, 5) * rng.uniform(0.93, 1.07, 5):
        w = 2.0 * np.pi * frequency
        limit = 0.3 * room.acceleration / w
        velocity += min(size, limit) * np.sin(w * time + rng.uniform(0.0, 2.0 * np.pi))
    return velocity * _fade(time)


def chirp(seconds: float, rng: Generator, room: Room, low: float = 0.3, high: float = 20.0) -> FloatArray:
    """Logarithmic chirp; amplitude 0.1 rad at first, later limited by an acceleration of 2 to 3 rad/s^2."""
    time = _time(seconds, room)
    growth = np.log(high / low) / seconds
    w = 2.0 * np.pi * low * np.exp(growth * time)
    limit = min(rng.uniform(2.0, 3.0), 0.5 * room.acceleration)
    size = 0.1 * (limit / w**2) / (0.1 + limit / w**2)
    velocity: FloatArray = size * w * np.cos((w - w[0]) / growth + rng.uniform(0.0, 2.0 * np.pi)) * _fade(time, 0.5)
    return velocity


def general(rng: Generator, room: Room, seconds: float = 60.0) -> Reference:
    """Good excitation: triangular velocity or a train of speeds, multisine, chirp, shares 25 : 22 : 13."""
    first = triangular if rng.random() < 0.6 else plateaus
    length = seconds / 60.0
    parts = [first(25.0 * length, rng, room), multisine(22.0 * length, rng, room), chirp(13.0 * length, rng, room)]
    return _from_velocity(np.concatenate(parts), rng.uniform(-0.15, 0.15), room.period)


def one_sine(rng: Generator, room: Room, seconds: float = 60.0) -> Reference:
    """One sine, 0.1 to 0.5 Hz, 0.2 to 0.5 rad."""
    time, w = _time(seconds, room), 2.0 * np.pi * rng.uniform(0.1, 0.5)
    velocity = rng.uniform(0.2, 0.5) * w * np.cos(w * time) * _fade(time)
    return _from_velocity(velocity, rng.uniform(-0.15, 0.15), room.period)


def one_direction(rng: Generator, room: Room, seconds: float = 60.0) -> Reference:
    """Speeds of 0.01 to 0.3 rad/s in one direction only, without a stop."""
    speeds = rng.permutation(np.geomspace(0.01, 0.3, 12)) * rng.choice([-1.0, 1.0])
    velocity = _plateau_train([(float(v), seconds / 12.0) for v in speeds], seconds, 1.0, room)
    return _from_velocity(velocity, float(-0.5 * velocity.sum() * room.period), room.period)


def constant_load(rng: Generator, room: Room, seconds: float = 60.0) -> Reference:
    """Slow small motions about one pose: the load hardly changes."""
    time, velocity = _time(seconds, room), np.zeros(round(seconds / room.period))
    for frequency in np.geomspace(0.1, 0.7, 4):
        w = 2.0 * np.pi * frequency
        velocity += 0.015 * np.sin(w * time + rng.uniform(0.0, 2.0 * np.pi))
    return _from_velocity(velocity * _fade(time), rng.choice([-1.0, 1.0]) * rng.uniform(0.5, 1.0), room.period)


def slow_only(rng: Generator, room: Room, seconds: float = 60.0) -> Reference:
    """Never faster than 15 to 30 mrad/s."""
    time, peak = _time(seconds, room), rng.uniform(0.015, 0.03)
    phase = (time / rng.uniform(6.0, 15.0) + 0.25) % 1.0
    velocity = peak * np.where(phase < 0.5, 4.0 * phase - 1.0, 3.0 - 4.0 * phase) * _fade(time)
    return _from_velocity(velocity, rng.uniform(-0.5, 0.5), room.period)


def fast_only(rng: Generator, room: Room, seconds: float = 60.0) -> Reference:
    """Only 4 to 20 Hz, a few milliradians."""
    velocity = chirp(seconds, rng, room, 4.0, 20.0)
    return _from_velocity(velocity, rng.uniform(-0.5, 0.5), room.period)


def short(rng: Generator, room: Room, seconds: float = 5.0) -> Reference:
    """A few seconds of a multisine."""
    velocity = multisine(min(seconds, 5.0), rng, room, 0.3, 3.0)
    return _from_velocity(velocity, rng.uniform(-0.15, 0.15), room.period)


def saturated(rng: Generator, room: Room, seconds: float = 60.0) -> Reference:
    """Bursts of a sine that asks for more than the torque limit."""
    time, w = _time(seconds, room), 2.0 * np.pi * rng.uniform(1.5, 3.0)
    bursts = np.sin(2.0 * np.pi * time / 10.0) > 0.6
    envelope = np.convolve(bursts, np.full(400, 1.0 / 400.0), "same") * _fade(time)
    velocity = rng.uniform(1.6, 2.2) * room.acceleration / w * np.cos(w * time) * envelope
    return _from_velocity(velocity, rng.uniform(-0.15, 0.15), room.period)


def open_loop(rng: Generator, room: Room, seconds: float = 60.0) -> Reference:
    """Slow sines of torque on a joint that is only softly held: the motion is what comes of it."""
    time = _time(seconds, room)
    torque = sum(np.sin(2.0 * np.pi * f * time + rng.uniform(0.0, 6.28)) for f in rng.uniform(0.05, 0.4, 3))
    rest, start = np.zeros(time.size), np.full(time.size, rng.uniform(-0.15, 0.15))
    push = 0.15 * room.acceleration * np.asarray(torque) * _fade(time)
    return Reference(room.period, start, rest, rest, push, 0.2)


def production(rng: Generator, room: Room, seconds: float = 60.0) -> Reference:
    """The same two or three moves between taught points, again and again, with pauses."""
    points, pause = rng.uniform(-0.5, 0.5, int(rng.integers(2, 4))), rng.uniform(0.3, 1.0)
    lengths = [
        1.875 * abs(b - a) / rng.uniform(0.3, 0.9) + 0.3 for a, b in zip(points, np.roll(points, -1), strict=True)
    ]
    cycle = []
    for a, b, length in zip(points, np.roll(points, -1), lengths, strict=True):
        x = _time(length, room) / length
        cycle += [(b - a) * 30.0 * x**2 * (1.0 - x) ** 2 / length, np.zeros(round(pause / room.period))]
    one, count = np.concatenate(cycle), round(seconds / room.period)
    velocity = np.tile(one, count // one.size + 1)[:count] * _fade(ticks(count, room.period), 0.2)
    return _from_velocity(velocity, float(points[0]), room.period)


Draw = Callable[[Generator, Room, float], Reference]
POOR: dict[str, Draw] = {
    "one_sine": one_sine,
    "one_direction": one_direction,
    "constant_load": constant_load,
    "slow_only": slow_only,
    "fast_only": fast_only,
    "short": short,
    "saturated": saturated,
    "open_loop": open_loop,
    "production": production,
}
MOTIONS: dict[str, Draw] = {"general": general, **POOR}
