"""Pages of `docs/reference` that are made from the code, by path: bench, commands, effects, nodes, glossary.

The figures of the bench are those of one run of `hd bench --growth --json docs/reference/bench.json`; commands are read
from their parsers, effects from their classes, nodes from the running nodes.
"""

from __future__ import annotations

import argparse
import inspect
import json
import sys
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from hd_control.bench.growth import FIELDS
from hd_control.chain.chain import CHAIN_PARTS, COMMON
from hd_control.cli import main
from hd_control.core.blocks import Layout
from hd_control.core.parameters import Change, Parameter, ParameterSet
from hd_control.core.topics import TOPICS, topic_info
from hd_control.drive.effect import Effect, EffectParameter
from hd_control.drive.library import library
from hd_control.lab.signals.joint_signals import SIGNALS
from hd_control.laws import fusion, integral_manifold, motion, torque, torque_feedback
from hd_control.pages.fault_page import fault_page
from hd_control.pages.node_facts import Interface, NodeFacts, node_facts
from hd_control.safety import limits

# ---- A few words of Markdown -----------------------------------------------------------------------


def cell(text: str) -> str:
    """Text for a table: one line, no bar that would end the cell."""
    return " ".join(text.split()).replace("|", "\\|")


def table(head: Sequence[str], rows: Iterable[Sequence[str]]) -> list[str]:
    """The lines of a table; a table without rows has none."""
    lines = ["| " + " | ".join(cell(text) for text in row) + " |" for row in rows]
    return ["| " + " | ".join(head) + " |", "|" + "---|" * len(head), *lines] if lines else []


def code(text: str) -> str:
    """Text in the form of code; an empty text stays empty."""
    return f"`{text}`" if text else ""


def page(title: str, source: str, *blocks: Sequence[str]) -> str:
    """A page with the sentence that says how it is made; blocks are separated by an empty line."""
    made = f"Made from {source} by `python -m hd_control.pages`; a test fails when it is not current."
    parts = [[f"# {title}"], [made], *(block for block in blocks if block)]
    return "\n\n".join("\n".join(part) for part in parts) + "\n"


# ---- Words of this package that belong to no table of the code; the tables fill the rest of the glossary ----


TERMS: dict[str, str] = {
    "bag": "A recording: a folder with metadata.yaml and MCAP files, a bare .mcap file or a .db3 file.",
    "balance, channel": "One of the three equations of a joint: motor_torque (rotor), transmission (torsion), "
    "link_torque (link). What the model leaves of it is the residual of that channel.",
    "chain": "Fusion, motion and torque law with gate, one after the other; also the node that runs them in one "
    "thread.",
    "effect": "One physical cause with its parameters, such as backlash. A model is a list of effects.",
    "flexspline torque": "The torque that the gear's flexible ring carries, measured by a gauge bridge on it.",
    "gate, guard": "The gate is the last limit before the command; the guard around it decides when to stop.",
    "goal": "A trajectory that is checked as a whole before it is accepted.",
    "held out": "Data that no fit has seen; errors that count are measured on them.",
    "joint side": "Behind the gear. Motor angles are divided by the gear ratio, motor torques multiplied by it.",
    "ladder": "Errors of a model before and after each effect that was added to it.",
    "law": "A pure step from sample and reference to output, with parameters and state as blocks.",
    "lock-step": "The plant waits for the command of tick k before tick k+1; the same torques on every machine.",
    "nat": "Unit of evidence: a factor e between the likelihoods of two explanations of the same data.",
    "presliding": "Elastic motion of a friction contact before it slips.",
    "residual": "Measurement minus model in one channel.",
    "rotor": "Motor shaft with wave generator.",
    "sealed truth": "The hidden effects of a simulated drive, in a file that is opened only after the diagnosis is "
    "written.",
    "stage": "A law at its place between topics, without ROS.",
    "tick": "The number k of a control period; time is k times the period and travels in header.stamp.",
    "torsion": "Joint angle minus motor angle divided by the gear ratio: wind-up of the gear.",
    "VDC": "Virtual decomposition control: the required torque of each joint from the dynamics of its own link (Zhu).",
    "verdict": "Answer of a diagnosis: adequate, missing, unknown, missing_and_unknown or cannot_tell.",
}
SIGNAL_MEANINGS: dict[str, str] = {
    "motor_shaft_position": "rotor angle before the gear, multi-turn [rad]",
    "joint_position": "joint angle behind the gear [rad]",
    "gauge_torque": "torque that the gauge bridge indicates [N m]",
    "motor_torque": "motor torque times gear ratio, held from its stamp to the next [N m]",
    "temperature": "motor temperature [degC]",
    "reference_position": "desired joint angle [rad]",
}
"""Meaning of each signal of `hd_control.lab.signals.joint_signals.SIGNALS`."""


