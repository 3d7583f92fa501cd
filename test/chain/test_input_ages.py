"""Each input of the torque law has an age: what stays away or is of another tick is seen by the gate (HD-F18)."""

import numpy as np
import pytest

from hd_control import _plane
from hd_control.core import topics
from hd_control.core.faults import FaultCode
from hd_control.nodes.fast_loop import make_input
from hd_control.record.schema import joint_state_codec
from hd_sim.plant_config import PlantConfig
from hd_sim.runner import Runner, RunSetup

LIMIT = 10
INPUTS = (topics.MOTOR_STATES, topics.JOINT_STATES, topics.REFERENCE, topics.REQUIRED)


@pytest.fixture
def runner():
    found = Runner(RunSetup(PlantConfig.from_file("single_joint_5")))
    found.run_on(150)
    assert not found.torque.guard.stopped
    return found


def without(runner, topic):
    """One tick in which a message between the laws did not come: the torque law runs on the one before."""
    step = runner.torque.step
    runner.torque.step = lambda tick, bus: step(tick, {name: each for name, each in bus.items() if name != topic})
    runner.step()
    runner.torque.step = step


@pytest.mark.parametrize("topic", INPUTS)
def test_f18_an_input_of_the_torque_law_that_stays_away_stops_at_the_age_limit(runner, topic):
    for _ in range(LIMIT - 1):
        without(runner, topic)
    assert not runner.torque.guard.stopped
    runner.step()  # it was there again
    assert not runner.torque.guard.stopped
    for _ in range(LIMIT):
        without(runner, topic)
    first = runner.torque.faults.first_stop
    assert first.code is FaultCode.NODE_KILLED and (first.value, first.limit) == (LIMIT, LIMIT)


def test_f18_an_input_of_a_later_tick_stops_at_once(runner):
    act = runner.torque.act

    def late(tick):
        runner.torque.input_ticks[2] = tick + 1
        act(tick)

    runner.torque.act = late
    runner.step()
    first = runner.torque.faults.first_stop
    assert first.code is FaultCode.NODE_KILLED and first.value == -1.0


def test_an_input_that_counts_only_once_it_was_seen_has_no_age_before():
    runner = Runner(RunSetup(PlantConfig.from_file("single_joint_5")))
    for _ in range(3 * LIMIT):
        without(runner, topics.REFERENCE)
    assert not runner.torque.guard.stopped and np.isnan(runner.torque.input_ticks[2])


def test_a_new_activation_knows_no_input(runner):
    runner.torque.start()
    seen = runner.torque.input_ticks
    assert np.isnan(seen[2]) and seen[[0, 1, 3]].tolist() == [-1.0] * 3
    runner.run_on(20)
    assert not runner.torque.guard.stopped and seen.tolist() == [169.0] * 4


def test_the_join_of_a_node_gives_each_input_its_tick(runner):
    """What the nodes' messages write beside their numbers; the same destinations that a node uses."""
    stage, dt_ns = runner.torque, 1_000_000
    join = _plane.Join(dt_ns)
    codecs = [joint_state_codec(topic, runner.robot.joint_names) for topic in INPUTS]
    for topic, codec in zip(INPUTS, codecs, strict=True):
        join.add(make_input(codec, stage.destinations(topic), topic in stage.wiring.optional))
    for index, codec in enumerate(codecs):
        arrays = {name: np.full(1, 0.25) for name in codec.fields}
        join.offer(index, codec.encode(777 * dt_ns, "a" * 16, **arrays))
    assert stage.input_ticks.tolist() == [777.0] * 4 and stage.sample.joint_velocity[0] == 0.25
