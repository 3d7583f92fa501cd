"""Torsion of spring and damper in parallel: tau_s / (k (1 + d s)), exact in d, and the torque of the spring alone."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from hd_control.analysis.bands import Band, FloatArray, Spectral, band_for
from hd_control.analysis.channels import Base, Channel, JointEquations
from hd_control.drive.effect import TRANSMISSION, DriveStates

SIGNAL_DELAY_PRIOR = 5e-4
"""s, standard deviation of delays between recorded signals that nobody declared; carried along, never a claim. The
delay of the gauge is one number in the rotor and the link balance."""
LONGEST_DAMPING = 0.02
SLOW_BAND = Band(18.0, 30.0)
"""Hz, of the torque that tells the compliance: what motion is made of."""
FAST = "fast_torque"
FAST_SHIFTS = (-3, -2, -1, 0, 1, 2, 3)
"""Rows by which the fast torque is shifted."""
SPRING_BAND = (60.0, 95.0)
"""Hz, of the torque that drives hysteresis and other torsion laws: wide, for its reversals must not be late."""


def torsion_base(
    spectral: Spectral, states: DriveStates, joint_position: FloatArray, band: Band, damping: float
) -> tuple[Base, ...]:
    """Columns of every model in the transmission: torsion at `damping` s, its change with it, zero, nuisances.

    Noise of the gauge, and noise of the encoder that comes back through the controller, bias the coefficient of the
    fast part of the torque; the slow part keeps its own.
    """
    lag = _lag(spectral, damping)
    torque = spectral.transform(states.gauge_torque)
    raw = spectral.back(*torque, band, 0, lag)[:, 0]
    slope = spectral.back(*torque, band, 1, np.asarray(lag * lag, dtype=np.complex128))[:, 0]
    return (
        Base("torsional_compliance", -raw),
        Base("torsional_damping", slope),
        Base("transmission_zero", np.ones(raw.size)),
        *_fast_torque(spectral, states, band),
        Base("joint_delay", spectral.filter(joint_position, band, 1), SIGNAL_DELAY_PRIOR),
    )


def _fast_torque(spectral: Spectral, states: DriveStates, band: Band) -> list[Base]:
    """The torque above `SLOW_BAND` at some rows before and after each row.

    In it stands what the controller made of the encoder's noise, which is on the left side too: how both go together
    at each frequency is the controller's affair and no torsion.
    """
    slow = spectral.filter(states.gauge_torque, Band(SLOW_BAND.flat, SLOW_BAND.zero))
    fast = spectral.filter(states.gauge_torque - slow, band)
    found = []
    for shift in FAST_SHIFTS:
        moved = np.zeros_like(fast)
        if shift > 0:
            moved[shift:] = fast[:-shift]
        else:
            moved[: fast.size + shift] = fast[-shift:]
        found.append(Base(f"{FAST}{shift:+d}", moved))
    return found


def compliance_of(channel: Channel) -> tuple[float, float]:
    """(1/k rad/(N m), change of d s) of a least-squares fit of the base alone; (0, 0) if it is no spring."""
    columns = channel.base_matrix[channel.valid]
    if not len(columns):
        return 0.0, 0.0
    scale = np.sqrt((columns**2).mean(axis=0)) + 1e-300
    solution = np.linalg.lstsq(columns / scale, channel.left[channel.valid], rcond=None)[0] / scale
    return (float(solution[0]), float(solution[1] / solution[0])) if solution[0] > 0.0 else (0.0, 0.0)


def with_spring(states: DriveStates, spectral: Spectral, channel: Channel | None) -> DriveStates:
    """The states with the torque that the spring carries without the damper, and the compliance as measured."""
    if channel is None:
        return states
    band = band_for(spectral.period, *SPRING_BAND)
    spring = spectral.filter(states.gauge_torque, Band(band.flat, band.zero), 0, _lag(spectral, channel.damping_time))
    return replace(states, spring_torque=spring, torsional_compliance=compliance_of(channel)[0])


def with_lost_torsion(
    states: DriveStates, spectral: Spectral, damping: float, damper: float, lost: FloatArray
) -> DriveStates:
    """The states with the torque of the spring where its torsion is tau / k + `lost` (n,) rad: the damper, `damper`
    N m s, carries a part for that torsion's rate too."""
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


def _lag(spectral: Spectral, damping: float) -> NDArray[np.complex128]:
    """Spring over whole torque: 1 / (1 + d s)."""
    return np.asarray(1.0 / (1.0 + 2j * np.pi * spectral.frequency * damping), dtype=np.complex128)
