"""`hd demo`: a robot on live nodes hides an effect; it is recorded, diagnosed, added, and the robot moves better.

`--track-only` hides nothing: one motion on live nodes, its recording, and how well it was followed.
"""

from __future__ import annotations

import argparse
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from pathlib import Path

    from hd_control.demo.outcome import Outcome
    from hd_control.lab.signals.tracking import Tracking
    from hd_control.session.session import Session
    from hd_sim.scenario import Plan


# ---- The command with `--track-only` ---------------------------------------------------------------


PAPER_JOINT_3 = 4.88e-4
"""rad; largest error of joint 3 in the coordinated move, Zhu, Fig. 3."""


def track(arguments: argparse.Namespace) -> int:
    """Starts the nodes, moves the robot, stops cleanly, prints the tracking table. 1 if the robot was stopped.

    A machine that cannot keep 1 kHz makes the safety gate stop the robot; then the run is repeated in lock-step, with
    the same processes and topics, unless `--wall` is given.
    """
    import time

    from hd_control.cli.options import say, write_json

    began = time.monotonic()
    arguments.plant, arguments.scenario = arguments.plant or "arm_a", arguments.scenario or "coordinated"
    output = _output(arguments)
    outcome = _attempt(arguments, output, arguments.lockstep)
    document = outcome
    if outcome["stopped"] and not arguments.lockstep and not arguments.wall:
        say(arguments, "this machine did not keep 1 kHz; the same run again in lock-step\n")
        document = _attempt(arguments, output.with_name(output.name + "_lockstep"), True)
        document["wall_clock_attempt"] = outcome
    write_json(arguments, {"schema": "hd.demo/1", **document, "seconds": time.monotonic() - began})
    return 1 if document["stopped"] else 0


def _output(arguments: argparse.Namespace) -> Path:
    """Where the recording goes; refused before anything is started if it exists."""
    import time
    from pathlib import Path

    from hd_control.cli.options import refuse_overwrite

    if not arguments.output:
        Path("bags").mkdir(exist_ok=True)
    output = Path(arguments.output or Path("bags") / time.strftime("demo_%Y%m%d_%H%M%S"))
    refuse_overwrite(output, arguments.force)
    if not arguments.lockstep and not arguments.wall:
        refuse_overwrite(output.with_name(output.name + "_lockstep"), arguments.force)
    return output


def _attempt(arguments: argparse.Namespace, output: Path, lockstep: bool) -> dict[str, Any]:
    """One run with its table and picture; the fields of `hd.demo/1`."""
    import shutil

    from hd_control.cli.options import say
    from hd_control.nodes.fast_loop import missed_percent

    if arguments.force:
        shutil.rmtree(output, ignore_errors=True)
    window_ns, nodes, stopped = _live(arguments, output, lockstep)
    whole, written = _read(output)
    tracking, picture = whole.within(*window_ns), _draw(arguments, whole, output)
    missed = missed_percent(nodes.get("plant_node", {}))
    statistics = [*node_lines(nodes), f"missed ticks: {missed:.2f} %"]
    table = [f"stopped: {stopped}"] if stopped else tracking_lines(tracking, window_ns)
    for line in (*table, "", *statistics, *written):
        say(arguments, line)
    say(arguments, f"recording: {output}\npicture:   {picture}")
    document: dict[str, Any] = {"bag": str(output), "clock": "lockstep" if lockstep else "wall"}
    document |= {"stopped": stopped or None, "missed_ticks_percent": missed, "nodes": nodes}
    document |= {"hidden_effects": [], "diagnosed": [], "ladder": {}}
    return document | {"tracking_before": tracking.maximum(), "tracking_after": None, "report": str(picture)}


