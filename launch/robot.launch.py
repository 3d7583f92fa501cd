"""The nodes of a robot: `ros2 launch hd_control robot.launch.py robot:=arm_a clock:=lockstep bag:=bags/first`.

The same plan as `hd up`, which needs no launch system. The nodes start by themselves, the plant last in effect: it
waits for its command in lock-step, and on the wall clock its gate holds the brake until the commands run.
"""

import os
from dataclasses import replace
from pathlib import Path

from launch.actions import DeclareLaunchArgument, OpaqueFunction, SetEnvironmentVariable
from launch.substitutions import LaunchConfiguration
from launch_ros.actions import Node

from hd_control.session.session import FOUR, RunPlan
from launch import LaunchDescription

DISCOVERY = "ROS_AUTOMATIC_DISCOVERY_RANGE"
ARGUMENTS = {"robot": "arm_a", "clock": "wall", "namespace": "", "bag": "", "nodes": " ".join(FOUR)}


def nodes(context):
    """One launch action for each process of the plan."""
    value = {name: LaunchConfiguration(name).perform(context) for name in ARGUMENTS}
    plan = RunPlan(
        nodes=tuple(value["nodes"].split()),
        plant=value["robot"],
        lockstep=value["clock"] == "lockstep",
        namespace=value["namespace"],
        bag=Path(value["bag"]) if value["bag"] else None,
    )
    plan = replace(plan, parameters={name: {"autostart": True} for name in (*plan.nodes, "recorder_node")})
    return [
        Node(
            package="hd_control",
            executable=process.executable,
            name=process.node,
            namespace=process.namespace,
            parameters=[dict(process.parameters)],
            output="screen",
        )
        for process in plan.processes()
    ]


def generate_launch_description():
    """Discovery stays on this computer unless the user has set another range."""
    return LaunchDescription(
        [
            *(DeclareLaunchArgument(name, default_value=default) for name, default in ARGUMENTS.items()),
            SetEnvironmentVariable(DISCOVERY, os.environ.get(DISCOVERY, "LOCALHOST")),
            OpaqueFunction(function=nodes),
        ]
    )
