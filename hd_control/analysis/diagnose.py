"""Which physical effect is missing in the model of one joint: gates, search, refinement, rivals, leftover, verdict."""

from __future__ import annotations

import time
from collections.abc import Mapping
from dataclasses import replace

import numpy as np

from hd_control.analysis.channels import JointEquations
from hd_control.analysis.confidence import LEAST, confidence
from hd_control.analysis.dictionary import Dictionary
from hd_control.analysis.fit import Fit, RawRows
from hd_control.analysis.gates import TORSION_SHAPES, Coverage, Lack, coverage, lacks, unsupported
from hd_control.analysis.groups import Group
from hd_control.analysis.hunt import Task, hunt
from hd_control.analysis.intervals import Bootstrap
from hd_control.analysis.leftover import bursts
from hd_control.analysis.reversal_rows import presliding
from hd_control.analysis.rivals import Rival, rivals
from hd_control.analysis.scores import Scores
from hd_control.analysis.search import Search, Selection
from hd_control.analysis.verdict import (
    ADEQUATE,
    CANNOT_TELL,
    MISSING,
    MISSING_AND_UNKNOWN,
    UNKNOWN,
    ChannelError,
    Experiment,
    JointDiagnosis,
    NamedEffect,
    Unknown,
)
from hd_control.drive.effect import MOTOR, TRANSMISSION, UNITS

HIGHER = 1.02
"""A name whose effect makes the held-out error of its channel larger by this factor is withdrawn."""


def diagnose(task: Task, dictionary: Dictionary | None = None) -> JointDiagnosis:
    """The verdict on one joint. `dictionary`: that of `hunt.prepare`, if it is there already."""
    start = time.process_time()
    found = coverage(task.equations)
    blocked = {name for lack in lacks(found) for name in lack.channels}
    open_channels = {name: c for name, c in task.equations.channels.items() if name not in blocked}
    if _hopeless(task.equations, found) or not open_channels:
        return _refusal(task, found, lacks(found), {}, time.process_time() - start)
    if len(open_channels) < len(task.equations.channels):
        task, dictionary = replace(task, equations=replace(task.equations, channels=open_channels)), None
    search, selection = hunt(task, dictionary)
    if TRANSMISSION in open_channels:
        found = replace(found, compliance_error=_compliance_error(search, selection))
    answer = _answer(task, found, lacks(found), search, selection)
    return replace(answer, seconds=time.process_time() - start)


def _compliance_error(search: Search, selection: Selection) -> float:
    """How well the motion tells the compliance: beside a law or curve of the torsion over torque it is one number of
    several of a curve, and says nothing of the motion."""
    bare = tuple(g for g in selection if TRANSMISSION not in g.channels or not _bends(g))
    return Fit.of(search.dictionary, search.scores, bare).relative_error(TRANSMISSION, "torsional_compliance")


def _bends(group: Group) -> bool:
    return group.name in TORSION_SHAPES if group.curve is None else group.curve.variable == "joint_torque"


def _hopeless(equations: JointEquations, found: Coverage) -> bool:
    """True if there are too few rows to fit anything."""
    return not equations.channels or found.duration < 3.0 or found.moving < 1.0


def _refusal(
    task: Task, found: Coverage, missing: list[Lack], channels: Mapping[str, ChannelError], seconds: float
) -> JointDiagnosis:
    return JointDiagnosis(
        joint=task.equations.joint,
        verdict=CANNOT_TELL,
        effects=(),
        unknown=None,
        experiments=_experiments(missing),
        channels=channels,
        coverage=found,
        notes=tuple(lack.what for lack in missing),
        seconds=seconds,
    )


def _experiments(missing: list[Lack]) -> tuple[Experiment, ...]:
    seen = dict.fromkeys((lack.purpose, lack.how) for lack in missing)
    return tuple(Experiment(purpose, how) for purpose, how in seen)


def _answer(task: Task, found: Coverage, missing: list[Lack], search: Search, selection: Selection) -> JointDiagnosis:
    """Names, unknowns, refusals: what may be said of the selection."""
    dictionary, scores = search.dictionary, search.scores
    fit = Fit.of(dictionary, scores, selection)
    raw = RawRows(dictionary, selection)
    channels = _errors(fit, raw, scores, selection)
    blocked = {name for lack in missing for name in lack.channels}
    effects, denied = _effects(task, found, search, fit, raw, blocked)
    effects += _near_reversals(task, fit, blocked)
    unknown = _unknown(fit, raw, search, selection, blocked)
    effects = _sure(effects, unknown is not None)
    experiments = list(_experiments([*missing, *denied]))
    for effect in effects:
        experiments += _separating(task, effect)
    verdict = _verdict(effects, unknown, bool(denied), blocked, {*found.acceleration_snr, *found.too_short})
    if verdict == CANNOT_TELL:
        effects, unknown = (), None
    notes = tuple(lack.what for lack in [*missing, *denied])
    seen = {(e.purpose, e.how): e for e in experiments}
    return JointDiagnosis(
        task.equations.joint, verdict, effects, unknown, tuple(seen.values()), channels, found, notes, fit
    )


def _verdict(
    effects: tuple[NamedEffect, ...], unknown: Unknown | None, denied: bool, blocked: set[str], channels: set[str]
) -> str:
    if effects:
        return MISSING_AND_UNKNOWN if unknown else MISSING
    if unknown:
        return UNKNOWN
    return CANNOT_TELL if denied or blocked & channels else ADEQUATE


def _errors(fit: Fit, raw: RawRows, scores: Scores, selection: Selection) -> dict[str, ChannelError]:
    before, after = raw.held_out_errors(scores, ()), raw.held_out_errors(scores, selection)
    found = {}
    for name, part in fit.dictionary.rows.items():
        channel = fit.dictionary.equations.channels[name]
        left = channel.left[part.usable]
        measured = float(np.sqrt(np.mean((left - left.mean()) ** 2))) if left.size else float("nan")
        found[name] = ChannelError(UNITS[name], measured, before[name], after[name], part.noise.deviation)
    return found