def _live(
    arguments: argparse.Namespace, output: Path, lockstep: bool
) -> tuple[tuple[int, int], dict[str, dict[str, str]], str]:
    """The run on live nodes: the stamps of the table's window, diagnostics by node and the reason of a stop."""
    import random

    from hd_control.cli.options import say
    from hd_control.session.session import RunPlan, Session
    from hd_sim.plant_config import PlantConfig
    from hd_sim.runner import RunSetup
    from hd_sim.scenario import find_scenario, make_plan

    config = PlantConfig.from_file(arguments.plant)
    names = config.robot.joint_names
    limit = RunSetup(config).node_values("motion_node")["velocity_limit"]
    scenario = find_scenario(arguments.scenario)
    plan = make_plan(scenario, names, config.start_position, limit, config.period, arguments.seed)
    run_plan = RunPlan(
        plant=arguments.plant,
        robot=config.robot.name,
        lockstep=lockstep,
        bag=output,
        joint_groups=tuple((name,) for name in names) if arguments.per_joint else (),
        parameters={"plant_node": {"seed": arguments.seed}},
    )
    say(arguments, f"starting {len(run_plan.processes())} nodes for {config.robot.name}")
    with Session(run_plan, domain=random.SystemRandom().randint(1, 100)) as session:
        session.activate()
        clock = "lock-step" if lockstep else "real time"
        say(arguments, f"{scenario.name}: {plan.ticks * config.period:.1f} s in {clock}")
        shift = drive(session, plan, config.period, lockstep)
        nodes, stopped = _state(session)
    dt_ns = round(config.period * 1e9)
    first, last = (round(time / config.period + shift) * dt_ns for time in plan.window)
    return (first, last), nodes, stopped


def drive(session: Session, plan: Plan, period: float, lockstep: bool) -> int:
    """Runs a plan on a running robot. Returns how many ticks later than planned its motion began.

    In lock-step the plant stands still while a goal is handed over, so the run equals the runner's, tick for tick.
    """
    from dataclasses import replace

    if lockstep:
        for tick, goal in plan.goals:
            session.run_to(tick)
            session.send_goal(goal, period)
        session.run_to(plan.ticks, timeout=60.0 + plan.ticks * period * 10.0)
        return 0
    session.wait_until_armed()
    shift = session.tick()
    for tick, goal in plan.goals:
        answer = session.send_goal(replace(goal, start_tick=None), period)
        shift = int(answer.split()[answer.split().index("start_tick") + 1]) - (goal.start_tick or tick)
    session.wait_until_tick(plan.ticks + shift, timeout=30.0 + plan.ticks * period * 2.0)
    return shift


def _state(session: Session) -> tuple[dict[str, dict[str, str]], str]:
    """Diagnostics of every node, once each has reported its last second, and the reason of a stop."""
    from hd_control.core.errors import HdError

    nodes = [process.node for process in session.processes]
    seen = {node: session.diagnostics(node) for node in nodes}
    try:
        session.wait_for(lambda: all(session.diagnostics(node) != seen[node] for node in nodes), 3.0, "diagnostics")
    except HdError:
        pass  # a node that stays silent keeps its last report
    found = {node: session.diagnostics(node) for node in nodes}
    stops = [values.get("message", "") for values in found.values() if values.get("gate_stopped") == "True"]
    if not stops and found.get("plant_node", {}).get("armed") == "False":
        stops = ["the drives never obeyed: commands did not come in time 100 times in a row"]
    return found, stops[-1] if stops else ""


def _draw(arguments: argparse.Namespace, tracking: Tracking, output: Path) -> Path:
    """The page with the tracking picture, beside the recording."""
    from hd_control.lab.page.model_figures import tracking_figure
    from hd_control.lab.page.style import write_page

    page = output.with_name(output.name + ".html")
    return write_page(tracking_figure(tracking, f"{arguments.scenario}: tracking of {output.name}"), page)


def _read(output: Path) -> tuple[Tracking, list[str]]:
    """The tracking of the whole recording, and a line for each thing that is missing in it."""
    from hd_control.lab.signals.tracking import tracking_of
    from hd_control.record.reader import BagReader

    with BagReader(output) as bag:
        lines = [f"recorded: {sum(bag.counts.values())} messages on {len(bag.counts)} topics"]
        lines += [f"  ! {problem}" for problem in bag.problems]
        return tracking_of(bag), lines


