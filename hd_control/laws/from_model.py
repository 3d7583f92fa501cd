"""An identified model into the controllers' parameters: what each effect becomes, what is applied, what not, and why.

applied = apply_model(model, {"torque_node": values, "fusion_node": values})
applied.values["torque_node"], applied.rows

Nothing is written that a rule or a limit of the law's parameters refuses. Pure: values in, values out.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

from hd_control.core.errors import ConfigError
from hd_control.core.parameters import Change, Parameter, ParameterSet, Shape
from hd_control.drive.model import JointModel, Model, ModelValue
from hd_control.laws import fusion, torque
from hd_control.laws.torque_adaptive import HARMONICS, LOOP_WARNING

# ---- What each effect becomes: settings by parameter, or the reason for none -----------------------
#
# All values are at the joint side of the gear, SI. Signs, model -> controller, docs/equations/compensation.md (C1):
#
#     q = phi + KE - tau / k                            law takes KE off: phi_d = q + y - KE            same sign
#     friction torque e |phi'| + k_v phi'               viscous_positive = k_v + e, viscous_negative = k_v - e
#     tau = tau_s (1 - g / (1 + g)) - offset - ripple   fusion: tau = (tau_s - offset' - ripple') / gain,
#                                                       gain = 1 + g, offset' = gain offset, ripple' = gain ripple
#     ripple over theta + turn q                        ripple over theta - gauge_joint_turns q + gauge_angle_offset


FUSION, TORQUE = "fusion_node", "torque_node"
FRICTION_SHARE = 0.9
"""Share of Coulomb friction that is fed forward: its sign changes at once, and the estimate may be too high."""
ADAPTATION_SCALE = 0.1
"""Factor on the adaptation gains once the start values are identified."""
MAX_TRANSMISSION_SLOPE = 0.5
"""Largest N dKE/dtheta that is believed: beyond, the rotor torque would change by half over a rotor turn."""


@dataclass(frozen=True)
class Setting:
    """One parameter of one node with its new value for a joint (or for all, if it is one number). `note`: a remark."""

    node: str
    name: str
    value: float | bool
    note: str = ""


@dataclass(frozen=True)
class Proposal:
    """What an effect of one joint becomes: settings, or none and the `reason`."""

    effect: str
    settings: tuple[Setting, ...] = ()
    reason: str = ""


@dataclass(frozen=True)
class JointCase:
    """One joint: its model, the present values of its parameters by node, the control period in s, the torque law."""

    model: JointModel
    own: Mapping[str, Mapping[str, Any]]
    period: float
    joints: int = 1

    @property
    def law(self) -> str:
        """The law of the torque node."""
        return str(self.own.get(TORQUE, {}).get("law", "adaptive"))

    def sure(self, effect: str, name: str) -> float | None:
        """The value if its 95 % interval excludes zero, else None."""
        value = self.model.effects.get(effect, {}).get(name)
        return value.value if value is not None and excludes_zero(value) else None

    def wave(self, effect: str, order: int) -> tuple[float, float]:
        """Cosine and sine of one order; both 0 if neither interval excludes zero."""
        names = (f"cosine_{order}", f"sine_{order}")
        if all(self.sure(effect, name) is None for name in names):
            return 0.0, 0.0
        return self.model.number(effect, names[0]), self.model.number(effect, names[1])

    def fusion(self, name: str) -> float:
        """A fusion parameter of this joint; 0 if no fusion parameters are given."""
        return float(self.own.get(FUSION, {}).get(name, 0.0))

    def bounded(self, name: str, value: float, bounds: str) -> Setting:
        """A start value of the torque law inside the bounds of its estimate."""
        own = self.own.get(TORQUE, {})
        low, high = float(own.get(f"{bounds}_low", -math.inf)), float(own.get(f"{bounds}_high", math.inf))
        inside = min(max(value, low), high)
        note = f"{value:.5g} is limited by {bounds}_{'low' if value < low else 'high'}" if inside != value else ""
        return Setting(TORQUE, name, inside, note)


def excludes_zero(value: ModelValue) -> bool:
    """Does the 95 % interval exist and exclude zero?"""
    return value.interval is not None and (value.interval[0] > 0.0 or value.interval[1] < 0.0)


def turned(cosine: float, sine: float, order: int, offset: float) -> tuple[float, float]:
    """Coefficients over the angle x of a wave that is written over x + `offset` rad."""
    c, s = math.cos(order * offset), math.sin(order * offset)
    return cosine * c + sine * s, sine * c - cosine * s


def unsure(case: JointCase, effect: str) -> str:
    """Why no value of an effect can be used: no interval, or one that holds zero; empty if one can."""
    values = case.model.effects[effect]
    if any(excludes_zero(value) for value in values.values()):
        return ""
    sources = sorted({value.source or "no source" for value in values.values()})
    if all(value.interval is None for value in values.values()):
        return f"no interval ({', '.join(sources) or 'no value'}): fit it to a recording with hd add --refit"
    return "its 95 % interval holds zero"


def _kinematic_error(case: JointCase, effect: str) -> Proposal:
    slope, settings = 0.0, []
    offset = case.fusion("encoder_offset")
    for order in range(1, HARMONICS + 1):
        cosine, sine = case.wave(effect, order)
        slope += case.model.gear_ratio * order * math.hypot(cosine, sine)
        for kind, value in zip(("cosine", "sine"), turned(cosine, sine, order, offset), strict=True):
            settings += [Setting(node, f"kinematic_{kind}_{order}", value) for node in (TORQUE, FUSION)]
    if slope >= MAX_TRANSMISSION_SLOPE:
        return Proposal(effect, (), f"limit: N dKE/dtheta up to {slope:.2g}, allowed {MAX_TRANSMISSION_SLOPE:g}")
    if case.law in ("direct", "torque_feedback"):
        settings = [replace(s, note="only in fusion") for s in settings if s.node == FUSION]
    elif case.law == "adaptive":
        settings.append(Setting(TORQUE, "kinematic_feedforward", True))
    return Proposal(effect, tuple(settings))


def _slower(case: JointCase) -> Setting:
    present = float(case.own.get(TORQUE, {}).get("adaptation_scale", ADAPTATION_SCALE))
    return Setting(TORQUE, "adaptation_scale", min(present, ADAPTATION_SCALE))


def _coulomb(case: JointCase, effect: str) -> Proposal:
    name = {"torque_feedback": "feedback_friction", "integral_manifold": "rotor_coulomb"}.get(case.law)
    value = FRICTION_SHARE * case.model.number(effect, "coulomb_torque")
    note = f"{FRICTION_SHARE:.0%} of the fitted value"
    if name is not None:
        return Proposal(effect, (Setting(TORQUE, name, value, note),))
    if case.law == "direct":
        return _law_has_none(case, effect)
    start = case.bounded("coulomb_torque_initial", value, "coulomb_torque")
    settings = [Setting(TORQUE, start.name, start.value, start.note or note), *_friction_without(case), _slower(case)]
    return Proposal(effect, tuple(settings))


def _friction_without(case: JointCase) -> Iterator[Setting]:
    """A Coulomb value belongs to its model: friction terms that the model has not, or not surely, are zero with it."""
    for name, effect, parameter in (
        ("load_friction_linear", "load_dependent_friction", "load_friction_linear"),
        ("load_friction_quadratic", "load_dependent_friction", "load_friction_quadratic"),
        ("friction_offset_initial", "asymmetric_friction", "friction_offset"),
    ):
        if case.sure(effect, parameter) is None:
            yield Setting(TORQUE, name, 0.0, f"the model has no {effect}")


def _viscous(case: JointCase, effect: str) -> Proposal:
    """Both directions together; the asymmetry is taken where its own interval excludes zero."""
    both = case.model.number("viscous_friction", "viscous")
    if case.law == "integral_manifold":
        return Proposal(effect, (Setting(TORQUE, "rotor_damping", both),))
    if case.law != "adaptive":
        return _law_has_none(case, effect)
    extra = case.sure("asymmetric_friction", "viscous_asymmetry") or 0.0
    pairs = (("viscous_positive_initial", both + extra), ("viscous_negative_initial", both - extra))
    return Proposal(effect, (*(case.bounded(name, value, "viscous") for name, value in pairs), _slower(case)))


def _asymmetric(case: JointCase, effect: str) -> Proposal:
    if case.law != "adaptive":
        return _law_has_none(case, effect)
    settings: list[Setting] = []
    offset = case.sure(effect, "friction_offset")
    if offset is not None:
        settings += [case.bounded("friction_offset_initial", offset, "friction_offset"), _slower(case)]
    if case.sure(effect, "viscous_asymmetry") is not None:
        settings += _viscous(case, effect).settings
    return Proposal(effect, tuple(settings))


def _load_friction(case: JointCase, effect: str) -> Proposal:
    if case.law != "adaptive":
        return _law_has_none(case, effect)
    names = ("load_friction_linear", "load_friction_quadratic")
    values = {name: case.sure(effect, name) or 0.0 for name in names}
    if min(values.values()) < 0.0:
        return Proposal(effect, (), "limit: friction that falls with load is not fed forward")
    return Proposal(effect, (*(Setting(TORQUE, name, value) for name, value in values.items()), _slower(case)))


def _stiffness(case: JointCase, effect: str) -> Proposal:
    stiffness = case.model.number(effect, "torsional_stiffness")
    if case.sure(effect, "torsional_stiffness") is None:
        return Proposal(effect, (), "the 95 % interval of torsional_stiffness is missing or holds zero")
    settings = [Setting(FUSION, "torsional_stiffness", stiffness), Setting(TORQUE, "torsional_stiffness", stiffness)]
    if case.law == "adaptive":
        settings.append(Setting(TORQUE, "torsional_compliance_initial", 1.0 / stiffness))
    return Proposal(effect, tuple(settings))


def _hysteresis(case: JointCase, effect: str) -> Proposal:
    if case.law != "integral_manifold":
        return Proposal(
            effect, (), "not in a loop with a torque sensor: the sensor sees it, feeding it forward gains 0"
        )
    names = ("hysteresis_stiffness", "hysteresis_rate")
    return Proposal(effect, tuple(Setting(TORQUE, name, case.model.number(effect, name)) for name in names))


def _gauge_gain(case: JointCase, effect: str) -> Proposal:
    return Proposal(effect, (Setting(FUSION, "gauge_gain", 1.0 + case.model.number(effect, "gauge_gain_error")),))


def gauge_gain(case: JointCase) -> float:
    """The gain that fusion will divide by: the model's if it is sure, else the present one."""
    error = case.sure("gauge_gain", "gauge_gain_error")
    return 1.0 + error if error is not None else case.fusion("gauge_gain") or 1.0


