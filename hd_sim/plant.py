"""The plant: drives, arm and sensors of one robot, advanced tick by tick. Deterministic: same inputs, same bits.

One tick of a loop:

    plant.latch(command)      # the command of the previous tick: it acts over [t_k, t_k + period)
    sample = plant.sample()   # sensors at t_k; motor_torque_applied is the torque that acts over [t_k, t_k + period)
    command = law(sample)
    plant.advance()
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from functools import lru_cache
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from hd_control.core.arrays import FloatArray
from hd_control.core.blocks import Block, layout_of
from hd_control.core.errors import RobotError
from hd_control.core.robot import Robot
from hd_sim import _plant
from hd_sim.plant_config import PlantConfig
from hd_sim.sensors import noise_key


@dataclass(frozen=True)
class PlantRecord:
    """Columns of a run: name to (ticks, n). `truth` is empty unless asked for; no analysis may read it."""

    samples: Mapping[str, FloatArray]
    truth: Mapping[str, FloatArray]


class Plant:
    """A simulated arm with harmonic drives, at rest at the start position and carrying its weight."""

    def __init__(self, config: PlantConfig, seed: int = 0, accounts: bool = False) -> None:
        """`seed` feeds the sensor noise only. `accounts` keeps the work accounts of the state (a little slower)."""
        _check_arm(config.robot)
        self.config, self.seed, self.joints = config, seed, config.joints
        self._accounts = accounts
        self._layouts = {name: layout_of(name, fields, config.joints) for name, fields in _plant.BLOCKS.items()}
        self._kernel = make_kernel(config, seed, accounts)
        self._kernel.start(config.start_position, self.gravity_torque(config.start_position), False)

    @property
    def tick(self) -> int:
        """Ticks since the start."""
        return int(self.state.tick)

    @property
    def time(self) -> float:
        """Seconds since the start."""
        return self.tick * self.config.period

    def latch(self, command: ArrayLike) -> None:
        """Sets the motor torque (n,) N m for the coming tick, clipped to the limit; what is no number counts as 0."""
        self._kernel.latch(command)

    def advance(self) -> None:
        """Advances one tick with the latched command (the last one is held)."""
        self._kernel.advance()

    def step(self, command: ArrayLike) -> None:
        """`latch` and `advance` in one call."""
        self._kernel.step(command)

    def sample(self) -> Block:
        """Sensor readings now: motor_shaft_position rad at the rotor, joint_position rad, gauge_torque and
        motor_torque_applied N m, motor_temperature degC; each (n,)."""
        return Block(self._layouts["PlantSample"], self._kernel.sample())

    def brake(self, engage: bool) -> None:
        """Requests the brakes of all joints (they hold after their closing time) or opens them at once."""
        self._kernel.brake(engage)

    def external_torque(self, joint: ArrayLike | None = None, motor: ArrayLike | None = None) -> None:
        """Torques from outside, (n,) N m, on the links and on the rotors (output side), until the next call."""
        zeros = np.zeros(self.joints)
        self._kernel.external(zeros if joint is None else joint, zeros if motor is None else motor)

    def step_many(self, commands: ArrayLike, samples: bool = True, truth: bool = False) -> PlantRecord:
        """One tick per row of `commands` (ticks, n); readings of row k are taken as in `latch, sample, advance`."""
        seen, real = self._kernel.step_many(commands, samples, truth)
        return PlantRecord(self._columns("PlantSample", seen), self._columns("PlantTruth", real))

    def world(self) -> Any:
        """The compiled world for a drive side in front of it, as a capsule; this plant must outlive it."""
        return self._kernel.world()

    @property
    def state(self) -> Block:
        """A copy of the complete state. `restore` of it continues the run bit for bit."""
        return Block(self._layouts["PlantState"], self._kernel.state())

    def restore(self, state: Block | FloatArray) -> None:
        """Sets the complete state, from `state` of a plant with the same number of joints."""
        self._kernel.restore(state.array if isinstance(state, Block) else state)

    def gravity_torque(self, joint_position: ArrayLike) -> FloatArray:
        """Torque (n,) N m that holds the links, payload included, at rest."""
        zeros = np.zeros(self.joints)
        bias: FloatArray = self._kernel.accelerate(joint_position, zeros, zeros, zeros)[2]
        return bias

    def true_state(self) -> Block:
        """What no sensor shows: angles, rates, torques, friction. For checks of the simulation only."""
        return Block(self._layouts["PlantTruth"], self._kernel.truth())

    @property
    def true_joint_position(self) -> FloatArray:
        """Exact joint angles (n,) rad. For checks of the simulation only."""
        return self.state.joint_position

    @property
    def true_joint_velocity(self) -> FloatArray:
        """Exact joint rates (n,) rad/s. For checks of the simulation only."""
        return self.state.joint_velocity

    def _columns(self, name: str, rows: FloatArray) -> dict[str, FloatArray]:
        return {field: rows[:, part] for field, part in self._layouts[name].slices.items()} if len(rows) else {}


def make_kernel(config: PlantConfig, seed: int = 0, accounts: bool = False) -> _plant.Kernel:
    """The compiled kernel of a configuration, not yet started."""
    return _plant.Kernel(
        joints=config.joints,
        parameters=config.parameters().array,
        dt=config.period / config.substeps,
        substeps=config.substeps,
        reported_delay=config.extra_delay_samples,
        first_order=config.scheme == "first_order",
        accounts=accounts,
        keys=[noise_key(seed, stream) for stream in _plant.NOISE_STREAMS],
    )


@lru_cache(maxsize=64)
def _verified(urdf: str) -> float:
    """Largest relative difference between the kernel's link accelerations and Pinocchio's, at one random state."""
    import pinocchio

    robot = Robot.from_urdf(urdf)
    n = robot.joints
    layout = layout_of("PlantParameters", _plant.BLOCKS["PlantParameters"], n)
    block = layout.zeros()
    block.link_rotation, block.link_origin = robot.rotation.reshape(-1, 9), robot.origin
    block.link_mass, block.link_center, block.link_inertia = (
        robot.mass,
        robot.center_of_mass,
        robot.inertia.reshape(-1, 9),
    )
    kernel = _plant.Kernel(n, block.array, 1e-3, 1, 0, False, False, [0] * len(_plant.NOISE_STREAMS))
    position, velocity, torque = np.random.default_rng(7).uniform(-1.0, 1.0, (3, n))
    armature = np.full(n, 0.1)
    model = robot.pinocchio_model()
    model.armature = armature
    expected = pinocchio.aba(model, model.createData(), position, velocity, torque)
    found = kernel.accelerate(position, velocity, torque, armature)[0]
    return float(np.max(np.abs(found - expected)) / np.max(np.abs(expected)))


def _check_arm(robot: Robot) -> None:
    difference = _verified(robot.urdf)
    if not difference < 1e-10:
        raise RobotError(f"{robot.name}: link dynamics differ from Pinocchio by {difference:.1e}; is gravity along -z?")
