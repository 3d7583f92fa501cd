"""From a recording and a model to answers, joint by joint. What commands and pages call."""

from __future__ import annotations

from hd_control.analysis.diagnose import diagnose
from hd_control.analysis.hunt import Task
from hd_control.analysis.joint_task import task_of
from hd_control.analysis.link_function import LinkSide
from hd_control.analysis.signals import Recording
from hd_control.analysis.verdict import JointDiagnosis
from hd_control.core.errors import ConfigError
from hd_control.drive.model import Model


def joint_task(recording: Recording, model: Model, joint: str, link: LinkSide | None = None) -> Task:
    """The task of one joint. Raises ConfigError if model or recording lack the joint."""
    if joint not in recording.joints:
        raise ConfigError(f"{recording.path}: no joint {joint!r} is recorded; there is {', '.join(recording.joints)}")
    side = link if link is not None else LinkSide(model, recording.joints)
    return task_of(recording.joints[joint], model.joint(joint), side.function(joint))


def diagnose_joint(recording: Recording, model: Model, joint: str, link: LinkSide | None = None) -> JointDiagnosis:
    """Which effect is missing in the model of one joint."""
    return diagnose(joint_task(recording, model, joint, link))
