"""Runs one case of the fault campaign and judges it; shrinks a case that fails."""

from dataclasses import dataclass, replace

import numpy as np
from fault_injection import ARMED, make_runner, start_motion
from oracles.deadlines import deadline
from oracles.degraded import DegradedOracle
from oracles.unsafe_run import RunOracle

from hd_control.core.resources import config_path
from hd_control.core.strict_yaml import load_params_file

BEFORE_TICKS = 2000
SENSOR_TOPICS = ("encoder", "resolver", "gauge_bridge", "motor_torque_applied", "motor_torque_command")
ESTIMATES = ("coulomb_torque", "friction_offset", "viscous_positive", "viscous_negative", "torsional_compliance")


@dataclass
class Verdict:
    """What a run showed: problems as text, tick of the first stop (-1: none), top speed, was it a controlled stop."""

    problems: list
    stop_tick: int
    fastest: float
    detected: str


def make_oracle(runner):
    """The oracle with the numbers of the limits file, taken by joint name."""
    values = load_params_file(config_path("limits.yaml"), "limits")
    rows = [values["joint_names"].index(name) for name in runner.robot.joint_names]
    torque, rate, deceleration = (
        np.array(values[name])[rows] for name in ("motor_torque_limit", "motor_torque_rate_limit", "stop_deceleration")
    )
    low, high = runner.robot.position_low, runner.robot.position_high
    drives = runner.world.seam.plant.config.drives
    return RunOracle(
        torque, rate * runner.period, low, high, deceleration, values["age_limit_samples"],
        drives["rotor_inertia"], drives["stiffness_linear"],
    )  # fmt: skip


def run_case(case, before=None):
    """The verdict of one case. `before`: ticks that are looked at before the first fault, None: all of them.

    Those before them run at once, compiled.
    """
    runner = make_runner(case)
    oracle, seam = make_oracle(runner), runner.world.seam
    plant, stop_tick, detected = seam.plant, -1, ""
    degraded, begin = DegradedOracle(runner.goal_limits.velocity), _run_ahead(runner, case, before)
    oracle.before = runner.given.tolist()
    first_stops, elsewhere = {}, []
    limit = plant.config.drives["torque_limit"]
    for tick in range(begin, case.ticks):
        if tick == ARMED:
            start_motion(runner, case)
        used = runner.used_tick
        runner.step()
        stopped, controlled = seam.stopped, seam.guard.controlled
        oracle.look(tick, runner.given, seam.armed, stopped, controlled, used, plant.state, plant)
        if not np.array_equal(runner.reached(tick), np.clip(runner.given, -limit, limit)):
            elsewhere.append(f"tick {tick}: {runner.reached(tick)} reached the plant, {runner.given} left the gate")
        law = runner.torque
        mode = law.mode
        if mode == "DEGRADED" or degraded.since is not None:
            degraded.look(tick, mode, runner.motion.reference.desired_velocity, estimates_of(law))
        for name, stopped in (("control", law.guard.stopped), ("drive", seam.stopped)):
            if stopped:
                first_stops.setdefault(name, tick)
        if stop_tick < 0 and (seam.stopped or runner.torque.guard.stopped):
            stop_tick = tick
            books = (runner.fusion.faults, runner.torque.faults, runner.world.faults)
            first = next((book.first_stop for book in books if book.first_stop is not None), None)
            detected = first.code.name if first is not None else "?"
    found = [*oracle.found[:5], *degraded.found[:5]]
    problems = [f"{letter} joint {joint} at tick {tick}" for tick, letter, joint in found]
    problems += elsewhere[:3] + black_box_problems(runner, first_stops)
    for injection in case.injections:
        last = deadline(injection, runner.seen[injection])
        if last is not None and not 0 <= stop_tick <= last:
            problems.append(f"no stop by tick {last} ({injection.target} {injection.kind}), stopped at {stop_tick}")
    return Verdict(problems, stop_tick, oracle.fastest, detected)


def _run_ahead(runner, case, before):
    """Runs the healthy begin of a case at once; the first tick that is left."""
    onset = min((injection.onset for injection in case.injections), default=0)
    first = 0 if before is None else onset - before
    if first <= ARMED:
        return 0
    runner.run_on(ARMED)
    start_motion(runner, case)
    runner.run_on(first - ARMED)
    runner.used_tick, runner.given = first - 1, runner.world.seam.native.applied.copy()
    return first


def estimates_of(law):
    """The estimates of the adaptive law as bytes."""
    if law.state is None or law.state.layout.name != "TorqueState":
        return b""
    return b"".join(law.state.view(name).tobytes() for name in ESTIMATES)


def black_box_problems(runner, first_stops):
    """G19: each side that has stopped kept what it saw before, from 2 s earlier or its first tick on."""
    found = []
    for name, box in (("control", runner.torque.black_box), ("drive", runner.world.black_box)):
        incidents = box.take(True)
        if name not in first_stops:
            continue
        stop = first_stops[name]
        if not incidents or abs(incidents[0].stop_tick - stop) > 1:
            found.append(f"black box: the {name} side stopped at {stop}, kept {[i.stop_tick for i in incidents]}")
            continue
        ticks, topics = incidents[0].ticks, incidents[0].topics
        first = max(0, stop - BEFORE_TICKS)
        if ticks[0] > first or incidents[0].stop_tick not in ticks or not set(SENSOR_TOPICS) <= set(topics):
            found.append(f"black box: the {name} side kept ticks {ticks[0]} to {ticks[-1]} of {sorted(topics)}")
        if name == "drive" and np.any(np.diff(ticks) != 1):
            found.append("black box: the drive side has holes")
    return found


def shrink(case):
    """The smallest case near this one that still fails: fewer injections, then shorter ones."""
    found = True
    while found:
        found = False
        for smaller in _smaller(case):
            if run_case(smaller).problems:
                case, found = smaller, True
                break
    return case


def _smaller(case):
    if len(case.injections) > 1:
        for k in range(len(case.injections)):
            yield replace(case, injections=case.injections[:k] + case.injections[k + 1 :])
    if case.distance != 0.0:
        yield replace(case, distance=0.0)
    for k, injection in enumerate(case.injections):
        for length in (1, injection.length // 2):
            if 0 < length < injection.length:
                short = replace(injection, length=length)
                yield replace(case, injections=case.injections[:k] + (short,) + case.injections[k + 1 :])
