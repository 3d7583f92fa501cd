"""A foreign program publishes commands before the torque node does: nobody is obeyed until it is gone (HD-F24)."""

from __future__ import annotations

import threading
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import pytest
import rclpy
from node_runs import JOINTS, random_domain
from sensor_msgs.msg import JointState

from hd_control.nodes.fast_loop import chain_qos
from hd_control.session.session import RunPlan, Session

pytestmark = pytest.mark.process
PLAN = RunPlan(lockstep=True, parameters={"plant_node": {"lockstep_timeout": 0.3, "pause_at_tick": 20}})


def hear_it(session: Session) -> None:
    """The nodes run, and stand still until the plant has heard the foreign program."""
    session.activate()
    session.wait_for(lambda: int(session.diagnostics("plant_node").get("strangers", "0")) > 0, 30.0, "not heard")


@contextmanager
def foreign(domain: int) -> Iterator[None]:
    """Sends 5 N m for every joint about 200 times a second."""
    context = rclpy.Context()
    rclpy.init(args=[], context=context, domain_id=domain)
    node = rclpy.create_node("foreign", context=context)
    publisher, end = node.create_publisher(JointState, "motor_torque_command", chain_qos()), threading.Event()
    message = JointState(name=list(JOINTS), effort=[5.0] * len(JOINTS))
    message.header.frame_id = "x" * 16

    def send() -> None:
        while not end.wait(0.005):
            publisher.publish(message)

    thread = threading.Thread(target=send)
    thread.start()
    try:
        yield
    finally:
        end.set()
        thread.join(5.0)
        node.destroy_node()
        rclpy.shutdown(context=context)


def test_f24_a_program_that_was_first_is_not_obeyed_and_the_robot_is_armed_once_it_is_gone(tmp_path: Path) -> None:
    domain = random_domain()
    with foreign(domain), Session(PLAN, domain, tmp_path / "logs") as session:
        # The fixture is closed first: the session lives on without the foreign program.
        hear_it(session)
        session.run_to(600)
        time.sleep(1.1)  # diagnostics come once a second
        said = session.fresh_diagnostics("plant_node")
        assert said["armed"] == "False" and int(said["strangers"]) > 0 and "two_publishers" in said
        assert session.client.drive_state == "WARMING"
    assert set(session.exit_codes.values()) == {0}, session.exit_codes


def test_f24_once_it_is_gone_the_robot_is_armed(tmp_path: Path) -> None:
    domain = random_domain()
    with Session(PLAN, domain, tmp_path / "logs") as session:
        with foreign(domain):
            hear_it(session)
            session.run_to(300)
            assert session.client.drive_state != "ARMED"
        assert session.set_parameters("plant_node", {"pause_at_tick": -1}) == ""
        session.wait_until_armed(60.0)
    assert set(session.exit_codes.values()) == {0}, session.exit_codes
