"""Which effect is missing by the innovations: the same gates, names and refusals as by the balances, another judge.

What the filter of the joint did not predict decides (`decide`). The balances give what people look at: errors in their
own unit before and after, the rows near reversals. Source: docs/equations/innovations.md (K1) to (K12).
"""

from __future__ import annotations

import time
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial

import numpy as np

from hd_control.drive.effect import LINK, MOTOR, TRANSMISSION, UNITS, Columns, DriveStates
from hd_control.lab.diagnosis.candidates import Candidate, Group
from hd_control.lab.diagnosis.claims import bursts, refuted, sure
from hd_control.lab.diagnosis.corrections import Task, known_candidates
from hd_control.lab.diagnosis.coverage import Coverage, Gates, Shortfall, coverage, shortfalls, unsupported
from hd_control.lab.diagnosis.decide import Decision, Question, decide
from hd_control.lab.diagnosis.diagnose import (
    compliance_error,
    effects_near_reversals,
    experiments_of,
    hopeless,
    refusal,
    separating,
    verdict_of,
)
from hd_control.lab.diagnosis.dictionary import build
from hd_control.lab.diagnosis.fit import Bootstrap, Fit, RawRows
from hd_control.lab.diagnosis.scores import Scores
from hd_control.lab.diagnosis.search import Selection, Thresholds
from hd_control.lab.diagnosis.verdict import (
    CANNOT_TELL,
    ChannelError,
    JointDiagnosis,
    NamedEffect,
    Rival,
    Unknown,
    rivals,
)
from hd_control.lab.innovations.core import JOINT_SENSOR, MOTOR_SENSOR, TORQUE_SENSOR
from hd_control.lab.innovations.equations import Given, innovations

LIMITS = Thresholds(gain=200.0, share=0.0, curve_share=0.0, curve_penalty=60.0, coupled=True)
"""nats: what a group must explain of all innovations together."""
GATES = Gates(decades=1.0, acceleration=1.0)
"""No acceleration stands alone here, and what needs more decades of speed says so itself."""
LEAST_DELAY = 0.6
"""Delay over the period below which it may be the other convention of sampling, with half a sample of difference."""
BURSTS_SHOW = {MOTOR_SENSOR: MOTOR, JOINT_SENSOR: TRANSMISSION, TORQUE_SENSOR: LINK}
"""Balance of which a burst in a sensor's innovations speaks."""


def diagnose_innovations(task: Task) -> JointDiagnosis:
    """The verdict on one joint. Raises ValueError for a task without what the innovations need."""
    start = time.process_time()
    if task.given is None:
        raise ValueError("the task does not say what the innovations need")
    found = coverage(task.equations)
    missing = shortfalls(found, GATES)
    blocked = {name for shortfall in missing for name in shortfall.channels}
    given = task.given()
    seen = visible(given) - blocked
    if hopeless(found) or not seen:
        return refusal(task, found, missing, time.process_time() - start)
    equations = innovations(given, task.equations, frozenset({MOTOR, LINK} & blocked))
    decision = decide(Question(equations, task.library, task.known, task.context, LIMITS, frozenset(seen)))
    if TRANSMISSION in seen:
        found = replace(found, compliance_error=compliance_error(decision.search, decision.selection))
    answer = _answer(task, found, shortfalls(found, GATES), decision)
    return replace(answer, seconds=time.process_time() - start)


def visible(given: Given) -> set[str]:
    """The balances whose effects these signals show."""
    signals, found = given.signals, set[str]()
    if signals.motor_torque is not None:
        found.add(MOTOR)
    if given.link is not None and (signals.motor_torque is not None or signals.gauge_torque is not None):
        found.add(LINK)
    angles = signals.motor_shaft_position is not None and signals.joint_position is not None
    if angles and (signals.gauge_torque is not None or given.link is not None):
        found.add(TRANSMISSION)
    return found


