"""The workbench's view of the plain joint of two masses: its balances, its model, its tasks; each made once."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from functools import lru_cache

import numpy as np
from oracles.simple_joint import RATIO, Changes, Joint, Tones, simulate, with_noise

from hd_control.drive.model import JointModel, Model, ModelValue
from hd_control.lab.balances.channels import JointEquations, Known, LinkFunction, LinkTerms
from hd_control.lab.balances.equations import build_equations
from hd_control.lab.balances.states import JOINT_TAPER
from hd_control.lab.diagnosis.candidates import Candidate
from hd_control.lab.diagnosis.dictionary import Dictionary, build
from hd_control.lab.diagnosis.scores import Scores
from hd_control.lab.signals.filters import Band, Spectral, band_for
from hd_control.lab.signals.joint_signals import JointSignals, Recording

PLAIN = Joint()
NAME = "joint_1"


def known(joint: Joint = PLAIN, **more: float) -> Known:
    """What the data sheet of the plain joint says."""
    return Known(RATIO, joint.rotor_inertia, **{"damping_time": joint.damping_time, **more})


def link_of(signals: JointSignals, joint: Joint = PLAIN) -> LinkFunction:
    """J q'' and g sin q of the recorded joint angle, filtered as the rows of the link balance ask for."""
    assert signals.joint_position is not None
    position = np.asarray(signals.joint_position)

    def terms(band: Band, spectral: Spectral) -> LinkTerms:
        light = band_for(signals.period, *JOINT_TAPER)
        angle = spectral.filter(position, Band(light.flat, light.zero, band.step))
        gravity = spectral.filter(joint.gravity * np.sin(position), band)
        assert angle.shape == gravity.shape
        return joint.link_inertia * spectral.filter(position, band, 2), joint.gravity * np.sin(angle), None, None

    return terms


@lru_cache(maxsize=16)
def signals(changes: Changes = Changes(), noisy: bool = True, tones: Tones | None = None) -> JointSignals:  # noqa: B008
    """The plain joint, with the noise of good sensors."""
    whole = simulate(changes) if tones is None else simulate(changes, tones=tones)
    return with_noise(whole) if noisy else whole


@lru_cache(maxsize=16)
def equations(changes: Changes = Changes(), noisy: bool = True) -> JointEquations:  # noqa: B008
    """Its three balances in the units of its data sheet."""
    recorded = signals(changes, noisy)
    return build_equations(recorded, known(), link_of(recorded))


def joint_model(joint: Joint = PLAIN, without: Sequence[str] = ()) -> JointModel:
    """The joint as a model file would hold it; all values right."""
    values = {
        "rotor_inertia": {"rotor_inertia": (joint.rotor_inertia, "kg m^2")},
        "coulomb_friction": {"coulomb_torque": (joint.coulomb, "N m")},
        "viscous_friction": {"viscous": (joint.viscous, "N m s")},
        "torsional_stiffness": {
            "torsional_stiffness": (joint.stiffness, "N m/rad"),
            "damping_time": (joint.damping_time, "s"),
        },
        "link_dynamics": {
            "inertia": (joint.link_inertia, "kg m^2"),
            "gravity_sine": (joint.gravity, "N m"),
        },
    }
    effects = {
        effect: {name: ModelValue(value, unit, source="datasheet") for name, (value, unit) in numbers.items()}
        for effect, numbers in values.items()
        if effect not in without
    }
    return JointModel(RATIO, 40.0, effects)


def model(joint: Joint = PLAIN, without: Sequence[str] = ()) -> Model:
    """A model file of one joint."""
    return Model(None, {NAME: joint_model(joint, without)})


def recording(recorded: JointSignals) -> Recording:
    """A recording of that joint alone."""
    return Recording("made", "", {NAME: recorded})


def planted(
    candidates: Sequence[Candidate], sizes: Mapping[str, float] | None = None, seed: int = 0, memory: float = 0.0
) -> Dictionary:
    """A dictionary whose white rows are known: base of the plain joint, `sizes` x columns of candidates, and noise. Its
    balances hold the same columns beside the noise of the plain joint.

    sizes: coefficient of each column of the first group of that name; columns have unit norm, so nats are half its
    square. Noise has unit variance; with `memory` it is an autoregression, as if whitening had left one.
    """
    from scipy.signal import lfilter

    found, random = build(equations(), candidates), np.random.default_rng(seed)
    true = np.zeros(found.size)
    true[found.base] = Scores(found).fit(found.base)
    for name, size in (sizes or {}).items():
        true[next(group for group in found.groups if group.name == name).index] = size
    rows, channels = {}, {}
    for name, part in found.rows.items():
        raw = found.equations.channels[name].left.copy()
        for group, candidate in zip(found.groups, candidates, strict=True):
            if name in candidate.columns:
                raw += (
                    found.equations.channels[name].rows_of(candidate.columns[name]) @ (true / found.norm)[group.index]
                )
        channels[name] = replace(found.equations.channels[name], left=raw)
        noise = np.sqrt(1.0 - memory**2) * random.standard_normal(part.left.size)
        left = part.columns @ true[part.index] + lfilter([1.0], [1.0, -memory], noise)
        rows[name] = replace(part, left=left)
    return replace(found, rows=rows, equations=replace(found.equations, channels=channels))
