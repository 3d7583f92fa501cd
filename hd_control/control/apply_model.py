"""An identified model into the controllers' parameters: what is applied, what is not, and why.

applied = apply_model(model, {"torque_node": values, "fusion_node": values})
applied.values["torque_node"], applied.rows

Nothing is written that a rule or a limit of the law's parameters refuses. Pure: values in, values out.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

from hd_control.control import torque
from hd_control.control.apply_rules import FUSION, TORQUE, JointCase, Proposal, Setting, proposals
from hd_control.core.errors import ConfigError
from hd_control.core.parameters import Change, Parameter, ParameterSet, Shape
from hd_control.drive.model import Model
from hd_control.sensing import fusion

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
