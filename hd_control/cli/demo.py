"""`hd demo`: the whole story on live nodes. A robot hides an effect; it is found, added, and the robot moves better."""

from __future__ import annotations

import argparse
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from pathlib import Path

    from hd_control.story.outcome import Outcome

NAME = "demo"
HELP = "the story on live nodes: run, record, diagnose, add, and move better with the new model"
EXAMPLE = """hd demo
  hd demo --lockstep --seed 3
  hd demo --effect kinematic_error:4 --json demo.json
  hd demo --track-only"""


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """The options of the command."""
    parser.add_argument("-o", "--output", metavar="DIR", help="new folder of all results [bags/demo_<time>]")
    clock = parser.add_mutually_exclusive_group()
    clock.add_argument("--lockstep", action="store_true", help="no real time: for slow or busy machines")
    clock.add_argument("--wall", action="store_true", help="real time only: do not repeat in lock-step if it fails")
    parser.add_argument("--seed", type=int, default=0, help="draws the hidden effect, its joint, motion and noise [0]")
    parser.add_argument(
        "--effect", metavar="[JOINT/]NAME[:STRENGTH]", default="", help="hide this; hd simulate --list names them"
    )
    parser.add_argument("--single-joint", action="store_true", help="one joint instead of seven: a third of the time")
    parser.add_argument("--all-joints", action="store_true", help="fit the models of all joints, not of suspects only")
    parser.add_argument("--separate", action="store_true", help="also in lock-step a process for each node; slower")
    parser.add_argument("--keep", action="store_true", help="also keep logs and an attempt that was given up")
    parser.add_argument("--domain", metavar="N", type=int, help="ROS domain [one that is free]")
    only = parser.add_argument_group("only the motion and its tracking, nothing hidden")
    only.add_argument("--track-only", action="store_true", help="the scenario coordinated and its picture")
    only.add_argument("--scenario", metavar="NAME", help="the same with another motion; hd simulate --list names them")
    only.add_argument("--plant", metavar="FILE", help="plant file, shipped name or path [arm_a]")
    only.add_argument("--per-joint", action="store_true", help="one torque node for each joint")


def run(arguments: argparse.Namespace) -> int:
    """Tells the story; 0 done, 1 the robot was stopped or the diagnosis is not what was hidden."""
    import time

    from hd_control.cli._track import track
    from hd_control.cli.main import UsageError
    from hd_control.cli.options import say, write_json
    from hd_control.story.plan import make_story
    from hd_control.story.tell import TellOptions, tell

    began = time.monotonic()
    if arguments.seed < 0:
        raise UsageError(f"demo: --seed {arguments.seed} must be 0 or more")
    if arguments.track_only or arguments.scenario or arguments.plant or arguments.per_joint:
        return track(arguments)
    story = make_story(arguments.seed, "single_joint" if arguments.single_joint else "arm", arguments.effect)
    folder = output_folder(arguments)
    options = TellOptions(
        lockstep=arguments.lockstep,
        wall=arguments.wall,
        keep=arguments.keep,
        every_joint=arguments.all_joints,
        domain=arguments.domain,
        one_process=not arguments.separate,
    )
    outcome = tell(story, folder, options, lambda text: say(arguments, f"[{time.monotonic() - began:4.0f} s] {text}"))
    page, picture = _show(arguments, outcome, folder)
    write_json(arguments, outcome.json(str(page), str(picture or ""), time.monotonic() - began))
    return 0 if outcome.right else 1


def output_folder(arguments: argparse.Namespace) -> Path:
    """Where the results go; refused before anything is started if it exists."""
    import shutil
    import time
    from pathlib import Path

    from hd_control.cli.options import refuse_overwrite
    from hd_control.core.errors import HdError

    if not arguments.output:
        Path("bags").mkdir(exist_ok=True)
    folder = Path(arguments.output or Path("bags") / time.strftime("demo_%Y%m%d_%H%M%S")).absolute()
    refuse_overwrite(folder, arguments.force)
    if folder.exists():
        if not (folder / "truth.seal").is_file():
            raise HdError(f"{folder}: is no folder of hd demo, --force does not remove it; choose another name")
        shutil.rmtree(folder)
    return folder


def _show(arguments: argparse.Namespace, outcome: Outcome, folder: Path) -> tuple[Path, Path | None]:
    """The table on the terminal, the picture as page and PNG."""
    from hd_control.cli.options import say
    from hd_control.story.outcome import table
    from hd_control.story.picture import story_figure, write_page, write_png

    lines = table(outcome)
    for line in lines:
        say(arguments, line)
    figure, page = story_figure(outcome), folder / "demo.html"
    write_page(page, outcome, figure, lines)
    picture = write_png(folder, figure)
    say(arguments, f"\npicture:    {picture or page}{'' if picture else ' (no PNG: no Chromium is installed)'}")
    say(arguments, f"page:       {page}\nrecordings: {', '.join(str(p.bag) for p in outcome.phases.values())}")
    return page, picture
