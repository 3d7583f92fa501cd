"""How a campaign asks the diagnosis: columns and data-sheet values in, the JSON form of one joint out. Blind."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Any

import numpy as np

from hd_control.core.arrays import FloatArray

if TYPE_CHECKING:
    from hd_control.analysis.signals import Recording
    from hd_control.drive.model import JointModel, Model
    from hd_sim.campaign import Question

COLUMNS = (
    "motor_shaft_position",
    "joint_position",
    "gauge_torque",
    "motor_torque",
    "temperature",
    "reference_position",
)


def joint_model(model: Mapping[str, Any]) -> JointModel:
    """The nominal joint of a pair as the drive model's own type; every value says that it is of the data sheet."""
    from hd_control.drive.model import JointModel, ModelValue

    effects = {
        effect: {name: ModelValue(value=value, source="datasheet") for name, value in values.items()}
        for effect, values in model["effects"].items()
    }
    return JointModel(gear_ratio=model["gear_ratio"], rated_torque=model["rated_torque"], effects=effects)


def nominal_model(model: Mapping[str, Any]) -> Model:
    """The nominal model of a pair: its robot and its joint."""
    from hd_control.drive.model import Model

    return Model(model["robot"], {model["joint"]: joint_model(model)})


def recording(columns: Mapping[str, FloatArray], joint: str, period: float) -> Recording:
    """The columns of a recording as the analysis reads them from a bag."""
    from hd_control.analysis.signals import JointSignals, Recording

    signals = JointSignals(
        joint=joint,
        time=columns["time"],
        period=period,
        valid=np.ones(columns["time"].size, dtype=bool),
        sources={name: name for name in COLUMNS},
        motor_shaft_position=columns["motor_shaft_position"],
        joint_position=columns["joint_position"],
        gauge_torque=columns["gauge_torque"],
        motor_torque=columns["motor_torque"],
        temperature=columns["temperature"],
        reference_position=columns["reference_position"],
    )
    return Recording("", "", {joint: signals})


def ask(question: Question) -> Mapping[str, Any]:
    """The diagnosis of the first recording."""
    from hd_control.analysis.workbench import diagnose_joint

    joint = str(question.model["joint"])
    answer = diagnose_joint(recording(question.fit, joint, question.period), nominal_model(question.model), joint)
    return answer.json()


HELD_OUT_EVERY = 4
"""Of how many joints the held-out reduction is measured once; it costs more than the diagnosis."""


def oracle(question: Question, answer: Mapping[str, Any], names: Sequence[str], seed: int) -> dict[str, float | None]:
    """What the true structure gains on the fitted recording, and what the answer reaches of it on the other one."""
    gains = {e["name"]: float(e.get("gain_nats") or 0.0) for e in answer.get("effects") or []}
    named = list(gains)
    true_gains = [gains[n] if n in gains else _gain_of(question, n, [m for m in names if m != n]) for n in names]
    share = None
    if seed % HELD_OUT_EVERY == 0 and named:
        base, answered, true = (_held_out(question, effects) for effects in ([], named, list(names)))
        share = (base - answered) / (base - true) if base > true else None
    return {"gain": min(true_gains, default=0.0), "held_out_share": share}


def _fitted(question: Question, effects: Sequence[str]) -> tuple[Model, float]:
    """The model with these effects, fitted one after the other, and what the last one gained, nats."""
    from dataclasses import replace

    from hd_control.analysis.adding import fit_joint
    from hd_control.analysis.workbench import joint_task
    from hd_control.core.errors import HdError

    joint = str(question.model["joint"])
    model, gain = nominal_model(question.model), 0.0
    columns = recording(question.fit, joint, question.period)
    for effect in [None, *effects]:
        try:
            found = fit_joint(joint_task(columns, model, joint), model.joint(joint), effect)
        except HdError:  # what the recording does not show is not added
            gain = 0.0
            continue
        model, gain = replace(model, joints={joint: found.model}), found.gain
    return model, gain


def _gain_of(question: Question, effect: str, others: Sequence[str]) -> float:
    return _fitted(question, [*others, effect])[1]


def _held_out(question: Question, effects: Sequence[str]) -> float:
    """Squared held-out errors over the noise floor, channels added, of a fit with these effects."""
    from hd_control.analysis.workbench import compare_task, joint_task

    joint = str(question.model["joint"])
    model, _ = _fitted(question, effects)
    task = joint_task(recording(question.held_out, joint, question.period), model, joint)
    channels = compare_task(task, model, joint).channels.values()
    return sum((channel.rms_error / channel.noise_floor) ** 2 for channel in channels)
