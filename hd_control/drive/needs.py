"""What a recording must cover before an effect may be named, and the experiment that covers it.

On a poor recording a name is a guess that held-out blocks of the same recording do not refute. So every effect says
what it needs (`Effect.needs`); needs that several effects share stand here, the others in the file of their effect.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

RAMPS = "slow torque ramps through zero to +-50 % of the rated torque, under gravity or against a locked output"
LOAD_SHARE = 0.1
"""Span of the joint torque over the rated torque that claims of the torsion's shape need."""
SAME_LOOP = 0.62
"""Autocorrelation of the speed from which on the torque runs through the same few loops (general motion: 0.57)."""
SPEED_VARIETY = 6.0
"""Effective number of quarter decades of speed from which on motion counts as varied although it repeats."""


@dataclass(frozen=True)
class Covered:
    """What the motion of one joint covers in a recording.

    `torque_low`, `torque_high` N m: 2 % and 98 % quantiles of the joint torque; `rated_torque` N m of the gear, None
    where it is not known. `joint_range` rad, `motor_turns` turns of the rotor, `temperature_span` K, 0 where it is not
    measured. `repetition`: largest autocorrelation of the speed beyond 1 s; `speed_variety`: effective number of
    quarter decades of speed; `speed_decades` between its 5 % and its 99 % quantile.
    """

    torque_low: float
    torque_high: float
    rated_torque: float | None
    joint_range: float
    motor_turns: float
    temperature_span: float
    repetition: float
    speed_variety: float
    speed_decades: float


@dataclass(frozen=True)
class Need:
    """A condition on what a recording covers. `unmet`: what is missing, one clause; empty where the need is met.
    `purpose` and `how`: what the experiment decides, and what to record."""

    unmet: Callable[[Covered], str]
    purpose: str
    how: str


def _too_little_load(c: Covered) -> str:
    if c.rated_torque is None or not c.torque_high - c.torque_low < LOAD_SHARE * c.rated_torque:
        return ""
    return f"joint torque from {c.torque_low:.3g} to {c.torque_high:.3g} N m only"


def _same_loops(c: Covered) -> str:
    same = c.repetition > SAME_LOOP and c.speed_variety < SPEED_VARIETY
    return "the torque runs through the same few loops again and again" if same else ""


TORSION = "stiffness, lost motion and hysteresis"
LOADED = Need(_too_little_load, TORSION, RAMPS)
"""A joint torque over a good part of the rated one."""
VARIED_LOOPS = Need(_same_loops, TORSION, RAMPS)
"""A torque that turns back at many values: what every law of the torsion over the torque needs."""
BOTH_SIGNS = Need(
    lambda c: "" if c.torque_low < 0.0 < c.torque_high else "the joint torque does not change its sign",
    "stiffness shape against hysteresis",
    "slow torque ramps through zero to +-50 % of the rated torque, three amplitudes",
)
"""A joint torque of both signs."""
WHOLE_TURN = Need(
    lambda c: f"the motor turns {c.motor_turns:.2f} times only" if c.motor_turns < 1.0 else "",
    "effects of the motor angle",
    "a slow move over 20 or more motor turns, both directions",
)
"""A whole turn of the motor."""


SPEED_DECADES = 1.3
"""Decades of speed that the shape of friction over speed needs."""
SPEEDS = Need(
    lambda c: (
        f"speeds over {c.speed_decades:.2f} decades only ({SPEED_DECADES:g} needed)"
        if c.speed_decades < SPEED_DECADES
        else ""
    ),
    "the shape of friction over speed",
    "constant speeds or a triangular velocity in both directions, log-spaced from 0.03 to 1 rad/s, at least 25 s",
)
