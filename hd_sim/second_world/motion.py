"""Reference motions of the second world: position and velocity of one joint at ticks, (n,) rad and rad/s.

Good recordings join three parts in random order: a Fourier series, legs of constant speed, and a band of small fast
sines. Poor ones show too little of one thing or the other.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from hd_control.core.arrays import FloatArray

Generator = np.random.Generator


@dataclass(frozen=True)
class Room:
    """What a motion may use: acceleration rad/s^2 within the torque limit, angle rad about which it moves, tick s."""

    acceleration: float
    middle: float
    period: float


@dataclass(frozen=True)
class Motion:
    """Position rad and velocity rad/s at ticks, each (n,)."""

    position: FloatArray
    velocity: FloatArray


def _window(count: int, period: float, ramp: float) -> FloatArray:
    """Smooth rise and fall within `ramp` s at both ends (quintic)."""
    edge = np.minimum(np.arange(count), np.arange(count)[::-1]) * period / ramp
    x = np.clip(edge, 0.0, 1.0)
    window: FloatArray = x**3 * (10.0 - 15.0 * x + 6.0 * x**2)
    return window


def _integrated(velocity: FloatArray, room: Room) -> Motion:
    """Position about the middle of the room, trapezoid rule."""
    steps = 0.5 * room.period * (velocity[1:] + velocity[:-1])
    position = np.concatenate([[0.0], np.cumsum(steps)])
    return Motion(position + room.middle - 0.5 * (position.min() + position.max()), velocity)


def _balanced(velocity: FloatArray, window: FloatArray) -> FloatArray:
    """The same velocity without net travel."""
    shaped = velocity * window
    balanced: FloatArray = shaped - window * (shaped.sum() / window.sum())
    return balanced


def fourier(seconds: float, rng: Generator, room: Room) -> FloatArray:
    """Velocity of a Fourier series of five harmonics with a period of 6 to 11 s (Swevers et al., 1997)."""
    count = round(seconds / room.period)
    time, base = np.arange(count) * room.period, 2.0 * np.pi / rng.uniform(6.0, 11.0)
    velocity = np.zeros(count)
    for order in range(1, 6):
        velocity += rng.normal(0.0, 0.42) * np.sin(order * base * time + rng.uniform(0.0, 2.0 * np.pi))
    peak = rng.uniform(0.8, 1.25)
    return _balanced(velocity * peak / np.abs(velocity).max(), _window(count, room.period, 0.8))


def legs(seconds: float, rng: Generator, room: Room, low: float = 0.02, high: float = 1.2) -> FloatArray:
    """Constant speeds between `low` and `high` rad/s, each forth and back, joined by ramps."""
    speeds = rng.permutation(np.geomspace(low, high, 7) * rng.uniform(0.85, 1.15, 7))
    share = np.minimum(0.9, 1.1 * speeds) / speeds
    lengths = np.maximum(np.round(0.5 * (seconds - 0.5) * share / share.sum() / room.period).astype(int), 1)
    wanted = np.concatenate([np.repeat([s, -s], n) for s, n in zip(speeds, lengths, strict=True)])
    count = round(seconds / room.period)
    wanted = np.concatenate([wanted, np.zeros(max(0, count - wanted.size))])[:count]
    gentle = 4.0 * high / (0.5 * room.acceleration)  # a reversal at full speed takes half of the room's acceleration
    width = max(3, min(round(max(rng.uniform(0.1, 0.25), gentle) / room.period), count // 12))
    bell = np.hanning(width + 2)[1:-1]
    smooth: FloatArray = np.convolve(wanted, bell / bell.sum(), "same") * _window(count, room.period, 0.2)
    return smooth


def band(seconds: float, rng: Generator, room: Room, low: float = 1.0, high: float = 22.0) -> FloatArray:
    """Twelve sines from `low` to `high` Hz; together at most 40 % of the room's acceleration, at most 4 rad/s^2."""
    count = round(seconds / room.period)
    time, velocity = np.arange(count) * room.period, np.zeros(count)
    for frequency in np.geomspace(low, high, 12) * rng.uniform(0.96, 1.04, 12):
        w = 2.0 * np.pi * frequency
        velocity += min(0.1, 1.0 / w) * np.sin(w * time + rng.uniform(0.0, 2.0 * np.pi))
    limit = min(4.0, 0.4 * room.acceleration)
    velocity *= min(1.0, limit / np.abs(np.gradient(velocity, room.period)).max())
    return _balanced(velocity, _window(count, room.period, 0.6))


