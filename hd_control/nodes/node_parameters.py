"""Parameters that every node has, and where shipped values come from: `config/nodes.yaml` and `config/<node>.yaml`."""

from __future__ import annotations

from typing import Any

from hd_control.core.parameters import Change, Parameter, ParameterSet
from hd_control.core.resources import config_path
from hd_control.core.strict_yaml import load_params_file

CHAIN_PARTS = ("fusion", "motion", "torque")

COMMON = ParameterSet(
    "nodes",
    (
        Parameter("robot", "robot description: shipped name or path of a URDF", kind=str, change=Change.FIXED),
        Parameter("period", "control period", "s", low=1e-4, high=0.1, change=Change.FIXED),
        Parameter("autostart", "configure and activate without a manager", kind=bool, change=Change.FIXED),
        Parameter("publisher_depth", "messages kept for slow readers: 1 on the wall clock, more for a lock-step recording",
                  kind=int, low=1, high=10_000, change=Change.FIXED),  # fmt: skip
        Parameter("introspection", "publish every number of the law each tick", kind=bool, change=Change.HOT),
    ),
)


def shipped_values(node: str) -> dict[str, Any]:
    """Shipped values of a node's parameters. The chain takes its laws' values from their own files, with a
    prefix, and those of the plant without one.

    Raises ConfigError for a file that is missing or malformed.
    """
    values = load_params_file(config_path("nodes.yaml"), node)
    if node == "chain":
        values.update(load_params_file(config_path("plant_node.yaml"), "plant_node"))
        for part in CHAIN_PARTS:
            law = load_params_file(config_path(f"{part}_node.yaml"), f"{part}_node")
            values.update({f"{part}.{name}": value for name, value in law.items() if name not in COMMON.names})
    values.update(load_params_file(config_path(f"{node}.yaml"), node))
    return values
