"""A process of the chain stands still for a while and comes back, or parameters change in every tick: a clear stop, no
dead end, and the robot moves again after a reset."""

from __future__ import annotations

import os
import signal
import time
from dataclasses import replace
from pathlib import Path

import pytest
from node_runs import MortalSession, random_domain

from hd_control.core.errors import HdError
from hd_control.laws.trajectory import quintic_move
from hd_control.session.session import RunPlan, Session

pytestmark = pytest.mark.process
FIRST, PATIENCE = 150, 0.2
"""Tick at which a process is stopped: the drives are armed then. s that the plant waits for a command."""


def make_plan(**torque: object) -> RunPlan:
    values = {"plant_node": {"lockstep_timeout": PATIENCE, "pause_at_tick": FIRST}, "torque_node": torque}
    return RunPlan(plant="single_joint_5", lockstep=True, parameters=values)


def move_again(session: Session) -> str:
    """Resets while the ticks run, then a goal: accepted, and the torque law is active."""
    assert session.set_parameters("plant_node", {"pause_at_tick": -1}) == ""
    refused = {"torque_node": "", "motion_node": "", "plant_node": ""}

    def granted() -> bool:
        for node in refused:
            refused[node] = session.reset(node)
        return not any(refused.values()) and session.client.drive_state == "ARMED"

    try:
        session.wait_for(granted, 60.0, "no reset")
    except HdError as error:
        raise AssertionError(refused) from error
    goal = quintic_move(("joint_5",), [0.0], [0.02], 0.2, "again")
    answer = session.send_goal(replace(goal, start_tick=None))
    session.wait_until_tick(session.tick() + 500)
    assert session.fresh_diagnostics("torque_node")["mode"] == "ACTIVE"
    return answer


@pytest.mark.parametrize("node", ["fusion_node", "motion_node", "torque_node"])
def test_f18_a_process_that_stood_still_costs_a_stop_and_no_restart(node: str, tmp_path: Path) -> None:
    with MortalSession(make_plan(), random_domain(), tmp_path) as session:
        session.activate()
        session.wait_until_tick(FIRST)
        process = session.pid(node)
        os.kill(process, signal.SIGSTOP)
        try:
            session.run_to(FIRST + 60)
            session.wait_for(lambda: session.diagnostics("plant_node").get("gate_stopped") == "True", 20.0, "no stop")
        finally:
            os.kill(process, signal.SIGCONT)
        said = session.diagnostics("plant_node")
        assert "HD-F18" in said["message"] and 0 < int(said["gate_stop_tick"]) - FIRST <= 10
        assert session.client.drive_state == "STOPPED"
        assert move_again(session).startswith("accepted again")
    assert set(session.exit_codes.values()) == {0}, session.exit_codes


def test_a_plant_that_stands_still_for_seconds_holds_everybody_up_and_nothing_stops(tmp_path: Path) -> None:
    with MortalSession(make_plan(), random_domain(), tmp_path) as session:
        session.activate()
        session.wait_until_tick(FIRST)
        process = session.pid("plant_node")
        assert session.set_parameters("plant_node", {"pause_at_tick": -1}) == ""
        os.kill(process, signal.SIGSTOP)
        time.sleep(1.0)
        os.kill(process, signal.SIGCONT)
        session.wait_until_tick(FIRST + 2000)
        said = session.fresh_diagnostics("torque_node")
        assert said["gate_stopped"] == "False" and said["missed"] == "0"


def test_parameters_that_change_all_the_time_are_taken_whole_and_the_robot_goes_on(tmp_path: Path) -> None:
    with Session(make_plan(), random_domain(), tmp_path) as session:
        session.activate()
        session.wait_until_tick(FIRST)
        gains = session.get_parameters("torque_node", ["motor_velocity_gain"])["motor_velocity_gain"]
        assert session.set_parameters("plant_node", {"pause_at_tick": -1}) == ""
        for number in range(200):
            share = 0.9 if number % 2 else 1.0
            wanted = {"motor_velocity_gain": [share * gain for gain in gains]}
            assert session.set_parameters("torque_node", wanted) == ""
        said = session.fresh_diagnostics("torque_node")
        assert int(said["parameter_changes"]) >= 200
        assert said["gate_stopped"] == "False" and said["mode"] == "ACTIVE"