def _gauge_offset(case: JointCase, effect: str) -> Proposal:
    value = gauge_gain(case) * case.model.number(effect, "gauge_offset")
    note = "holds at the mean temperature of the recording" if case.fusion("gauge_temperature_drift") else ""
    return Proposal(effect, (Setting(FUSION, "gauge_offset", value, note),))


def _gauge_ripple(case: JointCase, effect: str) -> Proposal:
    turn, gain = case.model.number(effect, "joint_turn"), gauge_gain(case)
    ahead = case.fusion("gauge_angle_offset") - case.fusion("encoder_offset") - turn * case.fusion("resolver_offset")
    settings = [Setting(FUSION, "gauge_joint_turns", 0.0 - turn)]
    for order in (2, 4):
        cosine, sine = case.wave(effect, order)
        waves = zip(("cosine", "sine"), turned(gain * cosine, gain * sine, order, -ahead), strict=True)
        settings += [Setting(FUSION, f"gauge_{kind}_{order}", value) for kind, value in waves]
    return Proposal(effect, tuple(settings))


def _delay(case: JointCase, effect: str) -> Proposal:
    delay = case.model.number(effect, "delay")
    if case.law == "integral_manifold" and case.joints == 1:
        return Proposal(effect, (Setting(TORQUE, "prediction_samples", 1.5 + delay / case.period),))
    own = case.own.get(TORQUE, {})
    gain = math.prod(float(own.get(name, 0.0)) for name in ("torsional_stiffness", "damping_time", "torque_rate_gain"))
    room = "room for it" if gain < LOOP_WARNING else "lower torque_rate_gain"
    return Proposal(effect, (), f"stability, not accuracy: k_f d lambda_tau = {gain:.2g} of {LOOP_WARNING:g}, {room}")