def tracking_lines(tracking: Tracking, window_ns: tuple[int, int]) -> list[str]:
    """The tracking table for people."""
    length = (window_ns[1] - window_ns[0]) * 1e-9
    lines = [f"joint position error over {length:.2f} s (reference minus joint sensor)"]
    lines.append("  joint      max rad    rms rad")
    largest, rms = tracking.maximum(), tracking.rms()
    lines += [f"  {name:9} {largest[name]:9.2e}  {rms[name]:9.2e}" for name in tracking.joint_names]
    if "joint_3" in largest:
        paper = f"Zhu's robot, joint 3, coordinated move: {PAPER_JOINT_3:.2e}"
        lines.append(f"  {paper}. Another plant: plausible, not identified.")
    return lines


def node_lines(nodes: dict[str, dict[str, str]]) -> list[str]:
    """Loop statistics for people, one line for each node."""
    wanted = ("ticks", "missed", "late", "skipped", "period_p50_us", "period_p99_us", "busy_p50_us", "busy_p99_us")
    lines = ["node            " + "".join(f"{name.removesuffix('_us'):>12}" for name in wanted) + "   (times in µs)"]
    for node, values in nodes.items():
        cells = [f"{float(values[name]):.0f}" if name in values else "-" for name in wanted]
        lines.append(f"{node:16}" + "".join(f"{cell:>12}" for cell in cells))
    return lines


# ---- The command -----------------------------------------------------------------------------------


NAME = "demo"
HELP = "all of it on live nodes: run, record, diagnose, add, and track better with the new model"
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
    parser.add_argument(
        "--all-joints",
        action="store_true",
        help="fit the models of all joints, not only of those where something is missing",
    )
    parser.add_argument("--separate", action="store_true", help="also in lock-step a process for each node; slower")
    parser.add_argument("--keep", action="store_true", help="also keep logs and an attempt that was given up")
    parser.add_argument("--domain", metavar="N", type=int, help="ROS domain [one that is free]")
    only = parser.add_argument_group("only the motion and its tracking, nothing hidden")
    only.add_argument("--track-only", action="store_true", help="the scenario coordinated and its picture")
    only.add_argument("--scenario", metavar="NAME", help="the same with another motion; hd simulate --list names them")
    only.add_argument("--plant", metavar="FILE", help="plant file, shipped name or path [arm_a]")
    only.add_argument("--per-joint", action="store_true", help="one torque node for each joint")


def run(arguments: argparse.Namespace) -> int:
    """Runs the demo; 0 done, 1 the robot was stopped or the diagnosis is not what was hidden."""
    import time

    from hd_control.cli.main import UsageError
    from hd_control.cli.options import say, write_json
    from hd_control.demo.plan import make_story
    from hd_control.demo.run import DemoOptions, run_demo

    began = time.monotonic()
    if arguments.seed < 0:
        raise UsageError(f"demo: --seed {arguments.seed} must be 0 or more")
    if arguments.track_only or arguments.scenario or arguments.plant or arguments.per_joint:
        return track(arguments)
    story = make_story(arguments.seed, "single_joint" if arguments.single_joint else "arm", arguments.effect)
    folder = output_folder(arguments)
    options = DemoOptions(
        lockstep=arguments.lockstep,
        wall=arguments.wall,
        keep=arguments.keep,
        every_joint=arguments.all_joints,
        domain=arguments.domain,
        one_process=not arguments.separate,
    )
    outcome = run_demo(
        story, folder, options, lambda text: say(arguments, f"[{time.monotonic() - began:4.0f} s] {text}")
    )
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
    from hd_control.demo.outcome import table
    from hd_control.demo.picture import story_figure, write_page, write_png

    lines = table(outcome)
    for line in lines:
        say(arguments, line)
    figure, page = story_figure(outcome), folder / "demo.html"
    write_page(page, outcome, figure, lines)
    picture = write_png(folder, figure)
    say(arguments, f"\npicture:    {picture or page}{'' if picture else ' (no PNG: no Chromium is installed)'}")
    say(arguments, f"page:       {page}\nrecordings: {', '.join(str(p.bag) for p in outcome.phases.values())}")
    return page, picture
