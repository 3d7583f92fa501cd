"""What may be said of a selection: which names stand, how sure they are, and what is unknown.

It rests on what is left after the fit (bursts in time, whiteness of the residual) and on what a name gains beside the
strongest effect.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace

import numpy as np

from hd_control.core.arrays import BoolArray, FloatArray
from hd_control.drive.effect import MOTOR
from hd_control.lab.balances.states import count_tone
from hd_control.lab.diagnosis.candidates import Group
from hd_control.lab.diagnosis.fit import Fit, RawRows
from hd_control.lab.diagnosis.search import Search, Selection
from hd_control.lab.diagnosis.verdict import NamedEffect, Unknown
from hd_control.lab.signals.joint_signals import quantum

# ---- What is left after the fit --------------------------------------------------------------------


BURST_BLOCK_S = 0.33
BURST_Z = 9.0
BURSTS_LEAST = 2


@dataclass(frozen=True)
class Bursts:
    """Where in time a channel's residual is far above its noise: z of the worst block and the times, s."""

    channel: str
    worst: float
    times: tuple[float, ...]

    @property
    def found(self) -> bool:
        """True if enough blocks stick out."""
        return len(self.times) >= BURSTS_LEAST


def bursts(fit: Fit) -> list[Bursts]:
    """Chi-square per block of 0.33 s, Wilson-Hilferty, robust centre and scale, by channel."""
    found = []
    for name, residual in fit.residuals().items():
        part = fit.dictionary.rows[name]
        smooth = ~_staircase(fit, name)
        residual = residual[smooth]
        block = np.floor(part.time[smooth] / BURST_BLOCK_S).astype(np.int64)
        _, inverse, counts = np.unique(block, return_inverse=True, return_counts=True)
        mean = np.bincount(inverse, residual**2) / counts
        enough = counts >= 8
        if enough.sum() < 8:
            continue
        spread = np.sqrt(2.0 / (9.0 * counts))
        z = (np.cbrt(mean) - (1.0 - spread**2)) / spread
        centre = float(np.median(z[enough]))
        scale = max(1.0, 1.4826 * float(np.median(np.abs(z[enough] - centre))))
        z = np.where(enough, (z - centre) / scale, 0.0)
        start = np.bincount(inverse, part.time[smooth]) / counts
        found.append(Bursts(name, float(z.max()), tuple(start[z > BURST_Z].tolist())))
    return found


def _staircase(fit: Fit, name: str) -> BoolArray:
    """Rows (rows,) at which the counts of an angle are a tone in the channel's band."""
    equations, part = fit.dictionary.equations, fit.dictionary.rows[name]
    states, zero = equations.states, part.channel.band.zero
    index = np.flatnonzero(part.usable) * part.channel.band.step
    slow = count_tone(states.motor_velocity[index], quantum(states.motor_position), states.period, zero)
    if name != MOTOR:
        joint = equations.derived.filled["joint_position"]
        slow |= count_tone(states.joint_velocity[index], quantum(joint), states.period, zero)
    return slow


@dataclass(frozen=True)
class Whiteness:
    """Mean square of the whitened residual (1 = noise) and its largest autocorrelation at lags 1 to 40, in units of
    its standard error."""

    mean_square: float
    correlation: float


def whiteness(residuals: Mapping[str, FloatArray]) -> dict[str, Whiteness]:
    """Whiteness by channel."""
    found = {}
    for name, r in residuals.items():
        if r.size < 200:
            continue
        centred = r - r.mean()
        power = float(centred @ centred)
        lags = [float(centred[lag:] @ centred[:-lag]) / power * np.sqrt(r.size) for lag in range(1, 41)]
        found[name] = Whiteness(float(np.mean(r**2)), float(np.max(np.abs(lags))))
    return found


# ---- How sure a name is ----------------------------------------------------------------------------
#
# The weights are fitted on random drives whose seeds are kept for calibration (docs/challenge.md).


WEIGHTS = (-2.5, 1.8, 1.1, -3.3)
"""Offset, log10 of the gain, log10 of it over the strongest gain on its channels, something unknown left (logistic)."""
LARGEST_GAIN, SMALLEST_SHARE = 1e4, 1e-4
LEAST = 0.5
"""A name that is less likely right than wrong is not said."""


def features(gain: float, strongest: float, unknown: bool) -> tuple[float, float, float, float]:
    """(1, log10 gain, log10 share of the strongest gain on its channels, 1 if something unknown is left)."""
    share = float(np.clip(gain / strongest, SMALLEST_SHARE, 1.0)) if strongest > 0.0 else 1.0
    return 1.0, float(np.log10(np.clip(gain, 1.0, LARGEST_GAIN))), float(np.log10(share)), float(unknown)