def _law_has_none(case: JointCase, effect: str) -> Proposal:
    return Proposal(effect, (), f"the law {case.law} has no such term")


RULES: Mapping[str, Callable[[JointCase, str], Proposal]] = {
    "gauge_gain": _gauge_gain,
    "gauge_offset": _gauge_offset,
    "gauge_ripple": _gauge_ripple,
    "torsional_stiffness": _stiffness,
    "kinematic_error": _kinematic_error,
    "coulomb_friction": _coulomb,
    "viscous_friction": _viscous,
    "asymmetric_friction": _asymmetric,
    "load_dependent_friction": _load_friction,
    "torsional_hysteresis": _hysteresis,
    "actuation_delay": _delay,
}
NO_TERM: Mapping[str, str] = {
    "rotor_inertia": "stays as commissioned: it scales the gains of the loop",
    "link_dynamics": "belongs to the robot description",
    "payload": "belongs to the robot description: add the mass to the last link",
    "link_friction": "the motion law has no such term; its integral holds it",
    "stribeck_friction": "the friction of the law, Zhu (3), (4), has no Stribeck part; the Coulomb estimate adapts",
    "temperature_friction": "the laws know no temperature; the adapting estimates follow",
    "joint_sensor_eccentricity": "fusion has no such correction; identical to an error of the transmission",
    "torque_constant_error": "correct the torque constant in the drive; the laws command its output",
}


