"""From a model file's joint and a recording to the task of fitting: what is known, with which values, how surely."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from hd_control.core.arrays import FloatArray
from hd_control.drive.effect import LINK, MOTOR, TRANSMISSION, Context, Effect, Shape
from hd_control.drive.library import library
from hd_control.drive.model import JointModel
from hd_control.lab.balances.channels import JointEquations, Known, LinkFunction
from hd_control.lab.balances.equations import build_equations
from hd_control.lab.diagnosis.corrections import Task
from hd_control.lab.diagnosis.dictionary import Dictionary
from hd_control.lab.signals.joint_signals import JointSignals

DELAY = "actuation_delay"
"""A delay in the model shifts the command; what exceeds it stays a candidate."""
PRIORS = {"datasheet": 0.1, "measured": 0.05, "fitted": 0.05, "guess": 1.0}
"""Relative standard deviation of an inertia by the source of its value, where the file gives no interval."""


def equations_of(signals: JointSignals, joint: JointModel, link: LinkFunction | None) -> JointEquations:
    """The balances of a recording in the units of the model."""
    inertia = joint.effects.get("rotor_inertia", {}).get("rotor_inertia")
    known = Known(
        gear_ratio=joint.gear_ratio,
        rotor_inertia=1.0 if inertia is None else float(inertia.value),
        rotor_inertia_prior=_prior(inertia),
        link_inertia_prior=_prior(joint.effects.get("link_dynamics", {}).get("inertia")),
        command_delay=joint.number(DELAY, "delay"),
        damping_time=joint.number("torsional_stiffness", "damping_time"),
    )
    equations = build_equations(signals, known, link)
    stiffness = joint.number("torsional_stiffness", "torsional_stiffness")
    if equations.states.torsional_compliance > 0.0 or stiffness <= 0.0:
        return equations
    return replace(equations, states=replace(equations.states, torsional_compliance=1.0 / stiffness))


def known_effects(joint: JointModel, context: Context) -> tuple[tuple[type[Effect], Shape, FloatArray], ...]:
    """The model's effects beyond those of every model: class, shape, coefficients."""
    found = []
    for name, effect in joint.effect_classes().items():
        if effect.in_every_model or name == DELAY:
            continue
        shape, coefficients = effect.split(joint.numbers(name), context)
        found.append((effect, shape, np.asarray(coefficients, dtype=float)))
    return tuple(found)


def task_of(signals: JointSignals, joint: JointModel, link: LinkFunction | None) -> Task:
    """Everything that a diagnosis of this joint needs."""
    equations = equations_of(signals, joint, link)
    context = joint.context(equations.states.torque_scale)
    known = known_effects(joint, context)
    return Task(
        equations=equations,
        library=library(),
        known=tuple((effect, shape) for effect, shape, _ in known),
        context=context,
        rated_torque=joint.rated_torque,
    )


def written_coefficients(dictionary: Dictionary, joint: JointModel, context: Context) -> FloatArray:
    """The model's own values as coefficients (p,) of a dictionary that was not rescaled."""
    compliance = 1.0 / context.torsional_stiffness
    channel = dictionary.equations.channels.get(TRANSMISSION)
    around = 0.0 if channel is None else channel.damping_time
    damping = (joint.number("torsional_stiffness", "damping_time") - around) * compliance
    base = {
        (MOTOR, "drive_torque"): 1.0,
        (MOTOR, "coulomb_friction"): context.coulomb_torque,
        (MOTOR, "viscous_friction"): joint.number("viscous_friction", "viscous"),
        (TRANSMISSION, "torsional_compliance"): compliance,
        (TRANSMISSION, "torsional_damping"): damping,
        (TRANSMISSION, "transmission_zero"): joint.number("torsional_stiffness", "transmission_zero"),
        (LINK, "drive_torque"): 1.0,  # the nominal link terms hold the inertia scale already
    }
    coefficients = np.zeros(dictionary.size)
    for i, name in enumerate(dictionary.base_names):
        coefficients[i] = base.get(name, 0.0)
    values = {effect.name: c for effect, _, c in known_effects(joint, context)}
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
