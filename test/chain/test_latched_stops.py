"""A latched stop survives whatever starts anew: the law, its node, another law in its place. Only a reset ends it."""

import numpy as np
import pytest

from hd_control.core.faults import FaultCode
from hd_sim.plant_config import PlantConfig
from hd_sim.runner import Runner, RunSetup


def setup_of(**torque):
    return RunSetup(PlantConfig.from_file("single_joint_5"), 0, {"torque_node": torque})


@pytest.fixture
def stopped():
    """A robot whose torque law has stopped, and the tick of that."""
    runner = Runner(setup_of())
    runner.run_on(200)
    runner.torque.emergency()
    runner.run_on(100)
    assert runner.torque.guard.stopped and runner.torque.faults.first_stop.code is FaultCode.NOT_FINITE
    return runner


def test_a_new_activation_of_the_torque_law_stays_stopped_and_gives_no_torque(stopped):
    stopped.torque.start()
    stopped.run_on(300)
    assert stopped.torque.guard.stopped and stopped.torque.mode == "STOPPED"
    assert np.all(stopped.torque.allowed == 0.0) and stopped.torque.faults.first_stop is not None


def test_many_activations_end_no_stop(stopped):
    for _ in range(20):
        stopped.torque.start()
        stopped.run_on(600)
    assert stopped.torque.guard.stopped and np.all(stopped.torque.allowed == 0.0)


def test_another_law_in_the_same_place_stays_stopped(stopped):
    setup = setup_of(law="torque_feedback")
    stopped.torque.adopt(stopped.torque.prepare(setup.node_values("torque_node")))
    stopped.torque.start()
    stopped.run_on(600)
    assert stopped.torque.params.layout.name == "FeedbackParams"
    assert stopped.torque.guard.stopped and np.all(stopped.torque.allowed == 0.0)


def test_the_same_activation_goes_on_after_a_reset(stopped):
    stopped.torque.start()
    stopped.run_on(600)
    stopped.motion.reset_asked = True
    stopped.run_on(2)
    stopped.torque.reset_asked = True
    stopped.run_on(2)
    assert stopped.torque.reset_answer == [] and not stopped.torque.guard.stopped
