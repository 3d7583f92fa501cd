"""Link model of virtual decomposition control: parameters, bounds and gains as blocks; torque of the rigid arm.

Zhu, section IV: each link has 13 parameters theta_L (`Robot.link_parameters`), each with an adaptation gain and bounds.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from hd_control import _motion
from hd_control.core.arrays import FloatArray
from hd_control.core.errors import ConfigError
from hd_control.core.robot import Robot

LINK_PARAMETERS = 13
GRAVITY = 9.81
"""m/s^2; the arm stands upright."""


def link_scale(scale: Sequence[float], joints: int) -> FloatArray:
    """`link_parameter_scale` as (n, 13): one factor for all, one for each joint, or one for each parameter.

    Raises ConfigError for any other length.
    """
    factors = np.array(scale, dtype=float)
    if factors.size == 1:
        return np.full((joints, LINK_PARAMETERS), factors.item())
    if factors.size == joints:
        return np.repeat(factors[:, None], LINK_PARAMETERS, axis=1)
    if factors.size == joints * LINK_PARAMETERS:
        return factors.reshape(joints, LINK_PARAMETERS)
    raise ConfigError(
        f"motion: link_parameter_scale has {factors.size} values, expected 1, {joints} or {joints * LINK_PARAMETERS}"
    )


def link_fields(values: Mapping[str, Any], robot: Robot) -> dict[str, ArrayLike]:
    """The robot's part of the parameter block: geometry, link parameters at the start, bounds, adaptation gains.

    `values` are in the robot's joint order. Bounds and gains belong to the robot description, the start value is the
    description's times `link_parameter_scale`. A parameter that is zero stays zero.
    """
    joints, theta = robot.joints, robot.link_parameters()
    factors = link_scale(values["link_parameter_scale"], joints)
    ends = [values["link_parameter_low_factor"] * theta, values["link_parameter_high_factor"] * theta]
    gain = np.asarray(values["link_adaptation_gain"], dtype=float)
    return {
        "gravity": GRAVITY,
        "rotation": robot.rotation.reshape(joints, 9),
        "origin": robot.origin,
        "link_parameters": factors * theta,
        "link_parameters_low": np.minimum(*ends),
        "link_parameters_high": np.maximum(*ends),
        "link_adaptation_gain": gain[:, None] * np.abs(theta),
    }


def rigid_torque(
    robot: Robot,
    position: ArrayLike,
    velocity: ArrayLike,
    acceleration: ArrayLike,
    required_velocity: ArrayLike | None = None,
) -> FloatArray:
    """Joint torques (k, n) of the robot without drives, N m, for k states (k, n); Zhu (36), (39).

    `required_velocity` None means equal to `velocity`: then this is the inverse dynamics. Otherwise `acceleration` is
    the required one. Raises ValueError for shapes that do not fit.
    """
    q, v, a = (np.ascontiguousarray(x, dtype=float) for x in (position, velocity, acceleration))
    v_r = v if required_velocity is None else np.ascontiguousarray(required_velocity, dtype=float)
    found: FloatArray = _motion.batch_torque(
        robot.joints, robot.rotation, robot.origin, GRAVITY, robot.link_parameters(), q, v, v_r, a
    )
    return found
