"""States of a drive for tests: at rest, and along a smooth trajectory with every signal alive."""

from __future__ import annotations

from typing import Any

import numpy as np

from hd_control.drive.effect import Context, DriveStates

CONTEXT = Context(torsional_stiffness=3e5, coulomb_torque=24.0, torque_scale=150.0)


def states_of(**fields: Any) -> DriveStates:
    """States that are zero but for the given fields; (n,) by the longest of them, numbers are repeated."""
    numbers = {"period": 1e-3, "gear_ratio": 1.0, "torque_scale": 1.0, "torsional_compliance": 0.0}
    given = {name: np.asarray(value, dtype=float) for name, value in fields.items() if name not in numbers}
    size = max((len(np.atleast_1d(value)) for value in given.values()), default=1)
    apart = ("_regressor", "spring_torque")
    names = [n for n in DriveStates.__dataclass_fields__ if n not in numbers and not n.endswith(apart)]
    arrays = {name: np.zeros(size) for name in names}
    for name, value in given.items():
        arrays[name] = (
            value.reshape(size, -1) if name.endswith("_regressor") else np.broadcast_to(value, (size,)).copy()
        )
    return DriveStates(**{**numbers, **{k: v for k, v in fields.items() if k in numbers}}, **arrays)


def moving(n: int = 4000, seed: int = 3) -> DriveStates:
    """A smooth trajectory with reversals of speed and torque, all signals consistent with a drive of joint 3."""
    period, stiffness = 1e-3, 2.9e5
    t = period * np.arange(n)
    q = 0.5 * np.sin(2.0 * np.pi * 0.4 * t) + 0.08 * np.sin(2.0 * np.pi * 1.7 * t + 1.0)
    v = np.gradient(q, period)
    a = np.gradient(v, period)
    torque = 120.0 * np.sin(q) + 40.0 * a
    rng = np.random.default_rng(seed)
    phi = q + torque / stiffness
    rate = np.gradient(phi, period)
    regressor = np.stack([np.cos(k * q) + 0.1 * k * a for k in range(10)], axis=1)
    return DriveStates(
        period=period, gear_ratio=120.0, torque_scale=float(np.quantile(np.abs(torque), 0.98)), time=t,
        motor_position=phi, motor_velocity=rate, motor_acceleration=np.gradient(rate, period),
        motor_direction=np.sign(rate), joint_position=q, joint_velocity=v, joint_acceleration=a, gauge_torque=torque,
        joint_torque=torque, joint_torque_rate=np.gradient(torque, period),
        motor_torque=torque + 28.0 * a + 24.0 * np.sign(rate) + rng.normal(size=n),
        temperature=25.0 + 10.0 * t / t[-1], link_inertia_torque=40.0 * a, link_bias_torque=120.0 * np.sin(q),
        link_regressor=regressor, tool_regressor=regressor[:, ::-1].copy(), torsional_compliance=1.0 / stiffness,
    )  # fmt: skip
