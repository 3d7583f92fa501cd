"""How a campaign asks the diagnosis: columns and data-sheet values in, the JSON form of one joint out. Blind."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

if TYPE_CHECKING:
    from hd_control.analysis.signals import Recording
    from hd_control.drive.model import JointModel, Model
    from hd_sim.campaign import Question

FloatArray = NDArray[np.float64]
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


def oracle(question: Question, answer: Mapping[str, Any], names: Sequence[str]) -> float | None:
    """Held-out reduction of the answer over that of the true names, both fitted on the first recording."""
    return None
