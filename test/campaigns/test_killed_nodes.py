"""Laws die at random ticks in lock-step, nodes are killed live: a stop within 10 ticks, then no torque."""

from __future__ import annotations

import numpy as np
import pytest
from counts import SEED, count, enough
from fault_cases import run_case
from fault_injection import Case, Injection, make_runner
from node_runs import MortalSession, random_domain
from results import write_result

from hd_control.session.session import RunPlan

GOALS = ("G12",)

KILLS, LIVE_SHARE = 50, 10
LAWS = ("fusion", "motion", "torque")
NODES = ("fusion_node", "motion_node", "torque_node")


def dead_law(law, number):
    """What is wrong with one death in lock-step."""
    random = np.random.default_rng([SEED, number, LAWS.index(law)])
    plant = "arm_a" if number % 10 == 9 else "single_joint_5"
    onset = int(random.integers(250, 700))
    case = Case(SEED, number, plant, 0.2, 0.3, (Injection(law, "off", -1, onset, 10**6, 1.0),))
    verdict, runner = run_case(case), make_runner(case)
    for _ in range(onset + 700):
        runner.step()
    found = list(verdict.problems)
    found += [] if 0 <= verdict.stop_tick <= onset + 10 else [f"stopped at {verdict.stop_tick}, onset {onset}"]
    found += [] if not np.any(runner.given) else [f"torque {runner.given} after the ramp"]
    return found


def killed_node(node, folder):
    """Ticks from the last command to the stop, and who is still alive."""
    values = {"plant_node": {"lockstep_timeout": 0.5, "pause_at_tick": 300}}
    with MortalSession(RunPlan(lockstep=True, parameters=values), random_domain(), folder) as session:
        session.activate()
        session.wait_until_tick(300)
        session.kill(node)
        session.run_to(350)
        session.wait_for(lambda: session.diagnostics("plant_node").get("gate_stopped") == "True", 20.0, "no stop")
        ticks = int(session.diagnostics("plant_node")["gate_stop_tick"]) - 300
        others = all(session.alive(other) for other in ("plant_node", *NODES) if other != node)
    return ticks, others


@pytest.mark.process
def test_g12_deaths(tmp_path):
    kills = count(KILLS)
    wrong = [(law, number, found) for law in LAWS for number in range(kills) if (found := dead_law(law, number))]
    live = [killed_node(node, tmp_path / f"{node}{k}") for node in NODES for k in range(max(1, kills // LIVE_SHARE))]
    late = [row for row in live if not (0 < row[0] <= 10 and row[1])]
    words = f"{len(wrong)} of {3 * kills} deaths in lock-step{enough(kills, KILLS)} and {len(late)} of {len(live)} "
    words += f"killed processes late or with torque left; at most {max(row[0] for row in live)} ticks live"
    write_result("G12", words, not wrong and not late and kills >= KILLS, kills=3 * kills, live=len(live))
    assert not wrong and not late, (wrong[:3], late[:3])
