"""A selection of groups fitted to one joint: coefficients, errors in the channel's own unit, values of the base.

Physical values: what multiplies a motor column is theta = coefficient / a, a link column coefficient / b; the
dictionary is kept in units in which a and b are 1.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from hd_control.analysis.dictionary import Dictionary, base_of
from hd_control.analysis.groups import Group
from hd_control.analysis.scores import Scores
from hd_control.core.arrays import FloatArray, IntArray
from hd_control.drive.effect import LINK, MOTOR, TRANSMISSION, Context

SCALE = {MOTOR: "drive_torque", LINK: "drive_torque"}


@dataclass(frozen=True)
class Fit:
    """A fitted selection. `coefficients` (p,) in physical units, zero where not selected."""

    dictionary: Dictionary
    scores: Scores
    selection: tuple[Group, ...]
    coefficients: FloatArray

    @classmethod
    def of(cls, dictionary: Dictionary, scores: Scores, selection: Sequence[Group]) -> Fit:
        """Least squares on all folds."""
        index = index_of(dictionary, selection)
        coefficients = np.zeros(dictionary.size)
        coefficients[index] = scores.fit(index) / dictionary.norm[index]
        return cls(dictionary, scores, tuple(selection), coefficients)

    @property
    def index(self) -> IntArray:
        """Coefficients of base and selection."""
        return index_of(self.dictionary, self.selection)

    def scale(self, channel: str) -> float:
        """a or b of a channel; 1 where the torque stands on the left."""
        i = self.dictionary.base_index(channel, "drive_torque")
        return 1.0 if i is None else float(self.coefficients[i])

    @property
    def scales(self) -> dict[str, float]:
        """a and b by channel, for `Dictionary.rescaled`."""
        return {name: self.scale(name) for name in (MOTOR, LINK) if name in self.dictionary.rows}

    def base(self, channel: str, name: str) -> float | None:
        """Physical coefficient of a base column."""
        i = self.dictionary.base_index(channel, name)
        return None if i is None else float(self.coefficients[i]) / self.scale(channel)

    @property
    def rotor_inertia(self) -> float:
        """I*, kg m^2, from the scale or the correction."""
        correction = self.base(MOTOR, "inertia_correction") or 0.0
        return self.dictionary.equations.inertia / self.scale(MOTOR) * (1.0 + correction)

    @property
    def link_inertia_scale(self) -> float:
        """True over nominal link inertia: 1 / b, or 1 + correction."""
        correction = self.base(LINK, "inertia_correction") or 0.0
        return self.dictionary.equations.link_scale / self.scale(LINK) * (1.0 + correction)

    @property
    def torsional_stiffness(self) -> float:
        """k, N m/rad; NaN without a transmission channel."""
        compliance = self.base(TRANSMISSION, "torsional_compliance")
        return 1.0 / compliance if compliance and compliance > 0.0 else float("nan")

    @property
    def coulomb_torque(self) -> float:
        """N m; NaN without a rotor balance."""
        return _or_nan(self.base(MOTOR, "coulomb_friction"))

    @property
    def viscous(self) -> float:
        """N m s; NaN without a rotor balance."""
        return _or_nan(self.base(MOTOR, "viscous_friction"))

    @property
    def transmission_zero(self) -> float:
        """rad; NaN without a transmission channel."""
        return _or_nan(self.base(TRANSMISSION, "transmission_zero"))

    def relative_error(self, channel: str, name: str) -> float:
        """Half-width of the 95 % interval of a base coefficient over its value, for white noise."""
        i = self.dictionary.base_index(channel, name)
        index = self.index
        left = self.scores.gram_all[np.ix_(index, index)] + np.diag(self.scores.ridge[index])
        if i is None or self.coefficients[i] == 0.0:
            return float("inf")
        unit = (index == i).astype(float)
        deviation = float(np.sqrt(unit @ np.linalg.solve(left, unit))) / self.dictionary.norm[i]
        return float(1.96 * deviation / abs(self.coefficients[i]))

    @property
    def damping_time(self) -> float:
        """d, s; NaN without a transmission channel."""
        change = self.base(TRANSMISSION, "torsional_damping")
        if change is None:
            return float("nan")
        return self.dictionary.equations.channels[TRANSMISSION].damping_time + change * self.torsional_stiffness

    def context(self, default: Context) -> Context:
        """Stiffness and Coulomb torque for the change to physical parameters; `default` where a channel is missing."""
        compliance = self.base(TRANSMISSION, "torsional_compliance")
        stiffness = 1.0 / compliance if compliance and compliance > 0.0 else default.torsional_stiffness
        coulomb = self.base(MOTOR, "coulomb_friction")
        return Context(
            stiffness, default.coulomb_torque if coulomb is None else coulomb, self.states_scale, default.extra
        )

    @property
    def states_scale(self) -> float:
        """The torque scale of the recording, N m."""
        return self.dictionary.equations.states.torque_scale

    def parameters(self, group: Group, default: Context) -> dict[str, float]:
        """Physical parameters of a selected effect."""
        assert group.effect is not None
        values = self.coefficients[group.index] / self._group_scale(group)
        return group.effect.join(group.shape, values, self.context(default))

    def _group_scale(self, group: Group) -> float:
        return float(np.mean([self.scale(name) for name in group.channels]))

    def residuals(self) -> dict[str, FloatArray]:
        """Whitened residual (rows,) by channel."""
        scaled = self.coefficients * self.dictionary.norm
        return {name: part.left - part.columns @ scaled[part.index] for name, part in self.dictionary.rows.items()}


def _or_nan(value: float | None) -> float:
    return float("nan") if value is None else value


def index_of(dictionary: Dictionary, selection: Sequence[Group]) -> IntArray:
    """Coefficients of the base and a selection."""
    return np.concatenate([dictionary.base, *(group.index for group in selection)])


class RawRows:
    """Unwhitened rows of base and selected groups, for errors in the channel's unit. Built once for several groups."""

    def __init__(self, dictionary: Dictionary, groups: Sequence[Group]) -> None:
        self.dictionary, self.groups = dictionary, tuple(groups)
        states = dictionary.equations.states
        self._parts: dict[str, tuple[FloatArray, IntArray]] = {}
        raw = {id(g): _columns(g, states) for g in (*dictionary.known, *groups)}
        for name, channel in dictionary.equations.channels.items():
            columns, index = [channel.base_matrix], [base_of(channel, dictionary.base_names)]
            for group in (*dictionary.known, *groups):
                if name in group.channels:
                    columns.append(channel.rows_of(raw[id(group)][name]))
                    index.append(group.index)
            self._parts[name] = np.concatenate(columns, axis=1), np.concatenate(index)

    def residual(self, coefficients: FloatArray) -> dict[str, FloatArray]:
        """Left side minus columns times physical coefficients (p,), all rows of each channel."""
        found = {}
        for name, (columns, index) in self._parts.items():
            channel = self.dictionary.equations.channels[name]
            found[name] = channel.left - columns @ coefficients[index]
        return found

    def held_out_errors(self, scores: Scores, selection: Sequence[Group]) -> dict[str, float]:
        """RMS by channel on rows that were not used for the fit, fold by fold."""
        index = index_of(self.dictionary, selection)
        folds = scores.train(index) / self.dictionary.norm[index]
        squares = dict.fromkeys(self._parts, 0.0)
        counts = dict.fromkeys(self._parts, 0)
        for fold, values in enumerate(folds):
            coefficients = np.zeros(self.dictionary.size)
            coefficients[index] = values
            for name, residual in self.residual(coefficients).items():
                part = self.dictionary.rows[name]
                rows = residual[part.usable][part.fold == fold]
                squares[name] += float(rows @ rows)
                counts[name] += rows.size
        return {name: float(np.sqrt(squares[name] / max(1, counts[name]))) for name in squares}


def _columns(group: Group, states: object) -> Mapping[str, FloatArray]:
    from hd_control.drive.effect import DriveStates

    assert isinstance(states, DriveStates)
    if group.curve is not None:
        return group.curve.columns_at(states)
    assert group.effect is not None
    return group.effect.columns(states, group.shape)
