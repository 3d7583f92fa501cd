"""`docs/reference/nodes.md`: parameters, topics and services of every node, as the running nodes tell them."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from typing import Any

from hd_control.core.parameters import Change, Parameter
from hd_control.nodes.node_facts import Interface, NodeFacts, node_facts
from hd_control.record.schema import topic_info
from hd_control.reference.markdown import code, page, table
from hd_control.stages.node_parameters import CHAIN_PARTS, COMMON

WHEN = {Change.HOT: "live", Change.INACTIVE: "INACTIVE", Change.FIXED: "fixed"}


def node_page() -> str:
    """The page."""
    nodes = node_facts()
    intro = [
        "Topic names are relative: a namespace or a remap moves them. `~` is the node's own name. *Latched* topics are",
        "transient local. *Live* parameters change at any time, *INACTIVE* ones while the node is not active, *fixed*",
        "ones only at its start. Values are those of the shipped files in `config/`; a list holds one value per joint",
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
    return [code(parameter.name), unit, _short(value), allowed, WHEN[parameter.change], meaning]


def _short(value: Any) -> str:
    if isinstance(value, (list, tuple)):
        if len(value) > 1 and all(item == value[0] for item in value):
            return f"{_short(value[0])} ({len(value)} ×)"
        return ", ".join(_short(item) for item in value) or "none"
    if isinstance(value, bool):
        return str(value).lower()
    return f"{value:g}" if isinstance(value, float) else str(value) or "empty"
