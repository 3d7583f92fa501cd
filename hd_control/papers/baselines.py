"""Laws to compare with, and the settings in which they are reported, so that none is beaten by a bad tuning alone.

The laws themselves are in hd_control/cpp/motion.hpp: `pd`, `pid`, `computed_torque`, `feed_forward`.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from hd_control.core.arrays import FloatArray
from hd_control.core.robot import Robot
from hd_control.laws.motion import rigid_torque

# ----------------------------------------------------------------------------------------------------
# Feed-forward from a drive model: the motor torque that a wanted motion under a wanted joint torque needs.
#
# Output side of the gear throughout. Plant, docs/equations/joint.md (J1)-(J4), Z(1)-(3), G(2) for KE, theta = N phi:
#
#     tau = k (delta + d delta'),  delta = phi + KE(theta) - q,  Y = 1 + N KE'(theta)
#     I* phi'' = u - F(phi', tau) - Y tau
#
# solved for u with given q, q', q'', tau, tau', tau''. Friction crosses zero smoothly: a feed-forward may not jump.
# Source: docs/equations/compensation.md (C1), (C2), (C3), (C4).


def kinematic_error(angle: Any, cosine: ArrayLike, sine: ArrayLike) -> tuple[Any, Any, Any]:
    """(KE, KE', KE'') at rotor angle `angle` rad; derivatives with respect to the rotor angle. Gandhi-Ghorbel (2).

    KE = sum over n = 1 ... of cosine[n-1] cos(n angle) + sine[n-1] sin(n angle), rad at the output. `angle` is a float
    or an array of any shape; the results have its shape. Empty harmonics give zeros.
    """
    angle = np.asarray(angle, dtype=float)
    a, b = np.asarray(cosine, dtype=float), np.asarray(sine, dtype=float)
    n = np.arange(1, len(a) + 1)
    c, s = np.cos(angle[..., None] * n), np.sin(angle[..., None] * n)
    in_phase = a * c + b * s
    return in_phase.sum(-1), (n * (b * c - a * s)).sum(-1), -(n * n * in_phase).sum(-1)


@dataclass(frozen=True)
class DriveValues:
    """One drive, output side, as plain numbers. SI: N m, rad, s; `friction_width` is a velocity, rad/s."""

    gear_ratio: float
    rotor_inertia: float
    torsional_stiffness: float = np.inf
    damping_time: float = 0.0
    coulomb_torque: float = 0.0
    friction_offset: float = 0.0
    viscous_positive: float = 0.0
    viscous_negative: float = 0.0
    load_friction_linear: float = 0.0
    load_friction_quadratic: float = 0.0
    friction_width: float = 1e-3
    kinematic_cosine: tuple[float, ...] = field(default=())
    kinematic_sine: tuple[float, ...] = field(default=())


@dataclass(frozen=True)
class MotorFeedforward:
    """The wanted motor torque N m, its terms N m, and the rotor motion that belongs to it (rad, rad/s, rad/s^2)."""

    motor_torque: FloatArray
    inertia_torque: FloatArray
    friction_torque: FloatArray
    transmitted_torque: FloatArray
    motor_position: FloatArray
    motor_velocity: FloatArray
    motor_acceleration: FloatArray


def friction(drive: DriveValues, motor_velocity: Any, joint_torque: Any) -> Any:
    """Friction torque at the rotor, N m, with tanh(velocity / friction_width) for the sign. Zhu (3), (4)."""
    v, load = np.asarray(motor_velocity, dtype=float), np.abs(joint_torque)
    grown = 1.0 + drive.load_friction_linear * load + drive.load_friction_quadratic * load * load
    viscous = np.where(v > 0.0, drive.viscous_positive, drive.viscous_negative) * v
    return drive.coulomb_torque * grown * np.tanh(v / drive.friction_width) + drive.friction_offset + viscous


def motor_position(drive: DriveValues, joint_position: Any, torsion: Any, rounds: int = 60) -> FloatArray:
    """Rotor angle / gear ratio with phi + KE(N phi) = q + torsion, rad. Newton; needs |N KE'| < 1."""
    wanted = np.asarray(joint_position, dtype=float) + torsion
    phi = wanted.copy()
    for _ in range(rounds):
        error, slope, _ = kinematic_error(drive.gear_ratio * phi, drive.kinematic_cosine, drive.kinematic_sine)
        change = (phi + error - wanted) / (1.0 + drive.gear_ratio * slope)
        phi = phi - change
        if not np.any(np.abs(change) > 1e-15 * (1.0 + np.abs(phi))):
            break
    return np.asarray(phi)


def motor_feedforward(
    drive: DriveValues,
    joint_position: ArrayLike,
    joint_velocity: ArrayLike,
    joint_acceleration: ArrayLike,
    joint_torque: ArrayLike,
    joint_torque_rate: ArrayLike = 0.0,
    joint_torque_acceleration: ArrayLike = 0.0,
) -> MotorFeedforward:
    """Inverse of the nominal drive. Arguments are floats or arrays of one shape, SI; the result has that shape.

    With damping the torsion is delta = (tau - d tau') / k to first order in d, which is exact for d = 0.
    """
    q, v, a, tau, rate, acceleration = np.broadcast_arrays(
        *(
            np.asarray(x, dtype=float)
            for x in (
                joint_position,
                joint_velocity,
                joint_acceleration,
                joint_torque,
                joint_torque_rate,
                joint_torque_acceleration,
            )
        )
    )
    k, ratio = drive.torsional_stiffness, drive.gear_ratio
    phi = motor_position(drive, q, (tau - drive.damping_time * rate) / k)
    _, slope, curvature = kinematic_error(ratio * phi, drive.kinematic_cosine, drive.kinematic_sine)
    transmission_slope = 1.0 + ratio * slope
    speed = (v + (rate - drive.damping_time * acceleration) / k) / transmission_slope
    phi_acceleration = (a + acceleration / k - ratio**2 * curvature * speed**2) / transmission_slope
    inertia = drive.rotor_inertia * phi_acceleration
    resisting = friction(drive, speed, tau)
    transmitted = transmission_slope * tau
    return MotorFeedforward(
        inertia + resisting + transmitted, inertia, np.asarray(resisting), transmitted, phi, speed, phi_acceleration
    )


# ----------------------------------------------------------------------------------------------------


@dataclass(frozen=True)
class Baseline:
    """A law with factors on its gains."""

    name: str
    law: str
    position: float = 1.0
    velocity: float = 1.0
    integral: float = 1.0

    def values(self, values: Mapping[str, Any]) -> dict[str, Any]:
        """The parameter values of a motion law, changed to this baseline."""
        factors = {"position_gain": self.position, "velocity_gain": self.velocity, "integral_gain": self.integral}
        scaled = {name: [factor * gain for gain in values[name]] for name, factor in factors.items()}
        return {**values, **scaled, "law": self.law}


BASELINES = (
    Baseline("pd", "pd"),
    Baseline("pid", "pid"),
    Baseline("pid_soft", "pid", position=0.7, velocity=0.7, integral=0.5),
    Baseline("computed_torque", "computed_torque"),
    Baseline("computed_torque_half", "computed_torque", position=0.5),
    Baseline("computed_torque_double", "computed_torque", position=2.0),
    Baseline("feed_forward", "feed_forward"),
)


def inverse_plant(
    robot: Robot,
    drives: Sequence[DriveValues],
    rotor_inertia: ArrayLike,
    position: ArrayLike,
    velocity: ArrayLike,
    acceleration: ArrayLike,
) -> FloatArray:
    """Feed-forward of the drives for wanted motions (k, n): torque to put into `reference.feed_forward_torque`, (k, n).

    It is the motor torque of the inverse drive model less what the law `feed_forward` supplies itself: the rigid arm
    and `rotor_inertia` (n,) times the acceleration; give zeros for a law that supplies no rotor torque. The change of
    the joint torque with time is neglected.
    """
    q, v, a = (np.atleast_2d(np.asarray(x, dtype=float)) for x in (position, velocity, acceleration))
    torque = rigid_torque(robot, q, v, a)
    columns = [
        motor_feedforward(drive, q[:, j], v[:, j], a[:, j], torque[:, j]).motor_torque for j, drive in enumerate(drives)
    ]
    return np.asarray(np.stack(columns, axis=1) - torque - np.asarray(rotor_inertia) * a)
