"""`hd apply --model M --params FILE -o NEWFILE`: an identified model into the controllers' parameters, file or live."""

from __future__ import annotations

import argparse
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from collections.abc import Mapping
    from pathlib import Path

    from hd_control.laws.from_model import Applied, Row
    from hd_control.session.live_apply import LiveNodes

NAME = "apply"
HELP = "write a model into the controllers' parameters: feed-forward, start values, gauge correction"
EXAMPLE = """hd apply --model better.yaml --params torque_node.yaml --params fusion_node.yaml -o tuned/
  hd apply --model better.yaml --live"""
SCHEMA = "hd.apply/1"
NOTHING = 1


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """The options of the command."""
    parser.add_argument("--model", metavar="MODEL", required=True, help="identified model: file or shipped name")
    parser.add_argument(
        "--params",
        metavar="FILE",
        action="append",
        help="parameters of torque_node or fusion_node to start from, repeatable [both as shipped]",
    )
    parser.add_argument("-o", "--output", metavar="FILE", help="file to write; a new folder if there are two --params")
    parser.add_argument("--joint", metavar="NAME", action="append", default=[], help="only this joint; repeatable")
    parser.add_argument(
        "--diagnosis", metavar="FILE", help="JSON of hd diagnose: effects whose name is not certain are left out"
    )
    parser.add_argument("--period", metavar="S", type=float, default=1e-3, help="control period, s [0.001]")
    parser.add_argument("--live", action="store_true", help="set the parameters of running nodes; the model ramps in")
    parser.add_argument(
        "--watch",
        metavar="S",
        type=float,
        default=0.0,
        help="with --live: measure the tracking error S seconds before "
        "and after, take the change back if it grew [off]",
    )
    parser.add_argument("--namespace", metavar="NS", default="", help="namespace of the running nodes")
    parser.add_argument("--domain", metavar="N", type=int, help="ROS domain of the running nodes [the environment's]")


def run(arguments: argparse.Namespace) -> int:
    """Writes the files or sets the nodes; 0 done, 1 if nothing of the model could be applied."""
    from hd_control.cli.options import say, write_json

    _check_words(arguments)
    applied, files, said = _live(arguments) if arguments.live else _files(arguments)
    for line in (*table(applied), *(f"written: {path}" for path in files), *said.lines):
        say(arguments, line)
    write_json(arguments, as_json(arguments, applied, files) | {"tracking": said.tracking})
    return NOTHING if said.withdrawn or not any(row.applied for row in applied.rows) else 0


def _check_words(arguments: argparse.Namespace) -> None:
    """Raises UsageError for options that do not go together."""
    from hd_control.cli.main import UsageError

    if arguments.live == bool(arguments.output):
        raise UsageError("apply: give -o FILE to write parameters, or --live to set those of running nodes")
    if arguments.live and arguments.params:
        raise UsageError("apply: --live starts from the parameters of the running nodes; leave out --params")
    if not 0.0 <= arguments.watch <= 600.0 or arguments.watch and not arguments.live:
        raise UsageError(f"apply: --watch {arguments.watch:g} needs --live and 0 to 600 s")


@dataclass(frozen=True)
class Said:
    """What a live change came to: lines for people, tracking errors by joint, and whether it was taken back."""

    lines: tuple[str, ...] = ()
    tracking: dict[str, Any] | None = None
    withdrawn: bool = False


def _files(arguments: argparse.Namespace) -> tuple[Applied, list[Path], Said]:
    """Applies the model to params files and writes the new ones, all or none."""
    from pathlib import Path

    from hd_control.cli.options import refuse_overwrite
    from hd_control.core.parameters import with_changes
    from hd_control.core.resources import find_config

    output = Path(arguments.output)
    refuse_overwrite(output, arguments.force)
    sources = [find_config(name) for name in arguments.params or ("torque_node.yaml", "fusion_node.yaml")]
    values = read_params(sources)
    applied = _applied(arguments, {node: found for node, (_, found) in values.items()})
    remark, texts = f"from {Path(arguments.model).name}", {}
    for node, (source, _) in values.items():
        target = output / source.name if len(sources) > 1 else output
        texts[target] = with_changes(source.read_text(encoding="utf-8"), applied.changed(node), remark, str(source))
    _write(texts, output if len(sources) > 1 else None)
    return applied, list(texts), Said()


def _write(texts: Mapping[Path, str], folder: Path | None) -> None:
    from hd_control.core.errors import ConfigError
    from hd_control.core.files import write_whole

    if folder is not None:
        if folder.exists() and not folder.is_dir():
            raise ConfigError(f"{folder}: is a file; two --params need a folder")
        folder.mkdir(exist_ok=True)
    for path, text in texts.items():
        write_whole(path, text)


def _applied(arguments: argparse.Namespace, values: Mapping[str, Any]) -> Applied:
    from hd_control.drive.model_file import load_model
    from hd_control.laws.from_model import apply_model

    ambiguous = ambiguous_names(arguments.diagnosis) if arguments.diagnosis else {}
    return apply_model(load_model(arguments.model), values, arguments.period, arguments.joint, ambiguous)


