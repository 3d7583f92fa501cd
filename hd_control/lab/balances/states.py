"""From one joint's signals to the state of its drive: lightly filtered, zero phase, with the masks of what is usable.

Nonlinear columns are formed from these states at the rate of the recording; the channels filter the columns afterwards.
Rows at which the counts of an angle are a tone, or repeat with the motion, are not usable: only elsewhere is the error
of the counts white noise.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from hd_control.core.arrays import BoolArray, FloatArray
from hd_control.drive.effect import DriveStates
from hd_control.lab.signals.filters import EDGE_S, Band, Spectral, band_for, fill_gaps
from hd_control.lab.signals.joint_signals import JointSignals, quantum

MOTOR_TAPER = (40.0, 65.0)
JOINT_TAPER = (10.0, 25.0)
PRESLIDING_SPEED = 6e-3
"""rad/s below which a motor counts as resting or presliding; raised where the encoder is coarse."""
PRESLIDING_TRAVEL = 1.5e-3
"""rad of travel after a reversal during which friction builds up."""
SPEED_NOISE_FACTOR = 6.0


@dataclass(frozen=True)
class Derived:
    """Filtered motor and joint motion (n,) at the rate of the recording, and where friction has its full value.

    `sliding`: outside presliding. `reversal_travel` rad and `reversal_time` s since the last change of direction.
    """

    filled: dict[str, FloatArray]
    usable: BoolArray
    motor_velocity: FloatArray
    joint_position: FloatArray
    joint_velocity: FloatArray
    gauge_torque: FloatArray
    sliding: BoolArray
    direction: FloatArray
    reversal_travel: FloatArray
    reversal_time: FloatArray
    speed_threshold: float


def noise_density(signal: FloatArray, period: float) -> float:
    """White noise of a signal, standard deviation per sample: from its spectrum above 0.3 of the rate, median."""
    differences = np.diff(signal, 3)
    frequency = np.fft.rfftfreq(differences.size, 1.0)
    power = np.abs(np.fft.rfft(differences * np.hanning(differences.size))) ** 2
    top = frequency > 0.3
    gain = np.abs(2.0 * np.sin(np.pi * frequency[top])) ** 6
    scale = np.sum(np.hanning(differences.size) ** 2)
    return float(np.sqrt(np.median(power[top] / gain) / np.log(2.0) / scale))


def reversals(velocity: FloatArray, threshold: float) -> NDArray[np.int64]:
    """Indices at which the direction changes; speeds below `threshold` rad/s do not count as a direction."""
    state = np.where(velocity > threshold, 1, np.where(velocity < -threshold, -1, 0))
    known = np.flatnonzero(state)
    changes = known[1:][np.diff(state[known]) != 0]
    before = known[:-1][np.diff(state[known]) != 0]
    crossings = [int(a + np.argmin(np.abs(velocity[a : b + 1]))) for a, b in zip(before, changes, strict=True)]
    return np.array(crossings, dtype=np.int64)


def since_reversal(
    position: FloatArray, velocity: FloatArray, period: float, threshold: float
) -> tuple[FloatArray, FloatArray]:
    """(travel rad, time s) since the last reversal, (n,); before the first one since the start."""
    index = np.concatenate([[0], reversals(velocity, threshold)])
    last = index[np.searchsorted(index, np.arange(position.size), side="right") - 1]
    return np.abs(position - position[last]), (np.arange(position.size) - last) * period


def derive(signals: JointSignals, gear_ratio: float, spectral: Spectral) -> Derived:
    """The derived motion of one joint. A motor or joint angle that is not recorded is replaced by the other."""
    period = signals.period
    filled: dict[str, FloatArray] = {}
    usable = np.asarray(signals.valid).copy()
    for name in ("motor_shaft_position", "joint_position", "gauge_torque", "motor_torque", "temperature"):
        value = getattr(signals, name)
        if value is not None:
            filled[name] = fill_gaps(value)
            if name != "temperature":
                usable &= np.isfinite(value)
    shaft, joint = filled.get("motor_shaft_position"), filled.get("joint_position")
    motor = shaft / gear_ratio if shaft is not None else joint
    if motor is None:
        raise ValueError("neither motor nor joint position")
    filled["motor_position"] = motor
    filled.setdefault("joint_position", motor)
    motor_band = Band(*_taper(MOTOR_TAPER, period))
    joint_band = Band(*_taper(JOINT_TAPER, period))
    motor_spectrum, joint_spectrum = spectral.transform(motor), spectral.transform(filled["joint_position"])
    velocity = spectral.back(*motor_spectrum, motor_band, 1)[:, 0]
    noise = noise_density(motor, period) * 2 * np.pi * 0.7 * motor_band.zero * np.sqrt(2 * motor_band.flat * period)
    threshold = max(PRESLIDING_SPEED, SPEED_NOISE_FACTOR * noise)
    travel, age = since_reversal(motor, velocity, period, 0.5 * threshold)
    sliding = (np.abs(velocity) >= threshold) & (travel >= PRESLIDING_TRAVEL)
    torque = filled.get("gauge_torque")
    edge = round(EDGE_S / period)
    usable[:edge] = usable[usable.size - edge :] = False
    return Derived(
        filled=filled,
        usable=usable,
        motor_velocity=velocity,
        joint_position=spectral.back(*joint_spectrum, joint_band)[:, 0],
        joint_velocity=spectral.back(*joint_spectrum, joint_band, 1)[:, 0],
        gauge_torque=np.full_like(motor, np.nan) if torque is None else spectral.filter(torque, motor_band),
        sliding=sliding,
        direction=np.where(np.abs(velocity) >= 0.1 * threshold, np.sign(velocity), 0.0),
        reversal_travel=travel,
        reversal_time=age,
        speed_threshold=threshold,
    )


def drive_states(signals: JointSignals, gear_ratio: float, spectral: Spectral, derived: Derived) -> DriveStates:
    """The states of the drive without link terms (they are NaN), (n,) each."""
    period, filled = signals.period, derived.filled
    missing = np.full(signals.time.size, np.nan)
    motor_band = Band(*_taper(MOTOR_TAPER, period))
    wide = Band(*_taper((0.3 / period, 0.45 / period), period))
    torque = derived.gauge_torque
    seen = derived.usable.any() and np.isfinite(torque).all()
    scale = float(np.quantile(np.abs(torque[derived.usable]), 0.98)) if seen else 1.0
    command = filled.get("motor_torque")
    held = missing if command is None else spectral.filter(command, wide, 0, spectral.hold())
    rate = missing if not np.isfinite(torque).all() else spectral.filter(filled["gauge_torque"], motor_band, 1)
    return DriveStates(
        period=period,
        gear_ratio=gear_ratio,
        torque_scale=max(scale, 1e-9),
        time=signals.time,
        motor_position=filled["motor_position"],
        motor_velocity=derived.motor_velocity,
        motor_acceleration=spectral.filter(filled["motor_position"], motor_band, 2),
        motor_direction=derived.direction,
        joint_position=derived.joint_position,
        joint_velocity=derived.joint_velocity,
        joint_acceleration=spectral.filter(filled["joint_position"], Band(*_taper(JOINT_TAPER, period)), 2),
        gauge_torque=filled.get("gauge_torque", missing),
        joint_torque=torque,
        joint_torque_rate=rate,
        motor_torque=held,
        temperature=filled.get("temperature", missing),
        link_inertia_torque=missing,
        link_bias_torque=missing,
    )


def _taper(taper: tuple[float, float], period: float) -> tuple[float, float]:
    band = band_for(period, *taper)
    return band.flat, band.zero


# ---- The counts of an angle ------------------------------------------------------------------------


FEW_COUNTS, FEW_COUNTS_S = 10, 0.1
"""Counts within so many s below which the error of the counts is no noise."""
COARSE = 0.5
"""Count of an angle over that of the coarsest one of a channel below which its tones do not matter."""
MOST_NOISY = 0.6
"""Share of a channel's rows that may be left out because of the counts of an angle."""