# ---- `reference/bench.md` --------------------------------------------------------------------------


FILE = Path(__file__).resolve().parents[2] / "docs" / "reference" / "bench.json"
PICTURE = FILE.parents[1] / "pictures" / "bench_growth.png"
COMMAND = "hd bench --growth --runs 5 --seconds 3 --png docs/pictures --json docs/reference/bench.json --force"


def _robot_meanings() -> dict[str, str]:
    """The rows of the real nodes, idle and beside busy programs."""
    forms = {
        "robot_ring": "four processes and a recorder, real laws, 1 kHz",
        "per_joint": "a torque process for each of seven joints, and a recorder",
        "one_process": "`chain` with plant in one process",
        "one_process_4khz": "the same at 4 kHz",
    }
    what = {
        "p50": "answer",
        "p99": "answer",
        "missed": "commands late or ticks slept through",
        "stopped": "runs that the safety gate ended",
    }
    load = {"": "", "_loaded": ", every processor busy"}
    return {f"{form}{tail}_{row}": f"{title}{busy}: {what[row]}"
            for form, title in forms.items() for tail, busy in load.items() for row in what}  # fmt: skip


MEANINGS = {
    "plant_5_substeps": "plant, 7 joints, 5 substeps per ms",
    "plant_10_substeps": "the same, 10 substeps",
    "step_fusion": "one call of the law, 7 joints",
    "step_motion": "one call of the law",
    "step_torque": "one call of the law",
    "step_gate": "one call of the safety gate",
    "chain_compute": "one tick of fusion, motion, torque, gate, as a node calls them",
    "lockstep_pure": "chain and plant without ROS",
    "decode_messages": "a bag to columns, open and check-sums included",
    "replay_batch": "recorded sensors through the laws again",
    "cli_start": "`hd --help`",
    "compare_bag": "`hd compare`, one joint, 60 s at 1 kHz, whole command",
    "diagnose_joint": "`hd diagnose`, the same recording",
    "peak_memory_compare": "largest process of that `hd compare`",
    "lockstep_ros_ticks": "four processes in lock-step",
    "ring_p50": "four processes that copy seven numbers, 1 kHz: round trip",
    "ring_p99": "the same",
    "ring_missed": "the same: ticks not back in time",
    **_robot_meanings(),
    "recorder_share": "of one processor, eleven topics at 1 kHz recorded",
    "recorder_lost": "the same: published less what is in the bag",
    "recorder_loaded_share": "the same while ordinary programs keep every processor busy",
    "recorder_loaded_lost": "the same",
}


def bench_page() -> str:
    """The page. Raises FileNotFoundError without the file of a run."""
    document = json.loads(FILE.read_text(encoding="utf-8"))
    machine = ", ".join(f"{key} {value}" for key, value in document["machine"].items())
    intro = [
        f"Measured by `{COMMAND}`,",
        "or in parts (`--only`, `--update`) where a note says so. What the figures mean: [speed](../bench.md). Compare",
        "ratios within one run: the machine is a virtual one, other programs ran beside, its line has the load.",
    ]
    names = {point["name"] for point in document["growth"]}
    missing = [name for _, curves in FIELDS for name in curves if name not in names]
    return page(
        "Figures of `hd bench`",
        "`docs/reference/bench.json`",
        intro,
        [f"Machine: {machine}."],
        ["## Rows"],
        table(["row", "median", "min", "p99", "unit", "beside", "what"], _rows(document["results"])),
        [f"- {note}" for note in document["notes"]],
        ["## Growth"],
        [f"![Cost over joints, length and rate, each curve over its first point](../pictures/{PICTURE.name})"]
        if PICTURE.is_file()
        else [],
        table(["figure", "over", "values", "unit"], _curves(document["growth"])),
        [f"Not in this run: {', '.join(map(code, missing))}."] if missing else [],
    )


def _rows(results: Sequence[Mapping[str, Any]]) -> Iterator[list[str]]:
    """One line per row of ours; peers of the same run beside it with their median and ratio."""
    for row in (row for row in results if row["peer"] is None):
        peers = [other for other in results if other["name"] == row["name"] and other["peer"] is not None]
        beside = "; ".join(f"{peer['peer']} {_number(peer['median'])}{_ratio(peer, row)}" for peer in peers)
        cells = [_number(row[key]) for key in ("median", "min", "p99")]
        yield [code(row["name"]), *cells, row["unit"], beside, MEANINGS.get(row["name"], "")]


