"""Pairs of recordings of one random joint with hidden effects: one to fit, one to check; the user's model; the truth.

pair = make_pair(seed, "one")           # or draw_case / chosen_case, then record_pair(case)
pair.fit["gauge_torque"]                # (n,) columns, names as in the joint's signals of the analysis
pair.model["effects"]["rotor_inertia"]  # what the user believes
pair.truth                              # what is hidden; nobody opens it before the diagnosis is written

The joint is moved by a servo drive of its own; `write_bag` makes a bag of the columns.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from hd_control.core import topics
from hd_control.core.arrays import FloatArray
from hd_control.record.cdr import TemperatureCodec, encode_text
from hd_control.record.schema import joint_state_codec
from hd_control.record.writer import BagWriter
from hd_sim.plant import Plant
from hd_sim.plant_config import PlantConfig
from hd_sim.puzzles.draw import (
    JOINT,
    Case,
    DriveNumbers,
    RandomDrive,
    cooled,
    draw_case,
    draw_drive,
    expected_rise,
    ranges,
    stream,
    with_current_lag,
    with_heating,
)
from hd_sim.puzzles.random_motion import MOTIONS, Reference, Room, general, ticks
from hd_sim.truth import apply_hidden, true_parameters, truth_of

# ---- As a bag: what a drive network would publish, and nothing that is hidden ----------------------


RUN_ID = "simulation_00000"
START_TIME = "2000-01-01T00:00:00Z"
"""Simulated time has no date; a fixed one makes equal runs equal bags."""
TEMPERATURE_PERIOD = 0.1
"""s between two messages of a joint's temperature."""
_TOPICS = (*topics.SENSORS, topics.REFERENCE)


def write_bag(
    path: str | Path,
    joint_names: Sequence[str],
    columns: Mapping[str, FloatArray],
    robot: str,
    period: float,
    metadata: Mapping[str, str],
) -> Path:
    """Writes columns (n,) or (n, joints), named as in `Pair`, with the user's robot description (URDF text).

    Nothing that `metadata` does not say is added, no seed in particular. Raises BagError.
    """
    joints = len(joint_names)
    tables = {name: np.asarray(values).reshape(len(values), -1) for name, values in columns.items()}
    tables["reference_velocity"] = np.asarray(np.gradient(tables["reference_position"], period, axis=0), np.float64)
    period_ns = round(period * 1e9)
    stamps = np.arange(len(tables["joint_position"]), dtype=np.int64) * period_ns
    with BagWriter(path, live=False, metadata=metadata, start_time_utc=START_TIME) as writer:
        writer.write("robot_description", None, 0, encode_text(robot))
        writer.attach("robot.urdf", robot, "application/xml")
        for topic in _TOPICS:
            values = {array: tables[name] for array, name in topics.TOPICS[topic].signals.items()}
            codec = joint_state_codec(topic, joint_names)
            writer.write_columns(topic, codec, stamps, frame_id=RUN_ID, **values)
        slow = max(1, round(TEMPERATURE_PERIOD / period))
        for joint in range(joints):
            codec_of = TemperatureCodec(joint_names[joint])
            for tick in range(0, len(stamps), slow):
                stamp = int(stamps[tick])
                value = tables["temperature"][tick, joint]
                payload = codec_of.encode(stamp, joint_names[joint], temperature=value)
                writer.write(topics.TEMPERATURE, stamp, stamp, payload)
        return writer.close()


# ---- The servo drive: cascaded position and velocity loops on the motor encoder, tick by tick ------
#
# The law is written in plain numbers, because a campaign runs it some hundred million times. It knows the user's data
# sheet (feed-forward) and its own sensors, never the world's parameters.


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


# ---- The pair --------------------------------------------------------------------------------------


FIT_S, HELD_OUT_S = 60.0, 24.0
JUDGE_SUBSTEPS = 20
"""Per ms, for the judge's other integration scheme."""


@dataclass(frozen=True)
class Pair:
    """Two recordings of one joint, the nominal model and the truth, all in plain types.

    `fit`, `held_out`: `time`, `motor_shaft_position`, `joint_position`, `gauge_torque`, `motor_torque`, `temperature`,
    `reference_position`, each (n,) SI. `model`: `gear_ratio`, `rated_torque`, `robot` (URDF text), `joint`, `effects`
    (name -> parameter -> value).
    """

    case: Case
    period: float
    fit: Mapping[str, FloatArray]
    held_out: Mapping[str, FloatArray]
    model: Mapping[str, Any]
    truth: Mapping[str, Any]


