"""An identified model as MJCF for MuJoCo: per joint a rotor hinge, a torsion hinge and a motor, all at the output side.

    joint angle = angle of the rotor hinge + angle of the torsion hinge
    rotor hinge: armature = rotor inertia, frictionloss = Coulomb friction, damping = viscous friction
    torsion hinge: stiffness = torsional stiffness k, damping = k d with the damping time d
    motor: torque times the gear ratio, N m

What MuJoCo's joints do not have is named in a comment and left out. https://mujoco.readthedocs.io (XML reference).
"""

from __future__ import annotations

import math
import xml.etree.ElementTree as ElementTree
from collections.abc import Sequence
from typing import Any

import numpy as np

from hd_control.core.errors import ConfigError
from hd_control.core.robot import Robot
from hd_control.drive.model import JointModel, Model

GRAVITY = 9.81
TIMESTEP = 5e-4
USED = {
    "rotor_inertia": ("rotor_inertia",),
    "torsional_stiffness": ("torsional_stiffness", "damping_time"),
    "coulomb_friction": ("coulomb_torque",),
    "viscous_friction": ("viscous",),
    "link_dynamics": ("inertia", "gravity_cosine", "gravity_sine"),
}
"""Effects that MuJoCo has, with the parameters that go into the file."""


def mjcf_text(model: Model, name: str = "robot", rigid: bool = False, joints: Sequence[str] = ()) -> str:
    """The model as a complete MJCF document; `joints`: only these, each alone on its own link.

    `rigid`: without torsion, one hinge per joint. A chain of links needs a robot description; without one every joint
    needs `link_dynamics` with an inertia. Raises ConfigError or RobotError.
    """
    root = ElementTree.Element("mujoco", model=name)
    ElementTree.SubElement(root, "compiler", angle="radian")
    ElementTree.SubElement(root, "option", timestep=_number(TIMESTEP), integrator="implicitfast")
    world, actuators = ElementTree.SubElement(root, "worldbody"), ElementTree.SubElement(root, "actuator")
    robot = model.robot_description()
    chosen = list(joints or (model.joints if robot is None else robot.joint_names))
    body = world
    for place, joint in enumerate(chosen):
        limit = math.inf
        if robot is None:
            _own_body(world, model.joint(joint), joint, rigid, place)
        else:
            row = robot.indices([joint])[0]
            body = _chain_body(world if joints else body, robot, row, model.joint(joint), rigid)
            limit = float(robot.effort_limit[row])
        _motor(actuators, joint, rigid, limit)
    ElementTree.indent(root)
    return ElementTree.tostring(root, encoding="unicode") + "\n"


def left_out(joint: JointModel) -> list[str]:
    """Effects and parameters of a joint that the file does not hold, `effect` or `effect.parameter`."""
    found = [effect for effect in joint.effects if effect not in USED]
    for effect, used in USED.items():
        neutral = {"inertia_scale": 1.0}
        found += [
            f"{effect}.{parameter}"
            for parameter, value in joint.effects.get(effect, {}).items()
            if parameter not in used and value.value != neutral.get(parameter, 0.0)
        ]
    return found


def _chain_body(parent: Any, robot: Robot, row: int, joint: JointModel, rigid: bool) -> Any:
    """A link of the arm in its place, with its joint."""
    name, turn = robot.joint_names[row], robot.rotation[row]
    body = ElementTree.SubElement(
        parent, "body", name=f"{name}_link", pos=_row(robot.origin[row]), xyaxes=_row([*turn[:, 0], *turn[:, 1]])
    )
    inertia = robot.inertia[row][[0, 1, 2, 0, 0, 1], [0, 1, 2, 1, 2, 2]]
    ElementTree.SubElement(
        body, "inertial", pos=_row(robot.center_of_mass[row]), mass=_number(robot.mass[row]), fullinertia=_row(inertia)
    )
    low, high = float(robot.position_low[row]), float(robot.position_high[row])
    _hinges(body, name, joint, rigid, "0 0 1", (low, high))
    return body


def _own_body(world: Any, joint: JointModel, name: str, rigid: bool, place: int) -> None:
    """A link of its own with J q'' + g_c cos q + g_s sin q: a point of mass in front of an axis along -y.

    Its height is r_x sin q + r_z cos q, so m g r_x = g_c and m g r_z = -g_s; half of J comes from the mass m.
    """
    inertia, cosine, sine = (joint.number("link_dynamics", p) for p in ("inertia", "gravity_cosine", "gravity_sine"))
    if not inertia > 0.0:
        raise ConfigError(f"{name}: MJCF needs the link's inertia: a robot description, or link_dynamics with inertia")
    weight = math.hypot(cosine, sine)
    mass = 2.0 * weight**2 / (inertia * GRAVITY**2) if weight > 0.0 else 1.0
    about_center = 0.5 * inertia if weight > 0.0 else inertia
    center = [cosine / (mass * GRAVITY), 0.0, -sine / (mass * GRAVITY)]
    body = ElementTree.SubElement(world, "body", name=f"{name}_link", pos=_row([0.0, float(place), 0.0]))
    ElementTree.SubElement(body, "inertial", pos=_row(center), mass=_number(mass), diaginertia=_row([about_center] * 3))
    _hinges(body, name, joint, rigid, "0 -1 0", None)


def _hinges(
    body: Any, name: str, joint: JointModel, rigid: bool, axis: str, limits: tuple[float, float] | None
) -> None:
    """The joint's elements: what an identified model is for MuJoCo."""
    words = ", ".join(left_out(joint) + (["torsional_stiffness (rigid)"] if rigid else [])) or "nothing"
    body.append(ElementTree.Comment(f" {name}: left out: {words} ".replace("--", "- -")))
    rotor = {
        "armature": joint.number("rotor_inertia", "rotor_inertia"),
        "frictionloss": joint.number("coulomb_friction", "coulomb_torque"),
        "damping": joint.number("viscous_friction", "viscous"),
    }
    place = {"range": _row(limits), "limited": "true"} if limits and np.isfinite(limits).all() else {}
    numbers = {key: _number(value) for key, value in rotor.items()}
    hinge = name if rigid else f"{name}_motor"
    ElementTree.SubElement(body, "joint", {"name": hinge, "type": "hinge", "axis": axis, **numbers, **place})
    if rigid:
        return
    stiffness = joint.number("torsional_stiffness", "torsional_stiffness")
    if not stiffness > 0.0:
        raise ConfigError(f"{name}: the model has no torsional_stiffness; export it with --rigid")
    if not rotor["armature"] > 0.0:
        raise ConfigError(f"{name}: the model has no rotor_inertia; a rotor hinge without inertia cannot be simulated")
    spring = {"stiffness": stiffness, "damping": stiffness * joint.number("torsional_stiffness", "damping_time")}
    numbers = {key: _number(value) for key, value in spring.items()}
    ElementTree.SubElement(body, "joint", {"name": f"{name}_torsion", "type": "hinge", "axis": axis, **numbers})


def _motor(actuators: Any, name: str, rigid: bool, limit: float) -> None:
    """The motor; torque times the gear ratio, so its gear is 1."""
    found = {"name": name, "joint": name if rigid else f"{name}_motor", "gear": "1"}
    if math.isfinite(limit) and limit > 0.0:
        found |= {"ctrlrange": _row([-limit, limit]), "ctrllimited": "true"}
    ElementTree.SubElement(actuators, "motor", found)


def _number(value: float) -> str:
    return repr(float(value)).removesuffix(".0")


def _row(values: Any) -> str:
    return " ".join(_number(value) for value in np.ravel(values))