def _ratio(peer: Mapping[str, Any], row: Mapping[str, Any]) -> str:
    both = (peer["median"], row["median"])
    return f" ({both[0] / both[1]:.3g} ×)" if all(both) else ""


def _curves(points: Sequence[Mapping[str, Any]]) -> Iterator[list[str]]:
    for name in dict.fromkeys(point["name"] for point in points):
        curve = [point for point in points if point["name"] == name]
        values = ", ".join(f"{point['size']:g}: {_number(point['value'])}" for point in curve)
        yield [code(name), curve[0]["axis"], values, curve[0]["unit"]]


def _number(value: float | None) -> str:
    return "-" if value is None else f"{value:.3g}" if abs(value) < 1e4 else f"{value:.4g}"


# ---- `reference/commands.md` -----------------------------------------------------------------------


def command_page() -> str:
    """The page."""
    intro = [
        'Exit codes: 0 done; 1 the answer is "no" or a check failed; 2 bad usage or bad input; 3 partly read; 70 a',
        "defect of this program; 130 interrupted. Every command has `--help`, `--json FILE`, `--force` and",
        "`--quiet`; they are not repeated below.",
    ]
    names = main.command_names()
    rows = ([f"[`hd {name}`](#hd-{name})", main.load_command(name).HELP] for name in names)
    overview = table(["command", "does"], rows)
    sections = [section for name in names for section in _command(name)]
    return page("Commands", "the parsers of `hd`", intro, overview, *sections)


def _command(name: str) -> Iterator[list[str]]:
    module = main.load_command(name)
    parser = main.command_parser(module)
    yield [f"## hd {name}"]
    yield [_sentence(module.HELP)]
    yield ["```sh parse", *(line.strip() for line in module.EXAMPLE.splitlines()), "```"]
    yield from _options(parser)
    if getattr(module, "PASS_UNKNOWN", False):
        yield ["Unknown options go to pytest."]


def _options(parser: argparse.ArgumentParser) -> Iterator[list[str]]:
    rows = [_command_row(action) for action in _shown(parser)]
    yield table(["argument", "meaning"], rows)
    for action in parser._actions:
        if isinstance(action, argparse._SubParsersAction):
            for word, inner in action.choices.items():
                yield [f"### {parser.prog} {word}"]
                yield from _options(inner)


def _shown(parser: argparse.ArgumentParser) -> Iterator[argparse.Action]:
    """What is not the same everywhere."""
    common = {"--help", "--json", "--force", "--quiet"}
    for action in parser._actions:
        words = isinstance(action, argparse._SubParsersAction)
        if not common & set(action.option_strings) and action.help is not argparse.SUPPRESS and not words:
            yield action


def _command_row(action: argparse.Action) -> tuple[str, str]:
    value = "" if action.nargs == 0 else _value(action)
    names = action.option_strings or [""]
    shown = ", ".join(code(f"{name} {value}".strip()) for name in names)
    required = " **required**" if action.option_strings and action.required else ""
    repeatable = isinstance(action, argparse._AppendAction) and "repeatable" not in (action.help or "")
    return shown, (action.help or "").replace("%%", "%") + ("; repeatable" if repeatable else "") + required


def _value(action: argparse.Action) -> str:
    if action.metavar is not None:
        name = action.metavar if isinstance(action.metavar, str) else " ".join(action.metavar)
    elif action.choices is not None:
        name = "{" + ",".join(str(choice) for choice in action.choices) + "}"
    else:
        name = action.dest.upper()
    return {"+": f"{name} ...", "*": f"[{name} ...]", "?": f"[{name}]"}.get(str(action.nargs), name)


def _sentence(text: str) -> str:
    return f"{text[0].upper()}{text[1:]}."


# ---- `reference/effects.md` ------------------------------------------------------------------------


def effect_page() -> str:
    """The page; effects of other packages are left out."""
    shipped = [effect for effect in library().values() if effect.__module__.startswith("hd_control.")]
    intro = [
        "Each effect is one file in `hd_control/drive/effects`. Values belong to the joint side of the gear. Model",
        "files: [model.md](../model.md); how a diagnosis finds an effect: [diagnosis.md](../diagnosis.md); an effect",
        "of your own: [tutorial](../tutorials/write_an_effect.md).",
    ]
    rows = ([f"[`{e.name}`](#{e.name})", e.title, "yes" if e.in_every_model else ""] for e in shipped)
    overview = table(["effect", "what it is", "in every model"], rows)
    sections = (block for effect in shipped for block in _effect(effect))
    return page("Effects", "the effect library", intro, overview, *sections)