def read_params(sources: list[Path]) -> dict[str, tuple[Path, dict[str, Any]]]:
    """File and complete values by node; what a file leaves out is as shipped. Raises ConfigError."""
    from hd_control.chain.chain import COMMON, for_joints, shipped_values
    from hd_control.cli._params import node_of
    from hd_control.core.errors import ConfigError
    from hd_control.laws.from_model import PARAMETERS

    found: dict[str, tuple[Path, dict[str, Any]]] = {}
    for source in sources:
        node, own = node_of(source, PARAMETERS)
        about = PARAMETERS[node]
        if node in found:
            raise ConfigError(f"{source}: parameters of {node}, as is {found[node][0]}; give each node once")
        shipped = {name: value for name, value in shipped_values(node).items() if name in about.names}
        shipped = for_joints(shipped, about, own.get("joint_names", shipped["joint_names"]))
        own = {name: value for name, value in own.items() if name not in COMMON.names and name != "limits"}
        about.check({**shipped, **own}, len(own.get("joint_names", shipped["joint_names"])), str(source))
        found[node] = (source, {**shipped, **own})
    return found


def ambiguous_names(path: str) -> dict[str, dict[str, list[str]]]:
    """By joint and effect the effects that explain the same data, from the JSON of hd diagnose. Raises ConfigError."""
    import json
    from pathlib import Path

    from hd_control.core.errors import ConfigError

    try:
        joints = json.loads(Path(path).read_text(encoding="utf-8"))["joints"]
        return {
            joint: {e["name"]: list(e["confusable_with"]) for e in said["effects"] if e["confusable_with"]}
            for joint, said in joints.items()
        }
    except OSError as error:
        raise ConfigError(f"{path}: cannot read ({error.strerror})") from None
    except (ValueError, KeyError, TypeError, AttributeError):
        raise ConfigError(f"{path}: not the JSON of hd diagnose") from None


def _live(arguments: argparse.Namespace) -> tuple[Applied, list[Path], Said]:
    """Reads the nodes' parameters, applies the model, sets what a running node takes."""
    from hd_control.laws.from_model import PARAMETERS
    from hd_control.session.live_apply import LiveNodes

    with LiveNodes(arguments.namespace, arguments.domain) as nodes:
        applied = _applied(arguments, {node: nodes.values(node, PARAMETERS[node].names) for node in nodes.find()})
        changes = {node: applied.changed(node, live=True) for node in applied.values}
        if not arguments.watch:
            nodes.set(changes)
            return applied, [], Said(tuple(live_lines(applied)))
        return applied, [], _watched(nodes, applied, changes, arguments.watch)


def _watched(nodes: LiveNodes, applied: Applied, changes: Mapping[str, Mapping[str, Any]], seconds: float) -> Said:
    """Sets the parameters between two measurements of the tracking error; takes them back if it grew."""
    from hd_control.chain.stage import RAMP_TIME
    from hd_control.session.session_client import WORSE, growth

    watch = nodes.watch()
    before = watch.measure(seconds)
    nodes.set(changes)
    watch.settle(RAMP_TIME)
    after = watch.measure(seconds)
    joints = sorted({row.joint for row in applied.rows if row.applied})
    ratio = growth(before, after, joints)
    lines = [f"{name}: tracking error {before[name]:.4g} rad before, {after[name]:.4g} rad after" for name in joints]
    tracking = {"before": before, "after": after, "ratio": ratio}
    if ratio <= WORSE:
        return Said((*live_lines(applied), *lines), tracking)
    nodes.set({node: {name: applied.before[node][name] for name in values} for node, values in changes.items()})
    why = f"withdrawn: the tracking error grew by {ratio - 1.0:.0%}; was the motion the same? Record and diagnose"
    return Said((*lines, why), tracking, withdrawn=True)


def table(applied: Applied) -> list[str]:
    """What changes and what is not applied, as text; values that are there already are left out."""
    lines: list[str] = []
    refused: dict[tuple[str, str], list[str]] = {}
    for row in applied.rows:
        if not row.applied:
            refused.setdefault((row.effect, row.note), []).append(row.joint)
        elif row.value != row.before:
            note = f"  ({row.note})" if row.note else ""
            unit = "" if row.unit == "-" else f" {row.unit}"
            values = f"{_number(row.before)} -> {_number(row.value)}{unit}"
            lines.append(f"{row.joint:<10} {row.effect:<26} {row.node} {row.parameter}: {values}{note}")
    every = {row.joint for row in applied.rows}
    for (effect, note), joints in refused.items():
        where = "all joints" if set(joints) == every and len(every) > 1 else ", ".join(joints)
        lines.append(f"not applied: {effect}: {note} ({where})")
    used = {(row.joint, row.effect) for row in applied.rows if row.applied}
    changed = sum(row.applied and row.value != row.before for row in applied.rows)
    return [*lines, f"applied: {len(used)} effects, {changed} values change"]


def live_lines(applied: Applied) -> list[str]:
    """What the nodes took, and which effects they take only while inactive."""
    from hd_control.chain.stage import RAMP_TIME

    lines = [
        f"set: {node}: {len(applied.changed(node, live=True))} parameters, the model ramps in over {RAMP_TIME:g} s"
        for node in applied.values
    ]
    late = applied.not_live().items()
    return [*lines, *(f"  ! {joint} {effect} was left: {name} needs INACTIVE" for (joint, effect), name in late)]


def _number(value: Any) -> str:
    return str(value).lower() if isinstance(value, bool) or value is None else f"{value:.5g}"


def as_json(arguments: argparse.Namespace, applied: Applied, files: list[Path]) -> dict[str, Any]:
    """The result in schema hd.apply/1."""

    def row(found: Row) -> dict[str, Any]:
        return {**found.__dict__}

    changed = {node: applied.changed(node, live=arguments.live) for node in applied.values}
    return {
        "schema": SCHEMA,
        "model": str(arguments.model),
        "files": [str(path) for path in files],
        "live": arguments.live,
        "rows": [row(found) for found in applied.rows],
        "changed": changed,
    }
