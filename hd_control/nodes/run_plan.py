"""Which node processes a robot needs, with which parameters: data for the session, `hd up` and the launch file."""

from __future__ import annotations

import json
import sys
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from hd_control.core.errors import ConfigError

MODULES = {
    "recorder_node": "hd_control.nodes.recorder_node",
    "torque_node": "hd_control.nodes.torque_node",
    "motion_node": "hd_control.nodes.motion_node",
    "fusion_node": "hd_control.nodes.fusion_node",
    "chain": "hd_sim.nodes.chain",
    "plant_node": "hd_sim.nodes.plant_node",
}
"""In the order of activation: a node finds its consumers awake, the plant comes last."""
FOUR = ("torque_node", "motion_node", "fusion_node", "plant_node")


@dataclass(frozen=True)
class RunPlan:
    """A robot's node processes. `parameters` and `params_files` are by node name, `plant` a shipped name or a path.

    `joint_groups` runs one torque node for each group of joint names, called torque_node_1 and so on.
    """

    nodes: tuple[str, ...] = FOUR
    plant: str = "arm_a"
    robot: str = ""
    lockstep: bool = False
    namespace: str = ""
    bag: Path | None = None
    recorder_lag: int = 200
    joint_groups: tuple[tuple[str, ...], ...] = ()
    parameters: Mapping[str, Mapping[str, Any]] = field(default_factory=dict)
    params_files: Mapping[str, tuple[Path, ...]] = field(default_factory=dict)

    def __post_init__(self) -> None:
        unknown = [name for name in self.nodes if name not in MODULES]
        if unknown:
            raise ConfigError(f"no node {unknown[0]!r}; there is {', '.join(MODULES)}")

    def processes(self) -> list[NodeProcess]:
        """The processes in the order of activation."""
        wanted = [
            *self.nodes,
            *(["recorder_node"] if self.bag is not None and "recorder_node" not in self.nodes else []),
        ]
        found = []
        for name in sorted(wanted, key=list(MODULES).index):
            if name == "torque_node" and self.joint_groups:
                for number, joints in enumerate(self.joint_groups, 1):
                    found.append(self._process(name, f"{name}_{number}", {"joints": list(joints)}))
            else:
                found.append(self._process(name, name, {}))
        return found

    def _process(self, executable: str, node: str, own: Mapping[str, Any]) -> NodeProcess:
        values: dict[str, Any] = {}
        if executable == "plant_node" or (executable == "chain" and "plant_node" not in self.nodes):
            values |= {"plant": self.plant, "clock": "lockstep" if self.lockstep else "wall"}
            if self.lockstep and self.bag is not None:
                values["lockstep_recorder_lag"] = self.recorder_lag
        if executable == "chain" and "plant_node" not in self.nodes:
            values["with_plant"] = True
        if executable != "plant_node" and "with_plant" not in values:
            values["robot"] = self.robot or self.plant
        if self.lockstep and self.bag is not None:
            values["publisher_depth"] = 2 * self.recorder_lag
        if executable == "recorder_node" and self.bag is not None:
            values["bag"] = str(self.bag)
        values |= own | dict(self.parameters.get(executable, {}))
        return NodeProcess(executable, node, self.namespace, values, self.params_files.get(executable, ()))


@dataclass(frozen=True)
class NodeProcess:
    """One process: its executable, its node's name and namespace, and its parameters."""

    executable: str
    node: str
    namespace: str
    parameters: Mapping[str, Any]
    params_files: tuple[Path, ...] = ()

    @property
    def path(self) -> str:
        """The node's full name."""
        return f"/{self.namespace.strip('/')}/{self.node}" if self.namespace.strip("/") else f"/{self.node}"

    def ros_arguments(self) -> list[str]:
        """What follows the executable on its command line."""
        arguments = ["--ros-args", "-r", f"__node:={self.node}"]
        if self.namespace.strip("/"):
            arguments += ["-r", f"__ns:=/{self.namespace.strip('/')}"]
        for path in self.params_files:
            arguments += ["--params-file", str(path)]
        for name, value in self.parameters.items():
            arguments += ["-p", f"{name}:={json.dumps(value)}"]
        return arguments

    def command(self) -> list[str]:
        """The command line of the process."""
        return [sys.executable, "-m", MODULES[self.executable], *self.ros_arguments()]