def _effect(effect: type[Effect]) -> Iterator[list[str]]:
    text = inspect.cleandoc(sys.modules[effect.__module__].__doc__ or "")
    yield [f"## {effect.name}"]
    yield ["```text", *text.splitlines(), "```"]
    yield [f"In the residual: {effect.evidence}."]
    yield table(["parameter", "unit", "range", "meaning"], map(_parameter, effect.parameters))
    yield [f"- can be confused with {code(one.effect)}; separated by: {one.experiment}" for one in effect.confusions]


def _parameter(parameter: EffectParameter) -> list[str]:
    low, high = (f"{value:g}" if np.isfinite(value) else "" for value in (parameter.low, parameter.high))
    shown = f"{low or '-inf'} to {high or 'inf'}" if low or high else ""
    return [code(parameter.name), parameter.unit, shown, parameter.meaning]


# ---- `reference/nodes.md` --------------------------------------------------------------------------


WHEN = {Change.HOT: "live", Change.INACTIVE: "INACTIVE", Change.FIXED: "fixed"}


def node_page() -> str:
    """The page."""
    nodes = node_facts()
    intro = [
        "Topic names are relative: a namespace or a remap moves them. `~` is the node's own name. *Latched* topics are",
        "transient local. *Live* parameters change at any time, *INACTIVE* ones while the node is not active, *fixed*",
        "ones only at its start. *x2, ±0.1* after *live*: counted from the activation, up to twice as large or as",
        "small, and a tenth of the joint's limits further (effort limit for N m, effort over velocity limit for N m s,",
        "their inverses; else of the unit itself); beyond that, deactivate the node (HD-F21).",
        "Values are those of the shipped files in `config/`; a list holds one value per joint",
        "of arm A, shown short where all are equal. Every node is a lifecycle node with the standard services, has the",
        "parameter services, and publishes `diagnostics` once a second.",
    ]
    common = [
        ["## Parameters of every node"],
        _parameters([(p, _shared(nodes, p.name)) for p in COMMON.parameters]),
    ]
    return page(
        "Nodes", "the nodes of this package", intro, *common, *(block for node in nodes for block in _node(node))
    )


def _shared(nodes: Sequence[NodeFacts], name: str) -> Any:
    """The value of a common parameter; a text if nodes differ."""
    values = {repr(value): value for node in nodes for p, value in node.parameters if p.name == name}
    return next(iter(values.values())) if len(values) == 1 else "differs"


def _node(node: NodeFacts) -> Iterator[list[str]]:
    yield [f"## {node.name}"]
    about = node.about.replace(f"`{node.name}`: ", "")
    yield [about[:1].upper() + about[1:]]
    if node.name == "chain":
        heads = tuple(f"{part}." for part in CHAIN_PARTS)
        yield [f"Parameters of the laws are those of their own nodes with a prefix: {', '.join(map(code, heads))}."]
        own = [(p, value) for p, value in node.parameters if not p.name.startswith(heads)]
    else:
        own = list(node.parameters)
    own = [(p, value) for p, value in own if p.name not in COMMON.names]
    yield table(["topic", "direction", "type", "carries"], _topics(node))
    yield table(["service", "type"], ([code(one.name), code(one.type_name)] for one in node.services))
    if node.name in ("motion_node", "chain"):
        yield [
            "Action `follow_joint_trajectory` (`control_msgs/action/FollowJointTrajectory`), where it can be imported."
        ]
    yield _parameters(own)


def _topics(node: NodeFacts) -> Iterator[list[str]]:
    for direction, found in (("in", node.subscriptions), ("out", node.publishers)):
        for one in found:
            known = topic_info(one.name.removeprefix("~/"))
            carries = known.meaning if known is not None else _own_meaning(one)
            latched = " *latched*" if one.latched and direction == "out" else ""
            yield [code(one.name), direction + latched, code(one.type_name), carries]


def _own_meaning(one: Interface) -> str:
    found = {
        "~/progress": "the next tick, every 50 ticks and whenever the plant stands still",
        "recorder/progress": "the newest tick that is recorded",
        "~/goal_status": "answer to the last goal, accepted or refused",
        "~/introspection/names": "names of the values, one a line",
        "~/introspection/values": "every term of the law, while `introspection` is true",
        "/clock": "time of the tick, in lock-step",
    }
    return found.get(one.name, "")


