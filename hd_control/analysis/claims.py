"""What may be said of a selection: which names stand, how sure they are, and what is unknown."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace

import numpy as np

from hd_control.analysis.confidence import LEAST, confidence
from hd_control.analysis.fit import Fit, RawRows
from hd_control.analysis.groups import Group
from hd_control.analysis.leftover import bursts
from hd_control.analysis.search import Search, Selection
from hd_control.analysis.verdict import NamedEffect, Unknown

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
