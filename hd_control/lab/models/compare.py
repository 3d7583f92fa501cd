"""How well a model explains a recording of one joint, channel by channel, as written and after refitting its values.

Beside the balances stand free runs (how far off a prediction is after 0.5 s and after 5 s) and, for order spectra, the
transmission over its widest band.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np

from hd_control.core.arrays import BoolArray, FloatArray
from hd_control.core.errors import ConfigError
from hd_control.drive.effect import TRANSMISSION, UNITS
from hd_control.drive.model import JointModel
from hd_control.drive.predict import HORIZONS, FreeRun, free_run
from hd_control.lab.balances.channels import Channel, JointEquations
from hd_control.lab.balances.floors import sensor_floor, smoothed_floor
from hd_control.lab.balances.link import LinkSide
from hd_control.lab.balances.noise import Noise
from hd_control.lab.balances.states import noisy_rows
from hd_control.lab.balances.torsion import ANGLES, BANDS, FAST, torsion_base
from hd_control.lab.diagnosis.corrections import Task, known_candidates, prepare
from hd_control.lab.diagnosis.dictionary import Dictionary, build
from hd_control.lab.diagnosis.fit import Fit, RawRows
from hd_control.lab.diagnosis.scores import Scores
from hd_control.lab.maps.orders import OrderRecord, channel_record
from hd_control.lab.signals.filters import band_for
from hd_control.lab.signals.joint_signals import JointSignals
from hd_control.lab.signals.sensors import SensorQuality

# ---- The transmission over its widest band ---------------------------------------------------------
#
# A fit wants the band in which the torque stands out of the noise, a line of an order wants every speed at which it
# can be seen.


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


# ---- Free runs -------------------------------------------------------------------------------------


SIGNALS = (
    ("motor_position", "rad"),
    ("joint_position", "rad"),
    ("joint_torque", "N m"),
)


@dataclass(frozen=True)
class Horizons:
    """Free runs by length of the window, s; `why_not`: why there are none, empty if there are."""

    runs: dict[float, FreeRun]
    why_not: str = ""

    def json(self) -> dict[str, Any]:
        """RMS errors at the end of the window, beside those of holding the start values."""
        found: dict[str, Any] = {}
        for length, run in self.runs.items():
            entry: dict[str, Any] = {"windows": run.windows, "clipped_share": run.clipped_share}
            for name, unit in SIGNALS:
                error, hold = getattr(run, f"rms_{name}"), getattr(run, f"hold_{name}")
                entry[name] = {"unit": unit, "rms_error": float(error[-1]), "rms_error_hold": float(hold[-1])}
            found[f"{length:g}"] = entry
        return found


def horizons(task: Task, signals: JointSignals, joint: JointModel, side: LinkSide) -> Horizons:
    """Predictions of all windows of one joint's recording by its model."""
    equations = task.equations
    if not np.isfinite(equations.states.motor_torque).any() or signals.motor_shaft_position is None:
        return Horizons({}, "a free run needs motor torque and motor position")
    link = side.own_link(signals.joint, equations.spectral)
    if link is None:
        return Horizons({}, side.why_not(signals.joint))
    runs = {}
    for length, every in HORIZONS:
        try:
            runs[length] = free_run(
                joint, equations.states, length, every, link, equations.derived.filled["motor_torque"],
                equations.derived.usable,
            )  # fmt: skip
        except ConfigError as error:
            return Horizons(runs, str(error))
    return Horizons(runs)


# ---- The comparison --------------------------------------------------------------------------------


NUISANCES = ("transmission_zero", FAST, "joint_delay", "torque_delay", "command_delay")


@dataclass(frozen=True)
class ChannelComparison:
    """One channel of one model on its rows: what is measured (the left side), the residual of the model as written and
    after refitting what it already has; arrays (rows,) in the unit of the channel, `used`: rows that count."""

    name: str
    time: FloatArray
    used: BoolArray
    measured: FloatArray
    residual: FloatArray
    refitted: FloatArray
    noise_floor: float
    worst: tuple[Mapping[str, Any], ...] = field(default=())

    @property
    def unit(self) -> str:
        """Unit of the channel."""
        return UNITS[self.name]

    @property
    def rms_measured(self) -> float:
        """RMS of the left side about its mean."""
        left = self.measured[self.used]
        return float(np.sqrt(np.mean((left - left.mean()) ** 2))) if left.size else float("nan")

    @property
    def rms_error(self) -> float:
        """RMS of the residual as written."""
        return _rms(self.residual[self.used])

    @property
    def rms_error_refitted(self) -> float:
        """RMS after refitting the values that the model has: a wrong value is not a missing effect."""
        return _rms(self.refitted[self.used])

    @property
    def structured_fraction(self) -> float:
        """Share of the residual's energy that is not noise."""
        error = self.rms_error
        return max(0.0, 1.0 - self.noise_floor**2 / error**2) if error > 0.0 else 0.0

    def json(self) -> dict[str, Any]:
        """The form of `hd.compare/1`."""
        measured = self.rms_measured
        return {
            "unit": self.unit,
            "rms_measured": measured,
            "rms_error": self.rms_error,
            "rms_error_refitted": self.rms_error_refitted,
            "error_percent": 100.0 * self.rms_error / measured if measured > 0.0 else None,
            "noise_floor": self.noise_floor,
            "max_error": float(np.max(np.abs(self.residual[self.used]), initial=0.0)),
            "structured_fraction": self.structured_fraction,
            "worst": [dict(item) for item in self.worst],
        }


