"""`hd replay BAG`: recorded sensors through the control chain again, and every output against the recorded one."""

from __future__ import annotations

import argparse
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from hd_control.chain.replay import Difference, ReplayBag, Replayed

NAME = "replay"
HELP = "recorded sensors through the chain again: what changed, what would have been commanded"
EXAMPLE = """hd replay bags/run1
  hd replay bags/run1 --set torque_node.rate_source=plain -o bags/run1_plain --html plain.html
  hd replay bags/run1 --live --stepped"""
SCHEMA = "hd.replay/1"
DIFFERS, PARTLY_READ = 1, 3


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """The options of the command."""
    parser.add_argument("bag", metavar="BAG", help="bag folder, .mcap or .db3 file with the sensor topics")
    parser.add_argument("--params", metavar="FILE", action="append", default=[], help="other parameters; repeatable")
    parser.add_argument("--model", metavar="MODEL", help="what this model adds to the parameters, as hd apply")
    parser.add_argument(
        "--set", metavar="NODE.PARAM=VALUE", action="append", default=[], help="change one parameter; VALUE is YAML"
    )
    parser.add_argument("--limits", metavar="FILE", default="limits.yaml", help="limits of the safety gate")
    parser.add_argument("--robot", metavar="NAME", help="robot description instead of that of the bag")
    parser.add_argument(
        "--recorded-inputs", action="store_true", help="each stage gets the recorded inputs: where does it differ first"
    )
    parser.add_argument("-o", "--output", metavar="BAG", help="write the outputs of the replay as a bag")
    parser.add_argument("--html", metavar="FILE", help="a page with every output that differs beside the recorded one")
    parser.add_argument("--live", action="store_true", help="publish the sensor topics instead, in real time")
    parser.add_argument("--rate", metavar="X", type=float, default=1.0, help="speed of --live [1]")
    parser.add_argument(
        "--stepped", action="store_true", help="with --live: the next tick after the command of the present one"
    )
    parser.add_argument("--namespace", metavar="NS", default="", help="namespace of --live topics")
    parser.add_argument("--domain", metavar="N", type=int, help="ROS domain of --live [the environment's]")


def run(arguments: argparse.Namespace) -> int:
    """0: the recorded numbers, or what was asked for; 1: unchanged parameters give other numbers; 3: partly read."""
    from hd_control.chain.replay import differences, read_replay_bag, replay
    from hd_control.cli.options import Progress, refuse_overwrite, say, write_json
    from hd_control.core.robot import Robot

    if arguments.live:
        return _live(arguments)
    for target in filter(None, (arguments.output, arguments.html)):
        refuse_overwrite(target, arguments.force)
    bag = read_replay_bag(arguments.bag, Robot.from_file(arguments.robot) if arguments.robot else None)
    values, changed = chosen_values(arguments, bag)
    progress = Progress(arguments, bag.ticks.size, "replay")
    try:
        made = replay(bag, values, arguments.limits, arguments.recorded_inputs, progress.update)
    finally:
        progress.close()
    found = differences(bag, made)
    for line in lines(bag, made, found, changed):
        say(arguments, line)
    if arguments.output:
        _write(arguments, bag, made, values)
        say(arguments, f"written: {arguments.output}")
    if arguments.html:
        _page(arguments, bag, made, found, changed)
        say(arguments, f"page: {arguments.html}")
    write_json(arguments, as_json(bag, made, found, changed))
    if not bag.whole:
        return PARTLY_READ
    return DIFFERS if not changed and any(one.first_tick is not None for one in found) else 0


def chosen_values(arguments: argparse.Namespace, bag: ReplayBag) -> tuple[dict[str, Any], dict[str, Any]]:
    """Values by node, and those that are not the recording's. Raises ConfigError."""
    from hd_control.chain.chain import LAWS
    from hd_control.chain.replay import complete_values
    from hd_control.cli._params import node_of
    from hd_control.cli.simulate import parameter_values
    from hd_control.core.resources import find_config
    from hd_control.drive.model_file import load_model
    from hd_control.laws.from_model import PARAMETERS, apply_model

    known = {node: law.PARAMETERS for node, law in LAWS.items()}
    changes: dict[str, dict[str, Any]] = {}
    for name in arguments.params:
        node, own = node_of(find_config(name), known)
        changes[node] = {**changes.get(node, {}), **own}
    for node, own in parameter_values(arguments.set).items():
        changes[node] = {**changes.get(node, {}), **own}
    recorded, values = complete_values(bag), complete_values(bag, changes)
    if arguments.model:
        both = {node: values[node] for node in PARAMETERS}
        values |= {n: dict(v) for n, v in apply_model(load_model(arguments.model), both, bag.period).values.items()}
    changed = {
        node: {name: value for name, value in own.items() if value != recorded[node].get(name)}
        for node, own in values.items()
    }
    return values, {node: own for node, own in changed.items() if own}


