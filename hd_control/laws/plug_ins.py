"""Torque laws of other installed packages, for experiments: one class in Python, named in entry-point group `GROUP`.

Such a law takes the interpreter lock in each tick, so its node is not real time; in lock-step that costs time and
nothing else. Monitors, guard and gate stay in front of the drives whatever the law does.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from hd_control.core.arrays import FloatArray
from hd_control.core.blocks import Block
from hd_control.core.errors import ConfigError

GROUP = "hd_control.laws"


class PythonLaw(ABC):
    """A torque law of some joints. It may keep a state of its own; `start` begins a new activation."""

    def __init__(self, joint_names: Sequence[str], period: float) -> None:
        """`period` s is the time of one tick."""
        self.joint_names, self.period = tuple(joint_names), period

    def start(self) -> None:  # noqa: B027 - a law without a state needs none
        """Forgets what the law remembers."""

    @abstractmethod
    def step(self, sample: Block, reference: Block) -> ArrayLike:
        """The motor torque (n,) N m, output side, of one tick.

        `sample` has joint_position, joint_velocity, joint_torque, motor_position, motor_velocity, motor_torque;
        `reference` joint_torque_required, desired_position, desired_velocity: each (n,), rad, rad/s, N m. Both are
        copies. What is no finite number, has another length, or raises becomes a stop of the guard.
        """


def law_named(name: str, joint_names: Sequence[str], period: float) -> PythonLaw:
    """The law of that entry point. Raises ConfigError if there is none, or it is no `PythonLaw`."""
    from importlib.metadata import entry_points

    points = {point.name: point for point in entry_points(group=GROUP)}
    if name not in points:
        known = ", ".join(sorted(points)) or "none"
        raise ConfigError(f"plug_in: no installed package has a law {name!r} in group {GROUP}; there is {known}")
    try:
        kind: Any = points[name].load()
        law = kind(joint_names, period)
    except Exception as error:  # another package may fail in any way
        raise ConfigError(f"plug_in: {points[name].value} cannot be made: {type(error).__name__}: {error}") from error
    if not isinstance(law, PythonLaw):
        raise ConfigError(f"plug_in: {points[name].value} is no hd_control.laws.plug_ins.PythonLaw")
    return law


def command_of(law: PythonLaw, sample: Block, reference: Block) -> FloatArray:
    """What the law answers to copies of these blocks, (n,) N m. Raises what the law raises, ValueError for a length."""
    given = law.step(Block(sample.layout, sample.array.copy()), Block(reference.layout, reference.array.copy()))
    torque = np.ascontiguousarray(given, dtype=float)
    if torque.shape != (len(law.joint_names),):
        raise ValueError(f"the law gave {torque.shape}, expected ({len(law.joint_names)},): one torque for each joint")
    return torque
