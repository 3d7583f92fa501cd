"""The launch file starts what `hd up` starts, with stand-ins for the launch system that the wheels do not have."""

from __future__ import annotations

import importlib.util
import sys
import types
from pathlib import Path
from types import SimpleNamespace

import pytest

from hd_control.session.session import FOUR, RunPlan

FILE = Path(__file__).resolve().parents[2] / "launch" / "robot.launch.py"


def stand_ins() -> dict[str, types.ModuleType]:
    """Modules whose classes keep their arguments; `LaunchConfiguration.perform` looks into the context."""
    keep = lambda *given, **named: SimpleNamespace(given=given, **named)  # noqa: E731 - one line says it
    names = {
        "launch": {"LaunchDescription": lambda actions: actions},
        "launch.actions": dict.fromkeys(("DeclareLaunchArgument", "OpaqueFunction", "SetEnvironmentVariable"), keep),
        "launch.substitutions": {
            "LaunchConfiguration": lambda name: SimpleNamespace(perform=lambda found: found[name])
        },
        "launch_ros": {},
        "launch_ros.actions": {"Node": keep},
    }
    found = {}
    for name, content in names.items():
        found[name] = types.ModuleType(name)
        for key, value in content.items():
            setattr(found[name], key, value)
    return found


@pytest.fixture
def launch_file(monkeypatch: pytest.MonkeyPatch) -> types.ModuleType:
    for name, module in stand_ins().items():
        monkeypatch.setitem(sys.modules, name, module)
    spec = importlib.util.spec_from_file_location("robot_launch", FILE)
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


def started(launch_file: types.ModuleType, **given: str) -> dict[str, SimpleNamespace]:
    """Node name to launch action."""
    return {node.name: node for node in launch_file.nodes({**launch_file.ARGUMENTS, **given})}


def test_every_argument_is_declared_and_the_nodes_follow(launch_file: types.ModuleType) -> None:
    actions = launch_file.generate_launch_description()
    declared = {action.given[0]: action.default_value for action in actions if hasattr(action, "default_value")}
    assert declared == launch_file.ARGUMENTS
    assert any(getattr(action, "function", None) is launch_file.nodes for action in actions)


def test_the_nodes_are_those_of_the_plan(launch_file: types.ModuleType) -> None:
    nodes = started(launch_file)
    assert set(nodes) == set(FOUR)
    for process in RunPlan().processes():
        node = nodes[process.node]
        assert (node.package, node.executable) == ("hd_control", process.executable)
        assert node.parameters == [{**process.parameters, "autostart": True}]


def test_arguments_reach_the_nodes(launch_file: types.ModuleType) -> None:
    nodes = started(launch_file, robot="arm_b", clock="lockstep", namespace="left", bag="bags/x", nodes="chain")
    assert set(nodes) == {"chain", "recorder_node"}
    chain = nodes["chain"].parameters[0]
    assert chain["plant"] == "arm_b" and chain["clock"] == "lockstep" and chain["with_plant"] is True
    assert nodes["recorder_node"].parameters[0]["bag"] == "bags/x" and nodes["chain"].namespace == "left"
