"""Torsion of spring and damper in parallel: tau_s / (k (1 + d s)), exact in d, and the torque of the spring alone.

    q - phi = -tau_s / (k (1 + d s)) + zero                                    s: derivative, d: damper over stiffness
            ~ -(1/k) tau_s / (1 + d0 s) + ((d - d0) / k) s tau_s / (1 + d0 s)^2 + zero        around a guess d0

The coefficients of the two columns are 1/k and (d - d0) / k; a few rounds bring d0 to d.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from hd_control.core.arrays import BoolArray, FloatArray
from hd_control.drive.effect import TRANSMISSION, DriveStates
from hd_control.drive.shapes import harmonics
from hd_control.lab.balances.channels import Base, Channel, JointEquations
from hd_control.lab.balances.states import noise_density
from hd_control.lab.signals.filters import Band, Spectral, band_for

SIGNAL_DELAY_PRIOR = 5e-4
"""s, standard deviation of delays between recorded signals that nobody declared; carried along, never a claim. The
delay of the gauge is one number in the rotor and the link balance."""
LONGEST_DAMPING = 0.02
BANDS = ((80.0, 122.0), (38.0, 60.0), (25.0, 40.0), (15.0, 24.0), (8.0, 13.0))
"""Hz, flat and zero, of the transmission."""
ANGLES: dict[str, tuple[int, ...]] = {"motor_position": (1,), "joint_position": (1,)}
"""Angles of the transmission, with the harmonics of their counts that matter."""
TOP_SNR = 3.0
"""Power of the torque over the stiffness over that of the torsion's noise, at the top of the band."""
FAST = "fast_torque"
FAST_PRIOR = 0.2
"""Standard deviation of the fast part's own compliance over the compliance."""
GEAR_ORDERS = (1, 2, 3, 4)
FEWEST_TURNS = 4.0
"""Turns of the wave generator from which on its waves are separable from motion and torque."""
SPRING_BAND = (60.0, 95.0)
"""Hz, of the torque that drives hysteresis and other torsion laws: wide, for its reversals must not be late."""


def torsion_base(
    spectral: Spectral, states: DriveStates, joint_position: FloatArray, band: Band, damping: float
) -> tuple[Base, ...]:
    """Columns of every model in the transmission: torsion at `damping` s, its change with it, zero, nuisances.

    Noise of the gauge biases the coefficient of the fast part of the torque towards zero; the slow part keeps its own.
    """
    lag = _lag(spectral, damping)
    torque = spectral.transform(states.gauge_torque)
    raw = spectral.back(*torque, band, 0, lag)[:, 0]
    slope = spectral.back(*torque, band, 1, np.asarray(lag * lag, dtype=np.complex128))[:, 0]
    return (
        Base("torsional_compliance", -raw),
        Base("torsional_damping", slope),
        Base("transmission_zero", np.ones(raw.size)),
        Base(FAST, raw - spectral.back(*torque, _lower(band), 0, lag)[:, 0], _fast_prior(states)),
        Base("joint_delay", spectral.filter(joint_position, band, 1), SIGNAL_DELAY_PRIOR),
    )


def _fast_prior(states: DriveStates) -> float:
    return FAST_PRIOR * states.torsional_compliance if states.torsional_compliance > 0.0 else np.inf


def torsion_band(
    spectral: Spectral, torsion: FloatArray, torque: FloatArray, quiet: Callable[[Band], BoolArray]
) -> Band:
    """The widest band at whose top the torque over the stiffness still stands out of the noise of the torsion.

    Beyond it the loop's answer to the encoder's noise is a larger part of the torque than the motion is. That noise is
    in the torsion too, so both are correlated, and not by the spring. `torsion` rad, `torque` N m (n,); `quiet`: rows
    to judge on.
    """
    period = spectral.period
    density = 2.0 * period * noise_density(torsion, period) ** 2
    slow = [spectral.filter(signal, Band(*BANDS[-1])) for signal in (torque, torsion)]
    for flat, zero in BANDS[:-1]:
        band = band_for(period, flat, zero)
        rows = quiet(band)
        x, y = (signal[rows] - signal[rows].mean() for signal in slow)
        compliance = -float(x @ y) / max(float(x @ x), 1e-300)
        upper, lower = Band(band.flat, 1.2 * band.flat), Band(0.75 * band.flat, 0.9 * band.flat)
        top = (spectral.filter(torque, upper) - spectral.filter(torque, lower))[rows]
        f = np.linspace(0.0, 1.2 * band.flat, 400)
        noise = density * float(np.trapezoid((upper.gain(f) - lower.gain(f)) ** 2, f))
        if top.size and compliance**2 * float(top @ top) / top.size >= TOP_SNR * noise:
            return band
    return band_for(period, *BANDS[-1])


