"""What each node offers, asked of the nodes themselves: parameters, topics, services. Makes every node once."""

from __future__ import annotations

import importlib
import secrets
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from typing import Any

import rclpy
from rclpy.node import Node
from rclpy.signals import SignalHandlerOptions

from hd_control.core.parameters import Parameter
from hd_control.nodes.process import prepare_environment

MAKERS = {
    "plant_node": "hd_sim.nodes.plant_node.PlantNode",
    "fusion_node": "hd_control.nodes.fusion_node.FusionNode",
    "motion_node": "hd_control.nodes.motion_node.MotionNode",
    "torque_node": "hd_control.nodes.torque_node.TorqueNode",
    "recorder_node": "hd_control.nodes.recorder_node.RecorderNode",
    "chain": "hd_control.nodes.chain.ChainNode",
}
STANDARD_TOPICS = {"/rosout", "/parameter_events"}


@dataclass(frozen=True)
class Interface:
    """One topic or service: name as the node wrote it, ROS type, latched or not."""

    name: str
    type_name: str
    latched: bool = False


@dataclass(frozen=True)
class NodeFacts:
    """A configured node: parameters with the values that it started with, topics out and in, services, first line."""

    name: str
    about: str
    parameters: tuple[tuple[Parameter, Any], ...]
    publishers: tuple[Interface, ...]
    subscriptions: tuple[Interface, ...]
    services: tuple[Interface, ...]


def node_facts() -> list[NodeFacts]:
    """Every node of the package. Raises HdError if one cannot be configured."""
    prepare_environment()
    found = []
    for name, path in MAKERS.items():
        module, _, kind = path.rpartition(".")
        with _alone(name) as arguments:
            rclpy.init(
                args=arguments, signal_handler_options=SignalHandlerOptions.NO, domain_id=1 + secrets.randbelow(100)
            )
            try:
                node = getattr(importlib.import_module(module), kind)()
                node.trigger_configure()
                about = importlib.import_module(module).__doc__.strip().splitlines()[0]
                found.append(_facts(node, about))
                node.destroy_node()
            finally:
                rclpy.shutdown()
    return found


@contextmanager
def _alone(name: str) -> Iterator[list[str]]:
    """ROS arguments of a node that only says what it has."""
    with tempfile.TemporaryDirectory(prefix="hd_facts_") as folder:
        extra = ["-p", f"bag:={folder}/bag"] if name == "recorder_node" else []
        yield ["--ros-args", *extra, "--log-level", "error"] if extra else ["--ros-args", "--log-level", "error"]


def _facts(node: Node, about: str) -> NodeFacts:
    name, space = node.get_name(), node.get_namespace()
    parameters = tuple((p, node.defaults.get(p.name, node.values[p.name])) for p in node.service.parameters.parameters)
    outgoing = node.get_publisher_names_and_types_by_node(name, space)
    incoming = node.get_subscriber_names_and_types_by_node(name, space)
    services = node.get_service_names_and_types_by_node(name, space)
    return NodeFacts(
        name,
        about,
        parameters,
        tuple(_interfaces(outgoing, name, lambda topic: _latched(node.get_publishers_info_by_topic(topic)))),
        tuple(_interfaces(incoming, name, lambda topic: _latched(node.get_subscriptions_info_by_topic(topic)))),
        tuple(_interfaces(services, name, lambda topic: False)),
    )


def _interfaces(found: Any, node: str, latched: Any) -> Iterator[Interface]:
    """Those that are the node's own; names as the node's author wrote them, `~` for the node's own name."""
    for topic, types in sorted(found):
        if topic in STANDARD_TOPICS or types[0].startswith(("rcl_interfaces/", "lifecycle_msgs/", "type_description")):
            continue
        own = topic.removeprefix("/")
        shown = (
            f"~/{own.removeprefix(node + '/')}" if own.startswith(f"{node}/") else topic if topic == "/clock" else own
        )
        yield Interface(shown, types[0], latched(topic))


def _latched(ends: Any) -> bool:
    return any(end.qos_profile.durability == rclpy.qos.DurabilityPolicy.TRANSIENT_LOCAL for end in ends)
