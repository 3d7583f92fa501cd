"""Fits a joint's model, with one more effect or without, to a recording: new values with intervals and remarks."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace

import numpy as np

from hd_control.core.arrays import FloatArray
from hd_control.core.errors import HdError
from hd_control.drive.effect import EffectParameter
from hd_control.drive.library import effect_named
from hd_control.drive.model import JointModel, ModelValue
from hd_control.lab.diagnosis.candidates import Group
from hd_control.lab.diagnosis.corrections import SECOND_STAGE, CorrectedSearch, Task, prepare
from hd_control.lab.diagnosis.dictionary import Dictionary
from hd_control.lab.diagnosis.fit import Bootstrap, Interval, interval_of, widened
from hd_control.lab.diagnosis.presliding import presliding
from hd_control.lab.diagnosis.search import Selection
from hd_control.lab.diagnosis.task import DELAY

ROUNDS = 3
DEAD_GAIN = 10.0
DEAD = "dead: the data do not need it"
FLAT = 0.5
TRADE_OFF = 0.95
AT_BOUND = 0.01
BASE = (
    ("rotor_inertia", "rotor_inertia", "rotor_inertia"),
    ("coulomb_friction", "coulomb_torque", "coulomb_torque"),
    ("viscous_friction", "viscous", "viscous"),
    ("torsional_stiffness", "torsional_stiffness", "torsional_stiffness"),
    ("torsional_stiffness", "damping_time", "damping_time"),
    ("torsional_stiffness", "transmission_zero", "transmission_zero"),
    ("link_dynamics", "inertia_scale", "link_inertia_scale"),
)
"""Effect of every model, parameter, attribute of Fit."""
NOT_PHYSICAL = ("transmission_zero",)
"""Parameters that depend on how the joint was put together; an interval that covers zero says nothing."""


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
    if effect is not None and effect in joint.effects and effect != DELAY:
        raise HdError(f"the model has {effect} already; hd add --refit fits its values again")
    if effect is not None and effect_named(effect).in_every_model:
        raise HdError(f"{effect} is in every model; hd add --refit fits its values again")
    if not task.equations.channels:
        raise HdError(f"{task.equations.joint}: the recorded signals allow no residual channel")
    corrected = CorrectedSearch(task, prepare(task) if dictionary is None else dictionary)
    corrected.rescale(())
    selection: Selection = () if effect is None or effect in SECOND_STAGE else (_best_shape(corrected, effect),)
    corrected.leave_blind_rows(selection)
    for _ in range(ROUNDS):
        selection, moved = corrected.correct(selection)
        if not moved:
            break
    table = _Table(task, joint, corrected, selection)
    table.base()
    table.known()
    gain = table.added(selection[0]) if selection else 0.0
    if effect in SECOND_STAGE:
        gain = table.near_reversals(str(effect))
    rows = tuple(replace(r, remark=DEAD) if r.effect == effect and gain < DEAD_GAIN else r for r in table.rows)
    return FittedJoint(table.joint, rows, gain)


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
        for effect, name, attribute in BASE:
            value = float(getattr(self.fit, attribute))
            if effect not in self.joint.effects and effect != "link_dynamics" or not np.isfinite(value):
                continue
            if attribute == "link_inertia_scale" and "link_torque" not in self.fit.dictionary.rows:
                continue
            if attribute == "rotor_inertia" and "motor_torque" not in self.fit.dictionary.rows:
                continue
            draws = self.bootstrap.base(attribute)
            if attribute == "link_inertia_scale":
                scale = self.joint.number(effect, name, 1.0)
                value, draws = scale * value, scale * draws
            self._put(effect, {name: (value, draws)}, {p.name: p for p in effect_named(effect).parameters})

    def known(self) -> None:
        """Values of the effects that the model has beyond those."""
        for group in self.fit.dictionary.known:
            self._group(group)

    def added(self, group: Group) -> float:
        """Values of the added effect; returns its held-out gain, nats."""
        self._group(group)
        return self.corrected.search.support(group, ()).gain

    def near_reversals(self, name: str) -> float:
        """Values of presliding. Raises HdError if the rows near reversals do not show it."""
        found = presliding(self.fit)
        if found is None:
            raise HdError(f"{name} cannot be fitted: the rows near reversals do not show it")
        parameters = {p.name: p for p in effect_named(name).parameters}
        for key, interval in found.parameters.items():
            self._write(name, parameters[key], interval, "")
        return found.gain

    def _group(self, group: Group) -> None:
        assert group.effect is not None
        best = self.fit.parameters(group, self.task.context)
        draws = self.bootstrap.draws_of(group, self.task.context)
        if group.name == DELAY:
            best = {name: value + self.joint.number(DELAY, name) for name, value in best.items()}
            draws = {name: value + self.joint.number(DELAY, name) for name, value in draws.items()}
        self._put(group.name, {n: (best[n], draws[n]) for n in best}, {p.name: p for p in group.effect.parameters})

    def _put(
        self, effect: str, values: Mapping[str, tuple[float, FloatArray]], about: Mapping[str, EffectParameter]
    ) -> None:
        intervals = widened(effect, {name: interval_of(value, draws) for name, (value, draws) in values.items()})
        for name, interval in intervals.items():
            self._draws[effect, name] = values[name][1]
            remark = self._remark(effect, name, interval, about.get(name))
            self._write(effect, about.get(name), interval, remark, name)

    def _write(
        self, effect: str, about: EffectParameter | None, interval: Interval, remark: str, name: str = ""
    ) -> None:
        name = name or (about.name if about else "")
        old = self.joint.effects.get(effect, {}).get(name)
        unit = old.unit if old and old.unit else (about.unit if about else "")
        low, high = (old.low, old.high) if old else (about.low, about.high) if about else (-np.inf, np.inf)
        value = float(np.clip(interval.value, low, high))
        new = ModelValue(value, unit, low, high, "fitted", (min(interval.low, value), max(interval.high, value)))
        self.joint = self.joint.with_effect(effect, {**self.joint.effects.get(effect, {}), name: new})
        was = None if old is None else old.value
        bound = f"{low:g} ... {high:g}" if np.isfinite(low) or np.isfinite(high) else ""
        row = FittedParameter(effect, name, unit, value, interval.low, interval.high, was, bound, remark)
        self.rows.append(row)

    def _remark(self, effect: str, name: str, interval: Interval, about: EffectParameter | None) -> str:
        """Why a value deserves no trust; empty if it does."""
        if name in NOT_PHYSICAL:
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
