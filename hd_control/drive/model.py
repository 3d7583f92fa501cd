"""The model of a robot: per joint a list of effects with parameter values, and where every value comes from.

model = load_model("arm_a.yaml")                  # drive/model_file.py, schema hd.model/1
joint = model.joints["joint_1"]
joint.effects["coulomb_friction"]["coulomb_torque"].value
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from hd_control.core.arrays import FloatArray
from hd_control.core.errors import ConfigError
from hd_control.drive.effect import Context, Effect, Shape

if TYPE_CHECKING:
    from hd_control.core.robot import Robot
    from hd_control.drive.expression import Expression

SOURCES = ("datasheet", "measured", "fitted", "guess")


@dataclass(frozen=True)
class ModelValue:
    """One parameter value. `unit` SI text of the effect's parameter; `low`, `high`: what is allowed; `source`: one of
    `SOURCES` or empty; `interval`: 95 % interval of a measured or fitted value."""

    value: float
    unit: str = ""
    low: float = -np.inf
    high: float = np.inf
    source: str = ""
    interval: tuple[float, float] | None = None


@dataclass(frozen=True)
class JointModel:
    """One joint: effects by name, each with its values by parameter, in the order of the file.

    `expressions` define the effects of this joint that a formula or a table gives; their values are in `effects` too.
    """

    gear_ratio: float
    rated_torque: float | None = None
    effects: Mapping[str, Mapping[str, ModelValue]] = field(default_factory=dict)
    expressions: Mapping[str, Expression] = field(default_factory=dict)

    def numbers(self, effect: str) -> dict[str, float]:
        """Values of an effect by parameter; empty if the joint does not have it."""
        return {name: value.value for name, value in self.effects.get(effect, {}).items()}

    def number(self, effect: str, parameter: str, default: float = 0.0) -> float:
        """One value, `default` if the joint does not have it."""
        return self.numbers(effect).get(parameter, default)

    def effect_classes(self) -> dict[str, type[Effect]]:
        """The class of every effect of this joint, expressions included. Raises ConfigError for an unknown name."""
        from hd_control.drive.library import effect_named

        own = {name: expression.effect() for name, expression in self.expressions.items()}
        return {name: own[name] if name in own else effect_named(name) for name in self.effects}

    def context(self, torque_scale: float = 1.0) -> Context:
        """What the change between parameters and coefficients needs."""
        stiffness = self.number("torsional_stiffness", "torsional_stiffness", np.inf)
        return Context(stiffness, self.number("coulomb_friction", "coulomb_torque"), torque_scale)

    def terms(self, torque_scale: float = 1.0) -> list[tuple[type[Effect], Shape, FloatArray]]:
        """Class, shape and coefficients of every effect, in the order of the model."""
        context = self.context(torque_scale)
        return [(effect, *effect.split(self.numbers(name), context)) for name, effect in self.effect_classes().items()]

    def with_effect(
        self, name: str, values: Mapping[str, ModelValue], expression: Expression | None = None
    ) -> JointModel:
        """A copy with one effect added or replaced."""
        expressions = {**self.expressions, name: expression} if expression is not None else self.expressions
        return replace(self, effects={**self.effects, name: dict(values)}, expressions=expressions)


@dataclass(frozen=True)
class Model:
    """A robot's model. `robot`: a URDF file (relative to `folder`), a shipped robot's name, URDF text, or None.

    `provenance`: the steps that made the file, oldest first, each with `command`, `program` and `bags` (`path`,
    `sha256`). `folder`: where the file lies.
    """

    robot: str | None
    joints: Mapping[str, JointModel]
    provenance: Sequence[Mapping[str, Any]] = ()
    folder: Path | None = field(default=None, compare=False)

    def joint(self, name: str) -> JointModel:
        """One joint. Raises ConfigError with the names that there are."""
        if name not in self.joints:
            raise ConfigError(f"the model has no joint {name!r}; it has {', '.join(self.joints)}")
        return self.joints[name]

    def with_effect(
        self, joint: str, name: str, values: Mapping[str, ModelValue], expression: Expression | None = None
    ) -> Model:
        """A copy in which one joint has an effect added or replaced. Raises ConfigError for an unknown joint."""
        changed = self.joint(joint).with_effect(name, values, expression)
        return replace(self, joints={**self.joints, joint: changed})

    def robot_description(self) -> Robot | None:
        """The robot, None if the model names none. Raises RobotError or ConfigError."""
        from hd_control.core.robot import Robot

        if self.robot is None:
            return None
        if is_urdf_text(self.robot):
            return Robot.from_urdf(self.robot)
        beside = (self.folder or Path()) / self.robot
        return Robot.from_file(str(beside) if beside.is_file() else self.robot)


def is_urdf_text(robot: str) -> bool:
    """Is it the description itself, not the name of a file?"""
    return robot.lstrip().startswith("<")


def model_from_urdf(
    robot: str, gear_ratios: Mapping[str, float] | float, rated_torques: Mapping[str, float] | float | None = None
) -> Model:
    """A first model from a robot description (file, shipped name or text): its joints with link dynamics only.

    Ratios and rated torques N m: one for all joints, or by joint name; joints without a ratio are left out. (The effort
    limit of a description is the largest torque, not the rated one.) Raises RobotError or ConfigError.
    """
    description = Model(robot, {}).robot_description()
    assert description is not None

    def of(given: Mapping[str, float] | float | None, name: str) -> float | None:
        value = given.get(name) if isinstance(given, Mapping) else given
        return None if value is None else float(value)

    ratios = {name: ratio for name in description.joint_names if (ratio := of(gear_ratios, name)) is not None}
    return Model(
        robot, {name: JointModel(r, of(rated_torques, name), {"link_dynamics": {}}) for name, r in ratios.items()}
    )
