"""`hd add EFFECT --model M --bag BAG -o M2`: fits an effect, and what it is coupled with, and writes the new model."""

from __future__ import annotations

import argparse
from collections.abc import Iterator
from dataclasses import replace
from typing import TYPE_CHECKING, Any

from hd_control.cli._workbench import (
    add_bag_options,
    bag_entry,
    chosen_joints,
    exit_code,
    name_of,
    one_thread,
    open_bag,
    open_model,
    provenance,
    report_recording,
)

if TYPE_CHECKING:
    from hd_control.drive.model import Model
    from hd_control.lab.models.fit_model import FittedJoint, FittedParameter
    from hd_control.lab.signals.joint_signals import Recording

NAME = "add"
HELP = "fit an effect to a recording and write the model that has it, with intervals and provenance"
EXAMPLE = """hd add kinematic_error --model arm_a.yaml --bag bags/run1 --joint joint_3 -o better.yaml
  hd add --refit --model arm_a.yaml --bag bags/run1 -o refitted.yaml"""
SCHEMA = "hd.add/1"


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """The options of the command."""
    parser.add_argument("effect", metavar="EFFECT", nargs="?", help="name of an effect, such as kinematic_error")
    parser.add_argument("--refit", action="store_true", help="no new effect: fit the values that the model has")
    parser.add_argument("--model", metavar="M", required=True, help="model file or shipped model")
    parser.add_argument("--bag", metavar="BAG", required=True, help="bag folder, .mcap or .db3 file")
    parser.add_argument("-o", "--output", metavar="M2", required=True, help="model file to write")
    add_bag_options(parser, bags="none")


def run(arguments: argparse.Namespace) -> int:
    """Writes the model; 0 done, 3 if the bag could be read in part only."""
    one_thread()
    from hd_control.cli.main import UsageError
    from hd_control.cli.options import refuse_overwrite, say, track, write_json
    from hd_control.drive.library import effect_named
    from hd_control.drive.model_file import model_sha256, save_model

    if bool(arguments.effect) == arguments.refit:
        raise UsageError("add: give the name of an effect, or --refit")
    if arguments.effect:
        effect_named(arguments.effect)
    refuse_overwrite(arguments.output, arguments.force)
    recording = open_bag(arguments, arguments.bag)
    model = open_model(arguments.model, recording)
    joints = _joints(arguments, recording, model)
    report_recording(arguments, recording)
    document: dict[str, Any] = {"schema": SCHEMA, "bag": bag_entry(recording), "effect": arguments.effect, "joints": {}}
    for joint in track(arguments, joints, len(joints), "fitting"):
        model, fitted, notes = _fit(recording, model, joint, arguments.effect)
        rows = [vars(row) for row in fitted.parameters]
        document["joints"][joint] = {"gain_nats": fitted.gain, "parameters": rows, "notes": list(notes)}
        for line in (*lines(joint, fitted.parameters, fitted.gain), *(f"  ! {text}" for text in notes)):
            say(arguments, line)
    effect = [arguments.effect] if arguments.effect else ["--refit"]
    words = ["add", *effect, "--model", name_of(arguments.model), "--bag", name_of(arguments.bag)]
    step = provenance([*words, *(word for joint in joints for word in ("--joint", joint))], [recording])
    written = save_model(model, arguments.output, step, arguments.force)
    document["model"] = {"path": arguments.output, "sha256": model_sha256(written)}
    say(arguments, f"written: {arguments.output}")
    write_json(arguments, document)
    return exit_code(recording)


def _joints(arguments: argparse.Namespace, recording: Recording, model: Model) -> list[str]:
    from hd_control.core.errors import HdError

    joints = chosen_joints(arguments, recording, model)
    if arguments.effect and not arguments.joint and len(joints) > 1:
        raise HdError(f"add: give with --joint the joint that gets {arguments.effect}; there is {', '.join(joints)}")
    return joints


def _fit(
    recording: Recording, model: Model, joint: str, effect: str | None
) -> tuple[Model, FittedJoint, tuple[str, ...]]:
    """The model with one joint fitted, its table, and which measured delays were taken out. Raises HdError if signals
    and model contradict each other."""
    from hd_control.core.errors import HdError
    from hd_control.lab.models.answers import checks_of, joint_task
    from hd_control.lab.models.fit_model import fit_joint
    from hd_control.lab.models.ladder import with_delays
    from hd_control.lab.signals.delays import carried

    task = joint_task(recording, model, joint)
    checks = checks_of(recording, model, joint, task.equations)
    if checks.contradictions:
        why = "; ".join(checks.contradictions)
        raise HdError(f"{joint}: signals and model contradict each other, so nothing is fitted: {why}")
    delays, notes = carried(checks.delays)
    if delays:
        task = joint_task(with_delays(recording, joint, delays), model, joint)
    fitted = fit_joint(task, model.joint(joint), effect)
    return replace(model, joints={**model.joints, joint: fitted.model}), fitted, notes


def lines(joint: str, rows: tuple[FittedParameter, ...], gain: float) -> Iterator[str]:
    """The parameter table of one joint as text."""
    yield f"{joint}:" + (f" held-out gain {gain:.0f} nats" if gain else "")
    for row in rows:
        was = "" if row.was is None else f", was {row.was:.5g}"
        yield (
            f"  {row.effect:<22} {row.name:<22} {row.value:>11.5g} {row.unit:<9}"
            f"({row.low:.5g} ... {row.high:.5g}{was})" + (f"  {row.remark}" if row.remark else "")
        )