@dataclass(frozen=True)
class Bench:
    """A random joint on the test bench: any number of recordings of the same plant, as a user would make them."""

    case: Case
    drive: RandomDrive
    world: PlantConfig
    warmth: float

    def record(self, motion: str, number: int = 0, seconds: float = FIT_S) -> dict[str, FloatArray]:
        """Recording `number` of a kind of motion; each number has its own trajectory and noise."""
        rng = stream(self.case.seed, f"motion/{motion}/{number}")
        reference = MOTIONS[motion](rng, room_of(self.drive), seconds)
        return self.play(reference, number)

    def play(self, reference: Reference, number: int = 0) -> dict[str, FloatArray]:
        """Records a given motion; later recordings start on a warm drive."""
        rng, world = stream(self.case.seed, f"start/{number}"), self.world
        warm = 0.0 if number == 0 else float(rng.uniform(*ranges()["warm_start_share"])) * self.warmth
        start = float(world.drives["ambient_temperature"][0]) + warm
        limit = ranges()["poor_rise_limit"] / max(1e-9, self._rise(reference))
        if limit < 1.0:
            heat = cooled(replace(self.drive, config=world), limit).config
            world = heat
        columns = run_servo(world, self.drive, reference, self.case.seed * 100 + number, start)
        return _recorded(columns, self.case, self.drive, reference.period)

    def _rise(self, reference: Reference) -> float:
        torque = self.drive.nominal.motor_torque(reference.position, reference.velocity, reference.acceleration)
        torque = np.clip(torque, -self.drive.nominal.torque_limit, self.drive.nominal.torque_limit)
        return expected_rise(self.drive, torque, reference.velocity, reference.period)


def make_pair(seed: int, kind: str = "mix", judge: bool | None = None) -> Pair:
    """The pair of a seed. `kind`: mix, none, one, two, unknown, poor. About 0.2 s of computing."""
    return record_pair(draw_case(seed, kind, judge))


def record_pair(case: Case) -> Pair:
    """Both recordings of a case."""
    bench = set_up(case)
    fit, held_out = bench.record(case.motion, 0, FIT_S), bench.record(case.motion, 1, HELD_OUT_S)
    period = bench.drive.config.period
    return Pair(case, period, fit, held_out, nominal_model(bench.drive), hidden_truth(bench))


def set_up(case: Case) -> Bench:
    """The drive of the case's seed with everything that is hidden in it."""
    drive = _drive_of(case.seed)
    if "current_lag" in case.features:
        drive = with_current_lag(drive, case.features["current_lag"])
    world = _judge_world(apply_hidden(drive.config, case.effects, case.seed), case)
    return Bench(case, drive, world, float(ranges()["drive_even"]["temperature_rise"][0]))


def room_of(drive: RandomDrive) -> Room:
    """What motions may use on this drive, by its data sheet."""
    nominal = drive.nominal
    static = nominal.gravity_torque + nominal.coulomb_torque + 1.1 * nominal.viscous
    inertia = nominal.rotor_inertia + nominal.link_inertia
    return Room(max(1.0, (nominal.torque_limit - static) / inertia), drive.config.period)


def nominal_model(drive: RandomDrive) -> dict[str, Any]:
    """What the user believes: robot, gear and the effects of every model with data-sheet values."""
    numbers = drive.nominal
    effects: dict[str, dict[str, float]] = {
        "rotor_inertia": {"rotor_inertia": numbers.rotor_inertia},
        "torsional_stiffness": {"torsional_stiffness": numbers.stiffness, "damping_time": numbers.damping_time},
        "coulomb_friction": {"coulomb_torque": numbers.coulomb_torque},
        "viscous_friction": {"viscous": numbers.viscous},
        "link_dynamics": {},
    }
    if numbers.current_time_constant > 0.0:
        effects["actuation_delay"] = {"delay": numbers.current_time_constant}
    return {
        "joint": JOINT,
        "gear_ratio": numbers.gear_ratio,
        "rated_torque": numbers.rated_torque,
        "robot": drive.nominal_urdf,
        "effects": effects,
    }


