"""Fits a joint's model, with one more effect or without, to a recording: new values with intervals and remarks."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace

import numpy as np

from hd_control.core.arrays import FloatArray
from hd_control.core.errors import HdError
from hd_control.drive.effect import Effect, EffectParameter
from hd_control.drive.library import base_numbers, effect_named, library
from hd_control.drive.model import JointModel, ModelValue
from hd_control.lab.diagnosis.candidates import Group
from hd_control.lab.diagnosis.corrections import CorrectedSearch, Task, prepare
from hd_control.lab.diagnosis.dictionary import Dictionary
from hd_control.lab.diagnosis.fit import Bootstrap, Interval, interval_of, widened
from hd_control.lab.diagnosis.near_reversals import near_reversals
from hd_control.lab.diagnosis.search import Selection

ROUNDS = 3
DEAD_GAIN = 10.0
DEAD = "dead: the data do not need it"
FLAT = 0.5
TRADE_OFF = 0.95
AT_BOUND = 0.01
OUTSIDE = "at bound: the free fit lies beyond it"
"""Remark on a value that a free fit would put beyond its limits, or outside its own interval."""


@dataclass(frozen=True)
class FittedParameter:
    """One line of the parameter table. `was`: the model's value before, None if it had none."""

    effect: str
    name: str
    unit: str
    value: float
    low: float
    high: float
    was: float | None = None
    bound: str = ""
    remark: str = ""


@dataclass(frozen=True)
class FittedJoint:
    """A joint model with fitted values, the table of them, and the held-out gain of the added effect, nats."""

    model: JointModel
    parameters: tuple[FittedParameter, ...]
    gain: float = 0.0


def fit_joint(
    task: Task, joint: JointModel, effect: str | None = None, dictionary: Dictionary | None = None
) -> FittedJoint:
    """Refits what the model has and, if named, one more effect. `dictionary`: that of `prepare`, if it is there.

    Raises HdError if the effect is in the model already or does not act on the channels of this recording.
    """
    if effect is not None:
        _check_addable(effect, joint)
    if not task.equations.channels:
        raise HdError(f"{task.equations.joint}: the recorded signals allow no residual channel")
    corrected = CorrectedSearch(task, prepare(task) if dictionary is None else dictionary)
    corrected.rescale(())
    added = None if effect is None else effect_named(effect)
    selection: Selection = () if added is None or added.near_reversals else (_best_shape(corrected, added.name),)
    corrected.leave_blind_rows(selection)
    for _ in range(ROUNDS):
        selection, moved = corrected.correct(selection)
        if not moved:
            break
    table = _Table(task, joint, corrected, selection)
    table.base()
    table.known()
    gain = table.added(selection[0]) if selection else 0.0
    if added is not None and added.near_reversals:
        gain = table.near_reversals(added)
    rows = tuple(replace(r, remark=DEAD) if r.effect == effect and gain < DEAD_GAIN else r for r in table.rows)
    return FittedJoint(table.joint, rows, gain)


def bounds_of(old: ModelValue | None, about: EffectParameter | None) -> tuple[float, float]:
    """What a value may be: the limits of the model's file and those of physics together."""
    lows = [-np.inf, *(x.low for x in (old, about) if x is not None)]
    highs = [np.inf, *(x.high for x in (old, about) if x is not None)]
    return max(lows), min(highs)


def _check_addable(name: str, joint: JointModel) -> None:
    """Raises HdError if the model has the effect already, ConfigError if there is none of that name."""
    effect = library().get(name)
    if name in joint.effects and not (effect is not None and effect.shifts_command):
        raise HdError(f"the model has {name} already; hd add --refit fits its values again")
    if effect_named(name).in_every_model:
        raise HdError(f"{name} is in every model; hd add --refit fits its values again")


def _best_shape(corrected: CorrectedSearch, effect: str) -> Group:
    ranking = corrected.search.ranking(())
    shapes = [i for i, group in enumerate(corrected.search.groups) if group.name == effect and not group.is_curve]
    if not shapes:
        channels = ", ".join(corrected.dictionary.rows)
        raise HdError(
            f"{effect} cannot be fitted here: it does not act on {channels}, or a signal that it needs is missing"
        )
    return corrected.search.groups[max(shapes, key=lambda i: float(ranking[i]))]


