"""Which physical effect is missing in the model of one joint: gates, search, refinement, rivals, verdict."""

from __future__ import annotations

import time
from collections.abc import Mapping
from dataclasses import replace

import numpy as np

from hd_control.drive.effect import MOTOR, TORSION_FAMILY, TRANSMISSION, UNITS
from hd_control.lab.diagnosis.candidates import Group
from hd_control.lab.diagnosis.claims import beside, refuted, sure, unknown_in
from hd_control.lab.diagnosis.corrections import Task, search_effects
from hd_control.lab.diagnosis.coverage import Coverage, Shortfall, coverage, shortfalls, unsupported
from hd_control.lab.diagnosis.dictionary import Dictionary
from hd_control.lab.diagnosis.fit import Bootstrap, Fit, RawRows
from hd_control.lab.diagnosis.near_reversals import near_reversals
from hd_control.lab.diagnosis.scores import Scores
from hd_control.lab.diagnosis.search import Search, Selection
from hd_control.lab.diagnosis.verdict import (
    ADEQUATE,
    CANNOT_TELL,
    MISSING,
    MISSING_AND_UNKNOWN,
    UNKNOWN,
    ChannelError,
    Experiment,
    JointDiagnosis,
    NamedEffect,
    Rival,
    Unknown,
    rivals,
)


def diagnose(task: Task, dictionary: Dictionary | None = None) -> JointDiagnosis:
    """The verdict on one joint. `dictionary`: that of `corrections.prepare`, if it is there already."""
    start = time.process_time()
    found = coverage(task.equations)
    blocked = {name for shortfall in shortfalls(found) for name in shortfall.channels}
    open_channels = {name: c for name, c in task.equations.channels.items() if name not in blocked}
    if not task.equations.channels or hopeless(found) or not open_channels:
        return refusal(task, found, shortfalls(found), time.process_time() - start)
    if len(open_channels) < len(task.equations.channels):
        task, dictionary = replace(task, equations=replace(task.equations, channels=open_channels)), None
    search, selection = search_effects(task, dictionary)
    if TRANSMISSION in open_channels:
        found = replace(found, compliance_error=compliance_error(search, selection))
    answer = _answer(task, found, shortfalls(found), search, selection)
    return replace(answer, seconds=time.process_time() - start)


def compliance_error(search: Search, selection: Selection) -> float:
    """How well the motion determines the compliance: beside a law or curve of the torsion over torque it is one number
    of several of a curve, and says nothing of the motion."""
    bare = tuple(g for g in selection if TRANSMISSION not in g.channels or not _bends(g))
    return Fit.of(search.dictionary, search.scores, bare).relative_error(TRANSMISSION, "torsional_compliance")


def _bends(group: Group) -> bool:
    if group.curve is not None:
        return group.curve.variable == "joint_torque"
    return group.effect is not None and group.effect.family == TORSION_FAMILY


def hopeless(found: Coverage) -> bool:
    """True if there are too few rows to fit anything."""
    return found.duration < 3.0 or found.moving < 1.0


def refusal(task: Task, found: Coverage, missing: list[Shortfall], seconds: float) -> JointDiagnosis:
    """The answer to a recording of which nothing can be said."""
    return JointDiagnosis(
        joint=task.equations.joint,
        verdict=CANNOT_TELL,
        effects=(),
        unknown=None,
        experiments=experiments_of(missing),
        channels={},
        coverage=found,
        notes=tuple(shortfall.what for shortfall in missing),
        seconds=seconds,
    )


def experiments_of(missing: list[Shortfall]) -> tuple[Experiment, ...]:
    """What to record, each once."""
    seen = dict.fromkeys((shortfall.purpose, shortfall.how) for shortfall in missing)
    return tuple(Experiment(purpose, how) for purpose, how in seen)


