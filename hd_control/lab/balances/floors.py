"""The noise that the sensors alone leave in a balance: on data that it has not seen, no model can have a smaller error.

    floor^2 = integral of gain(f)^2 (S_u + S_tau + ((2 pi f)^2 I)^2 S_phi) df          rotor balance, I its inertia
    floor^2 = integral of gain(f)^2 (S_tau + ((2 pi f)^2 J)^2 S_q) df                  link balance, J its inertia
    floor^2 = integral of gain(f)^2 (S_q + S_phi + S_tau / k^2) df                     transmission

S are the densities of the sensors (`signals/sensors.py`), gain is that of the balance's band. A torque that was
smoothed has no measured density; its floor comes from what a fitted model leaves below its cut-off (`smoothed_floor`).
"""

from __future__ import annotations

from collections.abc import Mapping
from itertools import pairwise

import numpy as np

from hd_control.core.arrays import FloatArray
from hd_control.drive.effect import LINK, MOTOR, TRANSMISSION
from hd_control.lab.balances.channels import Channel, JointEquations
from hd_control.lab.signals.filters import fill_gaps
from hd_control.lab.signals.sensors import Segments, SensorQuality

GRID = 400
TORQUES = {MOTOR: ("motor_torque", "gauge_torque"), LINK: ("gauge_torque",), TRANSMISSION: ("gauge_torque",)}
"""Torques whose noise is in a balance."""
PARTS = np.linspace(0.3, 0.9, 4)
"""Edges of the parts below a cut-off, over it, of which the quietest counts."""


def sensor_floor(equations: JointEquations, name: str, qualities: Mapping[str, SensorQuality]) -> float:
    """RMS of the sensors' noise in a balance, in its unit."""
    channel, ratio = equations.channels[name], equations.states.gear_ratio
    frequency = np.linspace(0.0, channel.band.zero, GRID)
    square = (2.0 * np.pi * frequency) ** 2

    def density(signal: str) -> float:
        quality = qualities.get(signal)
        return 0.0 if quality is None else quality.floor_density

    torque = sum(density(signal) * _recorded_as(signal, qualities, frequency) for signal in TORQUES[name])
    joint = density("joint_position")
    motor = density("motor_shaft_position") / ratio**2 if "motor_shaft_position" in qualities else joint
    if name == TRANSMISSION:
        power = joint + motor + channel.compliance**2 * torque + 0.0 * square
    elif name == LINK:
        power = torque + (link_inertia(equations) * square) ** 2 * joint
    else:
        inertia = equations.inertia
        if "gauge_torque" in equations.substituted:
            inertia += link_inertia(equations)
        power = torque + (inertia * square) ** 2 * motor
    return float(np.sqrt(np.trapezoid(channel.band.gain(frequency) ** 2 * power, frequency)))


def _recorded_as(signal: str, qualities: Mapping[str, SensorQuality], frequency: FloatArray) -> FloatArray:
    """Share of a sensor's noise power (k,) that its column has: a motor torque is held over a tick, or its mean."""
    if signal != "motor_torque" or signal not in qualities:
        return np.ones_like(frequency)
    quality = qualities[signal]
    turned = frequency / quality.rate
    return np.asarray(np.sinc(turned) ** 2 * (np.cos(np.pi * turned) ** 2 if quality.averaged else 1.0))


def link_inertia(equations: JointEquations) -> float:
    """kg m^2 that the link shows to its joint on average along the recording; 0 if it is not known."""
    s, use = equations.states, equations.derived.usable
    torque, acceleration = s.link_inertia_torque[use], s.joint_acceleration[use]
    square = float(acceleration @ acceleration)
    return abs(float(torque @ acceleration)) / square if square > 0.0 and np.isfinite(torque).all() else 0.0


def smoothed_floor(channel: Channel, residual: FloatArray, qualities: Mapping[str, SensorQuality]) -> float:
    """RMS of the noise of a balance one of whose torques was smoothed, from what a fitted model leaves: `residual`
    (rows,) in the quietest part below the cut-off. 0 if none was smoothed, or the recording is too short."""
    cuts = [qualities[signal].smoothed_above for signal in TORQUES[channel.name] if signal in qualities]
    cut = min(cuts, default=np.inf)
    if not np.isfinite(cut):
        return 0.0
    left = fill_gaps(np.where(channel.fitted, residual, np.nan))
    spectra = Segments.of([left], channel.band.step * channel.spectral.period, 4)
    if spectra is None:
        return 0.0
    frequency, power, top = spectra.frequency, spectra.power(0), min(cut, channel.band.flat)
    parts = [power[(frequency >= low * top) & (frequency < high * top)] for low, high in pairwise(PARTS.tolist())]
    density = min((float(np.median(part)) for part in parts if part.size), default=0.0)
    return min(float(np.sqrt(density * top)), float(np.std(residual[channel.fitted])))