def confidence(gain: float, strongest: float, unknown: bool) -> float:
    """Probability in [0, 1] that the named effect is the missing one. Gains in nats."""
    score = float(np.dot(WEIGHTS, features(gain, strongest, unknown)))
    return 1.0 / (1.0 + float(np.exp(-score)))


# ---- The claims ------------------------------------------------------------------------------------


HIGHER = 1.02
"""A name whose effect makes the held-out error of its channel larger by this factor is withdrawn."""


def refuted(claim: NamedEffect, group: Group, without: Mapping[str, float], whole: Mapping[str, float]) -> str | None:
    """Why a name does not stand, in words; None if it does: it raises the error, or asks for an impossible value.

    `without`, `whole`: held-out errors by channel of the selection without and with the group.
    """
    assert group.effect is not None
    if whole[claim.channel] > HIGHER * without[claim.channel]:
        return (
            f"{claim.name} was withdrawn: it makes the held-out error of the {claim.channel.replace('_', ' ')} larger"
        )
    for parameter in group.effect.parameters:
        found = claim.parameters.get(parameter.name)
        if found is not None and (found.high < parameter.low or found.low > parameter.high):
            value = f"{parameter.name.replace('_', ' ')} {found.value:.3g} {parameter.unit}".rstrip(" -")
            return f"{claim.name} was withdrawn: what is left looks like it only with an impossible {value}"
    return None


def beside(search: Search, selection: Selection) -> dict[str, float]:
    """What the strongest other effect, selected or in the model already, gains on the channels of each, nats: no law is
    exact, and what it leaves on its channels looks like weak effects there."""
    index = search.index(selection)
    whole = search.scores.channel_losses(index)
    laws = [group for group in (*selection, *search.dictionary.known) if not group.is_curve]
    gains = {}
    for law in laws:
        without = search.scores.channel_losses(np.setdiff1d(index, law.index))
        gains[law.name] = {name: without[name] - whole[name] for name in law.channels}

    def on_channels_of(group: Group, law: Group) -> float:
        return sum(max(0.0, gains[law.name].get(name, 0.0)) for name in group.channels)

    return {g.name: max((on_channels_of(g, law) for law in laws if law is not g), default=0.0) for g in selection}


def sure(
    effects: tuple[NamedEffect, ...], unknown: Unknown | None, channels: Mapping[str, tuple[str, ...]]
) -> tuple[NamedEffect, ...]:
    """The effects with their probabilities, without those that are more likely wrong than right."""
    said = []
    for effect in effects:
        left = unknown is not None and unknown.channel in channels.get(effect.name, (effect.channel,))
        effect = replace(effect, unknown_beside=left)
        probability = confidence(effect.gain, max(effect.gain, effect.beside), left)
        if probability >= LEAST:
            said.append(replace(effect, confidence=probability))
    return tuple(said)


def _lowers(group: Group, raw: RawRows, search: Search) -> bool:
    """True if a curve lowers the held-out error of one of its channels, in the unit of the channel."""
    rest = tuple(g for g in raw.groups if g is not group)
    before, after = raw.held_out_errors(search.scores, rest), raw.held_out_errors(search.scores, raw.groups)
    return any(after[name] < before[name] for name in group.channels)


def unknown_in(fit: Fit, raw: RawRows, search: Search, selection: Selection, blocked: set[str]) -> Unknown | None:
    """Free curves that survived, or bursts in time that no selected effect explains."""
    left = [g for g in selection if g.curve is not None and not set(g.channels) <= blocked and _lowers(g, raw, search)]
    if left:
        gains = [search.support(g, tuple(h for h in selection if h is not g)).gain for g in left]
        group = left[int(np.argmax(gains))]
        assert group.curve is not None
        channel = group.channels[0]
        variables = group.curve.variables
        words = " and ".join(v.replace("_", " ") for v in variables)
        text = f"{channel.replace('_', ' ')}: the residual depends on {words}"
        return Unknown(channel, variables, f"{text} ({max(gains):.0f} nats held out); no effect of the library fits")
    for burst in bursts(fit):
        if burst.found and burst.channel not in blocked:
            times = ", ".join(f"{t:.1f}" for t in burst.times[:8])
            text = (
                f"{burst.channel.replace('_', ' ')}: bursts at {times} s (worst {burst.worst:.0f} standard deviations)"
            )
            return Unknown(burst.channel, ("time",), text)
    return None
