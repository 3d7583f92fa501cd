"""Robot description: a serial arm of revolute joints, read from URDF with Pinocchio.

Frames follow Zhu's recursion: frame j is fixed to link j and its z axis is the joint axis. `R = rotation[j] Rz(q_j)`
maps frame j to frame j-1, `origin[j]` is the origin of frame j in frame j-1.
"""

from __future__ import annotations

import re
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from hd_control.core.arrays import FloatArray
from hd_control.core.errors import RobotError
from hd_control.core.resources import find_config

MAX_BYTES = 10_000_000


@dataclass(frozen=True)
class Robot:
    """A serial arm. Arrays have one row per joint; SI units.

    rotation (n,3,3), origin (n,3) m, mass (n,) kg, center_of_mass (n,3) m and inertia (n,3,3) kg m^2 about it, in the
    link frame; position_low, position_high (n,) rad; velocity_limit (n,) rad/s; effort_limit (n,) N m.
    """

    name: str
    joint_names: tuple[str, ...]
    rotation: FloatArray
    origin: FloatArray
    mass: FloatArray
    center_of_mass: FloatArray
    inertia: FloatArray
    position_low: FloatArray
    position_high: FloatArray
    velocity_limit: FloatArray
    effort_limit: FloatArray
    urdf: str

    @classmethod
    def from_file(cls, name_or_path: str) -> Robot:
        """Reads a user's URDF file, or a shipped one by name (`arm_a`). Raises RobotError or ConfigError."""
        name = name_or_path if name_or_path.endswith((".urdf", ".xml")) else f"{name_or_path}.urdf"
        path = find_config(name, "robots")
        try:
            with path.open("rb") as file:
                text = file.read(MAX_BYTES + 1).decode("utf-8")
        except (OSError, UnicodeDecodeError) as error:
            raise RobotError(f"{path}: cannot read ({error})") from None
        return cls.from_urdf(text, str(path))

    @classmethod
    def from_urdf(cls, text: str, where: str = "robot_description") -> Robot:
        """Reads URDF text. Raises RobotError for anything but a serial arm of revolute joints with masses."""
        _refuse_hostile(text, where)
        model = _pinocchio_model(text, where)
        if model.njoints < 2 or model.nv != model.njoints - 1:
            raise RobotError(f"{where}: {model.njoints - 1} moving joints; expected revolute joints only")
        if list(model.parents[1:]) != list(range(model.njoints - 1)):
            raise RobotError(f"{where}: the joints form a tree; expected one serial chain")
        turns = [_turn_to_z(_axis(model.joints[j], where)) for j in range(1, model.njoints)]
        before = [np.eye(3), *turns[:-1]]
        placements = [model.jointPlacements[j] for j in range(1, model.njoints)]
        inertias = [model.inertias[j] for j in range(1, model.njoints)]
        mass = np.array([inertia.mass for inertia in inertias])
        if not np.all(mass > 0.0):
            raise RobotError(f"{where}: link of {model.names[1 + int(np.argmin(mass))]} has no mass; add <inertial>")
        robot = cls(
            name=str(model.name),
            joint_names=tuple(model.names[1:]),
            rotation=np.array([b.T @ p.rotation @ t for b, p, t in zip(before, placements, turns, strict=True)]),
            origin=np.array([b.T @ p.translation for b, p in zip(before, placements, strict=True)]),
            mass=mass,
            center_of_mass=np.array([t.T @ i.lever for t, i in zip(turns, inertias, strict=True)]),
            inertia=np.array([t.T @ i.inertia @ t for t, i in zip(turns, inertias, strict=True)]),
            position_low=np.array(model.lowerPositionLimit),
            position_high=np.array(model.upperPositionLimit),
            velocity_limit=np.array(model.upperVelocityLimit),
            effort_limit=np.array(model.upperEffortLimit),
            urdf=text,
        )
        _refuse_impossible(robot, where)
        return robot

    @property
    def joints(self) -> int:
        """Number of joints."""
        return len(self.joint_names)

    def link_parameters(self) -> FloatArray:
        """The 13 parameters of every link, (n, 13): m, m r, m r_i^2, m r_i r_j - I_ij, I_ii (Zhu, section IV)."""
        m, r, inertia = self.mass[:, None], self.center_of_mass, self.inertia
        pairs = [(0, 1), (0, 2), (1, 2)]
        products = [m[:, 0] * r[:, i] * r[:, k] - inertia[:, i, k] for i, k in pairs]
        diagonal = inertia[:, range(3), range(3)]
        return np.column_stack([m, m * r, m * r * r, np.column_stack(products), diagonal])

    def pinocchio_model(self) -> Any:
        """The same robot as a `pinocchio.Model`; gravity is -9.81 m/s^2 along z."""
        return _pinocchio_model(self.urdf, self.name)

    def indices(self, names: Sequence[str]) -> list[int]:
        """Position of each named joint in this robot. Raises RobotError for an unknown name."""
        unknown = [name for name in names if name not in self.joint_names]
        if unknown:
            raise RobotError(f"unknown joint {unknown[0]!r}; {self.name} has {', '.join(self.joint_names)}")
        return [self.joint_names.index(name) for name in names]


