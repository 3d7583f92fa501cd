"""`hd export BAG -o FILE`: signals of a recording as CSV or NPZ, residuals of a model as a bag, a model as MJCF."""

from __future__ import annotations

import argparse
from pathlib import Path
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from hd_control.lab.signals.joint_signals import Recording

NAME = "export"
HELP = "a recording's signals as CSV or NPZ; a model's residuals as topics; a model for MuJoCo"
EXAMPLE = """hd export bags/run1 -o run1.csv --joint joint_3
  hd export bags/run1 --residuals arm_a.yaml -o bags/run1_residuals
  hd export better.yaml -o better.xml"""
PARTLY_READ = 3
SCHEMA = "hd.export/1"
TABLES = (".csv", ".npz")


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """The options of the command."""
    parser.add_argument("bag", metavar="BAG", help="bag folder, .mcap or .db3 file; a model for .xml")
    parser.add_argument(
        "-o", "--output", metavar="FILE", required=True, help=".csv or .npz file; a bag for --residuals; .xml: MJCF"
    )
    parser.add_argument("--rigid", action="store_true", help="MJCF without torsion: one hinge per joint")
    parser.add_argument("--residuals", metavar="MODEL", help="write this model's residual channels as a bag")
    parser.add_argument("--joint", metavar="NAME", action="append", help="only this joint; repeatable")
    parser.add_argument("--map", metavar="FILE", help="mapping of a foreign bag's topics, joints, units")
    parser.add_argument("--start", metavar="S", type=float, default=0.0, help="leave out what is before, s [0]")
    parser.add_argument("--seconds", metavar="S", type=float, help="length to take, s [all]")


def run(arguments: argparse.Namespace) -> int:
    """Writes the file; 0 done, 3 if the bag could be read in part only."""
    from hd_control.cli.main import UsageError
    from hd_control.cli.options import refuse_overwrite, say, write_json
    from hd_control.lab.signals.recording import read_recording

    output = Path(arguments.output)
    if output.suffix.lower() == ".xml":
        return _mjcf(arguments, output)
    if not arguments.residuals and output.suffix.lower() not in TABLES:
        raise UsageError(
            f"export: {output}: the name must end in .csv, .npz or .xml, or give --residuals MODEL for a bag"
        )
    refuse_overwrite(output, arguments.force)
    recording = read_recording(
        arguments.bag, arguments.map, _joints_to_read(arguments), arguments.start, arguments.seconds
    )
    written = _residuals(arguments, recording) if arguments.residuals else _table(arguments, recording)
    for text in (*recording.problems, *recording.notes):
        say(arguments, f"  ! {text}")
    for name, joint in recording.joints.items():
        for text in joint.notes:
            say(arguments, f"  ! {name}: {text}")
    document = {
        "schema": SCHEMA,
        "bag": {"path": recording.path, "sha256": recording.sha256},
        "files": [str(path) for path in written],
        "joints": {name: list(joint.present) for name, joint in recording.joints.items()},
        "problems": recording.problems,
    }
    write_json(arguments, document)
    return PARTLY_READ if recording.problems else 0


def _mjcf(arguments: argparse.Namespace, output: Path) -> int:
    """Writes a model for MuJoCo and says what it leaves out."""
    from hd_control.cli.options import refuse_overwrite, say, write_json
    from hd_control.core.files import write_whole
    from hd_control.drive.mjcf import left_out, mjcf_text
    from hd_control.drive.model_file import load_model

    refuse_overwrite(output, arguments.force)
    model = load_model(arguments.bag)
    text = mjcf_text(model, output.stem, arguments.rigid, arguments.joint or ())
    write_whole(output, text)
    joints = {name: left_out(model.joint(name)) for name in arguments.joint or model.joints}
    say(arguments, f"{output}: {', '.join(joints)}")
    for name, words in joints.items():
        if words:
            say(arguments, f"  ! {name}: MuJoCo has no {', '.join(words)}")
    write_json(arguments, {"schema": SCHEMA, "model": arguments.bag, "files": [str(output)], "left_out": joints})
    return 0


def _joints_to_read(arguments: argparse.Namespace) -> list[str] | None:
    """A residual of one joint of an arm needs the motion of all."""
    found: list[str] | None = None if arguments.residuals else arguments.joint
    return found


def _table(arguments: argparse.Namespace, recording: Recording) -> list[Path]:
    from hd_control.cli.options import Progress, say
    from hd_control.core.files import whole_file
    from hd_control.record.tables import write_csv, write_npz

    output = Path(arguments.output)
    joints = list(recording.joints.values())
    time = joints[0].time
    with whole_file(output) as place:
        if output.suffix.lower() == ".npz":
            write_npz(place, _arrays(recording))
        else:
            columns = {"time": time}
            columns |= {f"{j.joint}.{name}": getattr(j, name) for j in joints for name in j.present}
            progress = Progress(arguments, 1.0, "writing")
            try:
                write_csv(place, columns, progress.update)
            finally:
                progress.close()
    say(arguments, f"{output}: {len(joints)} joints, {time.size} rows, {time[-1]:.3f} s")
    return [output]


def _arrays(recording: Recording) -> dict[str, Any]:
    """`time` (n,), `joints` (names), each signal (n, joints) with NaN where a joint does not have it."""
    import numpy as np

    from hd_control.lab.signals.joint_signals import SIGNALS

    joints = list(recording.joints.values())
    missing = np.full(joints[0].time.size, np.nan)
    arrays: dict[str, Any] = {"time": joints[0].time, "joints": np.array([joint.joint for joint in joints])}
    for name in SIGNALS:
        columns = [getattr(joint, name) for joint in joints]
        if any(column is not None for column in columns):
            arrays[name] = np.column_stack([missing if column is None else column for column in columns])
    return arrays


def _residuals(arguments: argparse.Namespace, recording: Recording) -> list[Path]:
    from hd_control.cli.options import refuse_overwrite, say, track
    from hd_control.core.errors import BagError
    from hd_control.drive.model_file import load_model
    from hd_control.lab.models.answers import channel_rows, residual_pages, residual_series
    from hd_control.record.tables import layout_paths, write_layouts, write_series_bag

    output = Path(arguments.output)
    for path in layout_paths(output):
        refuse_overwrite(path, arguments.force)
    model = load_model(arguments.residuals)
    joints = arguments.joint or [name for name in recording.joints if name in model.joints]
    if not joints:
        there = f"{', '.join(recording.joints)} in the bag, {', '.join(model.joints)} in the model"
        raise BagError(f"{recording.path}: no joint of {arguments.residuals} is recorded; there is {there}")
    rows = track(arguments, channel_rows(recording, model, joints), len(joints), "comparing")
    comparisons = {joint: channels for joint, channels in rows if channels}
    if not comparisons:
        raise BagError(f"{recording.path}: the signals of {', '.join(joints)} allow no residual channel")
    metadata = {"residuals_of": recording.path, "model": str(arguments.residuals)}
    write_series_bag(output, residual_series(comparisons, recording.start_ns), arguments.force, metadata)
    layouts = write_layouts(output, residual_pages(comparisons), arguments.force)
    for joint, channels in comparisons.items():
        say(arguments, f"{output}: {joint}: {', '.join(channels)}")
    say(arguments, f"layouts: {', '.join(str(path) for path in layouts)}")
    return [output, *layouts]
