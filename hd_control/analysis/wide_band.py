"""The transmission's residual over the widest band, for order spectra: a fit wants the band in which the torque stands
out of the noise, a line of an order wants every speed at which it can be seen.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from hd_control.analysis.bands import band_for
from hd_control.analysis.channels import Channel, JointEquations
from hd_control.analysis.counts import noisy_rows
from hd_control.analysis.fit import Fit, RawRows
from hd_control.analysis.orders import OrderRecord, channel_record
from hd_control.analysis.torsion import ANGLES, BANDS, torsion_base
from hd_control.core.arrays import FloatArray
from hd_control.drive.effect import TRANSMISSION


def order_record(fit: Fit, name: str, coefficients: FloatArray) -> OrderRecord:
    """The residual of a channel over turns; `coefficients` (p,) of base and known groups of a fit, physical units."""
    equations = fit.dictionary.equations
    if name == TRANSMISSION:
        equations = with_wide_transmission(equations)
    dictionary = replace(fit.dictionary, equations=equations)
    channel = equations.channels[name]
    return channel_record(equations, name, RawRows(dictionary, ()).residual(coefficients)[name], channel.fitted)


def with_wide_transmission(equations: JointEquations) -> JointEquations:
    """The same equations with the transmission over the widest band that the rate carries."""
    old, spectral, filled = equations.channels[TRANSMISSION], equations.spectral, equations.derived.filled
    band = band_for(spectral.period, *BANDS[0])
    if band.zero <= old.band.zero:
        return equations
    base = torsion_base(spectral, equations.states, filled["joint_position"], band, old.damping_time)
    left = spectral.filter(filled["joint_position"] - filled["motor_position"], band)
    time = equations.states.time[:: band.step]
    every = np.ones(time.size, dtype=bool)
    wide = Channel(TRANSMISSION, band, spectral, time, every, left, base, None, old.snr, old.damping_time)
    valid = ~wide.blurred(~equations.derived.usable)
    noisy = noisy_rows(equations.derived, spectral.period, band, valid, ANGLES)
    wide = replace(wide, valid=valid, noisy=noisy)
    return replace(equations, channels={**equations.channels, TRANSMISSION: wide})
