"""The known linear core of one joint, as a filter: rotor, spring with damper, link.

    I phi'' = u - f - tau            f: friction and other forces on the rotor
    J q''   = tau - b - l            b: gravity, Coriolis and neighbours; l: other forces on the link
    tau     = k (phi + a - q) + c d/dt(phi + a - q)        a: zero and other angles in the transmission

A Kalman filter of these equations predicts what the sensors read next; what comes instead is the innovation. By
linearity whatever is added to f, a, l or to a reading adds to the innovations what it makes of the same filter.
Source: docs/equations/innovations.md (K1) to (K6).
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from hd_control._innovations import Filter, Joint
from hd_control.core.arrays import BoolArray, FloatArray
from hd_control.drive.effect import LINK, MOTOR, TRANSMISSION, Columns

MOTOR_SENSOR, JOINT_SENSOR, TORQUE_SENSOR = "motor_position", "joint_position", "gauge_torque"
SENSORS = (MOTOR_SENSOR, JOINT_SENSOR, TORQUE_SENSOR)
"""What is measured, in the order of the filter; a sensor term is a column of that name."""
START = (1e-2, 2.0, 1e-2, 2.0)
"""Standard deviations of the first state: angles rad, speeds rad/s."""
ROW_RATE = 125.0
"""Hz of the rows that are kept: effects of a drive are slower than 60 Hz, or wave-like and seen as their alias."""
SOFTEST, STIFFEST = 1.0 / 3.0, 3.0
"""How far one correction moves the stiffness at most, as a factor."""


@dataclass(frozen=True)
class Numbers:
    """Numbers of the core, SI, output side; `link_scale` multiplies the nominal link inertia."""

    rotor_inertia: float
    stiffness: float
    damping_time: float
    coulomb: float
    viscous: float
    zero: float = 0.0
    link_scale: float = 1.0

    @property
    def damping(self) -> float:
        """N m s/rad."""
        return self.stiffness * self.damping_time

    def near(self, other: Numbers, tolerance: float) -> bool:
        """True if inertias and stiffness of both differ by less than `tolerance`, relative."""
        mine = np.array([self.rotor_inertia, self.stiffness, self.link_scale])
        theirs = np.array([other.rotor_inertia, other.stiffness, other.link_scale])
        return bool((np.abs(mine / theirs - 1.0) < tolerance).all())

    def moved(self, change: Mapping[tuple[str, str], float]) -> Numbers:
        """The numbers after fitted changes of the base, by (balance, name); bounded: a poor fit stays a core."""
        compliance = 1.0 / self.stiffness + change.get((TRANSMISSION, "torsional_compliance"), 0.0)
        compliance = float(np.clip(compliance, SOFTEST / self.stiffness, STIFFEST / self.stiffness))
        damping = self.damping_time + change.get((TRANSMISSION, "torsional_damping"), 0.0) / compliance
        rotor = float(np.clip(1.0 + change.get((MOTOR, "inertia_correction"), 0.0), 0.4, 2.5))
        link = float(np.clip(1.0 + change.get((LINK, "inertia_correction"), 0.0), 0.4, 2.5))
        return Numbers(
            rotor_inertia=self.rotor_inertia * rotor,
            stiffness=1.0 / compliance,
            damping_time=float(np.clip(damping, 0.0, 0.02)),
            coulomb=self.coulomb + change.get((MOTOR, "coulomb_torque"), 0.0),
            viscous=self.viscous + change.get((MOTOR, "viscous"), 0.0),
            zero=self.zero + change.get((TRANSMISSION, "transmission_zero"), 0.0),
            link_scale=self.link_scale * link,
        )


@dataclass(frozen=True)
class Readings:
    """What is measured and known of a joint, (n,) each: `sensors` (n, 3) in the order of `SENSORS`, angles from the
    first one on; `variance` (n, 3) of their noise, infinite for a sensor that is not there; `torque` N m of the motor,
    None if it is not known; `torque_noise` N m; `inertia` kg m^2 and `rest` N m of the link (`OwnLink`), None if the
    link is not known; `sliding`: where friction has its full value; `usable`; `scale` N m of the joint torque."""

    period: float
    sensors: FloatArray
    variance: FloatArray
    torque: FloatArray | None
    torque_noise: float
    inertia: FloatArray | None
    rest: FloatArray | None
    usable: BoolArray
    sliding: BoolArray
    scale: float

    @property
    def present(self) -> tuple[str, ...]:
        """Names of the sensors that are there."""
        return tuple(name for name, v in zip(SENSORS, self.variance[0], strict=True) if np.isfinite(v))


QUIET_ROTOR, QUIET_LINK = 1e-4, 1e-3
"""Least noise of the forces over the torque scale: nothing is known better, and the filter forgets within 50 ms."""
STUCK = 0.5
"""Uncertainty of the friction at rest and in presliding, over the Coulomb torque."""


class Core:
    """One joint's filter at certain numbers. `share`: how much of the torque's fast part is noise (0 to 1)."""

    def __init__(self, readings: Readings, numbers: Numbers, share: float, held: bool) -> None:
        self.readings, self.numbers, self.share, self.held = readings, numbers, share, held
        self.stride = max(1, int(1.0 / readings.period / ROW_RATE + 1e-9))
        self.taps = _taps(self.stride)
        joint = Joint(numbers.rotor_inertia, numbers.stiffness, numbers.damping, readings.period)
        self.filter = Filter(
            joint, self._inertia(), readings.variance, self._forces(), readings.usable | True, list(START)
        )

    def _inertia(self) -> FloatArray:
        inertia = self.readings.inertia
        if inertia is None:
            return np.array([self.numbers.rotor_inertia])
        inertia = self.numbers.link_scale * inertia
        return inertia if np.ptp(inertia) > 1e-3 * inertia.mean() else inertia[:1]

    def _forces(self) -> FloatArray:
        """Variances (n, 2) of the forces on rotor and link; what is not known may be as large as the torque scale."""
        r = self.readings
        found = np.empty((len(r.sensors), 2))
        noise = r.scale if r.torque is None else self.share * r.torque_noise
        found[:, 0] = noise**2 + (QUIET_ROTOR * r.scale) ** 2
        found[~r.sliding, 0] += (STUCK * max(self.numbers.coulomb, 0.0)) ** 2
        found[:, 1] = r.scale**2 if r.rest is None else (QUIET_LINK * r.scale) ** 2
        return found

    def known(self, friction: FloatArray) -> dict[str, FloatArray]:
        """What drives the filter: readings, motor torque less `friction` (n,), link torque and zero, (n, 1) each."""
        r = self.readings
        torque = np.zeros(len(r.sensors)) if r.torque is None else r.torque if self.held else _middle(r.torque)
        rest = np.zeros(len(r.sensors)) if r.rest is None else _middle(r.rest)
        found = {"rotor": friction - torque, "link": rest, "angle": np.full(rest.size, -self._zero_torque)}
        for name, key, column in zip(SENSORS, SENSOR_INPUTS, r.sensors.T, strict=True):
            if name in r.present:
                found[key] = column
        return {key: np.ascontiguousarray(column[:, None]) for key, column in found.items()}

    @property
    def _zero_torque(self) -> float:
        return self.numbers.stiffness * self.numbers.zero

    def predicted(self, friction: FloatArray, added: Columns) -> FloatArray:
        """State (n, 4) at each stamp that follows from everything before it.

        `added`: effects (n, 1) that are known too, by balance or sensor.
        """
        inputs = self.known(friction)
        for key, column in self._inputs(added).items():
            if key in SENSOR_INPUTS:  # from the middles of the samples to their stamps
                column = 0.5 * (column + np.concatenate([column[:1], column[:-1]]))
            inputs[key] = np.ascontiguousarray(inputs[key] - column)
        return np.asarray(self.filter.predict(**inputs))

    def innovations(self, friction: FloatArray) -> dict[str, FloatArray]:
        """Standardised innovations (rows,) of the recording by sensor."""
        rows = self.filter.respond(self.taps, self.stride, True, **self.known(friction))
        return {name: rows[a][:, 0] for a, name in enumerate(self.readings.present)}

    def fast(self, friction: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Innovations of every sample (sensors, n) and the diagonal of their whitening (n, sensors)."""
        rows = self.filter.respond([1.0], 1, True, **self.known(friction))
        count = len(self.readings.present)
        return rows[:, :, 0], np.diagonal(self.filter.whitening(), axis1=1, axis2=2)[:, :count]

    def responses(self, columns: Columns) -> dict[str, FloatArray]:
        """What columns (n, k) of the middles of the samples add to the innovations, (rows, k) by sensor.

        Keys: balances (a torque that resists, an angle) and sensors (what is read too much).
        """
        inputs = {key: np.ascontiguousarray(column) for key, column in self._inputs(columns).items()}
        if not inputs:
            return {}
        rows = self.filter.respond(self.taps, self.stride, False, **inputs)
        return {name: rows[a] for a, name in enumerate(self.readings.present)}

    def _inputs(self, columns: Columns) -> dict[str, FloatArray]:
        """Columns as what drives the filter."""
        inputs = {}
        for name, column in columns.items():
            if name == TRANSMISSION:
                inputs["angle"] = self._spring(column)
            elif name in (MOTOR, LINK):
                inputs["rotor" if name == MOTOR else "link"] = -column
            elif name in self.readings.present:
                inputs[SENSOR_INPUTS[SENSORS.index(name)]] = column
        return inputs

    def responses_of(self, columns: list[Columns]) -> dict[str, FloatArray]:
        """`responses` of several, side by side."""
        found = [self.responses(one) for one in columns]
        return {name: np.concatenate([one[name] for one in found], axis=1) for name in self.readings.present}

    def _spring(self, angle: FloatArray) -> FloatArray:
        """Torque that an angle in the transmission makes in spring and damper."""
        torque = self.numbers.stiffness * angle
        if self.numbers.damping > 0.0:
            torque = torque + self.numbers.damping * np.gradient(angle, self.readings.period, axis=0)
        return torque

    def with_numbers(self, numbers: Numbers) -> Core:
        """The same joint at other numbers."""
        return Core(self.readings, numbers, self.share, self.held)


SENSOR_INPUTS = ("motor_sensor", "joint_sensor", "torque_sensor")


def _middle(values: FloatArray) -> FloatArray:
    """From values at the stamps to the middle of the samples."""
    return np.asarray(0.5 * (values + np.append(values[1:], values[-1])))


def _taps(stride: int) -> list[float]:
    """Low-pass at the rows' own Nyquist frequency: no empty band is left, which whitening would blow up."""
    from scipy.signal import firwin

    return [1.0] if stride == 1 else [float(tap) for tap in firwin(4 * stride + 1, 1.0 / stride)]
