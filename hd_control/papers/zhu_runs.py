"""Runs of Zhu's experiments on the pure runner, two at a time; deterministic in the case alone.

Errors are the desired minus the true joint position, which no sensor shows and no law sees.
"""

from __future__ import annotations

import multiprocessing
import os
from collections.abc import Iterable, Mapping
from concurrent.futures import ProcessPoolExecutor, as_completed
from dataclasses import dataclass
from typing import Any

import numpy as np

from hd_control.core.arrays import FloatArray
from hd_control.core.blocks import Block
from hd_control.core.workers import serve_only
from hd_control.papers.rows import Progress, load_constants
from hd_control.papers.zhu_options import STARTS, Case, setup_of
from hd_sim import scenario
from hd_sim.runner import Runner
from hd_sim.scenario import Context, Plan, Scenario, make_plan

PROCESSES = 2
MEAN_SECONDS = 0.1
"""Length of the mean whose sign says whether a slow motion ever goes back."""
ESTIMATES = (*STARTS, "torsional_compliance")
BOUNDS = {name: name if name in ("coulomb_torque", "friction_offset", "torsional_compliance") else "viscous"
          for name in ESTIMATES}  # fmt: skip


@dataclass(frozen=True)
class Outcome:
    """What a run gave; arrays (n,). `error` rad over the window, NaN if the gate stopped the robot.

    `reversals`: how often the 0.1 s mean velocity changes its sign. `outside`: largest excess of an estimate over its
    bounds, as a share of their distance; `held`: share of samples in which some estimate of the joint stands on a
    bound. `torque_step`: largest change of the command in a sample, N m.
    """

    error: FloatArray
    reversals: FloatArray
    outside: float
    held: float
    torque_step: FloatArray


@dataclass(frozen=True)
class History:
    """Samples of a run (k,) or (k, n): time s, desired and true position rad, command N m, estimates by name."""

    time: FloatArray
    desired: FloatArray
    true: FloatArray
    command: FloatArray
    estimates: Mapping[str, FloatArray]
    bounds: Mapping[str, tuple[FloatArray, FloatArray]]
    window: slice
    stopped: bool


def motion_of(case: Case) -> Scenario:
    """The motion of a case as a scenario."""
    constants = load_constants("zhu")

    def build(context: Context) -> scenario.Motion:
        if case.motion[0] == "sine":
            return scenario.enveloped_sine(context.start, case.motion[2], case.motion[1])
        if case.motion[0] == "coordinated":
            return scenario.coordinated_moves(
                context.start, float(np.deg2rad(constants["move_deg"])), constants["move_speed"]
            )
        return scenario.constant_speed(context.start, constants["slow_speed"], constants["slow_duration"])

    return Scenario(str(case.motion[0]), "", case.plant, build)


def started(case: Case) -> tuple[Runner, Plan]:
    """A runner ready for its first tick, and what it is to do."""
    setup = setup_of(case)
    runner = Runner(setup, prompt=case.delay == 0)
    if case.rate_gain is not None:
        assert runner.torque.params is not None
        runner.torque.params.torque_rate_gain = case.rate_gain
    start, limit = setup.config.start_position, runner.goal_limits.velocity
    return runner, make_plan(motion_of(case), runner.robot.joint_names, start, limit, runner.period, case.seed)


def history(case: Case) -> History:
    """Runs a case to the end of its window or its stop; rows after a stop are not numbers.

    The whole chain with its monitors. Raises GoalError if the robot refuses the motion.
    """
    runner, plan = started(case)
    first, last = (round(time / runner.period) for time in plan.window)
    run, n = runner.record(dict(plan.goals), last), runner.robot.joints
    params, state = runner.torque.params, runner.torque.state
    assert params is not None and state is not None
    parts = {name: run.states[:, state.layout.slices[name]].reshape(-1, n) for name in ESTIMATES}
    bounds = {name: _bounds(params, name) for name in parts}
    time: FloatArray = runner.period * np.arange(last, dtype=np.float64)
    return History(time, run.desired, run.true_position, run.command, parts, bounds, slice(first, last), run.stopped)


def _bounds(params: Block, name: str) -> tuple[FloatArray, FloatArray]:
    return params.view(f"{BOUNDS[name]}_low").copy(), params.view(f"{BOUNDS[name]}_high").copy()


def play(case: Case) -> Outcome:
    """Runs a case and keeps the figures."""
    seen = history(case)
    period = float(seen.time[1] - seen.time[0])
    error = np.abs(seen.desired - seen.true)[seen.window].max(axis=0)
    pace = mean_pace(seen.true[seen.window], period) / np.abs(mean_pace(seen.desired[seen.window], period)).max(axis=0)
    outside, held = 0.0, np.zeros(seen.command.shape, dtype=bool)
    for name, values in seen.estimates.items():
        low, high = seen.bounds[name]
        excess = np.maximum(low - values, values - high) / (high - low)
        outside, held = max(outside, float(excess.max())), held | (excess >= 0.0)
    step = np.abs(np.diff(seen.command[round(0.5 / period) :], axis=0)).max(axis=0)
    turns = (np.diff(np.sign(pace), axis=0) != 0).sum(axis=0).astype(float)
    return Outcome(np.full_like(error, np.nan) if seen.stopped else error, turns, outside, float(held.mean()), step)


def mean_pace(position: FloatArray, period: float) -> FloatArray:
    """Mean velocity (k, n) rad/s over 0.1 s of positions (.., n) rad."""
    n = round(MEAN_SECONDS / period)
    return np.asarray((position[n:] - position[:-n]) / MEAN_SECONDS)


def play_all(cases: Iterable[Case], progress: Progress) -> dict[Case, Outcome]:
    """The outcomes of all cases, each run once, on two processors where there are two."""
    wanted = list(dict.fromkeys(cases))
    workers = min(PROCESSES, os.cpu_count() or 1, len(wanted))
    if workers < 2:
        return {case: play(case) for case in wanted}
    found: dict[Case, Outcome] = {}
    context = multiprocessing.get_context("spawn")
    # The longest first, so that no processor waits for the last one.
    order = sorted(wanted, key=_weight, reverse=True)
    with ProcessPoolExecutor(workers, mp_context=context, initializer=serve_only) as pool:
        jobs: dict[Any, Case] = {pool.submit(play, case): case for case in order}
        try:
            for job in as_completed(jobs):
                found[jobs[job]] = job.result()
                progress(len(found) / len(wanted), f"{len(found)} of {len(wanted)} runs")
        except BaseException:
            pool.shutdown(wait=False, cancel_futures=True)
            raise
    return {case: found[case] for case in wanted}


def _weight(case: Case) -> float:
    """About how long a run takes, relative to others."""
    seconds = {"sine": 12.0 if case.motion[0] == "sine" and case.motion[1] < 1.0 else 6.0, "slow": 14.0}
    return seconds.get(case.motion[0], 6.0) * (4.0 if "fast_loop" in case.options else 1.0)