def count_tone(
    velocity: FloatArray, count: float, period: float, zero: float, orders: tuple[int, ...] = (1,)
) -> BoolArray:
    """Where the counts of an angle, or their beat with the sampling, fall below `zero` Hz, (n,): there the quantisation
    is a tone and no white noise. `orders`: harmonics of the count frequency that matter."""
    tone = np.zeros(velocity.size, dtype=bool)
    if count > 0.0:
        for order in orders:
            counts = order * velocity * (period / count)
            tone |= np.abs(counts - np.round(counts)) < zero * period
    return tone


def few_counts(position: FloatArray, count: float, period: float) -> BoolArray:
    """Where an angle stays within a few of its counts, (n,): there the quantisation repeats with the motion."""
    from scipy.ndimage import maximum_filter1d, minimum_filter1d

    if count <= 0.0:
        return np.zeros(position.size, dtype=bool)
    width = 2 * round(0.5 * FEW_COUNTS_S / period) + 1
    travel = maximum_filter1d(position, width) - minimum_filter1d(position, width)
    return np.asarray(travel < (FEW_COUNTS + 0.5) * count)


def noisy_rows(
    derived: Derived, period: float, band: Band, valid: BoolArray, angles: Mapping[str, tuple[int, ...]]
) -> BoolArray:
    """Rows of a channel, (rows,), at which the error of an angle's counts is no white noise.

    A tone of the encoder also comes back through the controller. `angles`: harmonics of the counts that matter, by the
    name of the angle; one that would take most rows is let in, and one much finer than another is no matter. `valid`
    (rows,): rows that count.
    """
    noisy = np.zeros(valid.size, dtype=bool)
    counts = {name: quantum(derived.filled[name]) for name in angles}
    for name, count in counts.items():
        if count < COARSE * max(counts.values()):
            continue
        velocity = derived.motor_velocity if name == "motor_position" else derived.joint_velocity
        rows = count_tone(velocity[:: band.step], count, period, band.zero, angles[name])
        rows |= few_counts(derived.filled[name], count, period)[:: band.step]
        if not valid.any() or (noisy | rows)[valid].mean() <= MOST_NOISY:
            noisy |= rows
    return noisy
