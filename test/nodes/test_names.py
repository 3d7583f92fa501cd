"""Namespaces and remaps move a node with all that it has; no name is absolute but /clock."""

from __future__ import annotations

import secrets
from collections.abc import Iterator
from contextlib import contextmanager

import rclpy
from rclpy.signals import SignalHandlerOptions

from hd_control.nodes.fusion_node import FusionNode
from hd_control.nodes.process import prepare_environment
from hd_control.nodes.shell import Shell
from hd_control.pages.node_facts import node_facts


@contextmanager
def made(kind: type[Shell], *remaps: str) -> Iterator[Shell]:
    """A configured node with some remaps."""
    prepare_environment()
    arguments = ["--ros-args", "--log-level", "error", *(word for remap in remaps for word in ("-r", remap))]
    rclpy.init(args=arguments, signal_handler_options=SignalHandlerOptions.NO, domain_id=1 + secrets.randbelow(100))
    node = kind()
    try:
        node.trigger_configure()
        yield node
    finally:
        node.destroy_node()
        rclpy.shutdown()


def test_a_namespace_and_remaps_move_everything() -> None:
    with made(FusionNode, "__ns:=/left", "__node:=left_fusion", "encoder:=drives/encoder") as node:
        assert node.get_fully_qualified_name() == "/left/left_fusion"
        heard = {name for name, _ in node.get_subscriber_names_and_types_by_node("left_fusion", "/left")}
        said = {name for name, _ in node.get_publisher_names_and_types_by_node("left_fusion", "/left")}
    assert {"/left/drives/encoder", "/left/resolver", "/left/gauge_bridge"} <= heard and "/left/encoder" not in heard
    assert {"/left/joint_states", "/left/diagnostics", "/left/left_fusion/introspection/values"} <= said
    absolute = {name for name in heard | said if not name.startswith("/left/")}
    assert absolute <= {"/rosout", "/parameter_events", "/clock"}


def test_the_facts_name_every_node_with_its_ends() -> None:
    facts = {node.name: node for node in node_facts()}
    assert len(facts) == 6
    commands = {name for name, node in facts.items() if any(t.name == "motor_torque_command" for t in node.publishers)}
    assert commands == {"torque_node", "chain"}
    assert [service.name for service in facts["plant_node"].services] == ["~/black_box", "~/reset"]
    assert all(
        not one.name.startswith("/") or one.name == "/clock" for node in facts.values() for one in node.publishers
    )
