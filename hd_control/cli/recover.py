"""`hd recover BAG -o NEW`: what is readable of a cut or damaged recording, as a new and whole one."""

from __future__ import annotations

import argparse
from collections.abc import Iterator
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from hd_control.record.recover import RecoveryReport

NAME = "recover"
HELP = "rewrite a cut or damaged recording as a whole one and say what is lost; the original stays"
EXAMPLE = "hd recover bags/killed -o bags/killed_recovered"
SCHEMA = "hd.recover/1"
PARTLY_READ = 3


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """The options of the command."""
    parser.add_argument("bag", metavar="BAG", help="bag folder, .mcap or .db3 file")
    parser.add_argument("-o", "--output", metavar="NEW", required=True, help="folder of the new bag; must not exist")


def run(arguments: argparse.Namespace) -> int:
    """Writes the new bag; 0 if nothing is missing in it, 3 if something is."""
    from hd_control.cli.options import Progress, refuse_overwrite, say, write_json
    from hd_control.record.recover import recover

    refuse_overwrite(arguments.output, arguments.force)
    progress = Progress(arguments, 1.0, "copying")
    try:
        report = recover(arguments.bag, arguments.output, arguments.force, progress.update)
    finally:
        progress.close()
    for line in lines(report):
        say(arguments, line)
    write_json(arguments, {"schema": SCHEMA, **report.document()})
    return 0 if report.complete else PARTLY_READ


def lines(report: RecoveryReport) -> Iterator[str]:
    """The report as text for people."""
    kept = sum(row.kept for row in report.topics.values())
    yield f"{report.target}: {kept} messages of {report.source}"
    width = max((len(name) for name in report.topics), default=0)
    end = max((row.last_ns for row in report.topics.values()), default=0)
    for name, row in report.topics.items():
        lost = "loss not known" if row.lost is None else f"{row.lost} lost" if row.lost else "all"
        before = (end - row.last_ns) * 1e-9
        yield f"  {name:<{width}}  {row.kept:>9} kept  {lost:<14}  ends {before:.3f} s before the last message"
    for problem in report.problems:
        yield f"  ! {problem}"
    for notice in report.notices:
        yield f"  - {notice}"
    if report.complete:
        yield "nothing is missing"
