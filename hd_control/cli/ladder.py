"""`hd ladder BAG --model M`: diagnose and add in a loop; the error on data that were not used for fitting."""

from __future__ import annotations

import argparse
from collections.abc import Iterator
from dataclasses import replace
from functools import partial
from typing import TYPE_CHECKING, Any

from hd_control.cli._workbench import (
    add_bag_options,
    bag_entry,
    by_joint,
    chosen_joints,
    exit_code,
    name_of,
    one_thread,
    open_bag,
    open_model,
    provenance,
    quantity,
    report_recording,
)

if TYPE_CHECKING:
    from hd_control.drive.model import Model
    from hd_control.lab.models.ladder import JointLadder, Split
    from hd_control.lab.signals.joint_signals import Recording

NAME = "ladder"
HELP = "diagnose and add until only noise stays; the error, rung by rung, on data not used for fitting"
EXAMPLE = "hd ladder bags/run1 --held-out bags/run2 --model arm_a.yaml -o better.yaml --json ladder.json"
SCHEMA = "hd.ladder/1"


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """The options of the command."""
    add_bag_options(parser)
    parser.add_argument("--model", metavar="M", required=True, help="model file or shipped model to start from")
    parser.add_argument("--held-out", metavar="BAG2", help="show errors on this bag; without it the last fifth")
    parser.add_argument("--limit", metavar="N", type=int, default=6, help="most effects to add to a joint [6]")
    parser.add_argument("-o", "--output", metavar="M2", help="write the model of the last rung")


def run(arguments: argparse.Namespace) -> int:
    """Prints the ladder; 0 done, 3 if a bag could be read in part only."""
    one_thread()
    from hd_control.cli.main import UsageError
    from hd_control.cli.options import refuse_overwrite, say, write_json
    from hd_control.lab.models.ladder import Split, split_recording

    if arguments.limit < 1:
        raise UsageError(f"ladder: --limit {arguments.limit} must be at least 1")
    if arguments.output:
        refuse_overwrite(arguments.output, arguments.force)
    recording = open_bag(arguments, arguments.bag)
    model = open_model(arguments.model, recording)
    joints = chosen_joints(arguments, recording, model)
    recordings = [recording]
    if arguments.held_out:
        recordings.append(open_bag(arguments, arguments.held_out))
        split = Split.of(*recordings)
        joints = [joint for joint in joints if joint in split.held_out.joints]
    else:
        split = split_recording(recording)
    for item in recordings:
        report_recording(arguments, item)
    document: dict[str, Any] = {"schema": SCHEMA, "bags": [bag_entry(item) for item in recordings], "joints": {}}
    best = model
    for joint, ladder in by_joint(arguments, joints, partial(_climb, split, model, arguments.limit), "climbing"):
        document["joints"][joint] = ladder.json()
        best = replace(best, joints={**best.joints, joint: ladder.model.joint(joint)})
        for line in lines(ladder):
            say(arguments, line)
    if arguments.output:
        _save(arguments, best, recordings, joints)
    write_json(arguments, document)
    return max(exit_code(item) for item in recordings)


def _climb(split: Split, model: Model, limit: int, joint: str) -> JointLadder:
    from hd_control.lab.models.ladder import climb

    ladder = climb(split, model, joint, limit)
    diagnosis = None if ladder.diagnosis is None else replace(ladder.diagnosis, fit=None)
    return replace(ladder, diagnosis=diagnosis)


def _save(arguments: argparse.Namespace, model: Model, recordings: list[Recording], joints: list[str]) -> None:
    from hd_control.cli.options import say
    from hd_control.drive.model_file import save_model

    words = ["ladder", name_of(arguments.bag), "--model", name_of(arguments.model)]
    words += ["--held-out", name_of(arguments.held_out)] if arguments.held_out else []
    words += ["--limit", str(arguments.limit), *(word for joint in joints for word in ("--joint", joint))]
    save_model(model, arguments.output, provenance(words, recordings), arguments.force)
    say(arguments, f"written: {arguments.output}")


def lines(ladder: JointLadder) -> Iterator[str]:
    """The ladder of one joint as text: held-out errors by channel, in brackets over the noise floor."""
    from hd_control.drive.effect import UNITS

    yield f"{ladder.joint}:"
    for text in ladder.notes:
        yield f"  ! {text}"
    for rung in ladder.rungs:
        parts = [
            f"{name} {quantity(error, UNITS[name])} ({rung.ratio(name):.2f})" for name, error in rung.held_out.items()
        ]
        yield f"  {rung.effect:<26} {'  '.join(parts)}"
    yield f"  stopped: {ladder.stopped_because}"
