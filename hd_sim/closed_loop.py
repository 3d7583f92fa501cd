"""The rest of an ordinary run at once: the runner's own world and laws in one compiled loop, bit for bit.

Left out are the monitors of sensors and adaptation and the black boxes: they only watch. Guard and gate of both sides
are in. A tick that is not ordinary (a guard or gate stops, a joint is far from its reference, a moving joint is let go)
ends the run, as "stopped"; the runner cannot go on after that, and neither after a run to the end.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np

from hd_control.chain.motion_stage import LOST_TOLERANCE
from hd_control.core.arrays import FloatArray
from hd_control.core.errors import ConfigError
from hd_control.laws.trajectory import Goal
from hd_control.safety.guard import Guard
from hd_sim.drive_side import LET_GO_SAMPLES, MOVING_SPEED, VELOCITY_WEIGHT
from hd_sim.runner import Runner


@dataclass(frozen=True)
class LoopRun:
    """Rows (ticks, n) from tick `first` on: rad, rad, N m; `states` (ticks, size) of the torque law.

    `stopped`: the run ended before its time; rows of `run_through` after that are not numbers.
    """

    first: int
    true_position: FloatArray
    desired: FloatArray
    command: FloatArray
    states: FloatArray
    stopped: bool


def ready(runner: Runner) -> bool:
    """Is the robot in ordinary motion? Drives armed, brakes open, nothing stopped, at rest if a goal still waits."""
    seam, follower = runner.world.seam, runner.motion.follower
    stopped = seam.stopped or runner.torque.guard.stopped
    settled = seam.armed and not seam.brake_closed and not stopped and seam.complete(runner.tick - 1)
    waiting = follower is None or (follower.pending is not None and len(follower.active.coefficients) > 0)
    return settled and not waiting and runner.torque.degraded_samples == 0


def run_on(runner: Runner, ticks: int, prompt: bool = False) -> LoopRun:
    """Runs `ticks` more ticks. `prompt`: the command of a sample acts at once.

    Raises ConfigError if the robot is not in ordinary motion or its torque law is not the adaptive or the direct one.
    """
    state, first = runner.torque.state, runner.tick
    if not ready(runner) or state is None or state.layout.name != "TorqueState":
        raise ConfigError("only ordinary motion under the adaptive or direct torque law can be run on at once")
    done, rows, states = runner.world.seam.plant.run_loop(_given(runner, prompt), first, ticks)
    runner.tick = first + done
    true, desired, command = rows[:, :done]
    return LoopRun(first, true, desired, command, states[:done], done < ticks)


def run_through(runner: Runner, goals: Mapping[int, Goal], ticks: int, prompt: bool = False) -> LoopRun:
    """A new runner from tick 0 to `ticks`, or to its stop: the whole chain until motion is ordinary, then `run_on`.

    `goals` by the tick at which they are offered. Raises GoalError if the robot refuses one.
    """
    rows, states, stopped = np.full((3, ticks, runner.robot.joints), np.nan), np.zeros((0, 0)), False
    seam, last_goal = runner.world.seam, max(goals, default=-1)
    while runner.tick < ticks and not (stopped or (runner.tick > last_goal and ready(runner))):
        tick = runner.tick
        if tick in goals:
            runner.offer(goals[tick])
        rows[0, tick], bus = seam.plant.true_joint_position, runner.step()
        rows[1, tick], rows[2, tick] = bus["joint_reference"]["position"], bus["motor_torque_command"]["effort"]
        numbers = np.zeros(0) if runner.torque.state is None else runner.torque.state.array
        states = np.full((ticks, numbers.size), np.nan) if states.size == 0 else states
        states[tick] = numbers
        # Two gates, one behind the law and one in front of the drives: either may have stopped the robot.
        stopped = seam.stopped or runner.torque.guard.stopped
    if runner.tick < ticks and not stopped:
        rest = run_on(runner, ticks - runner.tick, prompt)
        there, stopped = slice(rest.first, runner.tick), rest.stopped
        rows[:, there], states[there] = (rest.true_position, rest.desired, rest.command), rest.states
    return LoopRun(0, rows[0], rows[1], rows[2], states, bool(stopped))


def _given(runner: Runner, prompt: bool) -> dict[str, Any]:
    """What the loop starts from, copied: blocks of the laws, both sides, the drive's own sensing, the path."""
    fusion, motion, torque, seam = runner.fusion, runner.motion, runner.torque, runner.world.seam
    follower, guard, period = motion.follower, torque.guard, runner.period
    assert follower is not None
    path, numbers = follower.pending or follower.active, dict[str, Any]()
    for name, stage in (("fusion", fusion), ("motion", motion), ("torque", torque)):
        assert stage.params is not None and stage.state is not None
        numbers |= {f"{name}_params": stage.params.array, f"{name}_state": stage.state.array}
    numbers |= {
        "command": seam.command,
        "temperature": fusion.sample.motor_temperature,
        "drive_positions": seam.positions,
        "drive_velocities": seam.velocities,
        "gear_ratio": seam.plant.config.drives["gear_ratio"],
        "knots": path.knots,
        "coefficients": path.coefficients,
        "rest": follower.active.end.position,
        "end": np.concatenate([path.end.position, path.end.velocity, path.end.acceleration]),
        **_side("control", guard),
        **_side("drive", seam.guard),
    }
    given: dict[str, Any] = {name: np.array(value, dtype=float).ravel() for name, value in numbers.items()}
    return given | {
        "segments": len(path.coefficients),
        "start_tick": float(path.start_tick),
        "period": period,
        "age_limit": float(torque.limits.gate.age_limit),
        "lost_tolerance": LOST_TOLERANCE,
        "moving_speed": MOVING_SPEED,
        "let_go_samples": LET_GO_SAMPLES,
        "temperature_ticks": runner.temperature_ticks,
        "velocity_rate": VELOCITY_WEIGHT / period,
        "velocity_weight": VELOCITY_WEIGHT,
        "prompt": prompt,
    }


def _side(name: str, guard: Guard) -> dict[str, FloatArray]:
    return {
        f"{name}_gate": guard.gate.array,
        f"{name}_limits": guard.limits.gate.array,
        f"{name}_tick": guard.last_tick,
        f"{name}_bounds": guard.bounds,
    }
