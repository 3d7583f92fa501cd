"""`hd import TABLE -o BAG`: measurements of another robot, as CSV or NPZ, become a bag."""

from __future__ import annotations

import argparse

NAME = "import"
HELP = "CSV or NPZ measurements to a bag"
EXAMPLE = "hd import j4_v0p10.npz --map iiwa -o bags/j4"
PARTLY_READ = 3
SCHEMA = "hd.import/1"


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """The options of the command."""
    parser.add_argument("table", metavar="TABLE", help=".csv or .npz file")
    parser.add_argument("-o", "--output", metavar="BAG", required=True, help="folder of the new bag")
    parser.add_argument("--map", metavar="FILE", help="mapping of columns, joints, units; a file or iiwa, ur10")
    parser.add_argument("--robot", metavar="URDF", help="robot description to carry in the bag")


def run(arguments: argparse.Namespace) -> int:
    """Writes the bag; 0 done, 3 if rows had to be dropped."""
    from hd_control.cli.options import refuse_overwrite, say, write_json
    from hd_control.core.robot import Robot
    from hd_control.lab.signals.import_table import import_table
    from hd_control.lab.signals.sources import load_mapping
    from hd_control.record.bag_folder import whole_bag

    refuse_overwrite(arguments.output, arguments.force)
    mapping = load_mapping(arguments.map) if arguments.map else None
    robot = Robot.from_file(arguments.robot).urdf if arguments.robot else None
    with whole_bag(arguments.output, arguments.force) as path:
        done = import_table(arguments.table, path, mapping, robot)
    say(arguments, f"{arguments.output}: {len(done.joints)} joints, {done.samples} samples, {done.seconds:.3f} s")
    say(arguments, f"  signals: {', '.join(done.signals)}")
    for text in (*done.problems, *done.notes):
        say(arguments, f"  ! {text}")
    document = {
        "schema": SCHEMA,
        "bag": arguments.output,
        "table": arguments.table,
        "joints": done.joints,
        "signals": done.signals,
        "samples": done.samples,
        "seconds": done.seconds,
        "problems": done.problems,
        "notes": done.notes,
    }
    write_json(arguments, document)
    return PARTLY_READ if done.problems else 0
