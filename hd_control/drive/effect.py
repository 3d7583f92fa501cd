"""What a physical effect is: parameters, where it acts, and what it adds to the three balances of a joint.

The model of one joint is three balances; every term is written once, as a **column** of the channel it acts on:

    motor_torque    0 = I* phi'' - (u - tau_s) + sum coefficient * column   N m    column: torque that resists the rotor
    transmission    q = phi - tau_s/k + ...    + sum coefficient * column   rad    column: what it adds to the reading q
    link_torque     0 = M q'' + b - tau_s      + sum coefficient * column   N m    column: torque that resists the link

tau_s is what the gauge bridge indicates; docs/equations/joint.md (J6), (J7), (J8). Columns are functions of the drive's
state and of the effect's **shape** (the parameters in which it is not linear); physical coefficients multiply them. So
one file serves evaluation (known values), regression (unknown coefficients, shapes searched) and prediction (state by
state).

What a diagnosis decides about an effect is said by its class too: what a recording must cover before it may be named,
how wrong its law may be, what it is confused with, whether it is tested near reversals. Each has a default.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any, ClassVar

import numpy as np

from hd_control.core.arrays import BoolArray, FloatArray, IntArray
from hd_control.drive.needs import VARIED_LOOPS, Need

Shape = Mapping[str, Any]
"""Values of the parameters in which an effect is not linear, by name; and choices of form."""
Columns = dict[str, FloatArray]
"""Channel -> (n, k): what the k coefficients of the effect multiply. A channel that is not named has zeros."""

MOTOR, TRANSMISSION, LINK = "motor_torque", "transmission", "link_torque"
CHANNELS = (MOTOR, TRANSMISSION, LINK)
GAUGE, JOINT_SENSOR = "gauge_torque", "joint_position"
"""Signals that an effect may only read wrong: it moves nothing."""
UNITS = {MOTOR: "N m", TRANSMISSION: "rad", LINK: "N m"}


@dataclass(frozen=True)
class DriveStates:
    """The state of one joint at n instants: arrays (n,), SI, output side of the gear; NaN where not measured.

    In a regression the instants are the samples of a recording, evenly spaced; in a prediction they are independent
    runs at one time. `joint_torque` is the flexspline torque as well as it is known, `gauge_torque` what the bridge
    indicates (equal if no gauge effect is known). `motor_direction` is the exact sign of the motor velocity, 0 while
    the motor rests or only presliding happens. `torque_scale` is the 98 % quantile of |gauge torque| of the recording.
    `link_inertia_torque` M q'' and `link_bias_torque` (gravity, Coriolis) are the nominal link dynamics of the joint.
    `link_regressor` (n, 10) and `tool_regressor` (n, 10): torque at this joint per inertial parameter (mass, first
    moments, inertia about the joint frame's origin) of a body carried by the own link and by the last link; None
    without a robot description. `spring_torque`: the part of the joint torque that spring and hysteresis carry without
    the damper, None where it is not known apart. `torsional_compliance` 1/k rad/(N m) and `damping_time` d s of spring
    and damper in parallel, 0 where they are not known.
    """

    period: float
    gear_ratio: float
    torque_scale: float
    time: FloatArray
    motor_position: FloatArray
    motor_velocity: FloatArray
    motor_acceleration: FloatArray
    motor_direction: FloatArray
    joint_position: FloatArray
    joint_velocity: FloatArray
    joint_acceleration: FloatArray
    gauge_torque: FloatArray
    joint_torque: FloatArray
    joint_torque_rate: FloatArray
    motor_torque: FloatArray
    temperature: FloatArray
    link_inertia_torque: FloatArray
    link_bias_torque: FloatArray
    link_regressor: FloatArray | None = None
    tool_regressor: FloatArray | None = None
    torsional_compliance: float = 0.0
    damping_time: float = 0.0
    spring_torque: FloatArray | None = None

    @property
    def elastic_torque(self) -> FloatArray:
        """What winds up the spring, N m."""
        return self.joint_torque if self.spring_torque is None else self.spring_torque

    @property
    def motor_shaft_position(self) -> FloatArray:
        """Rotor angle before the gear, rad."""
        return self.gear_ratio * self.motor_position


@dataclass(frozen=True)
class EffectParameter:
    """One parameter: name, unit, meaning, physical bounds; `linear`: it multiplies a column; `by_assembly`: it depends
    on how the joint was put together, so that an interval that covers zero says nothing."""

    name: str
    unit: str
    meaning: str
    low: float = -np.inf
    high: float = np.inf
    linear: bool = True
    default: float | None = None
    by_assembly: bool = False


@dataclass(frozen=True)
class Confusion:
    """Another effect that leaves nearly the same trace, and the experiment that separates the two."""

    effect: str
    experiment: str


@dataclass(frozen=True)
class Reference:
    """A case with a known answer: shape and states in, columns out. For the conformance tests."""

    shape: Shape
    states: Mapping[str, Any]
    columns: Mapping[str, Any]
    tolerance: float = 1e-12


@dataclass(frozen=True)
class Context:
    """What the change between coefficients and physical parameters may need: stiffness N m/rad of the linear spring,
    Coulomb torque N m, and torque scale N m of the recording."""

    torsional_stiffness: float
    coulomb_torque: float
    torque_scale: float
    extra: Mapping[str, float] = field(default_factory=dict)


ROTOR_INERTIA, COULOMB, VISCOUS = "rotor_inertia", "coulomb_torque", "viscous"
STIFFNESS, DAMPING_TIME, ZERO = "torsional_stiffness", "damping_time", "transmission_zero"
LINK_INERTIA = "link_inertia_scale"
BASE_NUMBERS = (ROTOR_INERTIA, COULOMB, VISCOUS, STIFFNESS, DAMPING_TIME, ZERO, LINK_INERTIA)
"""What the balances of every joint hold, by the names that a fit gives them, in the order of its table."""


@dataclass(frozen=True)
class BaseNumber:
    """A parameter of an effect of every model, as a fit has it. `number`: one of `BASE_NUMBERS`; `channel`: the balance
    that fits it; `factor`: what is fitted multiplies the model's value, which is 1 where the model does not name the
    effect; `sure_as`: the parameter whose certainty is the prior of the number, itself if empty."""

    parameter: str
    number: str
    channel: str
    factor: bool = False
    sure_as: str = ""


@dataclass(frozen=True)
class NearReversals:
    """How an effect is tested that acts only near reversals of the motor, in rows that every other fit leaves out.

    `entry`: its one continuous shape entry, a parameter, tried at the values `grid`; `amplitude`: the parameter, N m,
    that is its one coefficient, in the rotor balance. A claim asks for an amplitude within `over_coulomb` (low, high)
    times the Coulomb torque and for at least `share` of the energy of these rows, held out.
    """

    entry: str
    grid: tuple[float, ...]
    amplitude: str
    over_coulomb: tuple[float, float]
    share: float


TORSION_FAMILY = "torsion over torque"
"""Laws of the torsion over the torque of the spring, with a loop or without."""


class Effect(ABC):
    """A physical effect. Subclasses are final, hold no state and define the class variables and class methods below."""

    name: ClassVar[str]
    title: ClassVar[str]
    """For people, in words, lower case: "kinematic error of the gear"."""
    evidence: ClassVar[str]
    """What its residual looks like, as a clause: "repeats twice per wave-generator turn in both directions"."""
    parameters: ClassVar[tuple[EffectParameter, ...]]
    in_every_model: ClassVar[bool] = False
    family: ClassVar[str] = ""
    """Effects of one family draw the same kind of curve: a small one beside a large one is what the law misses."""
    confusions: ClassVar[tuple[Confusion, ...]] = ()
    law_error: ClassVar[float] = 0.003
    """Half-width, relative to the value, of what the law leaves of the world's: where worlds were random and known
    (calibration seeds 100 500 to 100 739), the block bootstrap alone covered too rarely by that much."""
    near_reversals: ClassVar[NearReversals | None] = None
    """Set for an effect that acts only near reversals: it is tested there after the search, which leaves it out."""
    reads: ClassVar[str] = ""
    """`GAUGE` or `JOINT_SENSOR` for an effect of a sensor, that moves nothing: the columns of all balances follow from
    what the signal reads too much, its column of the link balance (gauge) or of the transmission (joint sensor)."""
    shifts_command: ClassVar[str] = ""
    """The parameter, s, by which the balances delay the recorded motor torque before anything is fitted: a fit finds
    what comes on top of the model's value, and the effect stays a candidate."""
    base: ClassVar[tuple[BaseNumber, ...]] = ()
    """For effects of every model: their parameters among what every balance holds."""
    references: ClassVar[tuple[Reference, ...]] = ()
    examples: ClassVar[tuple[Mapping[str, float], ...]] = ()
    """Values of a model file, one set for each form of the effect. For the conformance tests."""

    @classmethod
    @abstractmethod
    def columns(cls, states: DriveStates, shape: Shape) -> Columns:
        """What the effect's coefficients multiply, by channel, at all states, (n, k); memory starts at rest."""

    @classmethod
    @abstractmethod
    def coefficient_names(cls, shape: Shape) -> tuple[str, ...]:
        """Names of the k linear coefficients, in the order of the columns."""

    @classmethod
    def shapes(cls, states: DriveStates) -> Sequence[Shape]:
        """The shapes that a search tries on this recording, coarse first guess of each; never empty."""
        return ({},)

    @classmethod
    def more_shapes(cls, states: DriveStates) -> Sequence[Shape]:
        """Shapes beyond these that only the innovations separate from load and inertia."""
        return ()

    @classmethod
    def shape_bounds(cls, shape: Shape, states: DriveStates) -> dict[str, tuple[float, float]]:
        """Bounds of the continuous entries of a shape for refinement; entries that are choices are left out."""
        return {}

    @classmethod
    def needs(cls) -> tuple[Need, ...]:
        """What a recording must cover before the effect may be named, most important first."""
        return (VARIED_LOOPS,) if cls.family == TORSION_FAMILY else ()

    @classmethod
    def blind(cls, states: DriveStates, shape: Shape) -> dict[str, BoolArray]:
        """Rows (n,) by channel at which the effect acts but its law does not say how; a fit leaves them out."""
        return {}

    @classmethod
    def split(cls, values: Mapping[str, float], context: Context) -> tuple[Shape, FloatArray]:
        """Physical parameter values -> (shape, coefficients (k,))."""
        linear = {parameter.name for parameter in cls.parameters if parameter.linear}
        shape = {name: value for name, value in values.items() if name not in linear}
        return shape, np.array([values.get(name, 0.0) for name in cls.coefficient_names(shape)])

    @classmethod
    def join(cls, shape: Shape, coefficients: FloatArray, context: Context) -> dict[str, float]:
        """(shape, coefficients) -> physical parameter values, those that a model file holds. Inverse of `split`."""
        named = dict(zip(cls.coefficient_names(shape), coefficients.tolist(), strict=True))
        return named | {name: float(value) for name, value in shape.items()}

    @classmethod
    def memory(cls, shape: Shape, runs: int) -> FloatArray:
        """Initial memory (m, runs) of a prediction; (0, runs) for an effect without memory."""
        return np.zeros((0, runs))

    @classmethod
    def memory_along(cls, states: DriveStates, shape: Shape, rows: IntArray) -> FloatArray:
        """Memory (m, runs) of predictions that start at these rows of a recording: what lies before is replayed."""
        return cls.memory(shape, rows.size)

    @classmethod
    def advance(cls, states: DriveStates, shape: Shape, memory: FloatArray) -> tuple[Columns, FloatArray]:
        """One step of `states.period` of a prediction: the columns at the states and the new memory."""
        return cls.columns(states, shape), memory
