"""From a recording and a model to answers, joint by joint: what commands and pages call.

A diagnosis, a comparison, and the residuals as series on the bag's clock for plotting tools.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial
from typing import Any

import numpy as np
from numpy.typing import NDArray

from hd_control.core.arrays import FloatArray
from hd_control.core.errors import ConfigError
from hd_control.drive.model import Model
from hd_control.lab.balances.channels import JointEquations, shown_unit
from hd_control.lab.balances.link import LinkSide
from hd_control.lab.balances.noise import Noise
from hd_control.lab.diagnosis.by_innovations import diagnose_innovations
from hd_control.lab.diagnosis.corrections import Task
from hd_control.lab.diagnosis.diagnose import diagnose
from hd_control.lab.diagnosis.task import task_of, written_coefficients
from hd_control.lab.diagnosis.verdict import CANNOT_TELL, Experiment, JointDiagnosis
from hd_control.lab.maps.condition_maps import conditions_of, maps_of, sentence, worst
from hd_control.lab.maps.orders import describe, lines_of, order_spectrum
from hd_control.lab.models.compare import ChannelComparison, Horizons, JointComparison, compare, horizons, noises_of
from hd_control.lab.models.observations import Observations, observe
from hd_control.lab.signals.checks import SignalChecks, examine
from hd_control.lab.signals.delays import KnownLinks
from hd_control.lab.signals.joint_signals import Recording
from hd_control.lab.signals.sensors import SensorQuality
from hd_control.record.tables import topic_name

WORST = 8


@dataclass(frozen=True)
class JointReport:
    """A model against one joint: comparison with worst conditions, one sentence per channel, free runs, remarks.

    `order_lines`: channel -> lines of the residual's order spectrum, one sentence each.
    """

    joint: str
    signals: tuple[str, ...]
    comparison: JointComparison
    sentences: Mapping[str, str]
    order_lines: Mapping[str, tuple[str, ...]]
    horizons: Horizons
    notes: tuple[str, ...]
    observations: Observations

    def json(self) -> dict[str, Any]:
        """The form of `hd.compare/1`."""
        channels = {name: channel.json() for name, channel in self.comparison.channels.items()}
        for name, text in self.sentences.items():
            channels[name]["sentence"] = text
            channels[name]["order_lines"] = list(self.order_lines.get(name, ()))
        return {
            "signals": list(self.signals),
            "channels": channels,
            "free_run": self.horizons.json(),
            "notes": list(self.notes),
            **self.observations.json(),
        }


def joint_task(recording: Recording, model: Model, joint: str, link: LinkSide | None = None) -> Task:
    """The task of one joint. Raises ConfigError if the joint is not in the model or not in the recording."""
    if joint not in recording.joints:
        raise ConfigError(f"{recording.path}: no joint {joint!r} is recorded; there is {', '.join(recording.joints)}")
    side = link if link is not None else LinkSide(model, recording.joints)
    return task_of(recording.joints[joint], model.joint(joint), side.function(joint), partial(side.own_link, joint))


def checks_of(recording: Recording, model: Model, joint: str, equations: JointEquations) -> SignalChecks:
    """Do the signals of one joint make sense, and do they agree with what the model says of gear and gravity?"""
    about, s = model.joint(joint), equations.states
    known = model.robot is not None and np.isfinite(s.link_bias_torque).all()
    links = KnownLinks(s.link_inertia_torque, s.link_bias_torque) if known else None
    return examine(recording.joints[joint], about.gear_ratio, about.rated_torque, links)


def notes_of(recording: Recording, joint: str, link: LinkSide, checks: SignalChecks) -> tuple[str, ...]:
    """What looks wrong with the signals, and what the model does not allow."""
    why = link.why_not(joint)
    return (*recording.joints[joint].notes, *checks.sentences, *([why] if why else []))


BALANCES, INNOVATIONS = "balances", "innovations"
FORMS = (BALANCES, INNOVATIONS)
"""What decides: residuals of the filtered balances, or what a filter of the joint did not predict."""


def diagnose_joint(
    recording: Recording, model: Model, joint: str, link: LinkSide | None = None, form: str = BALANCES
) -> JointDiagnosis:
    """Which effect is missing in the model of one joint, by one of `FORMS`; none is named from signals that contradict
    the model."""
    side = link if link is not None else LinkSide(model, recording.joints)
    task = joint_task(recording, model, joint, side)
    checks = checks_of(recording, model, joint, task.equations)
    if checks.contradictions:
        found = contradicted(joint, checks.contradictions)
    else:
        found = diagnose_innovations(task) if form == INNOVATIONS else diagnose(task)
    return replace(found, notes=(*notes_of(recording, joint, side, checks), *found.notes))


def contradicted(joint: str, why: tuple[str, ...]) -> JointDiagnosis:
    """The answer for signals that contradict the model: no name, and the contradictions as the reason."""
    experiments = (Experiment("signals that agree with the model", f"mend mapping or model: {'; '.join(why)}"),)
    return JointDiagnosis(joint, CANNOT_TELL, (), None, experiments, {}, None, contradictions=why)


def compare_joint(
    recording: Recording,
    model: Model,
    joint: str,
    link: LinkSide | None = None,
    noises: Mapping[str, Noise] | None = None,
    free_run: bool = True,
) -> JointReport:
    """How well the model of one joint explains its recording, as written and refitted, and where it fails.

    `noises`: those of another model on the same recording, so that both are judged by one noise.
    """
    side = link if link is not None else LinkSide(model, recording.joints)
    task = joint_task(recording, model, joint, side)
    seen = observe(recording.joints[joint], task.equations, checks_of(recording, model, joint, task.equations))
    found = compare_task(task, model, joint, noises, seen.sensors)
    runs = horizons(task, recording.joints[joint], model.joint(joint), side) if free_run else Horizons({})
    channels, sentences, lines = {}, {}, {}
    for name, channel in found.channels.items():
        maps = maps_of(conditions_of(task.equations, name), channel.residual, channel.used)
        channels[name] = replace(channel, worst=tuple(worst(maps, WORST)))
        sentences[name] = sentence(maps, channel.noise_floor)
        lines[name] = _order_lines(found, channel)
    notes = notes_of(recording, joint, side, seen.checks)
    present = recording.joints[joint].present
    return JointReport(joint, present, replace(found, channels=channels), sentences, lines, runs, notes, seen)


def _order_lines(found: JointComparison, channel: ChannelComparison) -> tuple[str, ...]:
    """Named lines of the residual of the refitted model, cycles per turn."""
    record = found.order_record(channel.name, refitted=True)
    spectrum = order_spectrum([record], found.dictionary.equations.states.gear_ratio)
    factor, unit = shown_unit(channel.unit)
    return tuple(describe(line, spectrum, unit, factor) for line in lines_of(spectrum))


def compare_task(
    task: Task,
    model: Model,
    joint: str,
    noises: Mapping[str, Noise] | None = None,
    sensors: Mapping[str, SensorQuality] | None = None,
) -> JointComparison:
    """The model as written and refitted, on its own task; noise floors not below what the `sensors` allow."""
    if noises is None:
        noises = noises_of(task)
    first = compare(task, None, noises)
    return compare(task, written_coefficients(first.dictionary, model.joint(joint), task.context), noises, sensors)


# ---- Residual channels as series -------------------------------------------------------------------


NS = 1_000_000_000
Comparisons = Mapping[str, Mapping[str, tuple[FloatArray, FloatArray, FloatArray]]]
"""Joint -> channel -> (time s, residual, measured), each (rows,) in the unit of the channel, NaN where unusable."""


def residual_series(comparisons: Comparisons, start_ns: int = 0) -> dict[str, tuple[NDArray[np.int64], FloatArray]]:
    """Series `measured/JOINT/CHANNEL` and `residual/JOINT/CHANNEL`; `start_ns`: stamp of time zero."""
    found = {}
    for joint, channels in comparisons.items():
        for channel, (time, residual, measured) in channels.items():
            stamps = start_ns + np.round(np.asarray(time) * NS).astype(np.int64)
            found[topic_name("measured", joint, channel)] = (stamps, np.asarray(measured, dtype=np.float64))
            found[topic_name("residual", joint, channel)] = (stamps, np.asarray(residual, dtype=np.float64))
    return found


def residual_pages(comparisons: Comparisons) -> dict[str, list[list[str]]]:
    """One page per joint; per channel the measured series over the residual."""
    return {
        joint: [[topic_name(kind, joint, channel)] for channel in channels for kind in ("measured", "residual")]
        for joint, channels in comparisons.items()
        if channels
    }


def channel_rows(
    recording: Recording, model: Model, joints: Sequence[str]
) -> Iterator[tuple[str, dict[str, tuple[FloatArray, FloatArray, FloatArray]]]]:
    """(joint, channel -> (time, residual of the model as written, measured)), joint by joint. Raises ConfigError."""
    side = LinkSide(model, recording.joints)
    for joint in joints:
        task = joint_task(recording, model, joint, side)
        noises = noises_of(task)
        dictionary = compare(task, None, noises).dictionary
        written = written_coefficients(dictionary, model.joint(joint), task.context)
        yield joint, {name: _rows(channel) for name, channel in compare(task, written, noises).channels.items()}


def _rows(channel: ChannelComparison) -> tuple[FloatArray, FloatArray, FloatArray]:
    residual = np.where(channel.used, channel.residual, np.nan)
    return channel.time, residual, np.where(channel.used, channel.measured, np.nan)
