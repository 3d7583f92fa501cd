"""`hd compare BAG --model M`: how well a model explains a recording, and where it fails."""

from __future__ import annotations

import argparse
from collections.abc import Iterator
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
    from hd_control.lab.signals.joint_signals import Recording

NAME = "compare"
HELP = "how well a model explains a recording, per joint, channel and operating condition"
EXAMPLE = "hd compare bags/run1 --model arm_a.yaml --model better.yaml --json compare.json"
SCHEMA = "hd.compare/1"
SECTIONS = "sections"
"""Sentences on sensors, delays, friction and spectra; for people, not in the JSON."""


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """The options of the command."""
    add_bag_options(parser)
    parser.add_argument(
        "--model", metavar="M", action="append", required=True, help="model file or shipped model; repeatable"
    )
    parser.add_argument("--no-free-run", action="store_true", help="leave the predictions over 0.5 s and 5 s out")


def run(arguments: argparse.Namespace) -> int:
    """Prints the comparison; 0 done, 3 if the bag could be read in part only."""
    one_thread()
    from hd_control.cli.options import say, write_json

    recording = open_bag(arguments, arguments.bag)
    models = {path: open_model(path, recording) for path in dict.fromkeys(arguments.model)}
    joints = chosen_joints(arguments, recording, next(iter(models.values())))
    report_recording(arguments, recording)
    work = partial(_compare, recording, models, not arguments.no_free_run)
    answers: dict[str, dict[str, Any]] = {}
    for joint, found in by_joint(arguments, joints, work, "comparing"):
        for line in lines(joint, found):
            say(arguments, line)
        answers[joint] = {path: without(entry, SECTIONS) for path, entry in found.items()}
    documents = [
        {
            "schema": SCHEMA,
            "bag": bag_entry(recording),
            "model": model_entry(path, model),
            "joints": {joint: found[path] for joint, found in answers.items() if path in found},
        }
        for path, model in models.items()
    ]
    write_json(arguments, documents[0] | ({"others": documents[1:]} if len(documents) > 1 else {}))
    return exit_code(recording)


def _compare(recording: Recording, models: dict[str, Model], free_run: bool, joint: str) -> dict[str, Any]:
    """Model path -> its JSON form; all models are judged by the noise that the first one's channels have."""
    from hd_control.lab.models.answers import compare_joint
    from hd_control.lab.models.observations import sections

    found: dict[str, Any] = {}
    noises = None
    for path, model in models.items():
        if joint not in model.joints:
            continue
        report = compare_joint(recording, model, joint, None, noises, free_run)
        noises = noises or report.comparison.noises
        found[path] = report.json() | {SECTIONS: sections(report.observations)}
    return found


def lines(joint: str, found: dict[str, Any]) -> Iterator[str]:
    """The comparison of one joint as text."""
    first = next(iter(found.values()))
    yield f"{joint}: {', '.join(first['signals'])}"
    for text in first["notes"]:
        yield f"  ! {text}"
    for head, texts in first[SECTIONS]:
        for i, text in enumerate(texts):
            yield f"  {'' if i else head:<13} {text}"
    if not first["channels"]:
        yield "  no channel: these signals and this motion allow no balance"
    for path, entry in found.items():
        if len(found) > 1:
            yield f"  {path}"
        for name, channel in entry["channels"].items():
            yield from _channel_lines(name, channel)
        yield from _free_run_lines(entry["free_run"])


def without(entry: dict[str, Any], key: str) -> dict[str, Any]:
    """The entry without one of its keys."""
    return {name: value for name, value in entry.items() if name != key}


def _channel_lines(name: str, channel: dict[str, Any]) -> Iterator[str]:
    unit, floor = channel["unit"], channel["noise_floor"]
    error, refitted = channel["rms_error"], channel["rms_error_refitted"]
    percent = channel["error_percent"]
    share = f" ({percent:.3g} % of the signal)" if percent is not None else ""
    yield (
        f"  {name:<13} error {quantity(error, unit)}{share}, refitted {quantity(refitted, unit)}, "
        f"noise {quantity(floor, unit)}"
    )
    if refitted <= 1.1 * floor < error:
        yield "                its own values, fitted again, reach the noise: hd add --refit, nothing is missing"
    yield f"                {channel['sentence']}"
    for text in channel["order_lines"]:
        yield f"                line at {text}"


def _free_run_lines(entry: dict[str, Any]) -> Iterator[str]:
    for length, run in entry.items():
        parts = [
            f"{name.replace('_', ' ')} {quantity(run[name]['rms_error'], run[name]['unit'])} "
            f"(hold {quantity(run[name]['rms_error_hold'], run[name]['unit'])})"
            for name in ("motor_position", "joint_torque")
        ]
        yield f"  free run {length} s: {', '.join(parts)}, {100 * run['clipped_share']:.0f} % ran away"