def hidden_truth(bench: Bench) -> dict[str, Any]:
    """The sealed part: case, right names, values of their parameters, settings that changed."""
    case, drive = bench.case, bench.drive
    parameters = {name: true_parameters(name, drive.config, bench.world) for name in case.names}
    return {
        "case": case.to_dict(),
        "joints": {JOINT: {"names": list(case.names), "unknown": list(case.unknown), "parameters": parameters}},
        "world": truth_of(drive.config, case.effects, case.seed),
    }


def _drive_of(seed: int) -> RandomDrive:
    """The seed's drive: the first that its general recording loads well, heated by that recording."""
    attempt = 0
    while True:
        drive = draw_drive(seed, attempt)
        room = room_of(drive)
        reference = general(stream(seed, "motion/general/0"), room, FIT_S)
        q, v, a = reference.position, reference.velocity, reference.acceleration
        load = drive.nominal.joint_torque(q, a)
        wide = np.ptp(load) >= ranges()["general_load_span"] * drive.nominal.rated_torque
        if (wide and load.min() < 0.0 < load.max()) or attempt >= 50:
            return with_heating(drive, drive.nominal.motor_torque(q, v, a), v, reference.period)
        attempt += 1


def _judge_world(world: PlantConfig, case: Case) -> PlantConfig:
    """The world with the features that differ from the model library."""
    features = case.features
    if "scheme" in features:
        world = replace(world, scheme=features["scheme"], substeps_per_ms=JUDGE_SUBSTEPS)
    if "friction_law" in features:
        distance = features["friction_law"]["distance"]
        slips = distance * np.array([0.5, 1.0, 2.0, 4.0])
        world = world.with_settings(presliding_distance=distance, friction_slip_distance=slips)
        world = world.with_settings(friction_law=features["friction_law"]["law"])
    if "sampling_jitter" in features:
        world = world.with_settings(sampling_jitter=features["sampling_jitter"])
    if "gauge_lag" in features:
        world = world.with_settings(gauge_time_constant=features["gauge_lag"])
    if "kinematic" in features:
        rated = float(world.drives["rated_torque"][0])
        world = world.with_settings(
            kinematic_load_slope=features["kinematic"]["growth"] / rated,
            kinematic_angle_modulation=features["kinematic"]["modulation"],
        )
    return world


def _recorded(
    columns: Mapping[str, FloatArray], case: Case, drive: RandomDrive, period: float
) -> dict[str, FloatArray]:
    """What the recorder makes of the columns: slow temperature, channels that come late."""
    time = ticks(columns["temperature"].size, period)
    slow = slice(None, None, max(1, round(TEMPERATURE_PERIOD / period)))
    found: dict[str, FloatArray] = {"time": time, **columns}
    found["temperature"] = np.interp(time, time[slow], columns["temperature"][slow])
    if "skew" in case.features:
        name, delay = case.features["skew"]["channel"], case.features["skew"]["delay"]
        if name == "motor_torque":  # a held value read late is the one of the tick before
            found[name] = np.concatenate([found[name][:1], found[name][:-1]])
        else:
            found[name] = _on_counts(_later(found[name], delay / period), name, drive)
    return found


def _on_counts(values: FloatArray, name: str, drive: RandomDrive) -> FloatArray:
    """The sensor's own resolution again, rad."""
    settings = drive.config.drives
    counts = {
        "motor_shaft_position": settings["encoder_counts"][0],
        "joint_position": 2.0 ** settings["resolver_bits"][0],
    }
    if name not in counts:
        return values
    step = 2.0 * np.pi / counts[name]
    rounded: FloatArray = step * np.round(values / step)
    return rounded


def _later(values: FloatArray, samples: float) -> FloatArray:
    """The signal delayed by a part of a sample, in the frequency domain with odd reflection at both ends."""
    pad = min(1000, values.size - 1)
    head, tail = 2.0 * values[0] - values[pad:0:-1], 2.0 * values[-1] - values[-2 : -pad - 2 : -1]
    long = np.concatenate([head, values, tail])
    trend = np.linspace(long[0], long[-1], long.size)
    spectrum = np.fft.rfft(long - trend)
    turn = np.exp(-2j * np.pi * np.fft.rfftfreq(long.size) * samples)
    slope = (long[-1] - long[0]) / (long.size - 1)
    moved: FloatArray = np.fft.irfft(spectrum * turn, long.size) + trend - slope * samples
    return moved[pad : pad + values.size]
