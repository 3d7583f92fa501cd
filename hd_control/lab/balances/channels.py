"""The balances of one joint as data: channels with their rows, free columns of every model, what is known before."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, replace

import numpy as np

from hd_control.core.arrays import BoolArray, FloatArray
from hd_control.drive.effect import LINK, MOTOR, TRANSMISSION, Columns, DriveStates
from hd_control.lab.balances.states import Derived
from hd_control.lab.signals.filters import Band, Spectral

LinkTerms = tuple[FloatArray, FloatArray, FloatArray | None, FloatArray | None]
"""Nominal M q'' and bias (rows,), own-link and tool regressors (rows, 10) or None, at the rows of the link channel."""
LinkFunction = Callable[[Band, Spectral], LinkTerms]


@dataclass(frozen=True)
class Base:
    """A free column that every model has. `prior` is the standard deviation of its coefficient around zero; columns of
    several channels that are `shared` under one name have one coefficient."""

    name: str
    column: FloatArray
    prior: float = np.inf
    shared: bool = False
    owner: str = ""


@dataclass(frozen=True)
class Channel:
    """One balance on its decimated rows: `left` (rows,) = base columns and effects; unit of the channel.

    Transmission only: `damping_time` s of the spring, around which the torsion is linear; `compliance` rad/(N m), a
    first guess, 0 where it is no spring.
    `noisy` (rows,): rows that are not fitted, for a tone of the encoder's counts falls into the band there.
    `scale`: index of the base column whose coefficient (negated) is a or b; None where the torque stands on the left.
    """

    name: str
    band: Band
    spectral: Spectral
    time: FloatArray
    valid: BoolArray
    left: FloatArray
    base: tuple[Base, ...]
    scale: int | None
    snr: float
    damping_time: float = 0.0
    noisy: BoolArray | None = None
    compliance: float = 0.0

    @property
    def fitted(self) -> BoolArray:
        """Rows (rows,) that are valid and not noisy."""
        return self.valid if self.noisy is None else np.asarray(self.valid & ~self.noisy)

    def blurred(self, rows: BoolArray) -> BoolArray:
        """Rows (rows,) of the channel that see any of the given samples (n,) of the recording through its filter."""
        margin = round(self.band.support_s / self.spectral.period)
        count = np.concatenate([[0], np.cumsum(rows)])
        index = np.arange(0, rows.size, self.band.step)
        low, high = np.maximum(index - margin, 0), np.minimum(index + margin + 1, rows.size)
        return np.asarray(count[high] > count[low])

    def rows_of(self, columns: FloatArray) -> FloatArray:
        """Columns (n, k) at the rate of the recording -> (rows, k), filtered as the left side is."""
        return self.spectral.filter_columns(columns, self.band)

    @property
    def base_matrix(self) -> FloatArray:
        """(rows, number of base columns)."""
        return np.column_stack([base.column for base in self.base])


@dataclass(frozen=True)
class JointEquations:
    """All balances that one joint's signals allow. `inertia`: the rotor inertia I0 that scales the motor balance.

    `substituted`: signals that the model stands in for. `too_short`: channels left out for want of rows in motion.
    """

    joint: str
    states: DriveStates
    derived: Derived
    spectral: Spectral
    channels: Mapping[str, Channel]
    inertia: float
    link_scale: float = 1.0
    substituted: tuple[str, ...] = field(default=())
    too_short: tuple[str, ...] = field(default=())

    @property
    def damping_time(self) -> float:
        """Of the spring around which the torsion is linear, s."""
        return self.channels[TRANSMISSION].damping_time

    def offset(self, channel: str, name: str) -> float:
        """What is added to a base coefficient: 0, it is the value itself."""
        return 0.0

    def rows_of(self, columns: Columns, reads: str = "") -> dict[str, FloatArray]:
        """Columns (n, k) of an effect at the rate of the recording -> (rows, k) by channel, filtered as the left."""
        return {name: self.channels[name].rows_of(c) for name, c in columns.items() if name in self.channels}

    def with_scales(self, scales: Mapping[str, float]) -> JointEquations:
        """The same equations with left sides divided by the estimated a and b, so that the next estimate is near 1."""
        channels = {
            name: replace(channel, left=channel.left / scales.get(name, 1.0)) for name, channel in self.channels.items()
        }
        return replace(
            self,
            channels=channels,
            inertia=self.inertia / scales.get(MOTOR, 1.0),
            link_scale=self.link_scale / scales.get(LINK, 1.0),
        )


@dataclass(frozen=True)
class Known:
    """What the model says of one joint before anything is fitted; prior standard deviations relative to the value."""

    gear_ratio: float
    rotor_inertia: float
    rotor_inertia_prior: float = 0.1
    link_inertia_prior: float = 0.1
    command_delay: float = 0.0
    damping_time: float = 0.0


SCALES = {"rad": (1e6, "µrad"), "N m": (1.0, "N m"), "N*m": (1.0, "N m")}
"""Unit of a channel -> factor and unit of its pictures."""


def shown_unit(unit: str) -> tuple[float, str]:
    """Factor and name of the unit in which a channel is drawn."""
    return SCALES.get(unit, (1.0, unit))