@dataclass(frozen=True)
class JointComparison:
    """A model against one joint's recording. `coefficients` (p,): those of the model as written."""

    joint: str
    channels: Mapping[str, ChannelComparison]
    dictionary: Dictionary
    refit: Fit
    coefficients: FloatArray

    def order_record(self, channel: str, refitted: bool = False) -> OrderRecord:
        """A channel's residual over turns, as written or refitted, over the widest band."""
        return order_record(self.refit, channel, self.refit.coefficients if refitted else self.coefficients)

    @property
    def noises(self) -> dict[str, Noise]:
        """The noise of each channel."""
        return self.dictionary.noises


def noises_of(task: Task) -> dict[str, Noise]:
    """The noise of each channel: what the richest model does not explain."""
    return prepare(task).noises


def compare(
    task: Task,
    written: FloatArray | None,
    noises: Mapping[str, Noise] | None = None,
    sensors: Mapping[str, SensorQuality] | None = None,
) -> JointComparison:
    """Residuals of the model as written (coefficients of `task.written_coefficients`) and refitted.

    `sensors`: no noise floor falls below what they allow.

    The assembly zero of the joint sensor, small delays between signals and the noise of the gauge in the fast torsion
    are no properties of a model: they are always refitted.
    """
    noises = noises or noises_of(task)
    dictionary = build(task.equations, (), known_candidates(task), noises)
    scores = Scores(dictionary)
    fit = Fit.of(dictionary, scores, ())
    raw = RawRows(dictionary, ())
    refitted = raw.residual(fit.coefficients)
    coefficients = fit.coefficients if written is None else _with_nuisances(fit, written)
    residual = refitted if written is None else raw.residual(coefficients)
    found = {}
    for name, channel in task.equations.channels.items():
        floor = noises[name].deviation
        if sensors:
            allowed = sensor_floor(task.equations, name, sensors)
            floor = max(floor, allowed, smoothed_floor(channel, refitted[name], sensors))
        found[name] = ChannelComparison(
            name, channel.time, channel.fitted, channel.left, residual[name], refitted[name], floor
        )
    return JointComparison(task.equations.joint, found, dictionary, fit, coefficients)


def _with_nuisances(fit: Fit, written: FloatArray) -> FloatArray:
    """The written coefficients (p,) with those of `NUISANCES` fitted beside them.

    Twice: where the model leaves more than noise on a channel, that much is taken for its noise, or a delay that two
    channels share would follow the one that fails.
    """
    first = _nuisances(fit.dictionary, fit.scores, written)
    factors = {name: max(1.0, left) for name, left in _misfits(fit.dictionary, first).items()}
    quieter = {name: 1.0 / factor for name, factor in factors.items()}
    louder = fit.dictionary.louder(factors)
    return _nuisances(louder, fit.scores.moved(louder, columns=quieter, left=quieter), written)


def _nuisances(dictionary: Dictionary, scores: Scores, written: FloatArray) -> FloatArray:
    free = np.array([i for i, (_, name) in enumerate(dictionary.base_names) if name in NUISANCES], dtype=np.int64)
    held = np.setdiff1d(dictionary.base, free)
    left = scores.gram_all[np.ix_(free, free)] + np.diag(scores.ridge[free])
    scaled = written[held] * dictionary.norm[held]
    right = scores.right_all[free] - scores.gram_all[np.ix_(free, held)] @ scaled
    found = np.array(written, dtype=float)
    found[free] = np.linalg.solve(left, right) / dictionary.norm[free]
    return found


def _misfits(dictionary: Dictionary, coefficients: FloatArray) -> dict[str, float]:
    """RMS of the whitened residual by channel: 1 where only noise is left."""
    scaled = coefficients * dictionary.norm
    return {name: _rms(part.left - part.columns @ scaled[part.index]) for name, part in dictionary.rows.items()}


def _rms(x: FloatArray) -> float:
    return float(np.sqrt(np.mean(x**2))) if x.size else float("nan")
