"""Peers of the compiled plant for `hd bench`: each returns a callable that advances one simulated millisecond.

They are the same arm at the same substep, not the same physics in every detail; the docstrings say what each one does.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from typing import Any

import numpy as np

from hd_control.core.errors import ConfigError
from hd_sim.plant import Plant
from hd_sim.plant_config import PlantConfig
from hd_sim.slow_plant import SlowPlant

Advance = Callable[[], None]


def _moving_torque(config: PlantConfig) -> Callable[[int], Any]:
    """Motor torques that keep all joints moving and reversing: gravity plus 6 times Coulomb friction, 1 Hz, phased."""
    gravity = Plant(config).gravity_torque(config.start_position)
    size, phase = 6.0 * config.drives["coulomb_torque"], np.arange(config.joints)
    return lambda tick: gravity + size * np.sin(2.0 * np.pi * 1e-3 * tick + phase)


def _every_millisecond(config: PlantConfig, step: Callable[[Any], None]) -> Advance:
    torque, ticks = _moving_torque(config), [0]
    table = [torque(k) for k in range(1000)]

    def advance() -> None:
        step(table[ticks[0] % 1000])
        ticks[0] += 1

    return advance


def compiled_plant(config: PlantConfig, substeps_per_ms: int) -> Advance:
    """The kernel of this project, driven through `Plant.step`."""
    config = replace(config, period=1e-3, substeps_per_ms=substeps_per_ms)
    return _every_millisecond(config, Plant(config).step)


def numpy_peer(config: PlantConfig, substeps_per_ms: int) -> Advance:
    """The same scheme in numpy with Pinocchio's forward dynamics (`hd_sim.slow_plant`); basic drive, no sensors."""
    config = replace(config, period=1e-3, substeps_per_ms=substeps_per_ms)
    plant, start = SlowPlant(config), Plant(config).state
    plant.set_state(**{name: getattr(start, name) for name in plant.s})
    return _every_millisecond(config, plant.step)


def mujoco_peer(config: PlantConfig, substeps_per_ms: int) -> Advance:
    """MuJoCo with two hinges per joint: a rotor (armature, friction loss, damping) and the link on a linear spring.

    Kinematic error, hysteresis, nonlinear stiffness, load and Stribeck friction are left out; implicit-fast integrator,
    contacts off, friction loss through MuJoCo's constraint solver. Raises ConfigError if `mujoco` is not installed.
    """
    try:
        import mujoco
    except ImportError:
        raise ConfigError("the mujoco package is not installed; pip install mujoco") from None
    model = mujoco.MjModel.from_xml_string(arm_as_mjcf(config, 1e-3 / substeps_per_ms))
    data = mujoco.MjData(model)
    data.qpos[::2] = config.start_position

    def step(torque: Any) -> None:
        data.ctrl[:] = torque
        mujoco.mj_step(model, data, nstep=substeps_per_ms)

    return _every_millisecond(config, step)


def _text(values: Any) -> str:
    return " ".join(f"{float(value):.17g}" for value in np.ravel(values))


def arm_as_mjcf(config: PlantConfig, timestep: float) -> str:
    """The arm as MJCF: body j carries the hinges `motor` (rotor) and `link` (torsion of the flexspline)."""
    robot, p = config.robot, config.drives
    opening, closing, actuators = "", "", ""
    for j in range(robot.joints):
        r = robot.rotation[j]
        inertia = robot.inertia[j][[0, 1, 2, 0, 0, 1], [0, 1, 2, 1, 2, 2]]
        opening += (
            f'<body pos="{_text(robot.origin[j])}" xyaxes="{_text(r[:, 0])} {_text(r[:, 1])}">'
            f'<inertial pos="{_text(robot.center_of_mass[j])}" mass="{_text(robot.mass[j])}" '
            f'fullinertia="{_text(inertia)}"/>'
            f'<joint name="motor_{j}" type="hinge" axis="0 0 1" armature="{_text(p["rotor_inertia"][j])}" '
            f'frictionloss="{_text(p["coulomb_torque"][j])}" damping="{_text(p["viscous_positive"][j])}"/>'
            f'<joint name="link_{j}" type="hinge" axis="0 0 1" stiffness="{_text(p["stiffness_linear"][j])}" '
            f'damping="{_text(p["torsional_damping"][j])}"/>'
        )
        closing += "</body>"
        actuators += f'<motor joint="motor_{j}"/>'
    return (
        f'<mujoco><compiler angle="radian"/><option timestep="{timestep:.17g}" integrator="implicitfast" '
        'gravity="0 0 -9.81"><flag contact="disable"/></option>'
        f"<worldbody>{opening}{closing}</worldbody><actuator>{actuators}</actuator></mujoco>"
    )
