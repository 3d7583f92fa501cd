"""`hd diagnose BAG --model M`: which physical effect is missing in the model, or that none is, or that this
recording cannot decide."""

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
    model_entry,
    one_thread,
    open_bag,
    open_model,
    quantity,
    report_recording,
)

if TYPE_CHECKING:
    from hd_control.drive.model import Model
    from hd_control.lab.diagnosis.verdict import JointDiagnosis
    from hd_control.lab.signals.joint_signals import Recording

NAME = "diagnose"
HELP = "which physical effect is missing in a model, with evidence; or none; or that the data cannot tell"
EXAMPLE = "hd diagnose bags/run1 --model arm_a.yaml --json diagnosis.json"
SCHEMA = "hd.diagnosis/1"
CONTRADICTED = 2
"""Exit code if the signals of a joint contradict the model: sign, gear ratio, unit or gravity."""


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """The options of the command."""
    add_bag_options(parser)
    parser.add_argument("--model", metavar="M", required=True, help="model file or shipped model")
    parser.add_argument(
        "--form",
        choices=("balances", "innovations"),
        default="balances",
        help="what decides: the residuals of the balances, or what a filter of the joint did not predict",
    )
    parser.add_argument("--exit-code", action="store_true", help="end with 1 unless every joint is adequate")


def run(arguments: argparse.Namespace) -> int:
    """Prints the diagnosis; 0 for every verdict, 2 if signals contradict the model, 3 if the bag was read in part."""
    one_thread()
    from hd_control.cli.options import say, write_json
    from hd_control.lab.diagnosis.verdict import ADEQUATE

    recording = open_bag(arguments, arguments.bag)
    model = open_model(arguments.model, recording)
    joints = chosen_joints(arguments, recording, model)
    report_recording(arguments, recording)
    document: dict[str, Any] = {
        "schema": SCHEMA,
        "bag": bag_entry(recording),
        "model": model_entry(arguments.model, model),
        "joints": {},
    }
    verdicts, contradicted = set(), False
    for joint, found in by_joint(arguments, joints, partial(_diagnose, recording, model, arguments.form), "diagnosing"):
        document["joints"][joint] = found.json()
        verdicts.add(found.verdict)
        contradicted |= bool(found.contradictions)
        for line in lines(joint, found):
            say(arguments, line)
    write_json(arguments, document)
    if contradicted:
        return CONTRADICTED
    if arguments.exit_code and verdicts != {ADEQUATE}:
        return 1
    return exit_code(recording)


def _diagnose(recording: Recording, model: Model, form: str, joint: str) -> JointDiagnosis:
    from hd_control.lab.models.answers import diagnose_joint

    return replace(diagnose_joint(recording, model, joint, form=form), fit=None)


def lines(joint: str, found: JointDiagnosis) -> Iterator[str]:
    """The diagnosis of one joint as text."""
    from hd_control.lab.page.words import headline, reasons

    yield f"{joint}: {headline(found)}"
    for text in reasons(found):
        yield f"  {text}"
    for effect in found.effects:
        for name, value in effect.parameters.items():
            unit = effect.units.get(name, "")
            yield f"    {effect.name} {name} = {value.value:.4g} {unit} ({value.low:.4g} ... {value.high:.4g})"
    for name, channel in found.channels.items():
        texts = (quantity(value, channel.unit) for value in (channel.baseline, channel.explained, channel.noise_floor))
        yield "  {:<13} error refitted {}, explained {}, noise {}".format(name, *texts)
    for text in found.notes:
        yield f"  ! {text}"
    for experiment in found.experiments:
        yield f"  record for {experiment.purpose}: {experiment.how}"
