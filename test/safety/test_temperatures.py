"""Motor temperatures correct the gauge: one that cannot be must not move the arm (HD-F45)."""

import math

import numpy as np
import pytest
from monitors import FORMS, Sensors

from hd_control.core.faults import Action, FaultCode
from hd_sim.plant_config import PlantConfig
from hd_sim.runner import Runner, RunSetup

LIMITS = {"motor_temperature_low": -40.0, "motor_temperature_high": 200.0, "motor_temperature_rate": 5.0}
STILL = np.zeros((3, 2))


class Motor:
    """Sensors at rest, whose temperature a test sets. One tick is 1 ms."""

    def __init__(self, form):
        self.sensors = Sensors(form, **LIMITS)

    def __call__(self, *temperature, ticks=1):
        """`ticks` samples, the first with this reading (2,) degC; what corrects the gauge, and the findings."""
        warm, found = self.sensors.sample.motor_temperature, []
        warm[:] = temperature
        for _ in range(ticks):
            found += [(f.code, f.joint, f.value, f.limit, f.action) for f in self.sensors.send(*STILL)]
        return warm.tolist(), found


@pytest.fixture(params=FORMS)
def motor(request):
    return Motor(request.param)


def report(joint, value, limit):
    return (FaultCode.TEMPERATURE_BAD, joint, value, limit, Action.REPORT)


def test_f45_a_temperature_out_of_range_is_not_used(motor):
    assert motor(25.0, 26.0) == ([25.0, 26.0], [])
    assert motor(1e4, 26.0) == ([25.0, 26.0], [report(0, 1e4, 200.0)])
    assert motor(25.0, -41.0) == ([25.0, 26.0], [report(1, -41.0, -40.0)])
    for odd in (math.inf, -math.inf):
        assert motor(odd, 26.0)[0] == [25.0, 26.0]
    used, [finding] = motor(math.nan, 26.0)
    assert used == [25.0, 26.0] and finding[:2] == (FaultCode.TEMPERATURE_BAD, 0)


def test_f45_before_the_first_usable_reading_there_is_none(motor):
    used, found = motor(math.nan, 1e4)
    assert np.isnan(used).all() and found == [report(1, 1e4, 200.0)]
    assert motor(200.0, -40.0) == ([200.0, -40.0], []), "the first is taken as it is, the ends of the range too"


def test_f45_a_jump_is_followed_no_faster_than_a_motor_can_change(motor):
    motor(25.0, 25.0)
    used, found = motor(125.0, 25.0)
    assert used == [30.0, 25.0] and found == [report(0, 125.0, 25.0)], "a second's worth of the rate is in reserve"
    for _ in range(10):  # ten messages in a second
        used, found = motor(125.0, 25.0, ticks=100)
        assert len(found) == 1
    assert used[0] == pytest.approx(30.0 + 5.0 * 0.9, abs=0.02)


def test_f45_many_small_steps_are_no_way_around_the_rate(motor):
    motor(25.0, 25.0)
    value = 25.0
    for _ in range(200):
        value += 0.5
        [value, _], _ = motor(value, 25.0)
    assert value == pytest.approx(25.0 + 5.0 * 1.2, abs=0.01)


def test_f45_an_ordinary_change_is_used_bit_for_bit(motor):
    motor(25.0, 25.0)
    warm = 25.0
    for _ in range(20):
        warm += 0.49
        assert motor(warm, 25.0, ticks=100) == ([warm, 25.0], [])


def test_a_new_activation_takes_the_temperature_that_it_finds(motor):
    motor(25.0, 25.0)
    motor.sensors._stage.start()
    assert motor(90.0, 25.0) == ([90.0, 25.0], [])


@pytest.mark.parametrize("wrong", [1e4, -1e4, math.inf, 200.0])
def test_f45_a_foreign_temperature_does_not_throw_the_arm(wrong):
    """One second at a drift of 0.5 N m/K: before, the torque went to its limit and the joint to 4.8 rad/s."""
    drift = {"fusion_node": {"gauge_temperature_drift": [0.5] * 7}}
    runner = Runner(RunSetup(PlantConfig.from_file("single_joint_7"), 0, drift))
    runner.run_on(400)
    fastest = 0.0
    for tick in range(1000):
        if tick % 10 == 0:
            runner.fusion.sample.motor_temperature[:] = wrong
        runner.step()
        fastest = max(fastest, abs(runner.world.seam.plant.state.joint_velocity.item()))
    assert fastest < 0.1 and not runner.torque.guard.stopped and not runner.world.seam.stopped
    assert FaultCode.TEMPERATURE_BAD.text in str(runner.fusion.faults.values(runner.robot.joint_names))
