"""The three balances of one joint as linear equations, row by row: what is measured, what is known, what is free.

    motor_torque    -I0 phi'' = -a (u_z - tau_s) + k_c s + k_v phi' + sum theta x       a = I0 / I*
    transmission     q - phi  = -tau_s / (k (1 + d s)) + c0         + sum theta x
    link_torque     -M q''    = -b (tau_s - g)                      + sum theta x       b = nominal / true inertia

The noisy derivative stands on the left: a noisy regressor would be biased towards zero and hand its loss to an innocent
effect, and a left side u - tau_s would make gain errors an identity. Where the motion has too little acceleration for
that (the left side would be noise, and a = 0 would explain it), the torque stands on the left, a = 1, and the inertia
enters as a correction with its prior.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace

import numpy as np

from hd_control.core.arrays import BoolArray, FloatArray
from hd_control.drive.effect import COULOMB, LINK, MOTOR, TRANSMISSION, VISCOUS, DriveStates
from hd_control.lab.balances.channels import Base, Channel, JointEquations, Known, LinkFunction, LinkTerms
from hd_control.lab.balances.noise import with_history
from hd_control.lab.balances.states import Derived, derive, drive_states, noise_density, noisy_rows
from hd_control.lab.balances.torsion import (
    ANGLES,
    LONGEST_DAMPING,
    SIGNAL_DELAY_PRIOR,
    GearWaves,
    compliance_of,
    torsion_band,
    torsion_base,
    with_spring,
)
from hd_control.lab.signals.filters import Band, Spectral, band_for
from hd_control.lab.signals.joint_signals import JointSignals

LINK_BAND = (30.0, 40.0)
"""Hz, flat and zero."""
MOTOR_BANDS = ((38.0, 60.0), (30.0, 48.5), (25.0, 40.5), (20.0, 32.5), (15.0, 24.3))
"""Hz. The first in which the acceleration stands out of its noise: encoder noise returns through the controller into u,
so that a noisy band shows delays that are not there."""
MOTOR_SNR = 200.0
TOP_SNR = 1.0
"""The same in the upper third of the band alone."""
MASK_MARGIN_S = 0.02
ACCELERATION_SNR = 10.0
"""Power ratio of acceleration to its noise from which on the acceleration may stand alone on the left."""

COMMAND_DELAY_PRIOR = 3e-5
TONE_ORDERS = (1, 2)
"""Harmonics of the encoder's counts that matter in the rotor balance."""
LEAST_ROWS = 250
"""A channel with fewer rows in motion that can be whitened is left out: noise and what is missing are not separable."""

DAMPING_ROUNDS = 3


def build_equations(signals: JointSignals, known: Known, link: LinkFunction | None) -> JointEquations:
    """The balances that the present signals allow. `link` gives the nominal link terms; None: there are none."""
    spectral = Spectral(signals.time.size, signals.period)
    derived = derive(signals, known.gear_ratio, spectral)
    states = drive_states(signals, known.gear_ratio, spectral, derived)
    substituted: list[str] = []
    terms = link(_link_band(signals.period), spectral) if link is not None else None
    if terms is not None:
        states = _with_link(states, terms, _link_band(signals.period))
        if signals.gauge_torque is None:
            torque = states.link_inertia_torque + states.link_bias_torque
            scale = float(np.quantile(np.abs(torque[derived.usable]), 0.98)) if derived.usable.any() else 1.0
            states = replace(states, gauge_torque=torque, joint_torque=torque, torque_scale=max(scale, 1e-9))
            substituted.append("gauge_torque")
    builder = _Builder(signals, known, spectral, derived, states, terms, tuple(substituted))
    every = (builder.motor(), builder.transmission(), builder.link())
    channels = {c.name: c for c in every if c is not None and (with_history(c.valid) & c.fitted).sum() >= LEAST_ROWS}
    too_short = tuple(c.name for c in every if c is not None and c.name not in channels)
    states = with_spring(states, spectral, channels.get(TRANSMISSION))
    return JointEquations(
        signals.joint, states, derived, spectral, channels, known.rotor_inertia, 1.0, builder.substituted, too_short
    )


