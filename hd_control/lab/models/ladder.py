"""The ladder: diagnose, add the most important effect, look at data that were not used for the fit, again.

Three parts of the data: one for fitting and diagnosing, one that decides when to stop, one for the errors that are
shown. A figure of data that have decided something would be too good.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np

from hd_control.core.errors import HdError
from hd_control.drive.effect import UNITS
from hd_control.drive.library import base_numbers
from hd_control.drive.model import Model
from hd_control.drive.model_file import model_sha256
from hd_control.lab.balances.link import LinkSide
from hd_control.lab.balances.noise import Noise
from hd_control.lab.diagnosis.corrections import Task, prepare
from hd_control.lab.diagnosis.diagnose import diagnose
from hd_control.lab.diagnosis.verdict import ADEQUATE, CANNOT_TELL, UNKNOWN, JointDiagnosis
from hd_control.lab.models.answers import checks_of, compare_task, joint_task
from hd_control.lab.models.compare import JointComparison, noises_of
from hd_control.lab.models.fit_model import FittedJoint, fit_joint
from hd_control.lab.signals.delays import carried, in_time
from hd_control.lab.signals.joint_signals import JointSignals, Recording
from hd_control.lab.signals.sensors import sensor_qualities

GIVEN, REFIT = "as given", "refit"
"""First rungs: the model as it is, and with its own values fitted again."""
LIMIT = 6
FITTED, SHOWN = 0.75, 0.2
"""Share of a recording that is fitted, beside the part that decides when to stop; share that is shown, if one recording
is all there is."""
FLOOR_REACHED = 1.05
ROSE = 1.01


@dataclass(frozen=True)
class Split:
    """What is used for fitting, for the errors that are shown, and for stopping: recordings, or parts of one."""

    train: Recording
    held_out: Recording
    stopping: Recording

    @classmethod
    def of(cls, fit: Recording, held_out: Recording) -> Split:
        """Two recordings: the last part of the first one decides when to stop."""
        cut = _cuts(fit, FITTED)
        return cls(_part(fit, {}, cut), held_out, _part(fit, cut, {}))


@dataclass(frozen=True)
class LadderRung:
    """One rung: errors RMS by channel, train and held out, in the channel's unit, and the model it belongs to.

    `stopping`: errors on the part that decides when to stop, `stopping_floor` the noise there.
    """

    effect: str
    parameters_count: int
    train: Mapping[str, float]
    held_out: Mapping[str, float]
    floor: Mapping[str, float]
    model: Model
    added: FittedJoint | None = None
    stopping: Mapping[str, float] = field(default_factory=dict)
    stopping_floor: Mapping[str, float] = field(default_factory=dict)

    def stopping_ratio(self, channel: str) -> float:
        """Error over the noise floor on the part that decides when to stop."""
        floor = self.stopping_floor.get(channel)
        return self.stopping[channel] / floor if floor else float("nan")

    def ratio(self, channel: str) -> float:
        """Held-out error over the noise floor."""
        return self.held_out[channel] / self.floor[channel] if self.floor.get(channel) else float("nan")


@dataclass(frozen=True)
class JointLadder:
    """The rungs of a joint, why it ended, the last diagnosis, the channel that the headline errors are of; `notes`: the
    measured delays that were taken out of the signals."""

    joint: str
    rungs: tuple[LadderRung, ...]
    stopped_because: str
    diagnosis: JointDiagnosis | None
    channel: str
    notes: tuple[str, ...] = ()

    @property
    def model(self) -> Model:
        """The model of the last rung."""
        return self.rungs[-1].model

    def json(self) -> dict[str, Any]:
        """The form of `hd.ladder/1`."""
        rungs = [
            {
                "effect": rung.effect,
                "parameters_count": rung.parameters_count,
                "error_train": rung.train.get(self.channel),
                "error_held_out": rung.held_out.get(self.channel),
                "noise_floor": rung.floor.get(self.channel),
                "model_sha256": model_sha256(rung.model),
                "channels": {
                    name: {
                        "unit": UNITS[name],
                        "error_train": rung.train.get(name),
                        "error_held_out": error,
                        "error_stopping": rung.stopping.get(name),
                        "noise_floor": rung.floor[name],
                    }
                    for name, error in rung.held_out.items()
                },
            }
            for rung in self.rungs
        ]
        unit = UNITS.get(self.channel, "")
        found = {"channel": self.channel, "unit": unit, "rungs": rungs, "stopped_because": self.stopped_because}
        return found | {"notes": list(self.notes)}


class _Judge:
    """Models of one joint on one recording. The noise is that of the refitted model, for all of them."""

    def __init__(self, recording: Recording, joint: str) -> None:
        self.recording, self.joint = recording, joint
        self.noises: dict[str, Noise] = {}
        self.sensors = sensor_qualities(recording.joints[joint])
        self._tasks: list[tuple[Model, Task]] = []

    def task(self, model: Model) -> Task:
        """The balances of the recording in the units of a model; those of the last two models are kept."""
        for known, task in self._tasks:
            if known is model:
                return task
        task = joint_task(self.recording, model, self.joint, LinkSide(model, self.recording.joints))
        self._tasks = [*self._tasks[-1:], (model, task)]
        return task

    def compare(self, model: Model) -> JointComparison:
        """The model as written; only the assembly zero is fitted."""
        return compare_task(self.task(model), model, self.joint, self.noises, self.sensors)


def split_recording(recording: Recording, shown: float = SHOWN) -> Split:
    """One recording: its last part is shown, of the rest the last part decides when to stop, the first is fitted."""
    cut = _cuts(recording, 1.0 - shown)
    return Split.of(_part(recording, {}, cut), _part(recording, cut, {}))


def _cuts(recording: Recording, share: float) -> dict[str, int]:
    """Sample of each joint at which a share of its recording ends."""
    return {name: round(share * joint.time.size) for name, joint in recording.joints.items()}


def climb(split: Split, model: Model, joint: str, limit: int = LIMIT) -> JointLadder:
    """The ladder of one joint. Raises HdError if the signals allow no residual channel."""
    task = joint_task(split.train, model, joint)
    checks = checks_of(split.train, model, joint, task.equations)
    delays, notes = carried(checks.delays)
    parts = (with_delays(part, joint, delays) for part in (split.train, split.held_out, split.stopping))
    split = Split(*parts) if delays else split
    if checks.contradictions:
        judges = [_Judge(part, joint) for part in (split.train, split.held_out, split.stopping)]
        for judge in judges:
            judge.noises = noises_of(judge.task(model))
        why = f"signals and model contradict each other: {'; '.join(checks.contradictions)}"
        return JointLadder(joint, (_rung(judges, GIVEN, model, joint),), why, None, "")
    found = _climb(split, model, joint, limit)
    return replace(found, rungs=_with_possible_floors(found.rungs), notes=notes)


def with_delays(recording: Recording, joint: str, delays: Mapping[str, float]) -> Recording:
    """The recording with some signals of one joint read later, by s each."""
    return replace(recording, joints={**recording.joints, joint: in_time(recording.joints[joint], delays)})


def _with_possible_floors(rungs: tuple[LadderRung, ...]) -> tuple[LadderRung, ...]:
    """Noise is never more than what any model leaves on data that were not used for its fit: next to a large missing
    effect it is estimated too high, and the rung that has the effect shows it."""

    def floor(name: str, estimated: float) -> float:
        return min([estimated, *(rung.held_out[name] for rung in rungs if name in rung.held_out)])

    return tuple(replace(rung, floor={n: floor(n, value) for n, value in rung.floor.items()}) for rung in rungs)


def _climb(split: Split, model: Model, joint: str, limit: int) -> JointLadder:
    judges = tuple(_Judge(part, joint) for part in (split.train, split.held_out, split.stopping))
    train, held, stopping = judges
    fitted = _refit(train, model, joint)
    refitted = _with(model, joint, fitted)
    dictionary = prepare(train.task(refitted))
    train.noises = dictionary.noises
    held.noises, stopping.noises = (noises_of(judge.task(refitted)) for judge in (held, stopping))
    rungs = [_rung(judges, GIVEN, model, joint), _rung(judges, REFIT, refitted, joint, fitted)]
    channel = max(rungs[-1].stopping, key=rungs[-1].stopping_ratio, default="")
    diagnosis: JointDiagnosis | None = None
    for step in range(limit):
        current = rungs[-1].model
        task = train.task(current)
        dictionary = prepare(task) if step else dictionary
        diagnosis = diagnose(task, dictionary)
        reason = _nothing_to_add(diagnosis)
        if reason:
            return JointLadder(joint, tuple(rungs), _floor(rungs[-1]) or reason, diagnosis, channel)
        effect = diagnosis.effects[0]
        try:
            fitted = fit_joint(task, current.joint(joint), effect.name, dictionary)
        except HdError as error:
            return JointLadder(joint, tuple(rungs), str(error), diagnosis, channel)
        rung = _rung(judges, effect.name, _with(current, joint, fitted), joint, fitted)
        if reason := _not_better(rung, rungs[-1], effect.channel):
            return JointLadder(joint, tuple(rungs), reason, diagnosis, channel)
        if len(rungs) == 2:
            channel = effect.channel
        rungs.append(rung)
    return JointLadder(joint, tuple(rungs), f"limit of {limit} effects reached", diagnosis, channel)


def _refit(train: _Judge, model: Model, joint: str) -> FittedJoint:
    """The model's own values fitted again, on the channels whose error that lowers.

    Beside a large missing effect the values that fit best may be absurd, such as an inertia several times too large:
    the acceleration is explained, the torque is not. Then the values of that channel stay as they were.
    """
    task, given = train.task(model), model.joint(joint)
    dictionary = prepare(task)
    fitted, train.noises = fit_joint(task, given, dictionary=dictionary), dictionary.noises
    before, after = (train.compare(each).channels for each in (model, _with(model, joint, fitted)))
    worse = {name for name, channel in after.items() if channel.rms_error > before[name].rms_error}
    stay = {effect.name for effect, one in base_numbers() if one.channel in worse and effect.name in given.effects}
    stay |= {group.name for group in dictionary.known if worse & set(group.channels)}
    kept = {name: given.effects[name] if name in stay else values for name, values in fitted.model.effects.items()}
    rows = tuple(row for row in fitted.parameters if row.effect not in stay)
    return replace(fitted, model=replace(fitted.model, effects=kept), parameters=rows)


def _nothing_to_add(diagnosis: JointDiagnosis) -> str:
    if diagnosis.verdict == ADEQUATE:
        return "no further effect is supported by the data"
    if diagnosis.verdict == CANNOT_TELL:
        return "the recording cannot tell what else is missing"
    if diagnosis.verdict == UNKNOWN and diagnosis.unknown is not None:
        return f"only something unknown is left: {diagnosis.unknown.evidence}"
    return ""


def _not_better(rung: LadderRung, last: LadderRung, channel: str) -> str:
    """Why a rung does not stay: its error rose where nothing was fitted, or no error of the channel can be shown.

    Where the part that decides is too short to show the channel, the diagnosis alone has decided, by its own held-out
    blocks: the errors that are shown never do.
    """
    if channel not in rung.held_out or channel not in last.held_out:
        what = f"the held-out recording does not show {channel}, so {rung.effect} cannot be judged"
        return f"{what}; record a longer one"
    decides = channel in rung.stopping and channel in last.stopping
    if decides and rung.stopping[channel] > ROSE * last.stopping[channel]:
        return f"{rung.effect} raised the held-out error of {channel}; it was left out"
    return ""


def _floor(rung: LadderRung) -> str:
    """Whether every channel that is shown is at its noise where the stop is decided."""
    seen = bool(rung.held_out) and set(rung.held_out) <= set(rung.stopping)
    reached = seen and all(rung.stopping_ratio(name) <= FLOOR_REACHED for name in rung.stopping)
    return f"noise floor reached: held-out errors within {100 * (FLOOR_REACHED - 1):.0f} % of it" if reached else ""


def _rung(
    judges: Sequence[_Judge], effect: str, model: Model, joint: str, added: FittedJoint | None = None
) -> LadderRung:
    train, *others = (judge.compare(model) for judge in judges)
    count = sum(len(values) for values in model.joint(joint).effects.values())
    errors = [{name: channel.rms_error for name, channel in found.channels.items()} for found in (train, *others)]
    floors = [{name: _held_out_floor(name, train, other) for name in other.channels} for other in others]
    return LadderRung(effect, count, errors[0], errors[1], floors[0], model, added, errors[2], floors[1])


def _held_out_floor(name: str, train: JointComparison, held: JointComparison) -> float:
    """Noise of a channel in the held-out recording, and not less than in the longer one at the same speeds: a short
    recording is fitted too well by the many columns that the noise is estimated with."""
    channel = held.dictionary.equations.channels[name]
    twin = train.dictionary.equations.channels.get(name)
    if twin is None or twin.band != channel.band or twin.fitted.sum() < channel.fitted.sum():
        return held.channels[name].noise_floor
    noise = train.noises[name]
    velocity = held.dictionary.equations.states.motor_velocity[:: channel.band.step]
    level = noise.level(velocity[channel.fitted])
    return max(held.channels[name].noise_floor, noise.deviation * float(np.sqrt(np.mean(level**2))))


def _with(model: Model, joint: str, fitted: FittedJoint) -> Model:
    return replace(model, joints={**model.joints, joint: fitted.model})


def _part(recording: Recording, first: Mapping[str, int], last: Mapping[str, int]) -> Recording:
    """Samples from `first` to `last` of each joint; from the beginning or to the end where nothing is said."""
    joints = {n: _cut(joint, slice(first.get(n), last.get(n))) for n, joint in recording.joints.items()}
    return replace(recording, joints=joints)


def _cut(joint: JointSignals, rows: slice) -> JointSignals:
    """Some samples of a joint, its time from zero."""
    columns: dict[str, Any] = {name: getattr(joint, name)[rows] for name in joint.present}
    time = joint.time[rows]
    return replace(joint, time=time - time[:1].sum(), valid=joint.valid[rows], **columns)