def lines(bag: ReplayBag, made: Replayed, found: list[Difference], changed: dict[str, Any]) -> list[str]:
    """The result as text."""
    seconds = bag.ticks.size * bag.period
    text = [
        f"{bag.path}: {bag.ticks.size} ticks of {bag.period * 1e3:g} ms, {seconds:.3f} s, {bag.robot.joints} joints"
    ]
    if bag.left_out:
        text.append(f"  ! {bag.left_out} ticks without all sensors are left out")
    text += [f"  ! {problem}" for problem in bag.problems]
    text += [f"  {note}" for note in (*bag.notes, *made.notes, *made.faults)]
    text += [f"  changed: {node}: {', '.join(own)}" for node, own in changed.items()]
    text.append(f"  {'output':<34}{'largest':>12}{'RMS':>12}   joint      first different tick")
    for one in found:
        where = "none" if one.first_tick is None else f"{one.first_tick} ({one.first_time:.3f} s)"
        joint = one.joint if one.first_tick is not None else "-"
        text.append(f"  {one.topic + ' ' + one.field:<34}{one.largest:>12.4g}{one.rms:>12.4g}   {joint:<11}{where}")
    same = all(one.first_tick is None for one in found)
    if not found:
        text.append("no output is recorded, nothing to compare")
    elif same:
        text.append("every output is the recorded one, bit for bit")
    else:
        text.append(
            "what would have been commanded differs" if changed else "the chain no longer gives the recorded numbers"
        )
    return text


def as_json(bag: ReplayBag, made: Replayed, found: list[Difference], changed: dict[str, Any]) -> dict[str, Any]:
    """The result in schema hd.replay/1."""
    return {
        "schema": SCHEMA,
        "bag": bag.path,
        "ticks": int(bag.ticks.size),
        "period": bag.period,
        "left_out": bag.left_out,
        "changed": changed,
        "identical": bool(found) and all(one.first_tick is None for one in found),
        "outputs": [dict(one.__dict__) for one in found],
        "notes": [*bag.notes, *made.notes, *made.faults],
        "problems": list(bag.problems),
    }


def _write(arguments: argparse.Namespace, bag: ReplayBag, made: Replayed, values: dict[str, Any]) -> None:
    """Sensors and goals as recorded and outputs of the replay as a bag, with the parameters."""
    from hd_control.core import topics
    from hd_control.core.parameters import params_text
    from hd_control.record.schema import joint_state_codec
    from hd_control.record.writer import BagWriter

    stamps, run_id = bag.ticks * round(bag.period * 1e9), "replay_000000000"
    notes = {"period": repr(bag.period), "replay_of": bag.path}
    with BagWriter(arguments.output, live=False, force=arguments.force, metadata=notes) as writer:
        writer.attach("robot.urdf", bag.robot.urdf, "application/xml")
        for node, own in values.items():
            writer.attach(f"{node}.yaml", params_text(own), "application/yaml")
        tables = {name: bag.topics[name] for name in topics.SENSORS} | dict(made.outputs)
        for topic, table in tables.items():
            codec = joint_state_codec(topic, bag.robot.joint_names)
            writer.write_columns(topic, codec, stamps, frame_id=run_id, **table)
        for topic, stamp_ns, payload in bag.events:
            writer.write(topic, stamp_ns, stamp_ns, payload)


def _page(
    arguments: argparse.Namespace, bag: ReplayBag, made: Replayed, found: list[Difference], changed: dict[str, Any]
) -> None:
    """The outputs that differ, replayed beside recorded, as one self-contained page."""
    from html import escape

    from hd_control.core.files import write_whole
    from hd_control.lab.page.model_figures import UNITS, replay_figure
    from hd_control.lab.page.page import Figures, card, html_page, paragraph

    figures, time = Figures(), (bag.ticks - bag.ticks[0]) * bag.period
    pieces = [card(f"<pre>{escape(chr(10).join(lines(bag, made, found, changed)))}</pre>")]
    for one in [one for one in found if one.first_tick is not None]:
        recorded, new = bag.topics[one.topic][one.field], made.outputs[one.topic][one.field]
        title = f"{one.topic} {one.field}: largest difference {one.largest:.3g} {UNITS[one.field]} on {one.joint}"
        figure = replay_figure(title, UNITS[one.field], time, recorded, new, bag.robot.joint_names)
        pieces.append(card(figures.place(figure)))
    head = paragraph(f"Recording: {bag.path}", "meta")
    write_whole(arguments.html, html_page("hd replay", head, "", "".join(pieces), figures))


def _live(arguments: argparse.Namespace) -> int:
    """Publishes the recorded sensor messages; 1 if the chain did not answer a stepped replay."""
    from hd_control.chain.replay import read_replay_bag
    from hd_control.cli.main import UsageError
    from hd_control.cli.options import Progress, say, write_json
    from hd_control.core.robot import Robot
    from hd_control.session.replay_publisher import ReplayPublisher

    if not arguments.rate > 0.0:
        raise UsageError(f"replay: --rate {arguments.rate:g} must be above 0")
    bag = read_replay_bag(arguments.bag, Robot.from_file(arguments.robot) if arguments.robot else None)
    progress = Progress(arguments, bag.ticks.size, "replay")
    with ReplayPublisher(bag, arguments.namespace, arguments.domain) as publisher:
        say(arguments, f"publishing {bag.ticks.size} ticks of {', '.join(publisher.topics)}; Ctrl-C stops")
        answered = publisher.run(arguments.rate, arguments.stepped, progress.update)
    progress.close()
    say(arguments, f"published: {bag.ticks.size} ticks, {answered} of them answered with a command")
    write_json(arguments, {"schema": SCHEMA, "bag": bag.path, "ticks": int(bag.ticks.size), "answered": answered})
    return 0 if bag.whole else PARTLY_READ