def _link_band(period: float) -> Band:
    return band_for(period, *LINK_BAND)


def _with_link(states: DriveStates, terms: LinkTerms, band: Band) -> DriveStates:
    """The link terms at the rate of the recording, by cubic splines through the rows of the link channel."""
    from scipy.interpolate import CubicSpline

    time = states.time[:: band.step]

    def fine(rows: FloatArray | None) -> FloatArray | None:
        return None if rows is None else np.asarray(CubicSpline(time, rows, axis=0)(states.time))

    inertia, bias, own, tool = (fine(rows) for rows in terms)
    assert inertia is not None and bias is not None
    return replace(states, link_inertia_torque=inertia, link_bias_torque=bias, link_regressor=own, tool_regressor=tool)


@dataclass(frozen=True)
class _Builder:
    signals: JointSignals
    known: Known
    spectral: Spectral
    derived: Derived
    states: DriveStates
    terms: LinkTerms | None
    substituted: tuple[str, ...]

    def motor(self) -> Channel | None:
        """Balance of the rotor; with a substituted joint torque it is the balance of rotor and link together."""
        s, filled = self.signals, self.derived.filled
        if s.motor_torque is None or "gauge_torque" not in filled and "gauge_torque" not in self.substituted:
            return None
        if s.motor_shaft_position is None and "gauge_torque" not in self.substituted:
            return None
        sp, sliding = self.spectral, self.derived.usable & self.derived.sliding
        for taper in MOTOR_BANDS:
            band = band_for(s.period, *taper)
            acceleration, valid = sp.filter(filled["motor_position"], band, 2), self._valid(band, sliding)
            snr = self._snr(filled["motor_position"], band, acceleration, valid)
            if snr >= MOTOR_SNR and self._top_snr(filled["motor_position"], band, acceleration, valid) >= TOP_SNR:
                break
        held = sp.filter(filled["motor_torque"], band, 0, sp.hold(self.known.command_delay))
        if "gauge_torque" in self.substituted:
            assert self.terms is not None
            left = -self.known.rotor_inertia * acceleration - sp.filter(self.states.link_inertia_torque, band)
            drive = held - sp.filter(self.states.link_bias_torque, band)
        else:
            left = -self.known.rotor_inertia * acceleration
            drive = held - sp.filter(self.states.gauge_torque, band)
        friction = [
            Base(COULOMB, sp.filter(self.states.motor_direction, band)),
            Base(VISCOUS, sp.filter(self.states.motor_velocity, band)),
            Base("command_delay", sp.filter(filled["motor_torque"], band, 1, sp.hold()), COMMAND_DELAY_PRIOR),
        ]
        if "gauge_torque" in filled:
            friction.append(Base("torque_delay", -sp.filter(filled["gauge_torque"], band, 1), SIGNAL_DELAY_PRIOR, True))
        prior = self.known.rotor_inertia_prior
        channel = self._channel(MOTOR, band, valid, left, drive, friction, prior, snr)
        return replace(channel, noisy=self._noisy(band, valid, {"motor_position": TONE_ORDERS}))

    def _noisy(self, band: Band, valid: BoolArray, angles: Mapping[str, tuple[int, ...]]) -> BoolArray:
        return noisy_rows(self.derived, self.signals.period, band, valid, angles)

    def link(self) -> Channel | None:
        """Balance of the link side against the gauge."""
        if self.terms is None or self.signals.gauge_torque is None:
            return None
        band, sp = _link_band(self.signals.period), self.spectral
        left = -self.terms[0]
        drive = sp.filter(self.states.gauge_torque - self.states.link_bias_torque, band)
        valid = self._valid(band, self.derived.usable)
        position = self.derived.filled["joint_position"]
        snr = self._snr(position, band, sp.filter(position, band, 2), valid)
        delay = [Base("torque_delay", sp.filter(self.states.gauge_torque, band, 1), SIGNAL_DELAY_PRIOR, True)]
        channel = self._channel(LINK, band, valid, left, drive, delay, self.known.link_inertia_prior, snr)
        return replace(channel, noisy=self._noisy(band, valid, {"joint_position": (1,)}))

    def transmission(self) -> Channel | None:
        """Torsion against torque."""
        s, filled, sp = self.signals, self.derived.filled, self.spectral
        if (
            s.motor_shaft_position is None
            or s.joint_position is None
            or not np.isfinite(self.states.gauge_torque).all()
        ):
            return None
        torsion = filled["joint_position"] - filled["motor_position"]

        def quiet(band: Band) -> BoolArray:
            fine, usable = Band(band.flat, band.zero), self.derived.usable
            rows = np.asarray(usable & ~self._noisy(fine, usable, ANGLES))
            return rows if rows.any() else usable

        band = torsion_band(sp, torsion, self.states.gauge_torque, quiet)
        left = sp.filter(torsion, band)
        valid = self._valid(band, self.derived.usable)
        damping, waves = self.known.damping_time, GearWaves(sp, self.states, band)
        time = s.time[:: band.step]
        for _ in range(DAMPING_ROUNDS):
            base = torsion_base(sp, self.states, filled["joint_position"], band, damping)
            channel = Channel(TRANSMISSION, band, sp, time, valid, left, base, None, np.inf, damping)
            compliance, change = compliance_of(channel, waves.at(damping))
            damping = float(np.clip(damping + change, 0.0, LONGEST_DAMPING))
        states = replace(self.states, torsional_compliance=compliance)
        base = torsion_base(sp, states, filled["joint_position"], band, damping)
        noisy = self._noisy(band, valid, ANGLES)
        return Channel(TRANSMISSION, band, sp, time, valid, left, base, None, np.inf, damping, noisy, compliance)

    def _channel(
        self,
        name: str,
        band: Band,
        valid: BoolArray,
        left: FloatArray,
        drive: FloatArray,
        more: list[Base],
        prior: float,
        snr: float,
    ) -> Channel:
        time = self.signals.time[:: band.step]
        if snr >= ACCELERATION_SNR:
            base = (Base("drive_torque", -drive), *more)
            return Channel(name, band, self.spectral, time, valid, left, base, 0, snr)
        base = (Base("inertia_correction", -left, prior), *more)
        return Channel(name, band, self.spectral, time, valid, left + drive, base, None, snr)

    def _valid(self, band: Band, usable: BoolArray) -> BoolArray:
        """Rows whose surroundings are usable."""
        margin = round(max(MASK_MARGIN_S, band.support_s) / self.signals.period)
        bad = np.concatenate([[0], np.cumsum(~usable)])
        index = np.arange(0, usable.size, band.step)
        low, high = np.maximum(index - margin, 0), np.minimum(index + margin + 1, usable.size)
        return np.asarray(bad[high] == bad[low])

    def _top_snr(self, position: FloatArray, band: Band, acceleration: FloatArray, valid: BoolArray) -> float:
        """As `_snr`, of the upper third of the flat band."""
        lower = Band(0.55 * band.flat, 0.67 * band.flat, band.step)
        slow = self.spectral.filter(position, lower, 2)
        f = np.linspace(0.0, band.zero, 400)
        gain = band.gain(f) ** 2 - lower.gain(f) ** 2
        sigma = noise_density(position, self.signals.period)
        power = float(2.0 * self.signals.period * sigma**2 * np.trapezoid((2 * np.pi * f) ** 4 * gain, f))
        total = float(np.mean((acceleration - slow)[valid] ** 2)) if valid.any() else 0.0
        return max(0.0, total / power - 1.0) if power > 0.0 else np.inf

    def _snr(self, position: FloatArray, band: Band, acceleration: FloatArray, valid: BoolArray) -> float:
        """Power of the acceleration over the power that white position noise has in it."""
        sigma = noise_density(position, self.signals.period)
        f = np.linspace(0.0, band.zero, 400)
        weight = (2 * np.pi * f) ** 4 * band.gain(f) ** 2
        power = float(2.0 * self.signals.period * sigma**2 * np.trapezoid(weight, f))
        total = float(np.mean(acceleration[valid] ** 2)) if valid.any() else 0.0
        return max(0.0, total / power - 1.0) if power > 0.0 else np.inf
