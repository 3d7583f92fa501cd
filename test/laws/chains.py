"""Random serial arms, and shipped values, for the motion tests."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pinocchio

from hd_control.core.robot import Robot
from hd_control.core.strict_yaml import load_params_file

CONFIG = Path(__file__).resolve().parents[2] / "config" / "motion_node.yaml"


def shipped_values() -> dict:
    """The shipped values of the motion node."""
    return load_params_file(CONFIG, "motion_node")


def paper_values() -> dict:
    """The same with Zhu's own choices, whatever the shipped file prefers: plain rates, adapting links."""
    return {**shipped_values(), "law": "vdc", "rate_source": "plain", "link_adaptation": True}


def random_rotation(random: np.random.Generator) -> np.ndarray:
    q, r = np.linalg.qr(random.normal(size=(3, 3)))
    q = q * np.sign(np.diag(r))
    return q if np.linalg.det(q) > 0 else -q


def random_inertia(random: np.random.Generator) -> np.ndarray:
    """A physical inertia tensor: that of six point masses."""
    points = random.normal(size=(6, 3)) * 0.2
    points -= points.mean(axis=0)
    return sum(np.eye(3) * (x @ x) - np.outer(x, x) for x in points)


def random_robot(random: np.random.Generator, joints: int = 7) -> Robot:
    """A chain with random frames, masses, centres of mass and full inertia tensors."""
    base = Robot.from_file("arm_a")
    rows = [i % 7 for i in range(joints)]
    return replace(
        base,
        name="random",
        joint_names=tuple(f"joint_{j + 1}" for j in range(joints)),
        rotation=np.array([random_rotation(random) for _ in range(joints)]),
        origin=random.uniform(-0.5, 0.5, (joints, 3)),
        mass=random.uniform(1.0, 20.0, joints),
        center_of_mass=random.uniform(-0.3, 0.3, (joints, 3)),
        inertia=np.array([random_inertia(random) for _ in range(joints)]),
        position_low=base.position_low[rows],
        position_high=base.position_high[rows],
        velocity_limit=base.velocity_limit[rows],
        effort_limit=base.effort_limit[rows],
        urdf="",
    )


def pinocchio_chain(robot: Robot) -> pinocchio.Model:
    """The same chain built joint by joint in Pinocchio."""
    model, parent = pinocchio.Model(), 0
    for j, name in enumerate(robot.joint_names):
        place = pinocchio.SE3(robot.rotation[j], robot.origin[j])
        parent = model.addJoint(parent, pinocchio.JointModelRZ(), place, name)
        body = pinocchio.Inertia(float(robot.mass[j]), robot.center_of_mass[j], robot.inertia[j])
        model.appendBodyToJoint(parent, body, pinocchio.SE3.Identity())
    return model
