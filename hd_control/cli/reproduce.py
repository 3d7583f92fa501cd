"""`hd reproduce`: the tables and figures of the papers rebuilt, side by side with ours."""

from __future__ import annotations

import argparse
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from hd_control.cli.options import Progress
    from hd_control.papers.rows import Progress as Report

NAME = "reproduce"
HELP = "the papers' tables and figures, side by side with ours"
EXAMPLE = "hd reproduce zhu --quick --report zhu.html"


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """The options of the command."""
    parser.add_argument(
        "paper", nargs="?", default="all", choices=("zhu", "gandhi", "hashimoto", "all"), help="which paper [all]"
    )
    parser.add_argument("--quick", action="store_true", help="only what takes seconds")
    parser.add_argument("--seed", type=int, default=0, help="first seed of the noise [0]")
    parser.add_argument("--seeds", type=int, default=3, help="how many seeds, where noise matters [3]")
    parser.add_argument("--report", metavar="FILE.html", help="also write one page with tables and pictures")


def run(arguments: argparse.Namespace) -> int:
    """Runs the experiments, prints the table. 1 if a target is not met."""
    from pathlib import Path

    from hd_control.cli.options import refuse_overwrite, say, write_json
    from hd_control.core.errors import ConfigError, HdError
    from hd_control.papers import rows as papers
    from hd_control.papers.report import summary, write_report

    if arguments.seeds < 1 or arguments.seed < 0:
        raise ConfigError(f"--seed {arguments.seed}, --seeds {arguments.seeds}: at least 0 and 1")
    if arguments.report:
        refuse_overwrite(arguments.report, arguments.force)
    there = papers.available()
    names = there if arguments.paper == "all" else [arguments.paper]
    if arguments.paper not in (*there, "all"):
        raise HdError(f"the paper {arguments.paper} is not there yet; there is {', '.join(there)}")
    found, figures = [], dict[str, list[tuple[str, Any]]]()
    for name in names:
        paper = papers.load_paper(name)
        with _Bar(arguments, name) as report:
            found += paper.rows(arguments.quick, arguments.seed, report, arguments.seeds)
        if arguments.report:
            with _Bar(arguments, f"{name}, pictures") as report:
                figures[name] = paper.figures(arguments.quick, arguments.seed, report)
    for line in papers.table(found):
        say(arguments, line)
    say(arguments, f"{summary(found)}\n{papers.CAVEAT}")
    if arguments.report:
        say(arguments, f"report: {write_report(found, figures, arguments.seed, Path(arguments.report))}")
    write_json(arguments, papers.document(found, arguments.seed))
    return 1 if any(row.met is False for row in found) else 0


class _Bar:
    """A progress bar for the length of a `with`: gives what a paper calls with its share and words."""

    def __init__(self, arguments: argparse.Namespace, what: str) -> None:
        self.arguments, self.what = arguments, what

    def __enter__(self) -> Report:
        from hd_control.cli.options import Progress

        self.bar: Progress = Progress(self.arguments, 1.0, self.what)

        def report(share: float, what: str) -> None:
            self.bar.what = f"{self.what}: {what}"
            self.bar.update(share)

        return report

    def __exit__(self, *_: object) -> None:
        self.bar.close()
