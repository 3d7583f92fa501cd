"""Healthy runs: whatever stops one of them is a false stop."""

from dataclasses import replace

import numpy as np

from hd_control.laws.trajectory import quintic_move
from hd_sim.plant_config import PlantConfig
from hd_sim.runner import LOOK_TICKS, Runner, RunSetup

PLANTS = ("arm_a", "single_joint_3", "single_joint_4", "single_joint_5", "single_joint_7")


def healthy_hours(seed, seconds):
    """Texts of every stop in `seconds` of random moves at 0.01 to 0.8 rad/s on each plant, and the simulated hours."""
    found, hours = [], 0.0
    for number, plant in enumerate(PLANTS):
        random = np.random.default_rng([seed, number, 0xFA15])
        runner = Runner(RunSetup(PlantConfig.from_file(plant), int(random.integers(2**31))))
        origin, busy, stopped = None, 200, False
        ticks = round(seconds / runner.period)
        while runner.tick < ticks and not stopped:
            if runner.tick >= busy:
                origin = runner.torque.sample.joint_position.copy() if origin is None else origin
                busy = _move(runner, origin, random)
            # Many ticks at once: a stop latches, so it is seen at the end of them.
            runner.run_on(min(busy, ticks, runner.tick + LOOK_TICKS) - runner.tick)
            stopped = bool(runner.world.seam.stopped or runner.torque.guard.stopped)
            if stopped:
                names = runner.robot.joint_names
                texts = [
                    book.headline(names) for book in (runner.fusion.faults, runner.torque.faults, runner.world.faults)
                ]
                found.append(f"seed {seed} {plant} tick {runner.tick}: {'; '.join(filter(None, texts))}")
        hours += runner.tick * runner.period / 3600.0
    return found, hours


def _move(runner, origin, random):
    """Gives one goal near the origin; returns the tick after which the next may come."""
    start = runner.motion.follower.at(runner.motion.tick).position
    end = origin + random.uniform(-0.15, 0.15, origin.size)
    distance = float(np.abs(end - start).max())
    speed = float(10.0 ** random.uniform(-2.0, 0.0) * 0.8 * np.sqrt(2.0 * distance))
    runner.offer(replace(quintic_move(runner.robot.joint_names, start, end, max(speed, 0.01)), start_tick=None))
    return runner.tick + 100 + round(1.875 * distance / max(speed, 0.01) / runner.period)
