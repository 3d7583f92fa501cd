"""What a free run steps: the numbers of the base, the terms of the other effects, and the recording behind them."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from hd_control.core.arrays import BoolArray, FloatArray, IntArray
from hd_control.core.errors import ConfigError
from hd_control.drive.effect import LINK, MOTOR, TRANSMISSION, DriveStates, Effect, Shape
from hd_control.drive.link import OwnLink
from hd_control.drive.model import JointModel

BASE = ("rotor_inertia", "torsional_stiffness", "coulomb_friction", "viscous_friction", "link_dynamics")


@dataclass(frozen=True)
class Term:
    """One effect of the model beyond the base, and what its columns depend on."""

    effect: type[Effect]
    shape: Shape
    coefficients: FloatArray
    on_direction: bool
    on_transmission: bool
    on_torque: bool

    def value(self, states: DriveStates, memory: FloatArray) -> tuple[dict[str, FloatArray], FloatArray]:
        """What the effect adds to each channel, (runs,), and its new memory."""
        columns, memory = self.effect.advance(states, self.shape, memory)
        return {channel: column @ self.coefficients for channel, column in columns.items()}, memory


@dataclass(frozen=True)
class Plant:
    """Numbers of the base, terms, and the recording with the torque corrected for what the gauge is known to add."""

    states: DriveStates
    link: OwnLink
    terms: tuple[Term, ...]
    inertia: float
    stiffness: float
    damping_time: float
    coulomb: float
    viscous: float
    zero: float

    @classmethod
    def of(cls, joint: JointModel, states: DriveStates, link: OwnLink, usable: BoolArray) -> Plant:
        stiffness = joint.number("torsional_stiffness", "torsional_stiffness")
        inertia = joint.number("rotor_inertia", "rotor_inertia")
        if stiffness <= 0.0 or inertia <= 0.0:
            raise ConfigError("a prediction needs torsional_stiffness and rotor_inertia in the model")
        known = [term for term in joint.terms(states.torque_scale) if term[0].name not in BASE]
        gauge = [term for term in known if _is_gauge(term[0], joint)]
        added = sum((e.columns(states, s)[LINK] @ c for e, s, c in gauge), np.zeros(states.time.size))
        states = replace(states, joint_torque=states.gauge_torque - added)
        terms = tuple(_term(e, s, c, states) for e, s, c in known if not _is_gauge(e, joint))
        torsion = [t.effect.columns(states, t.shape).get(TRANSMISSION) for t in terms]
        wave = sum((c @ t.coefficients for c, t in zip(torsion, terms, strict=True) if c is not None), 0.0)
        zero = states.joint_position - states.motor_position + states.joint_torque / stiffness - wave
        return cls(
            states=states,
            link=link,
            terms=terms,
            inertia=inertia,
            stiffness=stiffness,
            damping_time=joint.number("torsional_stiffness", "damping_time"),
            coulomb=joint.number("coulomb_friction", "coulomb_torque"),
            viscous=joint.number("viscous_friction", "viscous"),
            zero=_median(zero[usable]),
        )

    def measured(self, starts: IntArray, steps: int) -> tuple[FloatArray, FloatArray, FloatArray]:
        """Motor position, joint position and joint torque, each (steps + 1, windows)."""
        index = starts + np.arange(steps + 1)[:, None]
        s = self.states
        return s.motor_position[index], s.joint_position[index], s.joint_torque[index]


def _median(values: FloatArray) -> float:
    """Of the real ones; 0 if there are none."""
    real = values[np.isfinite(values)]
    return float(np.median(real)) if real.size else 0.0


def _is_gauge(effect: type[Effect], joint: JointModel) -> bool:
    """Does the effect belong to the torque sensor, so that it moves nothing?"""
    if effect.name in joint.expressions:
        return dict(joint.expressions[effect.name].channels) == {MOTOR: -1.0, LINK: 1.0}
    return effect.name.startswith("gauge_")


def _term(effect: type[Effect], shape: Shape, coefficients: FloatArray, states: DriveStates) -> Term:
    """Probes on some rows of the recording whether the columns know direction and torque."""
    rows = np.flatnonzero(np.isfinite(states.joint_torque))[:: max(1, states.time.size // 50)]
    some = rows_of(states, rows)

    def depends(a: DriveStates, b: DriveStates, channels: Sequence[str]) -> bool:
        first, second = (effect.columns(x, shape) for x in (a, b))
        return any(c in first and not np.allclose(first[c], second[c], equal_nan=True) for c in channels)

    ones = np.ones(rows.size)
    direction = depends(replace(some, motor_direction=ones), replace(some, motor_direction=-ones), (MOTOR,))
    moved = replace(some, joint_torque=1.1 * some.joint_torque + 0.01 * states.torque_scale)
    follows = depends(some, moved, (TRANSMISSION,))
    return Term(effect, shape, coefficients, direction, TRANSMISSION in effect.columns(some, shape), follows)


def rows_of(states: DriveStates, rows: IntArray) -> DriveStates:
    """The states at some rows."""
    size = states.time.size
    arrays = {name: value for name, value in vars(states).items() if isinstance(value, np.ndarray)}
    some: dict[str, Any] = {name: value[rows] for name, value in arrays.items() if len(value) == size}
    return replace(states, **some)
