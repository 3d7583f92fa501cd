"""A minute on the wall clock in runs of six seconds: every tick is published or counted as slept through.

How many runs end without a stop depends on the computer; the rate is reported, 0.80 is wanted.
"""

from __future__ import annotations

import pytest
from counts import count, enough
from node_runs import random_domain
from results import write_result

from hd_control.session.session import RunPlan, Session

GOALS = ("G11",)

RUNS, TICKS = 10, 6000
WANTED = 0.80


def one_run(logs):
    """Published, skipped, the drive side's late commands, and was it stopped."""
    plan = RunPlan(parameters={"plant_node": {"stop_after_tick": TICKS}})
    with Session(plan, random_domain(), logs) as session:
        session.activate()

        def accounted():
            found = session.diagnostics("plant_node")
            return int(found.get("ticks", "0")) + int(found.get("skipped", "0"))

        session.wait_for(lambda: accounted() >= TICKS, 120.0, "published and skipped ticks do not add up")
        plant, torque = session.fresh_diagnostics("plant_node"), session.fresh_diagnostics("torque_node")
    return {
        "accounted": int(plant["ticks"]) + int(plant["skipped"]),
        "skipped": int(plant["skipped"]),
        "late": int(plant["late"]),
        "missed": int(torque["missed"]),
        "stopped": plant["gate_stopped"] == "True",
    }


@pytest.mark.process
def test_g11_every_late_tick_is_counted(tmp_path):
    runs = [one_run(tmp_path / str(number)) for number in range(count(RUNS))]
    uncounted = sum(run["accounted"] < TICKS for run in runs)
    rate = sum(not run["stopped"] for run in runs) / len(runs)
    late = sum(run["skipped"] + run["late"] for run in runs) / (TICKS * len(runs))
    words = f"{uncounted} of {len(runs)} runs of 6 s{enough(len(runs), RUNS)} with a tick that was not counted; "
    words += f"{rate:.0%} without a stop (80 % wanted), {late:.1%} of the commands late or slept through"
    write_result("G11", words, not uncounted and rate >= WANTED and len(runs) >= RUNS, runs=runs, success_rate=rate)
    assert not uncounted