def _parameters(rows: Sequence[tuple[Parameter, Any]]) -> list[str]:
    return table(["parameter", "unit", "default", "range", "change", "meaning"], (_row(p, value) for p, value in rows))


def _row(parameter: Parameter, value: Any) -> list[str]:
    meaning = parameter.meaning + (f" ({parameter.source})" if parameter.source else "")
    unit = "" if parameter.unit == "-" else parameter.unit
    allowed = parameter.allowed.removesuffix(parameter.unit).strip()
    return [code(parameter.name), unit, _short(value), allowed, WHEN[parameter.change] + _reach(parameter), meaning]


def _reach(parameter: Parameter) -> str:
    """How far a live parameter may go: factor and share, `, x2, ±0.1`."""
    factor, share = parameter.live or (1.0, 0.0)
    return (f", x{factor:g}" if factor != 1.0 else "") + (f", ±{share:g}" if share else "")


def _short(value: Any) -> str:
    if isinstance(value, (list, tuple)):
        if len(value) > 1 and all(item == value[0] for item in value):
            return f"{_short(value[0])} ({len(value)} ×)"
        return ", ".join(_short(item) for item in value) or "none"
    if isinstance(value, bool):
        return str(value).lower()
    return f"{value:g}" if isinstance(value, float) else str(value) or "empty"


# ---- `reference/glossary.md` -----------------------------------------------------------------------


SETS: dict[str, ParameterSet] = {
    "fusion_node": fusion.PARAMETERS,
    "motion_node": motion.PARAMETERS,
    "torque_node": torque.PARAMETERS,
    "torque_node, law torque_feedback": torque_feedback.PARAMETERS,
    "torque_node, law integral_manifold": integral_manifold.PARAMETERS,
    "limits": limits.GUARD_PARAMETERS,
}
OUTPUTS: dict[str, Layout] = {
    "fusion": fusion.layout("FusionOutput", 1),
    "motion": motion.layout("MotionOutput", 1),
    "torque": torque.layout("TorqueOutput", 1),
}


def glossary_page() -> str:
    """The page."""
    intro = [
        "Angles are in rad and torques in N m, on the joint side of the gear unless the name says `motor_shaft`:",
        "angles of the motor are divided by the gear ratio, torques multiplied by it. Symbols are those of the papers.",
        "SI units throughout.",
    ]
    effects = (effect for effect in library().values() if effect.__module__.startswith("hd_control."))
    return page(
        "Glossary",
        "the parameter tables, the output blocks of the laws, the effect library and the topics",
        intro,
        ["## Words"],
        table(["word", "meaning"], sorted(TERMS.items(), key=lambda item: item[0].lower())),
        ["## Signals of the analysis"],
        table(["name", "meaning"], ([code(name), SIGNAL_MEANINGS[name]] for name in SIGNALS)),
        ["## Topics"],
        table(["topic", "carries"], ([code(topic.name), topic.meaning] for topic in TOPICS.values())),
        ["## Effects"],
        table(["name", "what it is"], ([f"[`{e.name}`](effects.md#{e.name})", e.title] for e in effects)),
        ["## Parameters of laws and limits"],
        table(["name", "symbol", "unit", "meaning", "in"], _glossary_parameters()),
        ["## Numbers that the laws put out"],
        table(["name", "unit", "meaning", "of"], _outputs()),
    )


def _glossary_parameters() -> Iterator[list[str]]:
    """Every name once for each meaning that it has, with the places where it means that."""
    places: dict[tuple[str, str], tuple[Parameter, list[str]]] = {}
    for owner, parameters in SETS.items():
        for parameter in parameters.parameters:
            places.setdefault((parameter.name, parameter.meaning), (parameter, []))[1].append(owner)
    for _, (parameter, owners) in sorted(places.items()):
        yield [code(parameter.name), parameter.symbol, parameter.unit, parameter.meaning, "; ".join(owners)]


def _outputs() -> Iterator[list[str]]:
    rows = [(field, law) for law, layout in OUTPUTS.items() for field in layout.fields]
    for field, law in sorted(rows, key=lambda row: (row[0].name, row[1])):
        yield [code(field.name), field.unit, field.meaning, law]


# ---- All pages -------------------------------------------------------------------------------------


def _nodes() -> str:
    """Needs ROS, which the other pages do not."""

    return node_page()


PAGES: dict[str, Callable[[], str]] = {
    "faults.md": fault_page,
    "reference/commands.md": command_page,
    "reference/nodes.md": _nodes,
    "reference/effects.md": effect_page,
    "reference/glossary.md": glossary_page,
    "reference/bench.md": bench_page,
}
"""By path below `docs`."""