def _answer(task: Task, found: Coverage, missing: list[Shortfall], decision: Decision) -> JointDiagnosis:
    """Names, unknowns, refusals: what may be said of the selection."""
    picture = Picture.of(task, decision.selection)
    blocked = {name for shortfall in missing for name in shortfall.channels}
    effects, denied, withdrawn = _effects(task, found, decision, picture, blocked)
    effects += effects_near_reversals(task, picture.fit, blocked)
    unknown = _unknown(decision, blocked)
    effects = sure(effects, unknown, {group.name: group.channels for group in decision.selection})
    experiments = [*experiments_of([*missing, *denied]), *(e for effect in effects for e in separating(task, effect))]
    verdict = verdict_of(effects, unknown, bool(denied), bool(blocked & {*found.acceleration_snr, *found.too_short}))
    if verdict == CANNOT_TELL:
        effects, unknown = (), None
    return JointDiagnosis(
        joint=task.equations.joint,
        verdict=verdict,
        effects=effects,
        unknown=unknown,
        experiments=tuple({(e.purpose, e.how): e for e in experiments}.values()),
        channels=picture.errors(),
        coverage=found,
        notes=(*(shortfall.what for shortfall in [*missing, *denied]), *withdrawn),
        fit=picture.fit,
    )


@dataclass(frozen=True)
class _Claim:
    """A selected effect with what the innovations say of it."""

    group: Group
    gain: float
    t: float
    others: tuple[Rival, ...]


def _effects(
    task: Task, found: Coverage, decision: Decision, picture: Picture, blocked: set[str]
) -> tuple[tuple[NamedEffect, ...], list[Shortfall], list[str]]:
    """The selected effects that the recording can carry, by gain; what it cannot carry; withdrawn names."""
    claims, denied = _claims(task, found, decision, blocked)
    if not claims:
        return (), denied, []
    bootstrap, neighbours = Bootstrap(decision.fit), _beside(decision)
    chosen, effects, withdrawn = list[Group](), list[NamedEffect](), list[str]()
    whole = picture.held_out(decision.selection)
    for claim in claims:
        before, after = picture.held_out(chosen), picture.held_out([*chosen, claim.group])
        named = _named(task, claim, bootstrap, picture.shown_by(claim.group, before, after), before, after)
        named = replace(named, beside=neighbours[claim.group.name])
        without = picture.held_out([g for g in decision.selection if g is not claim.group])
        seen = named.channel in whole and named.channel in without
        why_not = refuted(named, claim.group, without, whole) if seen else None
        why_not = why_not or small_delay(named, claim.group, task.equations.states.period)
        if why_not is not None:
            withdrawn.append(why_not)
            continue
        chosen.append(claim.group)
        effects.append(named)
    return tuple(effects), denied, withdrawn


def _claims(task: Task, found: Coverage, decision: Decision, blocked: set[str]) -> tuple[list[_Claim], list[Shortfall]]:
    claims, denied = list[_Claim](), list[Shortfall]()
    for group in decision.selection:
        if group.effect is None:
            continue
        shortfall = unsupported(group.effect, found, task.rated_torque)
        if shortfall is not None or set(group.channels) <= blocked:
            denied += [shortfall] if shortfall is not None else []
            continue
        rest = tuple(g for g in decision.selection if g is not group)
        support = decision.search.support(group, rest)
        others = tuple(rivals(decision.search, decision.selection, group))
        claims.append(_Claim(group, support.gain, support.t, others))
    return sorted(claims, key=lambda claim: -claim.gain), denied


def _named(
    task: Task,
    claim: _Claim,
    bootstrap: Bootstrap,
    channel: str,
    before: Mapping[str, float],
    after: Mapping[str, float],
) -> NamedEffect:
    effect = claim.group.effect
    assert effect is not None
    return NamedEffect(
        name=effect.name,
        title=effect.title,
        confidence=1.0,
        channel=channel,
        gain=claim.gain,
        t=claim.t,
        error_before=before.get(channel, float("nan")),
        error_after=after.get(channel, float("nan")),
        parameters=bootstrap.parameters(claim.group, task.context),
        units={parameter.name: parameter.unit for parameter in effect.parameters},
        evidence=f"{channel.replace('_', ' ')}: the residual {effect.evidence}",
        rivals=claim.others,
    )


def small_delay(claim: NamedEffect, group: Group, period: float) -> str | None:
    """Why a delay is no name: half a sample is the difference between a held torque and a sampled one."""
    name = "" if group.effect is None else group.effect.shifts_command
    delay = claim.parameters.get(name)
    if delay is None or delay.low >= LEAST_DELAY * period:
        return None
    return f"{claim.name} was withdrawn: so small a delay depends on whether the torque is held or sampled"


