"""A servo drive in front of a single joint: cascaded position and velocity loops on the motor encoder, tick by tick.

The law is written in plain numbers, because a campaign runs it some hundred million times. It knows the user's data
sheet (feed-forward) and its own sensors, never the world's parameters.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from hd_control.core.arrays import FloatArray
from hd_sim.plant import Plant
from hd_sim.plant_config import PlantConfig
from hd_sim.random_drive import DriveNumbers, RandomDrive, ranges, stream
from hd_sim.random_motion import Reference

NOISE_SHARE = 0.06
"""Of the rated torque: what one encoder count may change the command by."""
CROSSOVER_SHARE = 0.4
"""Of the filter cutoff: the highest crossover of the velocity loop above the joint's resonance."""
LOWEST_CUTOFF = 120.0
"""rad/s"""


@dataclass(frozen=True)
class ServoGains:
    """Gains referred to the output: velocity N m s/rad, position 1/s, integral 1/s, filter cutoff rad/s, feed-forward
    as a share of the nominal torque."""

    velocity: float
    position: float
    integral: float
    cutoff: float
    feed_forward: float


def draw_gains(drive: RandomDrive) -> ServoGains:
    """Gains as a careful engineer would tune them on this drive; deterministic in the drive's seed."""
    rng, numbers = stream(drive.seed, "servo"), drive.nominal
    drawn = {key: float(rng.uniform(*pair)) for key, pair in ranges()["servo_even"].items()}
    inertia = numbers.rotor_inertia + numbers.link_inertia
    count = 2.0 * math.pi / float(drive.config.drives["encoder_counts"][0]) / numbers.gear_ratio
    cutoff = drawn["filter_cutoff"]
    while True:
        quiet = NOISE_SHARE * numbers.rated_torque / (inertia * cutoff * count)
        stable = CROSSOVER_SHARE * min(cutoff, 500.0) * numbers.rotor_inertia / inertia
        if quiet >= 12.0 or cutoff <= LOWEST_CUTOFF:
            break
        cutoff = max(0.8 * cutoff, LOWEST_CUTOFF)
    bandwidth = min(drawn["velocity_bandwidth"], max(quiet, 8.0), stable)
    position = drawn["position_share"] * bandwidth
    integral = drawn["integral_share"] * position
    return ServoGains(bandwidth * inertia, position, integral, cutoff, drawn["feed_forward"])


def motor_references(numbers: DriveNumbers, reference: Reference) -> tuple[FloatArray, FloatArray]:
    """Desired motor position (n,) rad, with the torsion of the data sheet, and feed-forward torque (n,) N m."""
    q, v, a = reference.position, reference.velocity, reference.acceleration
    position = q + numbers.joint_torque(q, a) / numbers.stiffness
    torque = numbers.motor_torque(q, v, a)
    return position, torque


def run_servo(
    config: PlantConfig, drive: RandomDrive, reference: Reference, seed: int, temperature: float | None = None
) -> dict[str, FloatArray]:
    """Runs the reference on the world `config`; returns the columns of the recording, each (n,).

    temperature: of motor and gear at the start, degC; the ambient one if None. Columns: `motor_shaft_position`,
    `joint_position`, `gauge_torque`, `motor_torque` (the set-point that acts over [t_k, t_k + period)), `temperature`,
    `reference_position`.
    """
    moved, gains = drive.nominal, draw_gains(drive)
    plant = Plant(_starting_at(config, float(reference.position[0])), seed)
    if temperature is not None:
        state = plant.state
        state.temperature = temperature
        plant.restore(state)
    desired, torque = motor_references(moved, reference)
    feed = gains.feed_forward * torque
    if reference.torque is not None:
        feed = feed + reference.torque * (moved.rotor_inertia + moved.link_inertia)
    rows = _loop(plant, gains, moved, reference, desired, feed)
    names = ("motor_shaft_position", "joint_position", "gauge_torque", "motor_torque", "temperature")
    columns = {name: np.ascontiguousarray(rows[:, index]) for index, name in enumerate(names)}
    return columns | {"reference_position": reference.position.copy()}


def _starting_at(config: PlantConfig, position: float) -> PlantConfig:
    from dataclasses import replace

    return replace(config, start_position=np.array([position]))


def _loop(
    plant: Plant,
    gains: ServoGains,
    numbers: DriveNumbers,
    reference: Reference,
    desired: FloatArray,
    feed: FloatArray,
) -> FloatArray:
    """The ticks: latch, sample, law, advance. Returns the sample rows (n, 5)."""
    latch, sample, advance = plant._kernel.latch, plant._kernel.sample, plant._kernel.advance
    dt, ratio, limit = reference.period, 1.0 / numbers.gear_ratio, numbers.torque_limit
    blend = 1.0 - math.exp(-gains.cutoff * dt)
    velocity_gain = gains.velocity * reference.stiffness_share
    position_gain, integral_step = gains.position, gains.integral * dt
    rows = np.empty((desired.size, 5))
    cell = plant.gravity_torque(reference.position[:1])
    before = plant.state.motor_position[0]
    rate = sum_error = 0.0
    for row, target, speed, known in zip(
        rows, desired.tolist(), reference.velocity.tolist(), feed.tolist(), strict=True
    ):
        latch(cell)
        row[:] = readings = sample()
        now = readings.item(0) * ratio
        rate += blend * ((now - before) / dt - rate)
        before = now
        error = target - now
        wanted = known + velocity_gain * (speed - rate + position_gain * (error + sum_error))
        if -limit < wanted < limit:
            sum_error += integral_step * error
        cell[0] = wanted
        advance()
    return rows