class _Table:
    """Rows of the parameter table and the model that grows with them."""

    def __init__(self, task: Task, joint: JointModel, corrected: CorrectedSearch, selection: Selection) -> None:
        self.task, self.joint, self.corrected = task, joint, corrected
        self.fit = corrected.fit(selection)
        self.bootstrap = Bootstrap(self.fit)
        self.rows: list[FittedParameter] = []
        self._draws: dict[tuple[str, str], FloatArray] = {}

    def base(self) -> None:
        """Values of the effects of every model, those that this recording determines."""
        for effect, one in base_numbers():
            value = float(getattr(self.fit, one.number))
            if effect.name not in self.joint.effects and not one.factor or not np.isfinite(value):
                continue
            if one.channel not in self.fit.dictionary.rows:
                continue
            draws = self.bootstrap.base(one.number)
            if one.factor:
                scale = self.joint.number(effect.name, one.parameter, 1.0)
                value, draws = scale * value, scale * draws
            self._put(effect, {one.parameter: (value, draws)})

    def known(self) -> None:
        """Values of the effects that the model has beyond those."""
        for group in self.fit.dictionary.known:
            self._group(group)

    def added(self, group: Group) -> float:
        """Values of the added effect; returns its held-out gain, nats."""
        self._group(group)
        return self.corrected.search.support(group, ()).gain

    def near_reversals(self, effect: type[Effect]) -> float:
        """Values of an effect that acts near reversals only, and its gain, nats. Raises HdError if it does not show."""
        found = near_reversals(self.fit, effect)
        if found is None:
            raise HdError(f"{effect.name} cannot be fitted: the rows near reversals do not show it")
        parameters = {p.name: p for p in effect.parameters}
        for key, interval in found.parameters.items():
            self._write(effect.name, parameters[key], interval, "")
        return found.gain

    def _group(self, group: Group) -> None:
        assert group.effect is not None
        best = self.fit.parameters(group, self.task.context)
        draws = self.bootstrap.draws_of(group, self.task.context)
        if group.effect.shifts_command:  # what is fitted comes on top of what the balances applied
            best = {name: value + self.joint.number(group.name, name) for name, value in best.items()}
            draws = {name: value + self.joint.number(group.name, name) for name, value in draws.items()}
        self._put(group.effect, {n: (best[n], draws[n]) for n in best})

    def _put(self, effect: type[Effect], values: Mapping[str, tuple[float, FloatArray]]) -> None:
        about = {parameter.name: parameter for parameter in effect.parameters}
        intervals = widened(effect, {name: interval_of(value, draws) for name, (value, draws) in values.items()})
        for name, interval in intervals.items():
            self._draws[effect.name, name] = values[name][1]
            remark = self._remark(effect.name, name, interval, about.get(name))
            self._write(effect.name, about.get(name), interval, remark, name)

    def _write(
        self, effect: str, about: EffectParameter | None, interval: Interval, remark: str, name: str = ""
    ) -> None:
        name = name or (about.name if about else "")
        old = self.joint.effects.get(effect, {}).get(name)
        unit = old.unit if old and old.unit else (about.unit if about else "")
        low, high = bounds_of(old, about)
        value, least, most = (float(np.clip(x, low, high)) for x in (interval.value, interval.low, interval.high))
        if not interval.low <= interval.value <= interval.high or not low <= interval.value <= high:
            remark = remark or OUTSIDE
        least, most = min(least, value), max(most, value)
        kept = (old.low, old.high) if old else (low, high)
        new = ModelValue(value, unit, *kept, "fitted", (least, most))
        self.joint = self.joint.with_effect(effect, {**self.joint.effects.get(effect, {}), name: new})
        was = None if old is None else old.value
        bound = f"{low:g} ... {high:g}" if np.isfinite(low) or np.isfinite(high) else ""
        row = FittedParameter(effect, name, unit, value, least, most, was, bound, remark)
        self.rows.append(row)

    def _remark(self, effect: str, name: str, interval: Interval, about: EffectParameter | None) -> str:
        """Why a value deserves no trust; empty if it does."""
        if about is not None and about.by_assembly:
            return ""
        if about is not None:
            for bound in (about.low, about.high):
                if np.isfinite(bound) and abs(interval.value - bound) <= AT_BOUND * max(abs(bound), abs(interval.high)):
                    return f"at bound: {bound:g} {about.unit}, physical limit"
        partner = self._partner(effect, name)
        if partner:
            return f"trade-off with {partner}: only their combination is known"
        if interval.high - interval.low > FLAT * abs(interval.value):
            return "flat: the data do not fix it"
        return ""

    def _partner(self, effect: str, name: str) -> str:
        draws = self._draws[effect, name]
        for (other, parameter), values in self._draws.items():
            if (other, parameter) == (effect, name) or values.std() == 0.0 or draws.std() == 0.0:
                continue
            if abs(float(np.corrcoef(values, draws)[0, 1])) > TRADE_OFF:
                return f"{other} {parameter}"
        return ""
