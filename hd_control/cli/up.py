"""`hd up`: starts the nodes of a robot, activates them and stays until Ctrl-C."""

from __future__ import annotations

import argparse

NAME = "up"
HELP = "start the nodes of a robot and keep them running until Ctrl-C"
EXAMPLE = "hd up --robot arm_a --bag bags/first"


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Options of the command."""
    parser.add_argument(
        "--robot", default="arm_a", metavar="NAME", help="robot and plant: shipped name or path (arm_a)"
    )
    parser.add_argument("--lockstep", action="store_true", help="lock-step instead of the wall clock")
    parser.add_argument(
        "--nodes", nargs="+", metavar="NODE", help="node executables to start; default: the four of the ring"
    )
    parser.add_argument("--one-process", action="store_true", help="chain and plant in one process instead of four")
    parser.add_argument("--per-joint", action="store_true", help="one torque node for each joint")
    parser.add_argument("--namespace", default="", metavar="NS", help="namespace of all nodes")
    parser.add_argument("--bag", metavar="DIR", help="record into this new folder")
    parser.add_argument(
        "--params", nargs=2, action="append", default=[], metavar=("NODE", "FILE"), help="params file of a node"
    )
    parser.add_argument(
        "--ticks", type=int, default=0, metavar="N", help="end after N ticks of the plant; 0: run until Ctrl-C"
    )
    parser.add_argument("--no-real-time", action="store_true", help="do not ask for real-time priority")


def run(arguments: argparse.Namespace) -> int:
    """Runs until Ctrl-C, a node's end or the given number of ticks; 1 if a node failed."""
    from hd_control.cli.options import say
    from hd_control.core.errors import HdError
    from hd_control.papers.shipped import departures
    from hd_control.session.session import Session

    plan = make_plan(arguments)
    say(
        arguments,
        "This is no safety function: a real arm needs a hardware emergency stop, drive limits and brakes of its own.",
    )
    if not arguments.params:
        say(arguments, "settings: the gains of Zhu's Tables I and II, shipped with these differences:")
        for text in departures():
            say(arguments, f"  {text}")
    session = Session(plan, real_time=False if arguments.no_real_time else None)
    try:
        with session:
            session.activate()
            say(arguments, f"running: {', '.join(process.path for process in session.processes)}; Ctrl-C stops")
            if session.has_drives:
                reason = session.arming()  # the robot stays up either way
                say(arguments, f"{reason}; it goes on" if reason else "armed: the drives obey, goals are taken")
            session.stay(arguments.ticks)
    except KeyboardInterrupt:
        pass
    codes = {name: code for name, code in session.exit_codes.items() if code != 0}
    if codes:
        raise HdError("; ".join(f"{name} ended with exit code {code}" for name, code in codes.items()))
    say(arguments, "stopped")
    return 0


def make_plan(arguments: argparse.Namespace):  # type: ignore[no-untyped-def]
    """The run plan that the options describe."""
    from pathlib import Path

    from hd_control.core.robot import Robot
    from hd_control.session.session import FOUR, RunPlan

    files: dict[str, tuple[Path, ...]] = {}
    for node, path in arguments.params:
        files[node] = (*files.get(node, ()), Path(path))
    groups = tuple((name,) for name in Robot.from_file(arguments.robot).joint_names) if arguments.per_joint else ()
    nodes = ("chain",) if arguments.one_process else tuple(arguments.nodes or FOUR)
    return RunPlan(
        nodes=nodes,
        plant=arguments.robot,
        lockstep=arguments.lockstep,
        namespace=arguments.namespace,
        bag=Path(arguments.bag) if arguments.bag else None,
        joint_groups=groups,
        params_files=files,
    )
