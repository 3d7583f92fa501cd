"""Does the recording excite enough? Coverage of motion, load, angle and temperature, and what that allows to claim.

On poor recordings a refusal is right and a name is a guess: held-out blocks of the same bag do not catch it. So the
gates come before the search, and every refusal carries the experiment that would decide.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from hd_control.core.arrays import FloatArray
from hd_control.drive.effect import LINK, MOTOR, TRANSMISSION, Effect
from hd_control.drive.needs import RAMPS, SPEED_DECADES, SPEED_VARIETY, TORSION, Covered
from hd_control.lab.balances.channels import JointEquations
from hd_control.lab.balances.equations import ACCELERATION_SNR
from hd_control.lab.balances.states import reversals

REVERSALS = 5
DURATION_S = 12.0
COMPLIANCE_ERROR = 0.02
"""Half-width of the interval of the compliance, relative, beyond which nothing can be said of the transmission."""
SATURATED = 0.03
REPETITION = 0.9


@dataclass(frozen=True)
class Coverage:
    """What the motion covers. Angles rad, speeds rad/s, torque N m, temperature K, times s.

    `saturated`: share of the time with the motor torque at its largest value. `repetition`: largest autocorrelation of
    the speed beyond 1 s. `speed_variety`: effective number of quarter decades of speed (exponential of the entropy).
    """

    duration: float
    moving: float
    slow_speed: float
    fast_speed: float
    both_directions: bool
    reversals: int
    torque_low: float
    torque_high: float
    joint_range: float
    motor_turns: float
    temperature_span: float
    acceleration_snr: dict[str, float]
    saturated: float = 0.0
    repetition: float = 0.0
    speed_variety: float = np.inf
    compliance_error: float = 0.0
    too_short: tuple[str, ...] = ()

    @property
    def speed_decades(self) -> float:
        """Decades between the 5 % and the 99 % quantile of the sliding speed."""
        return float(np.log10(self.fast_speed / self.slow_speed)) if self.slow_speed > 0.0 else 0.0

    def covered(self, rated_torque: float | None) -> Covered:
        """What effects ask of a recording; `rated_torque` N m of the gear, None where it is not known."""
        return Covered(
            torque_low=self.torque_low,
            torque_high=self.torque_high,
            rated_torque=rated_torque,
            joint_range=self.joint_range,
            motor_turns=self.motor_turns,
            temperature_span=self.temperature_span,
            repetition=self.repetition,
            speed_variety=self.speed_variety,
            speed_decades=self.speed_decades,
        )


def coverage(equations: JointEquations) -> Coverage:
    """Coverage of the usable part of one joint's recording."""
    d, s = equations.derived, equations.states
    use = d.usable
    speed = np.abs(d.motor_velocity[use & d.sliding])
    slow, fast = np.quantile(speed, [0.05, 0.99]) if speed.size > 50 else (0.0, 0.0)
    forward = float(np.mean(d.motor_velocity[use & d.sliding] > 0.0)) if speed.size else 0.0
    torque = s.joint_torque[use]
    low, high = np.quantile(torque, [0.02, 0.98]) if use.any() and np.isfinite(torque).all() else (0.0, 0.0)
    temperature = s.temperature[use]
    measured = bool(use.any()) and bool(np.isfinite(temperature).all())
    return Coverage(
        duration=float(use.sum()) * s.period,
        moving=float(speed.size) * s.period,
        slow_speed=float(slow),
        fast_speed=float(fast),
        both_directions=0.1 < forward < 0.9,
        reversals=int(reversals(d.motor_velocity, d.speed_threshold).size),
        torque_low=float(low),
        torque_high=float(high),
        joint_range=float(np.ptp(s.joint_position[use])) if use.any() else 0.0,
        motor_turns=float(np.ptp(s.motor_shaft_position[use])) / (2 * np.pi) if use.any() else 0.0,
        temperature_span=float(np.ptp(temperature)) if measured else 0.0,
        acceleration_snr={name: channel.snr for name, channel in equations.channels.items()},
        saturated=_saturated(equations),
        repetition=_repetition(d.motor_velocity, s.period),
        speed_variety=_variety(speed),
        too_short=equations.too_short,
    )


def _saturated(equations: JointEquations) -> float:
    torque = equations.derived.filled.get("motor_torque")
    used = np.zeros(0) if torque is None else np.abs(torque[equations.derived.usable])
    return float(np.mean(used > 0.995 * used.max())) if used.size and used.max() > 0.0 else 0.0