class GearWaves:
    """Waves of the turning wave generator, kinematic error or ripple of the gauge: nuisances of a first guess.

    Beside a light link the ripple may be most of what the gauge shows, and torsion knows nothing of it.
    """

    def __init__(self, spectral: Spectral, states: DriveStates, band: Band) -> None:
        self.spectral, self.band = spectral, band
        angle = states.motor_shaft_position
        turned = np.ptp(angle) >= 2.0 * np.pi * FEWEST_TURNS
        self._waves = spectral.transform(harmonics(angle, GEAR_ORDERS), np.float32) if turned else None

    def at(self, damping: float) -> FloatArray:
        """What they do to the torsion columns at `damping` s, (rows, k); k = 0 where the wave generator turns too
        little to separate them from the motion."""
        if self._waves is None:
            return np.empty((self.spectral.rows(self.band), 0))
        lag = _lag(self.spectral, damping)
        parts = (self.spectral.back(*self._waves, self.band, power, lag ** (power + 1)) for power in (0, 1))
        return np.concatenate([*parts], axis=1)


def compliance_of(channel: Channel, waves: FloatArray) -> tuple[float, float]:
    """(1/k rad/(N m), change of d s) of a least-squares fit of base and `waves` (rows, k); (0, 0) if no spring."""
    columns = np.concatenate([channel.base_matrix, waves], axis=1)[channel.valid]
    if not len(columns):
        return 0.0, 0.0
    scale = np.sqrt((columns**2).mean(axis=0)) + 1e-300
    solution = np.linalg.lstsq(columns / scale, channel.left[channel.valid], rcond=None)[0] / scale
    return (float(solution[0]), float(solution[1] / solution[0])) if solution[0] > 0.0 else (0.0, 0.0)


def with_spring(states: DriveStates, spectral: Spectral, channel: Channel | None) -> DriveStates:
    """The states with the torque that the spring carries without the damper, and compliance and damping as measured."""
    if channel is None:
        return states
    band = band_for(spectral.period, *SPRING_BAND)
    spring = spectral.filter(states.gauge_torque, Band(band.flat, band.zero), 0, _lag(spectral, channel.damping_time))
    compliance, damping = channel.compliance, channel.damping_time
    return replace(states, spring_torque=spring, torsional_compliance=compliance, damping_time=damping)


def with_lost_torsion(
    states: DriveStates, spectral: Spectral, damping: float, damper: float, lost: FloatArray
) -> DriveStates:
    """The states with the torque of the spring where its torsion is tau / k + `lost` (n,) rad: the damper, `damper`
    N m s, carries a part for that torsion's rate too: spring torque = (tau_s - damper s lost) / (1 + d s)."""
    band = band_for(spectral.period, *SPRING_BAND)
    band, lag = Band(band.flat, band.zero), _lag(spectral, damping)
    torque = spectral.filter(states.gauge_torque, band, 0, lag)
    return replace(states, spring_torque=torque - damper * spectral.filter(lost, band, 1, lag))


def with_damping(equations: JointEquations, damping: float) -> JointEquations:
    """The same equations with the torsion taken at another damping time, s."""
    channel, states = equations.channels[TRANSMISSION], equations.states
    joint = equations.derived.filled["joint_position"]
    base = torsion_base(equations.spectral, states, joint, channel.band, damping)
    channel = replace(channel, base=base, damping_time=damping)
    compliance = states.torsional_compliance
    states = replace(with_spring(states, equations.spectral, channel), torsional_compliance=compliance)
    return replace(equations, states=states, channels={**equations.channels, TRANSMISSION: channel})


def _lower(band: Band) -> Band:
    return Band(0.45 * band.flat, 0.7 * band.flat, band.step)


def _lag(spectral: Spectral, damping: float) -> NDArray[np.complex128]:
    """Spring over whole torque: 1 / (1 + d s)."""
    return np.asarray(1.0 / (1.0 + 2j * np.pi * spectral.frequency * damping), dtype=np.complex128)
