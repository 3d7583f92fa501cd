"""Everything that joins the ROS graph keeps its discovery on this computer unless the user set another range."""

from __future__ import annotations

import ast
import os
from pathlib import Path

import pytest

from hd_control.nodes import process
from hd_control.session.session import child_environment

ROOT = Path(__file__).resolve().parents[2]
NAME = "ROS_AUTOMATIC_DISCOVERY_RANGE"


def calls(function: ast.AST) -> list[str]:
    return [ast.unparse(node.func) for node in ast.walk(function) if isinstance(node, ast.Call)]


def test_every_start_of_ros_sets_the_range_first() -> None:
    found = []
    for path in [*ROOT.glob("hd_control/**/*.py"), *ROOT.glob("hd_sim/**/*.py")]:
        for node in ast.walk(ast.parse(path.read_text())):
            if isinstance(node, ast.FunctionDef) and "rclpy.init" in (names := calls(node)):
                found.append(path.name)
                assert "prepare_environment" in names, f"{path}:{node.lineno} {node.name}"
    assert len(found) >= 3


@pytest.mark.parametrize(("given", "expected"), [(None, "LOCALHOST"), ("SUBNET", "SUBNET"), ("OFF", "OFF")])
def test_the_default_never_overrides_the_user(monkeypatch, given, expected) -> None:
    if given is None:
        monkeypatch.delenv(NAME, raising=False)
    else:
        monkeypatch.setenv(NAME, given)
    assert child_environment()[NAME] == expected
    warning = process.prepare_environment()
    assert os.environ[NAME] == expected
    assert ("firewall" in warning) == (given == "SUBNET")


def test_the_launch_file_sets_it() -> None:
    text = (ROOT / "launch" / "robot.launch.py").read_text()
    assert 'SetEnvironmentVariable(DISCOVERY, os.environ.get(DISCOVERY, "LOCALHOST"))' in text
