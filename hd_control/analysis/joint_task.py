"""From a model file's joint and a recording to the task of fitting: what is known, with which values, how surely."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace

import numpy as np

from hd_control.analysis.bands import FloatArray
from hd_control.analysis.diagnose import Task
from hd_control.analysis.dictionary import Dictionary
from hd_control.analysis.equations import JointEquations, Known, LinkFunction, build_equations
from hd_control.analysis.signals import JointSignals
from hd_control.drive.effect import LINK, MOTOR, TRANSMISSION, Context, Effect, Shape
from hd_control.drive.model import JointModel

DELAY = "actuation_delay"
"""A delay in the model shifts the command; what exceeds it stays a candidate."""
PRIORS = {"datasheet": 0.1, "measured": 0.05, "fitted": 0.05, "guess": 1.0}
"""Relative standard deviation of an inertia by the source of its value, where the file gives no interval."""


def value_of(joint: JointModel, effect: str, parameter: str, default: float = 0.0) -> float:
    """A parameter's value in the model, `default` if the model does not hold it."""
    found = joint.effects.get(effect, {}).get(parameter)
    return default if found is None else float(found.value)


def context_of(joint: JointModel, torque_scale: float = 1.0) -> Context:
    """Stiffness and Coulomb torque as the model states them."""
    stiffness = value_of(joint, "torsional_stiffness", "torsional_stiffness", np.inf)
    return Context(stiffness, value_of(joint, "coulomb_friction", "coulomb_torque"), torque_scale)


def equations_of(signals: JointSignals, joint: JointModel, link: LinkFunction | None) -> JointEquations:
    """The balances of a recording in the units of the model."""
    inertia = joint.effects.get("rotor_inertia", {}).get("rotor_inertia")
    known = Known(
        gear_ratio=joint.gear_ratio,
        rotor_inertia=1.0 if inertia is None else float(inertia.value),
        rotor_inertia_prior=_prior(inertia),
        link_inertia_prior=_prior(joint.effects.get("link_dynamics", {}).get("inertia")),
        command_delay=value_of(joint, DELAY, "delay"),
        damping_time=value_of(joint, "torsional_stiffness", "damping_time"),
    )
    return build_equations(signals, known, link)


def known_effects(
    joint: JointModel, library: Mapping[str, type[Effect]], context: Context
) -> tuple[tuple[type[Effect], Shape, FloatArray], ...]:
    """The model's effects beyond those of every model: class, shape, coefficients."""
    found = []
    for name, values in joint.effects.items():
        effect = library.get(name)
        if effect is None or effect.in_every_model or name == DELAY:
            continue
        shape, coefficients = effect.split({key: value.value for key, value in values.items()}, context)
        found.append((effect, shape, np.asarray(coefficients, dtype=float)))
    return tuple(found)


def task_of(
    signals: JointSignals, joint: JointModel, library: Mapping[str, type[Effect]], link: LinkFunction | None
) -> Task:
    """Everything that a diagnosis of this joint needs."""
    equations = equations_of(signals, joint, link)
    context = replace(context_of(joint), torque_scale=equations.states.torque_scale)
    known = known_effects(joint, library, context)
    return Task(
        equations=equations,
        library=library,
        known=tuple((effect, shape) for effect, shape, _ in known),
        context=context,
        rated_torque=joint.rated_torque,
    )


def written_coefficients(
    dictionary: Dictionary, joint: JointModel, library: Mapping[str, type[Effect]], context: Context
) -> FloatArray:
    """The model's own values as coefficients (p,) of a dictionary that was not rescaled."""
    compliance = 1.0 / context.torsional_stiffness
    channel = dictionary.equations.channels.get(TRANSMISSION)
    around = 0.0 if channel is None else channel.damping_time
    damping = (value_of(joint, "torsional_stiffness", "damping_time") - around) * compliance
    base = {
        (MOTOR, "drive_torque"): 1.0,
        (MOTOR, "coulomb_friction"): context.coulomb_torque,
        (MOTOR, "viscous_friction"): value_of(joint, "viscous_friction", "viscous"),
        (TRANSMISSION, "torsional_compliance"): compliance,
        (TRANSMISSION, "torsional_damping"): damping,
        (TRANSMISSION, "transmission_zero"): value_of(joint, "torsional_stiffness", "transmission_zero"),
        (LINK, "drive_torque"): 1.0 / value_of(joint, "link_dynamics", "inertia_scale", 1.0),
    }
    coefficients = np.zeros(dictionary.size)
    for i, name in enumerate(dictionary.base_names):
        coefficients[i] = base.get(name, 0.0)
    values = {effect.name: c for effect, _, c in known_effects(joint, library, context)}
    for group in dictionary.known:
        coefficients[group.index] = values[group.name]
    return coefficients


def _prior(value: object) -> float:
    """Relative standard deviation of a model value: from its interval, else from its source."""
    interval, source = getattr(value, "interval", None), getattr(value, "source", "datasheet") or "datasheet"
    number = float(getattr(value, "value", 0.0) or 0.0)
    if interval and number:
        return max(1e-3, float(interval[1] - interval[0]) / (4.0 * abs(number)))
    return PRIORS.get(str(source), 0.1)
