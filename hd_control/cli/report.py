"""`hd report BAG --model M... -o FILE.html`: one self-contained page with the pictures."""

from __future__ import annotations

import argparse
from dataclasses import replace
from functools import partial
from typing import TYPE_CHECKING

from hd_control.cli._workbench import (
    add_bag_options,
    by_joint,
    chosen_joints,
    exit_code,
    name_of,
    one_thread,
    open_bag,
    open_model,
    report_recording,
)

if TYPE_CHECKING:
    from hd_control.drive.model import Model
    from hd_control.lab.models.ladder import Split
    from hd_control.lab.page.page_data import JointPage
    from hd_control.lab.signals.joint_signals import Recording

NAME = "report"
HELP = "one self-contained page: verdict in plain words, pictures, ladder, parameters"
EXAMPLE = "hd report bags/run1 --model arm_a.yaml --model better.yaml --held-out bags/run2 -o run1.html --png pictures"


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """The options of the command."""
    add_bag_options(parser)
    parser.add_argument(
        "--model", metavar="M", action="append", required=True, help="model file or shipped model; repeatable"
    )
    parser.add_argument("-o", "--output", metavar="FILE", required=True, help="page to write, .html")
    parser.add_argument("--held-out", metavar="BAG2", help="judge the ladder on this bag; without it on part of BAG")
    parser.add_argument("--no-ladder", action="store_true", help="leave the ladder out")
    parser.add_argument("--png", metavar="FOLDER", help="also the key figures as PNG (needs a browser)")


def run(arguments: argparse.Namespace) -> int:
    """Writes the page; 0 done, 3 if a bag could be read in part only."""
    one_thread()
    from hd_control.cli.main import UsageError
    from hd_control.cli.options import refuse_overwrite, say, write_json
    from hd_control.lab.models.ladder import Split, split_recording
    from hd_control.lab.page.page import write_report
    from hd_control.lab.page.page_data import ReportPage
    from hd_control.lab.page.pictures import write_pictures

    if not arguments.output.lower().endswith((".html", ".htm")):
        raise UsageError(f"report: {arguments.output}: the name must end in .html")
    refuse_overwrite(arguments.output, arguments.force)
    recording = open_bag(arguments, arguments.bag)
    models = {path: open_model(path, recording) for path in dict.fromkeys(arguments.model)}
    joints = chosen_joints(arguments, recording, next(iter(models.values())))
    report_recording(arguments, recording)
    split = Split.of(recording, open_bag(arguments, arguments.held_out)) if arguments.held_out else None
    if split is None and not arguments.no_ladder:
        split = split_recording(recording)
    work = partial(_page, recording, models, None if arguments.no_ladder else split)
    pages = tuple(page for _, page in by_joint(arguments, joints, work, "drawing"))
    command = "hd report " + " ".join([name_of(arguments.bag), *(f"--model {name_of(m)}" for m in arguments.model)])
    notes = (*recording.problems, *recording.notes)
    title = f"{name_of(arguments.bag)}: model against measurement"
    page = ReportPage(title, name_of(arguments.bag), tuple(map(name_of, models)), pages, command, notes)
    write_report(arguments.output, page, arguments.force)
    say(arguments, f"written: {arguments.output}")
    pictures = write_pictures(arguments.png, page, arguments.force) if arguments.png else []
    if pictures:
        say(arguments, f"written: {len(pictures)} pictures in {arguments.png}")
    document = {"schema": "hd.report/1", "page": arguments.output, "pictures": [str(path) for path in pictures]}
    write_json(arguments, document)
    return exit_code(recording)


def _page(recording: Recording, models: dict[str, Model], split: Split | None, joint: str) -> JointPage:
    """The page of one joint: every model compared, the first one diagnosed and climbed."""
    from hd_control.drive.effect import UNITS
    from hd_control.lab.models.answers import compare_joint, diagnose_joint
    from hd_control.lab.models.ladder import climb
    from hd_control.lab.page.model_figures import HorizonCurve, Rung
    from hd_control.lab.page.page_data import Ladder, joint_page

    comparisons, noises, observations = {}, None, None
    curves: dict[str, tuple[HorizonCurve, ...]] = {}
    for path, model in models.items():
        if joint not in model.joints:
            continue
        report = compare_joint(recording, model, joint, None, noises)
        noises, observations = noises or report.comparison.noises, observations or report.observations
        comparisons[name_of(path)] = report.comparison
        for length, run in report.horizons.runs.items():
            key = f"free run over {length:g} s, motor position"
            hold = HorizonCurve("hold last value", run.horizon, run.hold_motor_position, "rad", True)
            mine = HorizonCurve(name_of(path), run.horizon, run.rms_motor_position, "rad")
            curves[key] = (*curves.get(key, (hold,)), mine)
    first = next(iter(models.values()))
    diagnosis = replace(diagnose_joint(recording, first, joint), fit=None)
    ladders = []
    if split is not None and joint in split.held_out.joints:
        ladder = climb(split, first, joint)
        for name in ladder.rungs[0].held_out:
            rungs = tuple(
                Rung(r.effect, r.parameters_count, r.train[name], r.held_out[name], r.floor[name])
                for r in ladder.rungs
                if name in r.held_out
            )
            ladders.append(Ladder(rungs, UNITS[name], f"{name.replace('_', ' ')}; {ladder.stopped_because}"))
    return joint_page(joint, comparisons, diagnosis, ladders, None, curves, diagnosis.notes, observations)
