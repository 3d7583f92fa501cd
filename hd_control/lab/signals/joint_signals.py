"""What the analysis reads of a recording: one joint's aligned columns, and the joints of a recording together.

Long recordings are read at a lower rate, so that an hour costs no more memory than a fraction of it.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from functools import lru_cache

import numpy as np

from hd_control.core.arrays import BoolArray, FloatArray

# ---- The lower rate --------------------------------------------------------------------------------
#
# Only odd factors: the middle of a block of held values is then a sample, and the held value of the block
#
#     U(f) = H(f) u(f),   H = sinc(f T) / sinc(f D T) in the pass band
#
# acts, held over D T, exactly as the fast values did over T each.


LONGEST_ROWS = 1_200_000
"""20 min at 1 kHz; longer recordings are decimated."""
HALF_WIDTH = 12
"""Half length of the filter in samples of the lower rate."""
PASS, STOP = 0.8, 1.1
"""Edges of the filter in units of the new Nyquist frequency; what folds back stays above the pass band."""


def factor_of(rows: int, longest: int = LONGEST_ROWS) -> int:
    """The smallest odd factor that brings `rows` below `longest`."""
    factor = max(1, -(-rows // longest))
    return factor if factor % 2 else factor + 1


@lru_cache(maxsize=8)
def _taps(factor: int, held: bool) -> FloatArray:
    from scipy.signal import firwin2

    nyquist = np.linspace(0.0, 1.0, 513)
    gain = np.interp(nyquist * factor, [PASS, STOP], [1.0, 0.0])
    if held:
        gain *= np.sinc(nyquist / 2.0) / np.maximum(0.1, np.sinc(nyquist * factor / 2.0))
    taps: FloatArray = firwin2(2 * HALF_WIDTH * factor + 1, nyquist, gain)
    taps /= taps.sum()
    return taps


def decimate(values: FloatArray, factor: int, held: bool) -> FloatArray:
    """(n,) -> (n // factor,) at every `factor`-th sample; NaN where the filter would touch a NaN."""
    from scipy.signal import upfirdn

    count = values.size // factor
    taps = _taps(factor, held)
    half = taps.size // 2
    bad = ~np.isfinite(values)
    filled = np.where(bad, 0.0, values)
    if bad.any() and not bad.all():
        index = np.arange(values.size)
        filled = np.interp(index, index[~bad], values[~bad])
    # Odd reflection at both ends; output i has the filter's middle on sample factor * i, or on the middle of its block.
    head, tail = 2.0 * filled[0] - filled[half:0:-1], 2.0 * filled[-1] - filled[-2 : -half - 2 : -1]
    long = np.concatenate([head, filled, tail])[factor // 2 if held else 0 :]
    low: FloatArray = upfirdn(taps, long, 1, factor)[2 * HALF_WIDTH :][:count].copy()
    spoiled = np.add.reduceat(bad, np.arange(0, count * factor, factor)) > 0
    low[np.convolve(spoiled, np.ones(2 * HALF_WIDTH + 1), "same")[:count] > 0.0] = np.nan
    return low


# ---- The columns -----------------------------------------------------------------------------------


SIGNALS = (
    "motor_shaft_position",
    "joint_position",
    "gauge_torque",
    "motor_torque",
    "temperature",
    "reference_position",
)
"""Columns that a joint may have. The first four decide which residual channels exist."""


@dataclass(frozen=True)
class Grain:
    """How finely a column was recorded: `step` of its counts (0 if none is seen), share of samples that repeat the one
    before while the signal moves, and whether each value is a mean of samples at both ends of its tick."""

    step: float = 0.0
    repeated: float = 0.0
    averaged: bool = False


GRAIN_ROWS = 100_000
"""Samples in the middle of a column that are looked at for its counts."""
MOVES, MOVES_OVER = 16.0, 4
"""Steps over so many samples on each side from which on a signal moves: then counts do not repeat by chance."""


def quantum(signal: FloatArray) -> float:
    """The count of a quantised signal; 0 if its smallest steps are no counts."""
    steps = np.abs(np.diff(signal))
    steps = steps[steps > 1e-12 * max(1.0, float(np.max(np.abs(signal), initial=0.0)))]
    if steps.size == 0:
        return 0.0
    for small in (float(steps.min()), float(np.quantile(steps, 0.01))):
        whole = steps[:2000] / small
        if float(np.mean(np.abs(whole - np.round(whole)) < 0.05)) > 0.9:
            return small
    return 0.0


def grain_of(column: FloatArray, averaged: bool = False) -> Grain:
    """The grain of a column (n,) as it was recorded, before anything is interpolated."""
    first = max(0, (column.size - GRAIN_ROWS) // 2)
    values = column[first : first + GRAIN_ROWS]
    values = values[np.isfinite(values)]
    if values.size < 4 * MOVES_OVER:
        return Grain(averaged=averaged)
    step, equal = quantum(values), np.diff(values) == 0.0
    travel = np.abs(values[2 * MOVES_OVER :] - values[: -2 * MOVES_OVER])
    moving = travel > max(MOVES * step, 1e-12 * float(np.ptp(values)))
    repeated = equal[MOVES_OVER:-MOVES_OVER][: moving.size][moving[: equal.size - 2 * MOVES_OVER]]
    return Grain(step, float(repeated.mean()) if repeated.size else 0.0, averaged)


@dataclass(frozen=True)
class JointSignals:
    """One joint on an even time base; every column is (n,) float64, NaN where it is missing, or None if not recorded.

    `time` s from the start, `period` s; `valid` (n,) is False inside gaps. `motor_shaft_position` rad before the gear,
    `joint_position` rad, `gauge_torque` N m as the bridge indicates it, `motor_torque` N m times the gear ratio, held
    from its stamp to the next (its true value if the drive reports it, else the command), `temperature` deg C,
    `reference_position` rad.
    `sources`: column -> the topic it came from. `period_command_delay`: samples between the stamp of `motor_torque` and
    the moment it acts that the reader has not taken out, as far as the recording says. `notes`: what was repaired or
    looks wrong, one sentence each. `grains`: column -> how finely it was recorded, where the reader knows it.
    """

    joint: str
    time: FloatArray
    period: float
    valid: BoolArray
    motor_shaft_position: FloatArray | None = None
    joint_position: FloatArray | None = None
    gauge_torque: FloatArray | None = None
    motor_torque: FloatArray | None = None
    temperature: FloatArray | None = None
    reference_position: FloatArray | None = None
    sources: Mapping[str, str] | None = None
    period_command_delay: int = 0
    notes: tuple[str, ...] = ()
    grains: Mapping[str, Grain] = field(default_factory=dict)

    @property
    def present(self) -> tuple[str, ...]:
        """Names of the columns that are there."""
        return tuple(name for name in SIGNALS if getattr(self, name) is not None)


@dataclass(frozen=True)
class Recording:
    """The joints of a bag, all on one time base.

    `start_ns`: stamp of the first tick. `robot`: URDF text if the bag carries one. `sha256` of the bag's files.
    `problems`: what could not be read (then a command ends with exit code 3). `notes`: what holds for all joints.
    """

    path: str
    sha256: str
    joints: Mapping[str, JointSignals]
    robot: str | None = None
    notes: tuple[str, ...] = ()
    problems: tuple[str, ...] = ()
    start_ns: int = 0