def general(rng: Generator, room: Room, seconds: float) -> Motion:
    """All three parts, shares of about 40, 35 and 25 % in random order."""
    shares = np.array([0.4, 0.35, 0.25]) * rng.uniform(0.85, 1.15, 3)
    lengths = seconds * shares / shares.sum()
    parts = [make(length, rng, room) for make, length in zip((fourier, legs, band), lengths, strict=True)]
    return _integrated(np.concatenate([parts[i] for i in rng.permutation(3)]), room)


def sine(rng: Generator, room: Room, seconds: float) -> Motion:
    """One slow sine."""
    count, w = round(seconds / room.period), 2.0 * np.pi * rng.uniform(0.1, 0.4)
    velocity = rng.uniform(0.2, 0.5) * w * np.sin(w * np.arange(count) * room.period + rng.uniform(0.0, 6.28))
    return _integrated(_balanced(velocity, _window(count, room.period, 1.0)), room)


def one_way(rng: Generator, room: Room, seconds: float) -> Motion:
    """Speeds up to 0.2 rad/s, one direction only."""
    count = round(seconds / room.period)
    ends = np.geomspace(0.01, 0.2, 9)[rng.permutation(9)]
    velocity = np.interp(np.arange(count), np.linspace(0, count - 1, 9), ends) * rng.choice([-1.0, 1.0])
    return _integrated(velocity * _window(count, room.period, 0.5), room)


def one_pose(rng: Generator, room: Room, seconds: float) -> Motion:
    """Slow motion of a few hundredths of a radian about one pose."""
    count, velocity = round(seconds / room.period), np.zeros(round(seconds / room.period))
    for frequency in rng.uniform(0.08, 0.6, 3):
        w = 2.0 * np.pi * frequency
        velocity += 0.012 * w * np.sin(w * np.arange(count) * room.period + rng.uniform(0.0, 6.28))
    return _integrated(_balanced(velocity, _window(count, room.period, 1.0)), room)


def creeping(rng: Generator, room: Room, seconds: float) -> Motion:
    """Never faster than 12 to 28 mrad/s."""
    count, peak = round(seconds / room.period), rng.uniform(0.012, 0.028)
    w = 2.0 * np.pi / rng.uniform(7.0, 16.0)
    velocity = peak * np.sin(w * np.arange(count) * room.period + rng.uniform(0.0, 6.28))
    return _integrated(_balanced(velocity, _window(count, room.period, 0.5)), room)


def shaking(rng: Generator, room: Room, seconds: float) -> Motion:
    """Fast and small: 5 to 20 Hz only."""
    return _integrated(band(seconds, rng, room, 5.0, 20.0), room)


def brief(rng: Generator, room: Room, seconds: float) -> Motion:
    """Four seconds of a Fourier series."""
    return _integrated(fourier(min(seconds, 4.0), rng, room), room)


def pick_and_place(rng: Generator, room: Room, seconds: float) -> Motion:
    """The same move there and back with pauses, all over again."""
    travel, length = rng.uniform(0.3, 0.8), rng.uniform(0.8, 1.6)
    move, rest = round(length / room.period), round(rng.uniform(0.3, 0.9) / room.period)
    x = np.arange(move) / move
    shape = travel * 30.0 * x**2 * (1.0 - x) ** 2 / length
    cycle = np.concatenate([np.zeros(rest), shape, np.zeros(rest), -shape])
    count = round(seconds / room.period)
    velocity = np.tile(cycle, count // cycle.size + 1)[:count]
    return _integrated(velocity * _window(count, room.period, 0.2), room)


Draw = Callable[[Generator, Room, float], Motion]
POOR: dict[str, Draw] = {
    "sine": sine,
    "one_way": one_way,
    "one_pose": one_pose,
    "creeping": creeping,
    "shaking": shaking,
    "brief": brief,
    "pick_and_place": pick_and_place,
}
MOTIONS: dict[str, Draw] = {"general": general, **POOR}