def proposals(case: JointCase) -> Iterator[Proposal]:
    """What every effect of the joint becomes, in the order of `RULES`, then the effects without a term."""
    for effect in sorted(case.model.effects, key=lambda name: list(RULES).index(name) if name in RULES else 99):
        if effect in case.model.expressions:
            yield Proposal(effect, (), "an expression has no name that the laws know")
        elif effect not in RULES:
            yield Proposal(effect, (), NO_TERM.get(effect, "the laws have no such term"))
        elif why := unsure(case, effect):
            yield Proposal(effect, (), why)
        else:
            yield RULES[effect](case, effect)


# ---- The table, and the values that grow with it ---------------------------------------------------


PARAMETERS: Mapping[str, ParameterSet] = {FUSION: fusion.PARAMETERS, TORQUE: torque.PARAMETERS}
"""The nodes whose parameters a model can improve."""
Values = Mapping[str, Any]


@dataclass(frozen=True)
class Row:
    """One line of the table. `applied` False: `note` says why. `before`, `value` in `unit`; `live`: may change while
    the node runs."""

    joint: str
    effect: str
    applied: bool
    note: str = ""
    node: str = ""
    parameter: str = ""
    before: float | bool | None = None
    value: float | bool | None = None
    unit: str = ""
    live: bool = False


@dataclass(frozen=True)
class Applied:
    """New values by node, the values before, and the table."""

    values: Mapping[str, Values]
    before: Mapping[str, Values]
    rows: tuple[Row, ...]

    def changed(self, node: str, live: bool = False) -> dict[str, Any]:
        """The parameters of a node that differ; with `live` those of effects that a running node takes as a whole."""
        before, values = self.before[node], dict(self.values[node])
        if live:
            values, late = dict(before), self.not_live()
            for row in self.rows:
                if row.applied and row.node == node and (row.joint, row.effect) not in late:
                    _put(values, row.joint, PARAMETERS[node][row.parameter], row.value)
        return {name: value for name, value in values.items() if value != before[name]}

    def not_live(self) -> dict[tuple[str, str], str]:
        """Joint and effect that need an inactive node, with the parameter that does."""
        late = [row for row in self.rows if row.applied and row.value != row.before and not row.live]
        return {(row.joint, row.effect): row.parameter for row in late}


