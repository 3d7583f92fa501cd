"""One running robot: parameters, goals and introspection through the same services that any ROS program uses."""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import replace

import numpy as np
import pytest
from node_runs import JOINTS, a_goal, random_domain

from hd_control.core.errors import GoalError, HdError
from hd_control.laws.trajectory import Goal
from hd_control.session.session import RunPlan, Session

TERMS = (
    "inertia_torque",
    "coulomb_feedforward",
    "offset_feedforward",
    "viscous_feedforward",
    "velocity_feedback",
    "joint_torque_feedforward",
    "torque_feedback",
    "saturation_torque",
)
pytestmark = pytest.mark.process
EARLY = 40
"""Tick before the drives obey."""


@pytest.fixture(scope="module")
def session(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Session]:
    plan = RunPlan(
        lockstep=True, parameters={"plant_node": {"pause_at_tick": EARLY}, "torque_node": {"introspection": True}}
    )
    with Session(plan, random_domain(), tmp_path_factory.mktemp("logs")) as running:
        running.activate()
        running.wait_until_tick(EARLY)
        yield running
    assert set(running.exit_codes.values()) == {0}, running.exit_codes


def test_a_live_gain_change_is_accepted(session: Session) -> None:
    gains = session.get_parameters("torque_node", ["motor_velocity_gain"])["motor_velocity_gain"]
    wanted = [0.9 * gain for gain in gains]
    assert session.set_parameters("torque_node", {"motor_velocity_gain": wanted}) == ""
    assert session.get_parameters("torque_node", ["motor_velocity_gain"])["motor_velocity_gain"] == wanted


@pytest.mark.parametrize(
    ("values", "words"),
    [
        ({"motor_velocity_gain": [100.0] * 6}, ["motor_velocity_gain", "6 values, expected 7"]),
        ({"motor_velocity_gain": [100.0] * 6 + [math.nan]}, ["motor_velocity_gain[6]", "nan"]),
        ({"motor_velocity_gain": [100.0] * 6 + [-1.0]}, ["motor_velocity_gain[6]", "-1", "(0,"]),
        ({"motor_velocity_gain": "fast"}, ["motor_velocity_gain", "expected a list"]),
        ({"torque_rate_gain": [1.0] * 7}, ["Remark 3.1", "torque_rate_gain below"]),
        ({"law": "direct"}, ["law", "needs INACTIVE"]),
        ({"period": 0.002}, ["period", "read-only"]),
    ],
)
def test_a_bad_change_is_refused_as_a_whole(session: Session, values: dict[str, object], words: list[str]) -> None:
    before = session.get_parameters("torque_node")
    good = {"motor_position_gain": [40.0] * 7}
    reason = session.set_parameters("torque_node", {**good, **values})
    assert all(word in reason for word in words), reason
    assert session.get_parameters("torque_node") == before


def test_a_goal_at_once_waits_for_the_drives_and_a_session_says_what_they_wait_for(session: Session) -> None:
    assert session.tick() <= EARLY, "the plant stands still before the drives obey"
    goal = replace(a_goal(), start_tick=None, identifier="early")
    session.wait_for(lambda: session.client.drive_state == "WARMING", 10.0, "no state of the drives")
    session.wait_for(lambda: refusal(session, goal).startswith("refused early not_armed"), 10.0, "never refused for it")
    text = refusal(session, goal)
    assert "not yet armed: the drives are WARMING" in text and "100 times in a row" in text
    with pytest.raises(HdError, match="not armed within 0.1 s: the drives are WARMING; Wait: commands must come"):
        session.wait_until_armed(0.1)


def refusal(session: Session, goal: Goal) -> str:
    answer: str = session.client.send_goal(goal, 1_000_000, 10.0)
    return answer


def test_goals_are_refused_with_joint_and_limit(session: Session) -> None:
    goal = a_goal()
    positions = goal.positions.copy()
    positions[-1, 2] = math.nan
    far = goal.positions.copy()
    far[-1, 1] += 3.0
    cases = {
        "joint_unknown": replace(goal, joint_names=(*JOINTS[:6], "elbow")),
        "not_finite": replace(goal, positions=positions),
        "time": replace(goal, times=np.array([0.0, 0.0])),
        "position_limit": replace(goal, positions=far),
        "start_stamp": replace(goal, start_tick=1),
    }
    for code, bad in cases.items():
        with pytest.raises(GoalError) as refusal:
            session.send_goal(replace(bad, identifier=code))
        assert refusal.value.code == code, refusal.value
    session.run_to(session.tick() + 50)
    session.wait_for(lambda: session.diagnostics("motion_node").get("goal") == "hold", 10.0, "state unchanged")


def test_introspection_values_have_names(session: Session) -> None:
    from std_msgs.msg import Float64MultiArray, String

    names: list[str] = []
    rows: list[list[float]] = []
    from hd_control.nodes.fast_loop import chain_qos, latched_qos

    node = session.client.node
    topic = "torque_node/introspection"
    node.create_subscription(String, f"{topic}/names", lambda m: names.extend(m.data.splitlines()), latched_qos())
    node.create_subscription(Float64MultiArray, f"{topic}/values", lambda m: rows.append(list(m.data)), chain_qos(100))
    session.wait_for(lambda: bool(names), 10.0, "names did not come")
    session.run_to(session.tick() + 50)
    session.wait_for(lambda: bool(rows), 10.0, "values did not come")
    assert len(rows[-1]) == len(names) == len(set(names))
    row = dict(zip(names, rows[-1], strict=True))
    total = sum(row[f"torque/output/{term}/joint_4"] for term in TERMS)
    # Zhu (7): the motor torque is the sum of its terms; rounding of eight numbers below 1000 N m
    assert math.isclose(total, row["torque/output/motor_torque/joint_4"], abs_tol=1e-9)
    assert session.set_parameters("torque_node", {"introspection": False}) == ""


def test_a_new_goal_is_accepted_and_followed(session: Session) -> None:
    goal = replace(a_goal(), start_tick=session.tick() + 20, identifier="again")
    answer = session.send_goal(goal)
    assert answer == f"accepted again start_tick {goal.start_tick} end_tick {goal.start_tick + 313}"
    session.run_to(goal.start_tick + 350)
    session.wait_until_armed()
    session.wait_for(lambda: session.diagnostics("motion_node").get("moving") == "False", 10.0, "the goal did not end")


def test_deactivated_nodes_accept_what_they_refused_and_run_again(session: Session) -> None:
    session.deactivate()
    assert session.set_parameters("torque_node", {"rate_source": "error_filter"}) == ""
    assert session.set_parameters("torque_node", {"rate_source": "plain"}) == ""
    session.activate_again()
    start = session.tick()
    session.run_to(start + 100)
    assert session.tick() >= start + 100