def _beside(decision: Decision) -> dict[str, float]:
    """What the strongest other law on a balance of each, selected or in the model, gains, nats."""
    search, selection = decision.search, decision.selection
    index = search.index(selection)
    whole = search.scores.loss(index)
    laws = [group for group in (*selection, *search.dictionary.known) if not group.is_curve]
    gains = {law.name: search.scores.loss(np.setdiff1d(index, law.index)) - whole for law in laws}

    def on_balances_of(group: Group, law: Group) -> float:
        return max(0.0, gains[law.name]) if set(group.channels) & set(law.channels) else 0.0

    return {g.name: max((on_balances_of(g, law) for law in laws if law is not g), default=0.0) for g in selection}


def _unknown(decision: Decision, blocked: set[str]) -> Unknown | None:
    """Free curves that survived, or bursts in time that nothing selected explains."""
    search, selection = decision.search, decision.selection
    left = [g for g in selection if g.curve is not None and not set(g.channels) <= blocked]
    if left:
        gains = [search.support(g, tuple(h for h in selection if h is not g)).gain for g in left]
        group = left[int(np.argmax(gains))]
        assert group.curve is not None
        channel, variables = group.channels[0], group.curve.variables
        words = " and ".join(v.replace("_", " ") for v in variables)
        text = f"{channel.replace('_', ' ')}: the residual depends on {words}"
        return Unknown(channel, variables, f"{text} ({max(gains):.0f} nats held out); no effect of the library fits")
    for burst in bursts(decision.fit):
        channel = BURSTS_SHOW[burst.channel]
        if burst.found and channel not in blocked:
            times = ", ".join(f"{t:.1f}" for t in burst.times[:8])
            words = f"bursts at {times} s (worst {burst.worst:.0f} standard deviations)"
            return Unknown(channel, ("time",), f"{channel.replace('_', ' ')}: {words}")
    return None


@dataclass(frozen=True)
class Picture:
    """The selection in the balances: errors in a balance's unit, which the innovations do not have.

    `groups`: the balances' groups by the name of the selected one; what acts on no balance here is left out.
    """

    fit: Fit
    raw: RawRows
    groups: Mapping[str, Group]

    @classmethod
    def of(cls, task: Task, selection: Selection) -> Picture:
        """Fits the selection to the balances, with noise of their own."""
        channels = task.equations.channels
        candidates = []
        for group in selection:
            made = group.curve.columns_at if group.curve is not None else partial(_shaped, group)
            columns = {n: c for n, c in made(task.equations.states).items() if n in channels}
            if columns and all(np.isfinite(c).all() for c in columns.values()):
                candidates.append(Candidate(group.name, columns, group.effect, group.shape, group.curve))
        dictionary = build(task.equations, candidates, known_candidates(task))
        scores = Scores(dictionary)
        found = {group.name: group for group in dictionary.groups}
        return cls(Fit.of(dictionary, scores, dictionary.groups), RawRows(dictionary, dictionary.groups), found)

    def held_out(self, selection: Sequence[Group]) -> dict[str, float]:
        """RMS by balance on rows that were not used for the fit."""
        return self.raw.held_out_errors(
            self.fit.scores, [self.groups[g.name] for g in selection if g.name in self.groups]
        )

    def errors(self) -> dict[str, ChannelError]:
        """Errors of every balance before and after."""
        before, after = self.held_out(()), self.held_out(list(self.groups.values()))
        found = {}
        for name, part in self.fit.dictionary.rows.items():
            left = self.fit.dictionary.equations.channels[name].left[part.usable]
            measured = float(np.sqrt(np.mean((left - left.mean()) ** 2))) if left.size else float("nan")
            found[name] = ChannelError(UNITS[name], measured, before[name], after[name], part.noise.deviation)
        return found

    def shown_by(self, group: Group, before: Mapping[str, float], after: Mapping[str, float]) -> str:
        """The balance in which the group lowers the error most, over its noise."""
        floor = {name: part.noise.deviation for name, part in self.fit.dictionary.rows.items()}
        here = [name for name in group.channels if name in floor]
        return max(here, key=lambda n: (before[n] ** 2 - after[n] ** 2) / floor[n] ** 2, default=group.channels[0])


def _shaped(group: Group, states: DriveStates) -> Columns:
    assert group.effect is not None
    return group.effect.columns(states, group.shape)