def _put(values: dict[str, Any], joint: str, about: Parameter, value: Any) -> None:
    """Sets one value of one joint, or of all; the lists that were there stay as they are."""
    if about.shape is Shape.PER_JOINT:
        numbers = list(values[about.name])
        numbers[list(values["joint_names"]).index(joint)] = value
        values[about.name] = numbers
    else:
        values[about.name] = value


def apply_model(
    model: Model,
    values: Mapping[str, Values],
    period: float = 1e-3,
    joints: Sequence[str] = (),
    ambiguous: Mapping[str, Mapping[str, Sequence[str]]] | None = None,
) -> Applied:
    """The controllers' values with what the model knows. `values`: complete sets of fusion and torque node, or one.

    `joints`: only these. `period` s. `ambiguous`: by joint and effect the effects that explain the same data; such an
    effect is not used. Raises ConfigError for values that are not valid, or if model and values share no joint.
    """
    for node, given in values.items():
        PARAMETERS[node].check(given, len(given.get("joint_names", ())), node)
    known = [name for given in values.values() for name in given["joint_names"]]
    chosen = [name for name in model.joints if name in known and (not joints or name in joints)]
    strangers = [name for name in joints if name not in chosen]
    if strangers or not chosen:
        what = strangers[0] if strangers else "model and parameters have no joint in common"
        raise ConfigError(f"{what}: the model has {', '.join(model.joints)}; the parameters {', '.join(known)}")
    table = _Table(values)
    for joint in chosen:
        table.take(joint, model, period, (ambiguous or {}).get(joint, {}))
    return Applied(table.values, dict(values), tuple(table.rows))


class _Table:
    """The values that grow with the rows."""

    def __init__(self, values: Mapping[str, Values]) -> None:
        self.values: dict[str, dict[str, Any]] = {
            node: {name: list(v) if isinstance(v, list) else v for name, v in given.items()}
            for node, given in values.items()
        }
        self.rows: list[Row] = []

    def take(self, joint: str, model: Model, period: float, ambiguous: Mapping[str, Sequence[str]]) -> None:
        """All effects of one joint."""
        own = {node: self._own(node, joint) for node in self.values if joint in self.values[node]["joint_names"]}
        joints = len(self.values.get(TORQUE, {}).get("joint_names", ()))
        for proposal in proposals(JointCase(model.joint(joint), own, period, joints)):
            rivals = ambiguous.get(proposal.effect, ())
            if rivals and proposal.settings:
                proposal = Proposal(proposal.effect, (), f"its name is not certain: it may be {', '.join(rivals)}")
            self._judge(joint, proposal, own)

    def _own(self, node: str, joint: str) -> dict[str, Any]:
        given, about = self.values[node], PARAMETERS[node]
        row = list(given["joint_names"]).index(joint)
        return {name: v[row] if about[name].shape is Shape.PER_JOINT else v for name, v in given.items()}

    def _judge(self, joint: str, proposal: Proposal, own: Mapping[str, Values]) -> None:
        """Takes the settings of an effect as a whole, or refuses them with the first limit that they break."""
        if not proposal.settings:
            self.rows.append(Row(joint, proposal.effect, False, proposal.reason))
            return
        usable = [setting for setting in proposal.settings if setting.node in own]
        if not usable:
            node = proposal.settings[0].node
            self.rows.append(Row(joint, proposal.effect, False, f"no parameters of {node} with this joint are given"))
            return
        trial = {node: dict(values) for node, values in self.values.items()}
        for setting in usable:
            _put(trial[setting.node], joint, PARAMETERS[setting.node][setting.name], setting.value)
        for node, values in trial.items():
            if broken := PARAMETERS[node].problems(values, len(values["joint_names"])):
                self.rows.append(Row(joint, proposal.effect, False, f"limit: {broken[0]}"))
                return
        self.values = trial
        self.rows += [self._row(joint, proposal.effect, setting, own) for setting in usable]

    def _row(self, joint: str, effect: str, setting: Setting, own: Mapping[str, Values]) -> Row:
        about = PARAMETERS[setting.node][setting.name]
        before, live = own[setting.node][setting.name], about.change is Change.HOT
        return Row(
            joint, effect, True, setting.note, setting.node, setting.name, before, setting.value, about.unit, live
        )
