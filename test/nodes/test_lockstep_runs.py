"""Lock-step over real processes: nothing is lost, and how the chain is cut into processes does not change a bit."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from node_runs import END, GOAL_TICK, JOINTS, PAUSE, START, a_goal, random_domain, record

from hd_control.record.reader import BagReader
from hd_control.session.session import RunPlan, Session
from hd_sim.plant_config import PlantConfig
from hd_sim.runner import Runner, RunSetup

pytestmark = pytest.mark.process
CHAIN_TOPICS = (
    "encoder",
    "resolver",
    "gauge_bridge",
    "motor_torque_applied",
    "joint_states",
    "motor_states",
    "joint_reference",
    "joint_torque_required",
    "motor_torque_command",
)


@pytest.fixture(scope="module")
def four_processes(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return record(tmp_path_factory.mktemp("four"))


def command(bag: Path) -> np.ndarray:
    """Motor torque commands (ticks, joints) by tick and joint name, from one publisher or several."""
    with BagReader(bag) as reader:
        found = np.full((END, len(JOINTS)), np.nan)
        for _, message in reader.messages("motor_torque_command"):
            tick = round((message.header.stamp.sec + message.header.stamp.nanosec * 1e-9) * 1000)
            for name, effort in zip(message.name, message.effort, strict=True):
                found[tick, JOINTS.index(name)] = effort
    return found


def test_every_tick_of_every_topic_is_recorded(four_processes: Path) -> None:
    with BagReader(four_processes) as reader:
        assert reader.complete
        for topic in CHAIN_TOPICS:
            ticks = np.round(reader.columns(topic).stamps_ns / 1e6).astype(int)
            assert np.array_equal(np.unique(ticks), np.arange(END)), topic


def test_the_goal_moves_the_arm(four_processes: Path) -> None:
    with BagReader(four_processes) as reader:
        wanted = reader.columns("joint_reference").position
        measured = reader.columns("resolver").position
    assert np.array_equal(wanted[:GOAL_TICK], np.broadcast_to(wanted[0], (GOAL_TICK, len(JOINTS))))
    assert np.allclose(wanted[-1], START + 0.05, atol=1e-12)
    # 5 mrad: ten times the tracking error of a healthy controller, a tenth of the motion
    assert np.max(np.abs(measured[-1] - wanted[-1])) < 5e-3


def test_temperatures_are_degrees_celsius_of_every_joint(four_processes: Path) -> None:
    """Near the 22 degC of the room that the shipped drives stand in."""
    with BagReader(four_processes) as reader:
        warm = reader.columns("motor_temperature")
    assert set(warm.names) == set(JOINTS) and len(warm) == len(JOINTS) * -(-END // 100)
    named = warm.values["temperature"][np.isfinite(warm.values["temperature"])]
    assert len(named) == len(warm), "each message is of one joint"
    assert np.all(np.abs(named - 22.0) < 5.0)


def test_commands_are_finite_and_complete(four_processes: Path) -> None:
    assert np.all(np.isfinite(command(four_processes)))


def test_a_second_run_gives_the_same_bytes(four_processes: Path, tmp_path: Path) -> None:
    again = record(tmp_path)
    assert command(four_processes).tobytes() == command(again).tobytes()


def test_one_process_per_joint_gives_the_same_torques(four_processes: Path, tmp_path: Path) -> None:
    seven = record(tmp_path, joint_groups=tuple((name,) for name in JOINTS))
    assert command(four_processes).tobytes() == command(seven).tobytes()


def test_one_thread_gives_the_same_torques(four_processes: Path, tmp_path: Path) -> None:
    chain = record(tmp_path, nodes=("chain",))
    assert np.all(np.isfinite(command(chain))), "a message was lost"
    assert command(four_processes).tobytes() == command(chain).tobytes()


def test_two_robots_on_one_domain_do_not_hear_each_other(four_processes: Path, tmp_path: Path) -> None:
    """Two chains with plant and recorder, in two namespaces, at the same time; each commands what it commands alone."""
    domain, parameters = random_domain(), {"chain": {"pause_at_tick": PAUSE}}
    plans = [
        RunPlan(nodes=("chain",), lockstep=True, namespace=name, bag=tmp_path / name, parameters=parameters)
        for name in ("left", "right")
    ]
    with Session(plans[0], domain, tmp_path / "logs_left") as left:
        with Session(plans[1], domain, tmp_path / "logs_right") as right:
            for robot in (left, right):
                robot.activate()
            for robot in (left, right):
                robot.wait_until_tick(PAUSE)
            left.send_goal(a_goal())
            for robot in (left, right):
                assert not robot.set_parameters("chain", {"pause_at_tick": END})
            for robot in (left, right):
                robot.run_to(END)  # waits for its recorder too: the chain is faster
    assert set(left.exit_codes.values()) | set(right.exit_codes.values()) == {0}
    assert command(tmp_path / "left").tobytes() == command(four_processes).tobytes()
    resting = command(tmp_path / "right")
    assert np.array_equal(resting[:GOAL_TICK], command(four_processes)[:GOAL_TICK])
    with BagReader(tmp_path / "right") as reader:
        assert np.ptp(reader.columns("joint_reference").position, axis=0).max() == 0.0, "it got the other one's goal"
        assert all(topic.startswith("/right/") for topic in reader.topics)


def test_the_runner_without_ros_gives_the_same_torques(four_processes: Path) -> None:
    runner = Runner(RunSetup(PlantConfig.from_file("arm_a")))
    rows = []
    for tick in range(END):
        if tick == PAUSE:
            runner.offer(a_goal())
        rows.append(runner.step()["motor_torque_command"]["effort"].copy())
    assert command(four_processes).tobytes() == np.array(rows).tobytes()