def _effects(
    task: Task, found: Coverage, search: Search, fit: Fit, raw: RawRows, blocked: set[str]
) -> tuple[tuple[NamedEffect, ...], list[Lack]]:
    """The selected library effects that the recording can carry, most important first; and what it cannot carry."""
    selection = fit.selection
    named = [group for group in selection if not group.is_curve]
    if not named:
        return (), []
    bootstrap = Bootstrap(fit)
    order: list[tuple[Group, float, float, tuple[Rival, ...]]] = []
    denied: list[Lack] = []
    for group in named:
        lack = unsupported(group.name, found, task.rated_torque)
        if lack is not None or set(group.channels) <= blocked:
            denied += [lack] if lack is not None else []
            continue
        support = search.support(group, tuple(g for g in selection if g is not group))
        order.append((group, support.gain, support.t, tuple(rivals(search, selection, group))))
    order.sort(key=lambda item: -item[1])
    neighbours = _beside(search, selection)
    chosen: tuple[Group, ...] = ()
    effects = []
    before = raw.held_out_errors(search.scores, ())
    for group, gain, t, others in order:
        chosen = (*chosen, group)
        after = raw.held_out_errors(search.scores, chosen)
        named_effect = _named(task, fit, bootstrap, group, gain, t, others, before, after)
        named_effect = replace(named_effect, beside=neighbours[group.name])
        if named_effect.error_after > HIGHER * named_effect.error_before:
            chosen = chosen[:-1]
            continue
        effects.append(named_effect)
        before = after
    refused = len(named) > len(order) and not denied
    return tuple(effects), denied if not refused else [Lack("structure in channels that the motion cannot decide", (),
        "what the motion cannot decide", "see the other experiments")]  # fmt: skip


def _named(
    task: Task,
    fit: Fit,
    bootstrap: Bootstrap,
    group: Group,
    gain: float,
    t: float,
    others: tuple[Rival, ...],
    before: Mapping[str, float],
    after: Mapping[str, float],
) -> NamedEffect:
    assert group.effect is not None
    effect = group.effect
    floor = {name: part.noise.deviation for name, part in fit.dictionary.rows.items()}
    channel = max(group.channels, key=lambda name: (before[name] ** 2 - after[name] ** 2) / floor[name] ** 2)
    units = {parameter.name: parameter.unit for parameter in effect.parameters}
    return NamedEffect(
        name=effect.name,
        title=effect.title,
        confidence=1.0,
        channel=channel,
        gain=gain,
        t=t,
        error_before=before[channel],
        error_after=after[channel],
        parameters=bootstrap.parameters(group, task.context),
        units=units,
        evidence=f"{channel.replace('_', ' ')}: the residual {effect.evidence}",
        rivals=others,
    )


def _beside(search: Search, selection: Selection) -> dict[str, float]:
    """What the strongest other named effect gains on the channels of each, nats: no law is exact, and what it leaves on
    its channels looks like weak effects there."""
    whole = search.scores.channel_losses(search.index(selection))
    gains = {}
    for group in selection:
        without = search.scores.channel_losses(search.index(tuple(g for g in selection if g is not group)))
        gains[group.name] = {name: without[name] - whole[name] for name in group.channels}
    return {
        group.name: max(
            (
                sum(max(0.0, gains[other.name].get(name, 0.0)) for name in group.channels)
                for other in selection
                if other is not group and not other.is_curve
            ),
            default=0.0,
        )
        for group in selection
    }


def _sure(effects: tuple[NamedEffect, ...], unknown: bool) -> tuple[NamedEffect, ...]:
    """The effects with their probabilities, without those that are more likely wrong than right."""
    said = tuple(replace(e, confidence=confidence(e.gain, max(e.gain, e.beside), unknown)) for e in effects)
    return tuple(effect for effect in said if effect.confidence >= LEAST)


def _near_reversals(task: Task, fit: Fit, blocked: set[str]) -> tuple[NamedEffect, ...]:
    """Presliding, which only the rows near reversals show."""
    effect = task.library.get("presliding")
    found = None if effect is None or MOTOR in blocked or effect in [e for e, _ in task.known] else presliding(fit)
    if effect is None or found is None:
        return ()
    return (
        NamedEffect(
            name=effect.name,
            title=effect.title,
            confidence=1.0,
            channel=MOTOR,
            gain=found.gain,
            t=found.t,
            error_before=found.error_before,
            error_after=found.error_after,
            parameters=found.parameters,
            units={parameter.name: parameter.unit for parameter in effect.parameters},
            evidence=f"motor torque: the residual {effect.evidence}",
        ),
    )


def _separating(task: Task, effect: NamedEffect) -> list[Experiment]:
    """Experiments that separate a named effect from those that it can be confused with here."""
    cls = task.library[effect.name]
    known = {confusion.effect: confusion.experiment for confusion in cls.confusions}
    return [
        Experiment(f"{effect.name} against {other}", known[other]) for other in effect.confusable_with if other in known
    ]


def _lowers(group: Group, raw: RawRows, search: Search) -> bool:
    """True if a curve lowers the held-out error of one of its channels, in the unit of the channel."""
    rest = tuple(g for g in raw.groups if g is not group)
    before, after = raw.held_out_errors(search.scores, rest), raw.held_out_errors(search.scores, raw.groups)
    return any(after[name] < before[name] for name in group.channels)


def _unknown(fit: Fit, raw: RawRows, search: Search, selection: Selection, blocked: set[str]) -> Unknown | None:
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
