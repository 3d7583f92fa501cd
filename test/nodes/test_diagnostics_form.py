"""Diagnostics as rqt_robot_monitor and other tools read them: names, levels, hardware, texts (REP 107)."""

from __future__ import annotations

import secrets

import pytest
import rclpy
from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus
from rclpy.signals import SignalHandlerOptions

from hd_control.nodes.process import prepare_environment
from hd_control.nodes.torque_node import TorqueNode

LEVELS = {DiagnosticStatus.OK, DiagnosticStatus.WARN, DiagnosticStatus.ERROR}


@pytest.fixture
def node():
    prepare_environment()
    arguments = ["--ros-args", "-r", "__ns:=/left", "--log-level", "error"]
    rclpy.init(args=arguments, signal_handler_options=SignalHandlerOptions.NO, domain_id=1 + secrets.randbelow(100))
    made = TorqueNode()
    yield made
    made.destroy_node()
    rclpy.shutdown()


def said(node: TorqueNode, monkeypatch: pytest.MonkeyPatch) -> DiagnosticStatus:
    """The one status that the node publishes now."""
    found: list[DiagnosticArray] = []
    monkeypatch.setattr(node._diagnostics, "publish", found.append)
    node.publish_diagnostics()
    assert len(found) == 1 and len(found[0].status) == 1 and found[0].header.stamp.sec > 0
    return found[0].status[0]


def test_a_status_has_a_tree_of_names_a_robot_and_one_line(node: TorqueNode, monkeypatch: pytest.MonkeyPatch) -> None:
    status = said(node, monkeypatch)
    assert status.name == "/left/torque_node" and status.hardware_id == "arm_a" and status.level in LEVELS
    assert status.message == "not active" and "\n" not in status.message
    node.trigger_configure()
    node.trigger_activate()
    status = said(node, monkeypatch)
    assert status.message == "running" and status.level == DiagnosticStatus.OK
    keys = [pair.key for pair in status.values]
    assert len(set(keys)) == len(keys) and all(isinstance(pair.value, str) for pair in status.values)


def test_a_fault_is_an_error_with_its_reason(node: TorqueNode, monkeypatch: pytest.MonkeyPatch) -> None:
    node.trigger_configure()
    node.report_fault(ValueError("a callback raised"))
    status = said(node, monkeypatch)
    assert status.level == DiagnosticStatus.ERROR and "a callback raised" in status.message