def _repetition(velocity: FloatArray, period: float) -> float:
    """Largest autocorrelation of the speed at delays from 1 s to half of the recording."""
    step = max(1, round(0.02 / period))
    x = velocity[::step] - velocity[::step].mean()
    spectrum = np.fft.rfft(x * np.hanning(x.size), 4 * x.size)
    correlation = np.fft.irfft(np.abs(spectrum) ** 2)[: x.size // 2]
    later = correlation[round(1.0 / (step * period)) :]
    return float(later.max() / correlation[0]) if later.size and correlation[0] > 0.0 else 0.0


def _variety(speed: FloatArray) -> float:
    if speed.size == 0:
        return 0.0
    share = np.histogram(np.log10(np.maximum(speed, 1e-6)), np.arange(-6.0, 2.01, 0.25))[0] / speed.size
    share = share[share > 0.0]
    return float(np.exp(-(share * np.log(share)).sum()))


@dataclass(frozen=True)
class Shortfall:
    """One thing that is missing in a recording: what, for which channels nothing can be said, and what to record."""

    what: str
    channels: tuple[str, ...]
    purpose: str
    how: str


_SPEEDS = "constant speeds or a triangular velocity in both directions, log-spaced from 0.03 to 1 rad/s, at least 25 s"
_CHIRP = "a sum of sines from 0.1 to 2.5 Hz (22 s) and a chirp from 0.3 to 20 Hz (13 s), both within the robot's limits"


@dataclass(frozen=True)
class Gates:
    """What a form of diagnosis needs at least: decades of speed, power of the acceleration over its noise."""

    decades: float = SPEED_DECADES
    acceleration: float = ACCELERATION_SNR


def shortfalls(found: Coverage, gates: Gates = Gates()) -> list[Shortfall]:
    """What is missing for a full diagnosis, most important first. Empty for a recording that can decide."""
    everything = (MOTOR, TRANSMISSION, LINK)
    missing: list[Shortfall] = []
    if found.duration < DURATION_S or found.moving < 0.5 * DURATION_S:
        what = f"only {found.duration:.1f} s of usable recording, {found.moving:.1f} s of them in motion"
        missing.append(Shortfall(what, everything, "enough data", f"60 s: {_SPEEDS}; then {_CHIRP}"))
    for name in found.too_short:
        what = f"too little sliding motion for the {name.replace('_', ' ')} balance"
        missing.append(Shortfall(what, (name,), "friction and inertia", f"60 s: {_SPEEDS}; then {_CHIRP}"))
    if found.saturated > SATURATED:
        what = f"the motor torque is at its limit for {100 * found.saturated:.0f} % of the time"
        missing.append(Shortfall(what, everything, "torques that the drive can follow", _CHIRP))
    if found.repetition > REPETITION and found.speed_variety < SPEED_VARIETY:
        what = "the same few moves again and again: nothing that is held out is new"
        missing.append(Shortfall(what, everything, "motion that does not repeat", f"{_SPEEDS}; then {_CHIRP}"))
    if found.reversals < REVERSALS or not found.both_directions:
        what = f"{found.reversals} changes of direction" + ("" if found.both_directions else ", motion mostly one way")
        missing.append(Shortfall(what, (MOTOR, LINK), "friction against offsets and load", _SPEEDS))
    if found.speed_decades < gates.decades:
        what = (
            f"speeds from {found.slow_speed:.3g} to {found.fast_speed:.3g} rad/s only "
            f"({found.speed_decades:.2f} decades, {gates.decades:g} needed)"
        )
        missing.append(Shortfall(what, (MOTOR, LINK), "the shape of friction over speed", _SPEEDS))
    for name in (MOTOR, LINK):
        snr = found.acceleration_snr.get(name)
        if snr is not None and snr < gates.acceleration:
            what = f"acceleration {snr:.1f} times its noise in power ({gates.acceleration:g} needed)"
            missing.append(Shortfall(what, (name,), "inertia against friction and delays", _CHIRP))
    if TRANSMISSION in found.acceleration_snr and found.compliance_error > COMPLIANCE_ERROR:
        what = f"stiffness within {100 * found.compliance_error:.0f} % only"
        missing.append(Shortfall(what, (TRANSMISSION,), TORSION, RAMPS))
    return missing


def unsupported(effect: type[Effect], found: Coverage, rated_torque: float | None) -> Shortfall | None:
    """Why this recording cannot carry a claim of that effect: the first of its needs that is not met; None if all are.

    `rated_torque` N m of the gear, None where it is not known.
    """
    covered = found.covered(rated_torque)
    unmet = ((need.unmet(covered), need) for need in effect.needs())
    return next((Shortfall(what, (), need.purpose, need.how) for what, need in unmet if what), None)
