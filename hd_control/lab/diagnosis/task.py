"""From a model file's joint and a recording to the task of fitting: what is known, with which values, how surely."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np

from hd_control.core.arrays import FloatArray
from hd_control.drive.effect import (
    COULOMB,
    DAMPING_TIME,
    LINK,
    LINK_INERTIA,
    MOTOR,
    ROTOR_INERTIA,
    STIFFNESS,
    TRANSMISSION,
    VISCOUS,
    ZERO,
    Context,
    Effect,
    Shape,
)
from hd_control.drive.library import base_numbers, library
from hd_control.drive.link import OwnLink
from hd_control.drive.model import JointModel
from hd_control.lab.balances.channels import JointEquations, Known, LinkFunction
from hd_control.lab.balances.equations import build_equations
from hd_control.lab.diagnosis.corrections import Task
from hd_control.lab.diagnosis.dictionary import Dictionary
from hd_control.lab.innovations.equations import Given
from hd_control.lab.signals.filters import Spectral
from hd_control.lab.signals.joint_signals import JointSignals

PRIORS = {"datasheet": 0.1, "measured": 0.05, "fitted": 0.05, "guess": 1.0}
"""Relative standard deviation of an inertia by the source of its value, where the file gives no interval."""


def equations_of(signals: JointSignals, joint: JointModel, link: LinkFunction | None) -> JointEquations:
    """The balances of a recording in the units of the model."""
    base, priors = _base(joint), _priors(joint)
    known = Known(
        gear_ratio=joint.gear_ratio,
        rotor_inertia=base.get(ROTOR_INERTIA, 1.0),
        rotor_inertia_prior=priors[ROTOR_INERTIA],
        link_inertia_prior=priors[LINK_INERTIA],
        command_delay=_command_delay(joint),
        damping_time=base.get(DAMPING_TIME, 0.0),
    )
    equations = build_equations(signals, known, link)
    stiffness = base.get(STIFFNESS, 0.0)
    if equations.states.torsional_compliance > 0.0 or stiffness <= 0.0:
        return equations
    return replace(equations, states=replace(equations.states, torsional_compliance=1.0 / stiffness))


def known_effects(joint: JointModel, context: Context) -> tuple[tuple[type[Effect], Shape, FloatArray], ...]:
    """The model's effects beyond those of every model: class, shape, coefficients.

    A delay of the command is applied before (`equations_of`); what exceeds it stays a candidate.
    """
    found = []
    for name, effect in joint.effect_classes().items():
        if effect.in_every_model or effect.shifts_command:
            continue
        shape, coefficients = effect.split(joint.numbers(name), context)
        found.append((effect, shape, np.asarray(coefficients, dtype=float)))
    return tuple(found)


def task_of(
    signals: JointSignals,
    joint: JointModel,
    link: LinkFunction | None,
    own: Callable[[Spectral], OwnLink | None] = lambda spectral: None,
) -> Task:
    """Everything that a diagnosis of this joint needs. `own`: its own link along the recording, None if not known."""
    equations = equations_of(signals, joint, link)
    context = joint.context(equations.states.torque_scale)
    known = known_effects(joint, context)
    return Task(
        equations=equations,
        library=library(),
        known=tuple((effect, shape) for effect, shape, _ in known),
        context=context,
        rated_torque=joint.rated_torque,
        given=lambda: Given(signals, own(equations.spectral), _base(joint), _command_delay(joint), known),
    )


def written_coefficients(dictionary: Dictionary, joint: JointModel, context: Context) -> FloatArray:
    """The model's own values as coefficients (p,) of a dictionary that was not rescaled."""
    held, compliance = _base(joint), 1.0 / context.torsional_stiffness
    channel = dictionary.equations.channels.get(TRANSMISSION)
    around = 0.0 if channel is None else channel.damping_time
    damping = (held.get(DAMPING_TIME, 0.0) - around) * compliance
    base = {
        (MOTOR, "drive_torque"): 1.0,
        (MOTOR, COULOMB): context.coulomb_torque,
        (MOTOR, VISCOUS): held.get(VISCOUS, 0.0),
        (TRANSMISSION, "torsional_compliance"): compliance,
        (TRANSMISSION, "torsional_damping"): damping,
        (TRANSMISSION, ZERO): held.get(ZERO, 0.0),
        (LINK, "drive_torque"): 1.0,  # the nominal link terms hold the inertia scale already
    }
    coefficients = np.zeros(dictionary.size)
    for i, name in enumerate(dictionary.base_names):
        coefficients[i] = base.get(name, 0.0)
    values = {effect.name: c for effect, _, c in known_effects(joint, context)}
    for group in dictionary.known:
        coefficients[group.index] = values[group.name]
    return coefficients


def _base(joint: JointModel) -> dict[str, float]:
    """Values of the model by base number; a number that the model does not give is left out."""
    found = {}
    for effect, one in base_numbers():
        values = joint.numbers(effect.name)
        if one.parameter in values:
            found[one.number] = float(values[one.parameter])
    return found


def _priors(joint: JointModel) -> dict[str, float]:
    """Relative standard deviation of every base number."""
    values = {one.number: joint.effects.get(e.name, {}).get(one.sure_as or one.parameter) for e, one in base_numbers()}
    return {number: _prior(value) for number, value in values.items()}


def _shifting() -> list[tuple[str, type[Effect]]]:
    """Effects that delay the command, by name."""
    return [(name, effect) for name, effect in library().items() if effect.shifts_command]


def _command_delay(joint: JointModel) -> float:
    """Delay of the command that the model knows, s."""
    return sum(joint.number(name, effect.shifts_command) for name, effect in _shifting())


def _prior(value: object) -> float:
    """Relative standard deviation of a model value: from its interval, else from its source."""
    interval, source = getattr(value, "interval", None), getattr(value, "source", "datasheet") or "datasheet"
    number = float(getattr(value, "value", 0.0) or 0.0)
    if interval and number:
        return max(1e-3, float(interval[1] - interval[0]) / (4.0 * abs(number)))
    return PRIORS.get(str(source), 0.1)