def _answer(
    task: Task, found: Coverage, missing: list[Shortfall], search: Search, selection: Selection
) -> JointDiagnosis:
    """Names, unknowns, refusals: what may be said of the selection."""
    dictionary, scores = search.dictionary, search.scores
    fit = Fit.of(dictionary, scores, selection)
    raw = RawRows(dictionary, selection)
    channels = _errors(fit, raw, scores, selection)
    blocked = {name for shortfall in missing for name in shortfall.channels}
    effects, denied, withdrawn = _effects(task, found, search, fit, raw, blocked)
    effects += effects_near_reversals(task, fit, blocked)
    unknown = unknown_in(fit, raw, search, selection, blocked)
    effects = sure(effects, unknown, {group.name: group.channels for group in selection})
    experiments = list(experiments_of([*missing, *denied]))
    for effect in effects:
        experiments += separating(task, effect)
    closed = bool(blocked & {*found.acceleration_snr, *found.too_short})
    verdict = verdict_of(effects, unknown, bool(denied), closed)
    if verdict == CANNOT_TELL:
        effects, unknown = (), None
    notes = (*(shortfall.what for shortfall in [*missing, *denied]), *withdrawn)
    seen = {(e.purpose, e.how): e for e in experiments}
    return JointDiagnosis(
        task.equations.joint, verdict, effects, unknown, tuple(seen.values()), channels, found, notes, fit
    )


def verdict_of(effects: tuple[NamedEffect, ...], unknown: Unknown | None, denied: bool, closed: bool) -> str:
    """The verdict in one word. `denied`: a name was not carried; `closed`: a balance could not be judged."""
    if effects:
        return MISSING_AND_UNKNOWN if unknown else MISSING
    if unknown:
        return UNKNOWN
    return CANNOT_TELL if denied or closed else ADEQUATE


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
) -> tuple[tuple[NamedEffect, ...], list[Shortfall], list[str]]:
    """The selected library effects that the recording can carry, most important first; what it cannot carry; and which
    names were withdrawn, with the reason."""
    selection = fit.selection
    named = [group for group in selection if not group.is_curve]
    if not named:
        return (), [], []
    bootstrap = Bootstrap(fit)
    order: list[tuple[Group, float, float, tuple[Rival, ...]]] = []
    denied: list[Shortfall] = []
    for group in named:
        assert group.effect is not None
        shortfall = unsupported(group.effect, found, task.rated_torque)
        if shortfall is not None or set(group.channels) <= blocked:
            denied += [shortfall] if shortfall is not None else []
            continue
        support = search.support(group, tuple(g for g in selection if g is not group))
        order.append((group, support.gain, support.t, tuple(rivals(search, selection, group))))
    order.sort(key=lambda item: -item[1])
    neighbours = beside(search, selection)
    chosen: tuple[Group, ...] = ()
    effects, withdrawn = [], list[str]()
    before, whole = raw.held_out_errors(search.scores, ()), raw.held_out_errors(search.scores, selection)
    for group, gain, t, others in order:
        chosen = (*chosen, group)
        after = raw.held_out_errors(search.scores, chosen)
        named_effect = _named(task, fit, bootstrap, group, gain, t, others, before, after)
        named_effect = replace(named_effect, beside=neighbours[group.name])
        without = raw.held_out_errors(search.scores, tuple(g for g in selection if g is not group))
        why_not = refuted(named_effect, group, without, whole)
        if why_not is not None:
            chosen, withdrawn = chosen[:-1], [*withdrawn, why_not]
            continue
        effects.append(named_effect)
        before = after
    refused = len(named) > len(order) and not denied
    if refused:
        what = "structure in channels that the motion cannot decide"
        denied = [Shortfall(what, (), "what the motion cannot decide", "see the other experiments")]
    return tuple(effects), denied, withdrawn


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


def effects_near_reversals(task: Task, fit: Fit, blocked: set[str]) -> tuple[NamedEffect, ...]:
    """Effects that only the rows near reversals show."""
    held = [effect for effect, _ in task.known]
    tested = [] if MOTOR in blocked else [e for e in task.library.values() if e.near_reversals and e not in held]
    named = []
    for effect in tested:
        found = near_reversals(fit, effect)
        if found is None:
            continue
        claim = NamedEffect(
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
        )
        named.append(claim)
    return tuple(named)


def separating(task: Task, effect: NamedEffect) -> list[Experiment]:
    """Experiments that separate a named effect from those that it can be confused with here."""
    cls = task.library[effect.name]
    known = {confusion.effect: confusion.experiment for confusion in cls.confusions}
    return [
        Experiment(f"{effect.name} against {other}", known[other]) for other in effect.confusable_with if other in known
    ]
