"""Nominal link dynamics of one joint: M q'' and gravity with Coriolis torque, and what an added body would add.

    tau_j = (M(q) q'')_j + b_j(q, q'),    added body: tau_j = Y_j(q, q', q'') p

Frames are those of `Robot`: the z axis of a link's frame is its joint's axis. All samples at once; linear in q''.
Source: docs/equations/link.md (L1), (L2), (L3).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from hd_control.core.arrays import FloatArray
from hd_control.core.errors import ConfigError
from hd_control.core.robot import Robot
from hd_control.drive.effects.payload import NAMES, Payload
from hd_control.drive.model import JointModel, Model

GRAVITY = 9.81
"""m/s^2, along -z of the base."""

LinkTerms = tuple[FloatArray, FloatArray, FloatArray | None, FloatArray | None]


def link_terms(
    model: Model,
    joint: str,
    positions: FloatArray,
    velocities: FloatArray,
    accelerations: FloatArray,
    robot: Robot | None = None,
) -> LinkTerms:
    """(M q'')_j and b_j (n,) N m, regressors (n, 10) of a body fixed to the own and to the last link (or None).

    positions, velocities, accelerations: (n, J) of all joints of the robot in its order, or (n,) of the joint alone,
    SI; an alone joint of an arm is refused. `robot` takes the place of the model's. Raises ConfigError or RobotError.
    """
    description = robot if robot is not None else model.robot_description()
    if description is not None:
        return arm_terms(model, positions, velocities, accelerations, [joint], description)[joint]
    q, _, a = _rows(positions, velocities, accelerations)
    j = 0 if q.shape[1] == 1 else list(model.joints).index(joint)
    return _single(model.joint(joint), q[:, j], a[:, j])


def arm_terms(
    model: Model,
    positions: FloatArray,
    velocities: FloatArray,
    accelerations: FloatArray,
    joints: Sequence[str] | None = None,
    robot: Robot | None = None,
) -> dict[str, LinkTerms]:
    """`link_terms` of several joints (all of the model if None), which costs little more than one."""
    names = list(model.joints) if joints is None else list(joints)
    description = robot if robot is not None else model.robot_description()
    if description is None:
        return {name: link_terms(model, name, positions, velocities, accelerations) for name in names}
    q, v, a = _rows(positions, velocities, accelerations)
    _check_width(q, description, ", ".join(names))
    inertia = torques(description, q, np.zeros_like(v), a, 0.0)
    bias = torques(description, q, v, np.zeros_like(a), GRAVITY)
    motion = link_motion(description, q, v, a, GRAVITY)
    found: dict[str, LinkTerms] = {}
    for name, j in zip(names, description.indices(names), strict=True):
        bodies = (j, description.joints - 1)
        own, tool = (body_regressor(description, motion, j, body) for body in bodies)
        found[name] = (_inertia_scale(model, name) * inertia[:, j], bias[:, j], own, tool)
    return found


def added_bodies(joint: JointModel) -> tuple[FloatArray, FloatArray]:
    """Inertial parameters (10,) that the model adds to the joint's own and to the last link; zeros where it adds none.

    Their order is that of the regressors' columns (`body_regressor`).
    """
    known = joint.numbers(Payload.name)
    own, last = (np.array([known.get(f"{body}_{name}", 0.0) for name in NAMES]) for body in ("link", "tool"))
    return own, last


def single_inertia(joint: JointModel) -> float:
    """Inertia kg m^2 of the link of a single joint without a robot description; 0 where the model gives none."""
    return joint.number("link_dynamics", "inertia")


def _rows(*motion: FloatArray) -> list[FloatArray]:
    """Each as (n, J)."""
    arrays = [np.asarray(x, dtype=float) for x in motion]
    return [x[:, None] if x.ndim == 1 else x for x in arrays]


def _check_width(q: FloatArray, robot: Robot, joint: str) -> None:
    if q.shape[1] != robot.joints:
        raise ConfigError(
            f"link dynamics of {joint}: {robot.name} has {robot.joints} joints, the motion of {q.shape[1]} is known"
        )


def _inertia_scale(model: Model, joint: str) -> float:
    return model.joint(joint).number("link_dynamics", "inertia_scale", 1.0) if joint in model.joints else 1.0


def _single(joint: JointModel, q: FloatArray, a: FloatArray) -> LinkTerms:
    """A single joint without a description: inertia and gravity from its `link_dynamics`."""
    numbers = joint.numbers("link_dynamics")
    inertia = numbers.get("inertia", 0.0) * numbers.get("inertia_scale", 1.0)
    if inertia <= 0.0:
        raise ConfigError("link_dynamics: the model has neither a robot description nor an inertia; give one of them")
    gravity = numbers.get("gravity_cosine", 0.0) * np.cos(q) + numbers.get("gravity_sine", 0.0) * np.sin(q)
    return inertia * a, gravity, None, None


@dataclass(frozen=True)
class LinkMotion:
    """Motion of every link in its own frame: rotation[j] (n, 3, 3) to the frame before; rate, angular acceleration and
    acceleration of the origin (gravity included), each a list of (n, 3)."""

    rotation: list[FloatArray]
    rate: list[FloatArray]
    angular: list[FloatArray]
    linear: list[FloatArray]


def link_motion(robot: Robot, q: FloatArray, v: FloatArray, a: FloatArray, gravity: float) -> LinkMotion:
    """Outward recursion of Newton and Euler for all samples (n, J) at once."""
    n = len(q)
    motion = LinkMotion([], [], [], [])
    rate, angular = np.zeros((n, 3)), np.zeros((n, 3))
    linear = np.tile([0.0, 0.0, gravity], (n, 1))
    for j in range(robot.joints):
        origin = np.broadcast_to(robot.origin[j], (n, 3))
        linear = linear + _cross(angular, origin) + _cross(rate, _cross(rate, origin))
        rotation = _turned(robot.rotation[j], q[:, j])
        rate, angular, linear = (_into(rotation, x) for x in (rate, angular, linear))
        spin = np.zeros((n, 3))
        spin[:, 2] = v[:, j]
        angular = angular + _cross(rate, spin)
        angular[:, 2] += a[:, j]
        rate = rate + spin
        for store, value in zip((motion.rotation, motion.rate, motion.angular, motion.linear),
                                (rotation, rate, angular, linear), strict=True):  # fmt: skip
            store.append(value)
    return motion


def torques(robot: Robot, q: FloatArray, v: FloatArray, a: FloatArray, gravity: float) -> FloatArray:
    """Joint torques (n, J) of the rigid arm: inverse dynamics by Newton and Euler."""
    return motion_torques(robot, link_motion(robot, q, v, a, gravity))


def motion_torques(robot: Robot, motion: LinkMotion) -> FloatArray:
    """Inward recursion of Newton and Euler, (n, J)."""
    n = len(motion.rate[0])
    force, moment = np.zeros((n, 3)), np.zeros((n, 3))
    found = np.empty((n, robot.joints))
    for j in reversed(range(robot.joints)):
        rate, angular, linear = motion.rate[j], motion.angular[j], motion.linear[j]
        center = np.broadcast_to(robot.center_of_mass[j], rate.shape)
        pull = robot.mass[j] * (linear + _cross(angular, center) + _cross(rate, _cross(rate, center)))
        turn = angular @ robot.inertia[j] + _cross(rate, rate @ robot.inertia[j]) + _cross(center, pull)
        if j + 1 < robot.joints:
            force, moment = (_out(motion.rotation[j + 1], x) for x in (force, moment))
            moment = moment + _cross(np.broadcast_to(robot.origin[j + 1], force.shape), force)
        force, moment = force + pull, moment + turn
        found[:, j] = moment[:, 2]
    return found


def body_regressor(robot: Robot, motion: LinkMotion, joint: int, body: int) -> FloatArray:
    """Torque at `joint` per inertial parameter of a body fixed to link `body` >= `joint`, (n, 10).

    Parameters: mass, first moments x y z, inertia xx xy yy xz yz zz about the origin of the link's frame, in it.
    """
    rate, angular, linear = motion.rate[body], motion.angular[body], motion.linear[body]
    axis = np.zeros_like(rate)
    axis[:, 2] = 1.0
    arm = np.zeros_like(rate)  # from the joint's origin to the body's, in the frame of the link reached so far
    for j in range(joint + 1, body + 1):
        arm = _into(motion.rotation[j], arm + robot.origin[j])
        axis = _into(motion.rotation[j], axis)
    lever = _cross(axis, arm)
    found = np.empty((len(rate), 10))
    found[:, 0] = (lever * linear).sum(axis=1)
    found[:, 1:4] = -_cross(angular, lever) + rate * (rate * lever).sum(axis=1)[:, None]
    found[:, 1:4] += -lever * (rate * rate).sum(axis=1)[:, None] + _cross(linear, axis)
    turned = _cross(axis, rate)
    for column, (i, k) in enumerate(((0, 0), (0, 1), (1, 1), (0, 2), (1, 2), (2, 2)), start=4):
        term = axis[:, i] * angular[:, k] + turned[:, i] * rate[:, k]
        found[:, column] = term if i == k else term + axis[:, k] * angular[:, i] + turned[:, k] * rate[:, i]
    return found


def _turned(rotation: FloatArray, angle: FloatArray) -> FloatArray:
    """rotation @ Rz(angle), (n, 3, 3)."""
    c, s = np.cos(angle)[:, None], np.sin(angle)[:, None]
    found = np.empty((angle.size, 3, 3))
    found[:, :, 0] = c * rotation[:, 0] + s * rotation[:, 1]
    found[:, :, 1] = c * rotation[:, 1] - s * rotation[:, 0]
    found[:, :, 2] = rotation[:, 2]
    return found


def _into(rotation: FloatArray, vector: FloatArray) -> FloatArray:
    """Components in the later frame: rotation^T vector."""
    return np.asarray(np.einsum("nij,ni->nj", rotation, vector))


def _out(rotation: FloatArray, vector: FloatArray) -> FloatArray:
    """Components in the earlier frame: rotation vector."""
    return np.asarray(np.einsum("nij,nj->ni", rotation, vector))


def _cross(a: FloatArray, b: FloatArray) -> FloatArray:
    """Cross product of rows; several times faster than the general one."""
    x = a[:, 1] * b[:, 2] - a[:, 2] * b[:, 1]
    y = a[:, 2] * b[:, 0] - a[:, 0] * b[:, 2]
    return np.stack([x, y, a[:, 0] * b[:, 1] - a[:, 1] * b[:, 0]], axis=1)


@dataclass(frozen=True)
class OwnLink:
    """The link of one joint along a recording, (n,): tau = inertia q'' + rest + slope (q - measured q).

    inertia kg m^2, the joint's own; rest N m: gravity, Coriolis and the neighbours' accelerations; slope N m/rad.
    """

    inertia: FloatArray
    rest: FloatArray
    slope: FloatArray


def own_link(
    model: Model,
    joint: str,
    positions: FloatArray,
    velocities: FloatArray,
    accelerations: FloatArray,
    robot: Robot | None = None,
) -> OwnLink:
    """The own link of a joint for a prediction, the neighbours moving as measured. Arguments as in `link_terms`."""
    description = robot if robot is not None else model.robot_description()
    q, v, a = _rows(positions, velocities, accelerations)
    if description is None:
        single, j = model.joint(joint), 0 if q.shape[1] == 1 else list(model.joints).index(joint)
        inertia, rest, _, _ = _single(single, q[:, j], np.ones(len(q)))
        slope = _single(single, q[:, j] + 0.5 * np.pi, a[:, j])[1]  # of a sine: itself a quarter turn later
        return OwnLink(inertia, rest, slope)
    _check_width(q, description, joint)
    j, scale = description.indices([joint])[0], _inertia_scale(model, joint)
    still, unit = np.zeros_like(v), np.zeros_like(a)
    unit[:, j] = 1.0
    alone = link_motion(description, q, still, unit, 0.0)
    inertia = scale * motion_torques(description, alone)[:, j]
    whole = torques(description, q, v, a, GRAVITY)[:, j]
    if scale != 1.0:
        whole += (scale - 1.0) * torques(description, q, still, a, 0.0)[:, j]
    return OwnLink(inertia, whole - inertia * a[:, j], _gravity_slope(description, alone, j))


def _gravity_slope(robot: Robot, motion: LinkMotion, joint: int) -> FloatArray:
    """Slope of a joint's gravity torque h_x g_y - h_y g_x over its own angle, (n,) N m/rad.

    h: first moment of all links from the joint on, fixed in its frame; g: upward acceleration, which turns in it.
    """
    moment, mass = np.zeros_like(motion.rate[0]), 0.0
    for j in reversed(range(joint, robot.joints)):
        if j + 1 < robot.joints:
            moment = _out(motion.rotation[j + 1], moment) + mass * robot.origin[j + 1]
        moment, mass = moment + robot.mass[j] * robot.center_of_mass[j], mass + robot.mass[j]
    upward = np.tile([0.0, 0.0, GRAVITY], (len(moment), 1))
    for j in range(joint + 1):
        upward = _into(motion.rotation[j], upward)
    return np.asarray(-(moment[:, :2] * upward[:, :2]).sum(axis=1))
