"""Goals become references by tick: paths made of goals, followed at full or at slow rate.

Time is `(tick - start tick) * period`; no clock is read. A new goal starts at the present reference with its velocity
and acceleration, so it may replace one in motion. The last point is held exactly. Interpolation follows what the goal
gives: positions only are joined by lines, with velocities by cubics, with accelerations by quintics. Knots count
samples, so points that fall on a tick are met exactly.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import ArrayLike

from hd_control import _laws
from hd_control.core.arrays import FloatArray
from hd_control.core.errors import GoalError
from hd_control.core.faults import FaultCode

# ---- Paths: splines of all joints over ticks; pure functions ---------------------------------------


def refusal(code: str, joint: str, what: str, remedy: str) -> GoalError:
    """The error with its text, `HD-F22 goal_bad joint_3: what. remedy.`; `joint` may be empty."""
    return GoalError(code, FaultCode.GOAL_BAD.line(f"{what}. {remedy}.", joint))


@dataclass(frozen=True)
class Goal:
    """A wanted motion. times (k,) s from the start; positions, velocities, accelerations (k, joints of the goal), SI.

    `start_tick` None means now. `velocities` and `accelerations` may be None; accelerations need velocities.
    """

    joint_names: tuple[str, ...]
    times: FloatArray
    positions: FloatArray
    velocities: FloatArray | None = None
    accelerations: FloatArray | None = None
    start_tick: int | None = None
    identifier: str = ""

    @property
    def order(self) -> int:
        """Degree of the spline through the points: 1, 3 or 5."""
        if self.velocities is None:
            return 1
        return 3 if self.accelerations is None else 5


@dataclass(frozen=True)
class Motion:
    """Position rad, velocity rad/s and acceleration rad/s^2 of all joints at one instant, (n,) each."""

    position: FloatArray
    velocity: FloatArray
    acceleration: FloatArray


@dataclass(frozen=True)
class Path:
    """A spline of all joints from `start_tick` on, and the state at its end.

    knots (s + 1,) in samples from the start, coefficients (s, n, 6) in SI from each segment's start. No segments: hold.
    """

    start_tick: int
    period: float
    knots: FloatArray
    coefficients: FloatArray
    end: Motion
    identifier: str = ""

    @property
    def end_tick(self) -> int:
        """First tick at or after the last point."""
        return self.start_tick + int(np.ceil(self.knots[-1]))

    def delayed(self, ticks: float) -> Path:
        """The same motion, `ticks` >= 0 later."""
        whole = int(np.floor(ticks))
        return replace(self, start_tick=self.start_tick + whole, knots=self.knots + (ticks - whole))

    def evaluate(self, tick: float, cursor: int, out: FloatArray) -> int:
        """Writes position, velocity, acceleration (3n,) at a tick; returns the cursor for the next call.

        Before the start the start, at the last point its values, after it its position at rest.
        """
        offset, n = float(tick - self.start_tick), self.end.position.size
        if offset < self.knots[-1] and len(self.coefficients):
            after: int = _laws.spline_evaluate(
                self.knots, self.coefficients, max(offset, 0.0), self.period, cursor, out, n
            )
            return after
        exactly = offset == self.knots[-1]
        out[:n] = self.end.position
        out[n : 2 * n] = self.end.velocity if exactly else 0.0
        out[2 * n :] = self.end.acceleration if exactly else 0.0
        return cursor

    def extrema(self) -> FloatArray:
        """Lowest and highest position, velocity, acceleration of every segment and joint, (s, n, 6), exact."""
        n = self.end.position.size
        found: FloatArray = _laws.spline_extrema(self.knots, self.coefficients, self.period, n)
        return found


def hold_path(position: ArrayLike, tick: int, period: float) -> Path:
    """Standing still at `position` (n,) from `tick` on."""
    q = np.array(position, dtype=float)
    none = np.zeros_like(q)
    return Path(tick, period, np.zeros(1), np.zeros((0, q.size, 6)), Motion(q, none, none), "hold")


def braking_path(present: Motion, tick: int, period: float, acceleration_limit: FloatArray) -> Path:
    """From `present` to rest, velocity as a cubic, within `acceleration_limit` (n,) (or the present one, if larger).

    All joints stop after the same time, the shortest found by steps of 5 %.
    """
    v, a = present.velocity, present.acceleration
    allowed = np.maximum(acceleration_limit, np.abs(a)) * (1.0 + 1e-9)
    samples = max(1.0, float(np.ceil(np.max(1.5 * np.abs(v) / allowed) / period)))
    while True:
        t = samples * period
        second, third = -(3.0 * v + 2.0 * a * t) / t**2, (2.0 * v + a * t) / t**3
        with np.errstate(divide="ignore", invalid="ignore"):
            vertex = np.where(third != 0.0, -second / (3.0 * third), 0.0)
        at = np.clip(vertex, 0.0, t)
        if np.all(np.abs(a + 2.0 * second * at + 3.0 * third * at**2) <= allowed) or samples * period > 3600.0:
            break
        samples = np.ceil(1.05 * samples)
    columns = [present.position, v, 0.5 * a, second / 3.0, third / 4.0, np.zeros_like(v)]
    none = np.zeros_like(v)
    end = Motion(present.position + v * t / 2.0 + a * t**2 / 12.0, none, none)
    return Path(tick, period, np.array([0.0, samples]), np.stack(columns, axis=1)[None], end, "stop")


def in_robot_order(
    goal: Goal, joint_names: Sequence[str], present: Motion, stop_time: float
) -> tuple[FloatArray, FloatArray | None, FloatArray | None]:
    """The goal's positions, velocities, accelerations as (k, n) in the robot's joint order, matched by name.

    Joints that the goal leaves out stop within `stop_time` s and stay. Raises GoalError for unknown or repeated names.
    """
    names, known = list(goal.joint_names), list(joint_names)
    for name in names:
        if name not in known:
            raise refusal("joint_unknown", name, "unknown joint", f"Use some of {', '.join(known)}")
        if names.count(name) > 1:
            raise refusal("joint_repeated", name, f"named {names.count(name)} times", "Name it once")
    columns = [known.index(name) for name in names]

    def table(values: FloatArray, filler: FloatArray) -> FloatArray:
        found = np.empty((len(goal.times), len(known)))
        found[:] = filler
        found[:, columns] = values
        return found

    rest, none = present.position + 0.5 * stop_time * present.velocity, np.zeros(len(known))
    return (
        table(goal.positions, rest),
        None if goal.velocities is None else table(goal.velocities, none),
        None if goal.accelerations is None else table(goal.accelerations, none),
    )


def plan_path(
    goal: Goal, joint_names: Sequence[str], present: Motion, start_tick: int, period: float, blend_time: float
) -> Path:
    """The path of a goal from `present`, the reference at the start tick. Changes nothing, checks only names.

    First point later than time 0: a quintic leads from the present reference to it. First point at time 0: the path
    starts at the present reference, and its distance to the goal's own spline (in position, velocity and acceleration)
    fades out as a quintic within `blend_time` s. No distance, no change.
    """
    times = np.asarray(goal.times, dtype=float)
    moving = times[times > 0.0]
    q, v, a = in_robot_order(goal, joint_names, present, float(moving[0]) if moving.size else 0.0)
    knots = _samples(times, period)
    coefficients = _spline(goal.order, knots, period, q, v, a)
    if knots[0] > 0.0:
        lead = _lead_in(present, coefficients, (q, v, a), knots[0], period)
        knots, coefficients = np.concatenate([[0.0], knots]), np.concatenate([lead, coefficients])
    elif len(coefficients):
        knots, coefficients = _faded_in(knots, coefficients, period, present, blend_time)
    none = np.zeros(len(joint_names))
    end = Motion(q[-1], none if v is None else v[-1], none if a is None else a[-1])
    return Path(start_tick, period, knots, coefficients, end, goal.identifier)


def _samples(times: FloatArray, period: float) -> FloatArray:
    """Times in samples; what lies within a millionth of a tick is on the tick."""
    samples = times / period
    whole = np.rint(samples)
    return np.where(np.abs(samples - whole) <= 1e-6, whole, samples)


def _spline(
    order: int, knots: FloatArray, period: float, q: FloatArray, v: FloatArray | None, a: FloatArray | None
) -> FloatArray:
    none = np.empty(0)
    v, a = none if v is None else v, none if a is None else a
    found: FloatArray = _laws.spline_coefficients(order, knots, period, q, v, a, q.shape[1])
    return found


def _lead_in(
    present: Motion,
    after: FloatArray,
    points: tuple[FloatArray, FloatArray | None, FloatArray | None],
    samples: float,
    period: float,
) -> FloatArray:
    """One quintic segment from the present reference to the first point, continuous with what follows it."""
    q, v, a = points
    none = np.zeros_like(q[0])
    rate = v[0] if v is not None else (after[0, :, 1] if len(after) else none)
    second = a[0] if a is not None else (2.0 * after[0, :, 2] if len(after) else none)
    knots = np.array([0.0, samples])
    ends = (present.position, q[0]), (present.velocity, rate), (present.acceleration, second)
    return _spline(5, knots, period, *(np.stack(pair) for pair in ends))


_BINOMIAL = np.array(
    [
        [1, 1, 1, 1, 1, 1],
        [0, 1, 2, 3, 4, 5],
        [0, 0, 1, 3, 6, 10],
        [0, 0, 0, 1, 4, 10],
        [0, 0, 0, 0, 1, 5],
        [0] * 5 + [1],
    ]
)


def _shifted(coefficients: FloatArray, offsets: FloatArray) -> FloatArray:
    """The polynomials (k, n, 6) with time counted from `offsets` (k,) s on."""
    found = np.zeros_like(coefficients)
    for k in range(6):
        for j in range(k, 6):
            found[:, :, k] += _BINOMIAL[k, j] * coefficients[:, :, j] * offsets[:, None] ** (j - k)
    return found


def _faded_in(
    knots: FloatArray, coefficients: FloatArray, period: float, present: Motion, blend_time: float
) -> tuple[FloatArray, FloatArray]:
    """Knots and coefficients plus the quintic that takes the distance between present reference and goal to zero.

    The quintic ends `blend_time` s after the start, or with the goal; a segment that it ends in is split there.
    """
    start = coefficients[0, :, :3].T * [[1.0], [1.0], [2.0]]
    gap = np.stack([present.position, present.velocity, present.acceleration]) - start
    if not gap.any():
        return knots, coefficients
    end = min(max(1.0, float(np.rint(blend_time / period))), float(knots[-1]))
    last = int(np.searchsorted(knots, end))
    if knots[last] > end:
        split = _shifted(coefficients[last - 1 : last], np.array([(end - knots[last - 1]) * period]))
        knots, coefficients = np.insert(knots, last, end), np.insert(coefficients, last, split[0], axis=0)
    ends = np.stack([gap, np.zeros_like(gap)], axis=1)
    fade = _spline(5, np.array([0.0, end]), period, ends[0], ends[1], ends[2])
    coefficients[:last] += _shifted(np.repeat(fade, last, axis=0), knots[:last] * period)
    return knots, coefficients


# ---- Goals of usual shapes: rest-to-rest moves and sines with a quintic envelope -------------------


QUINTIC_PEAK = 1.875
"""Peak velocity of the rest-to-rest quintic over distance D in time T is 1.875 D / T."""


def quintic_move(
    joint_names: Sequence[str], start: ArrayLike, end: ArrayLike, peak_velocity: float, identifier: str = "move"
) -> Goal:
    """One rest-to-rest quintic, all joints in the same time; the farthest reaches `peak_velocity` rad/s."""
    distance = float(np.max(np.abs(np.subtract(end, start))))
    return _at_rest(joint_names, [0.0, QUINTIC_PEAK * distance / peak_velocity], [start, end], identifier)


def moves(
    joint_names: Sequence[str],
    start: ArrayLike,
    offsets: Sequence[ArrayLike],
    peak_velocity: float,
    hold_before: float = 1.0,
    hold_after: float = 0.6,
    identifier: str = "moves",
) -> Goal:
    """Rest-to-rest moves by each of `offsets` in turn, rad, `hold_before` s first and `hold_after` s after each."""
    times, points = [0.0, hold_before], [np.asarray(start, dtype=float)] * 2
    for offset in offsets:
        travel = QUINTIC_PEAK * float(np.max(np.abs(offset))) / peak_velocity
        points += [points[-1] + np.asarray(offset)] * 2
        times += [times[-1] + travel, times[-1] + travel + hold_after]
    return _at_rest(joint_names, times, points, identifier)


def enveloped_sine(
    time: ArrayLike, amplitude: float, frequency: float, ramp_periods: float = 2.0
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """A sin(2 pi f t) under a quintic envelope from 0 to 1 over `ramp_periods`: value and two derivatives, SI."""
    t = np.asarray(time, dtype=float)
    ramp, w = ramp_periods / frequency, 2.0 * np.pi * frequency
    x = np.clip(t / ramp, 0.0, 1.0)
    e = x**3 * (10.0 - 15.0 * x + 6.0 * x**2)
    e1 = 30.0 * x**2 * (1.0 - x) ** 2 / ramp
    e2 = 60.0 * x * (1.0 - x) * (1.0 - 2.0 * x) / ramp**2
    s, c = amplitude * np.sin(w * t), amplitude * np.cos(w * t)
    return e * s, e1 * s + e * w * c, e2 * s + 2.0 * e1 * w * c - e * w**2 * s


def sine_goal(
    joint_names: Sequence[str],
    center: ArrayLike,
    amplitude: ArrayLike,
    frequency: float,
    periods: int,
    ramp_periods: int = 2,
    points_per_period: int = 80,
    identifier: str = "sine",
) -> Goal:
    """Sines of `periods` periods, the first `ramp_periods` under the envelope, and as many more fading out to rest.

    `amplitude` is one value or (n,) rad. Quintics through 80 points a period differ from the sine by 2e-12 of it.
    """
    length = (periods + ramp_periods) / frequency
    times = np.linspace(0.0, length, (periods + ramp_periods) * points_per_period + 1)
    up = enveloped_sine(times, 1.0, frequency, ramp_periods)
    down = enveloped_sine(length - times, 1.0, frequency, ramp_periods)
    late = times > 0.5 * length
    shapes = [np.where(late, sign * b, a) for a, b, sign in zip(up, down, (-1.0, 1.0, -1.0), strict=True)]
    size, q0 = np.broadcast_to(amplitude, np.shape(center)), np.asarray(center, dtype=float)
    q, v, a = (np.outer(shape, size) for shape in shapes)
    return Goal(tuple(joint_names), times, q0 + q, v, a, identifier=identifier)


def _at_rest(joint_names: Sequence[str], times: Sequence[float], points: Sequence[ArrayLike], identifier: str) -> Goal:
    """Points with zero velocity and acceleration."""
    q = np.array(points, dtype=float)
    return Goal(tuple(joint_names), np.array(times), q, np.zeros_like(q), np.zeros_like(q), identifier=identifier)


# ---- The reference by tick -------------------------------------------------------------------------


class TrajectoryFollower:
    """The reference by tick: holds, follows one path, and may have one more that starts later.

    The state is `active` and `pending` (paths, never changed once made) and `cursor`, which only saves search time.
    Positions are in rad, in the order of `joint_names`; `period` is the length of a tick in s.
    """

    def __init__(
        self,
        joint_names: Sequence[str],
        period: float,
        position: ArrayLike,
        tick: int = 0,
        blend_time: float = 0.2,
    ) -> None:
        self.joint_names, self.period, self.blend_time = tuple(joint_names), period, blend_time
        self.active = hold_path(position, tick, period)
        self.pending: Path | None = None
        self.cursor = 0

    def copy(self) -> TrajectoryFollower:
        """An independent follower in the same state."""
        twin = TrajectoryFollower(self.joint_names, self.period, self.active.end.position, 0, self.blend_time)
        twin.active, twin.pending, twin.cursor = self.active, self.pending, self.cursor
        return twin

    def hold(self, position: ArrayLike, tick: int) -> None:
        """Stands still at `position` (n,) from `tick` on, without a blend; drops every goal."""
        self.active, self.pending, self.cursor = hold_path(position, tick, self.period), None, 0

    def at(self, tick: int) -> Motion:
        """The reference at a present or future tick; changes nothing. May be called from another thread."""
        pending = self.pending  # read before `active`: `sample` promotes in the other order
        path = pending if pending is not None and tick >= pending.start_tick else self.active
        out = np.empty(3 * len(self.joint_names))
        path.evaluate(tick, 0, out)
        position, velocity, acceleration = out.reshape(3, -1)
        return Motion(position, velocity, acceleration)

    def start_tick(self, goal: Goal, tick: int) -> int:
        """Tick at which a goal received at `tick` begins."""
        return tick if goal.start_tick is None else goal.start_tick

    def plan(self, goal: Goal, tick: int) -> Path:
        """The path that a goal would give, from the reference at its start tick on; changes nothing."""
        start = self.start_tick(goal, tick)
        return plan_path(goal, self.joint_names, self.at(start), start, self.period, self.blend_time)

    def accept(self, goal: Goal | Path, tick: int) -> Path:
        """Follows a goal, or better the path that `check_goal` made of it, from its start tick on.

        A start tick in the future leaves the present motion alone until then; only one goal waits, the newest.
        """
        path = self.plan(goal, tick) if isinstance(goal, Goal) else goal
        if path.start_tick > tick:
            self.pending = path
        else:
            self.active, self.pending, self.cursor = path, None, 0
        return path

    def delay(self, ticks: float) -> None:
        """Whatever is planned happens `ticks` later, fractions included; the present reference stays as it is."""
        self.active = self.active.delayed(ticks)
        self.pending = None if self.pending is None else self.pending.delayed(ticks)

    def sample(self, tick: float, out: FloatArray | None = None) -> tuple[FloatArray, FloatArray, FloatArray]:
        """Desired position, velocity, acceleration at a tick, (n,) each: views of `out` (3n,) if it is given."""
        if self.pending is not None and tick >= self.pending.start_tick:
            self.active, self.pending, self.cursor = self.pending, None, 0
        n = len(self.joint_names)
        values = np.empty(3 * n) if out is None else out
        self.cursor = self.active.evaluate(tick, self.cursor, values)
        return values[:n], values[n : 2 * n], values[2 * n :]

    def moving(self, tick: float) -> bool:
        """True until the last accepted goal has ended."""
        return self.pending is not None or tick < self.active.end_tick

    def stop(self, tick: int, acceleration_limit: ArrayLike) -> Path:
        """Brings all joints to rest within `acceleration_limit` (n,) rad/s^2; drops every goal."""
        path = braking_path(self.at(tick), tick, self.period, np.asarray(acceleration_limit, dtype=float))
        self.active, self.pending, self.cursor = path, None, 0
        return path
