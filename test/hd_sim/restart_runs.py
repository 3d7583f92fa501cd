"""Stop and reset again and again: the torque never changes faster than its limit, the arm does not jump."""

import numpy as np
from fault_cases import make_oracle
from fault_injection import FaultyRunner

from hd_sim.plant_config import PlantConfig
from hd_sim.runner import RunSetup

WAIT = 700
"""Ticks until a reset may be granted: 500 healthy samples and the ramp."""
LARGEST_STEP = 0.002
"""rad; a joint that moves further within a cycle of a resting arm has jumped or dropped."""


def restart_cycles(count, seed, plant="single_joint_5"):
    """Problems of `count` cycles at rest; stops alternate between the law's side and the drive's side."""
    runner = FaultyRunner(RunSetup(PlantConfig.from_file(plant), seed), [], seed)
    oracle, seam, found = make_oracle(runner), runner.world.seam, []
    before = np.zeros(runner.robot.joints)
    position = None
    for tick in range(300 + count * 2 * WAIT):
        phase = (tick - 300) % (2 * WAIT)
        if tick >= 300 and phase == 0:
            position = seam.plant.true_joint_position.copy()
            _stop(runner, ((tick - 300) // (2 * WAIT)) % 2)
        if phase == WAIT + 10:
            runner.motion.reset_asked = True
        if phase == WAIT + 12:
            runner.torque.reset_asked = runner.world.reset_asked = True
        runner.step()
        change = np.abs(runner.given - before)
        if np.any(change > np.array(oracle.step) * (1.0 + 1e-9)):
            found.append(f"tick {tick}: torque changed by {change} N m")
        before = runner.given
        if tick > 300 and phase == 2 * WAIT - 1:
            found += _ended(runner, tick, position)
    return found


def _stop(runner, kind):
    if kind == 0:
        runner.torque.emergency()
    else:
        runner.world.command(slice(None), np.full(runner.robot.joints, np.nan), runner.tick)


def _ended(runner, tick, position):
    """After a cycle: obeying again, at the same place."""
    seam, found = runner.world.seam, []
    if seam.stopped or runner.torque.guard.stopped or seam.brake_closed:
        found.append(f"tick {tick}: not back, {runner.torque.reset_answer}, {runner.world.reset_answer}")
    moved = np.abs(seam.plant.true_joint_position - position)
    if np.any(moved > LARGEST_STEP):
        found.append(f"tick {tick}: joint moved by {moved} rad")
    return found