def _refuse_hostile(text: str, where: str) -> None:
    if len(text) > MAX_BYTES:
        raise RobotError(f"{where}: URDF larger than {MAX_BYTES} bytes")
    if re.search(r"<!\s*(DOCTYPE|ENTITY)", text, re.IGNORECASE):
        raise RobotError(f"{where}: URDF with DOCTYPE or ENTITY is refused; remove the declaration")


def _refuse_impossible(robot: Robot, where: str) -> None:
    """Every number that the laws calculate with is finite, every range has a lower end below its upper one."""
    for what in ("rotation", "origin", "mass", "center_of_mass", "inertia"):
        values = getattr(robot, what)
        bad = ~np.isfinite(values).reshape(robot.joints, -1).all(axis=1)
        if bad.any():
            name = robot.joint_names[int(np.argmax(bad))]
            raise RobotError(f"{where}: {what.replace('_', ' ')} at {name} is not finite; give plain numbers")
    for low, high, what in (
        (robot.position_low, robot.position_high, "position range"),
        (np.zeros(robot.joints), robot.velocity_limit, "velocity limit"),
        (np.zeros(robot.joints), robot.effort_limit, "effort limit"),
    ):
        good = low <= high
        if not good.all():
            worst = int(np.argmin(good))
            raise RobotError(
                f"{where}: {what} of {robot.joint_names[worst]} is {low[worst]:g} … {high[worst]:g}; "
                "the upper end must not be below the lower one"
            )


def _pinocchio_model(text: str, where: str) -> Any:
    import pinocchio

    try:
        return pinocchio.buildModelFromXML(text)
    except (ValueError, RuntimeError) as error:
        raise RobotError(f"{where}: not a usable URDF ({str(error).strip().splitlines()[0]})") from None


def _axis(joint: Any, where: str) -> FloatArray:
    """Unit axis of a revolute joint in its own frame."""
    kind = joint.shortname()
    named = {"JointModelRX": 0, "JointModelRY": 1, "JointModelRZ": 2}
    if kind in named:
        return np.asarray(np.eye(3)[named[kind]])
    if kind == "JointModelRevoluteUnaligned":
        return np.array(joint.extract().axis if hasattr(joint, "extract") else joint.axis, dtype=float)
    raise RobotError(f"{where}: joint type {kind.removeprefix('JointModel')} is not supported; use revolute joints")


def _turn_to_z(axis: FloatArray) -> FloatArray:
    """A rotation whose third column is `axis` (identity for z), right-handed."""
    if axis[2] == 1.0:
        return np.eye(3)
    helper = np.eye(3)[int(np.argmin(np.abs(axis)))]
    first = np.cross(helper, axis)
    first /= np.linalg.norm(first)
    return np.column_stack([first, np.cross(axis, first), axis])
