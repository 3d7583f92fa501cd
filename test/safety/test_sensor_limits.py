"""Monitors of the sensors with numbers exactly on a limit, and the least step beyond it; compiled and plain form."""

import math

import numpy as np
import pytest
from monitors import FORMS, STIFFNESS, Sensors
from oracles.sensor_monitors_law import LARGEST_STEP, LONGEST_WAY, WHOLE_TURN

from hd_control.core.faults import Action, FaultCode

STEP = 2.0**-7
"""A limit without rounding."""
BIT = 2.0**-40
"""A step beyond it that still has none."""
ZERO = np.zeros(2)
REPORT, STOP = Action.REPORT, Action.CONTROLLED_STOP
pytestmark = pytest.mark.parametrize("form", FORMS)


@pytest.mark.parametrize("row", [0, 1, 2])
@pytest.mark.parametrize("side", [1.0, -1.0])
@pytest.mark.parametrize("over", [0.0, BIT])
def test_a_jump_of_exactly_the_limit_is_none(form, row, side, over):
    """Alone, and while the other joint jumps further."""
    for other in (0.0, 1.0):
        sensors = Sensors(form, position_step_limit=STEP, gauge_step_limit=STEP)
        readings = np.zeros((3, 2))
        assert sensors.send(*readings) == []
        readings[row] = side * (STEP + over), other
        faults = sensors.send(*readings)
        assert [(f.joint, f.code) for f in faults if f.joint == 0] == [(0, FaultCode.SPIKE)] * bool(over)
        assert [f.joint for f in faults if f.joint == 1] == [1] * bool(other)
        assert sensors.used[row, 0] == (0.0 if over else side * STEP)


@pytest.mark.parametrize("over", [0.0, BIT])
def test_a_jump_that_stays_within_exactly_the_limit_is_taken_over(form, over):
    sensors = Sensors(form, position_step_limit=STEP, rejected_samples=3.0)
    sensors.send(ZERO, ZERO, ZERO)
    for value in (2.0, 2.0, 2.0 + STEP + over):
        faults = sensors.send([value, 0.0], ZERO, ZERO)
    assert [f.action for f in faults] == [STOP]
    assert bool(sensors.send([value, 0.0], ZERO, ZERO)) is bool(over), "what did not stay within is still rejected"


@pytest.mark.parametrize("share", [1.0, -1.0])
def test_exactly_as_many_bad_readings_as_are_bridged(form, share):
    sensors = Sensors(form, position_step_limit=STEP, rejected_samples=4.0)
    sensors.send(ZERO, ZERO, ZERO)
    actions = [sensors.send([share * 3.0**k, 0.0], ZERO, ZERO)[0].action for k in range(1, 6)]
    assert actions == [REPORT] * 3 + [STOP] * 2


# ---- frozen gauge, rail, disagreement ----------------------------------------------------------------------------


@pytest.mark.parametrize("start", [0.0, 1.0])
@pytest.mark.parametrize("side", [1.0, -1.0])
def test_f03_a_gauge_that_slept_through_exactly_the_limit_is_not_frozen(form, start, side):
    sensors, motion = Sensors(form, twist_limit=STEP, frozen_samples=4.0, disagree_samples=1e9), 5.0 * STEP
    place = np.array([start, 0.0])
    for _ in range(9):
        sensors.send(place, place, [5.0, 5.0])
    place = place + side * np.array([motion, 2.0 * motion])
    assert [f.joint for f in sensors.send(place, place, [5.0, 5.0])] == [1]
    place = place + side * np.array([BIT, 0.0])
    assert [f.joint for f in sensors.send(place, place, [5.0, 5.0])] == [0, 1]


def test_f03_a_gauge_may_repeat_itself_one_sample_less_often_than_the_limit(form):
    sensors, seen = Sensors(form, twist_limit=STEP, frozen_samples=6.0, disagree_samples=1e9), []
    for k in range(8):
        seen.append(len(sensors.send([k, 0.0], [k, 0.0], ZERO)))
    assert seen == [0] * 5 + [1] * 3, "the first reading counts"


@pytest.mark.parametrize("side", [1.0, -1.0])
@pytest.mark.parametrize("over", [0.0, BIT])
def test_f07_positions_apart_by_exactly_the_limit_agree(form, side, over):
    """Alone, and while the other joint's positions are further apart."""
    for other in (0.0, 2.0 * STEP):
        sensors = Sensors(form, twist_limit=STEP, disagree_samples=3.0)
        for k in range(1, 5):
            faults = sensors.send([side * (STEP + over), side * other], ZERO, ZERO)
            expected = [0] * bool(over) + [1] * bool(other)
            assert [f.joint for f in faults] == (expected if k >= 3 else [])


@pytest.mark.parametrize("side", [1.0, -1.0])
def test_f08_exactly_at_99_percent_of_the_rail(form, side):
    """0.99 times 100 is 99; one bit below it is no rail. The other joint is there or not."""
    below = math.nextafter(99.0, 0.0)
    for other in (0.0, 100.0):
        sensors = Sensors(form, gauge_rail=100.0, rail_samples=3.0)
        for k in range(1, 5):
            faults = sensors.send(ZERO, ZERO, [side * 99.0, other])
            assert [f.action for f in faults] == [STOP if k >= 3 else REPORT] * (1 + bool(other))
        assert [f.joint for f in sensors.send(ZERO, ZERO, [side * below, other])] == [1] * bool(other)
        again = sensors.send(ZERO, ZERO, [side * 99.0, other])
        assert [f.action for f in again if f.joint == 0] == [REPORT], "the count begins anew"


# ---- the residual over the motor's turn --------------------------------------------------------------------------


def follow(form, angles, residual=8.0, gauge=lambda angle: 0.0, **limits):
    """The shaft of joint 0 moves over these angles, that of joint 1 stands; faults of every sample."""
    sensors, found = Sensors(form, **limits), []
    for angle in angles:
        found.append(sensors.send([angle, 0.0], [angle, 0.0], [residual + gauge(angle), 0.0]))
    return sensors, found


QUARTERS = [0.25 * k for k in range(26)]
"""Steps without rounding, up to 6.25 rad."""


@pytest.mark.parametrize("side", [1.0, -1.0])
@pytest.mark.parametrize(("last", "whole"), [(WHOLE_TURN, True), (math.nextafter(WHOLE_TURN, 0.0), False)])
def test_f10_a_turn_is_whole_at_exactly_two_pi_and_the_other_joint_goes_on(form, side, last, whole):
    sensors, _ = follow(form, [side * angle for angle in [*QUARTERS, last]])
    assert bool(sensors.mean[0] == 8.0) is whole and math.isnan(sensors.mean[1])


def there_and_back(way):
    """Forth to 4 rad and back until so much way is made, then a whole turn."""
    back = [4.0 - 0.25 * k for k in range(1, 16)]
    end = 0.25 - (way - 7.75)
    return [*QUARTERS[:17], *back, end, *(end + 0.25 * k for k in range(1, 30))]


def test_f10_a_way_of_exactly_one_and_a_quarter_turns_still_counts(form):
    """The sums begin anew once the way is longer."""
    assert LONGEST_WAY == 1.25 * WHOLE_TURN

    def ends(way):
        sensors, ended = Sensors(form), []
        for k, angle in enumerate(there_and_back(way)):
            sensors.send([angle, 0.0], [angle, 0.0], [8.0, 0.0])
            if not math.isnan(sensors.mean[0]):
                ended.append(k)
        return ended[:1]

    # 26 steps of 0.25 rad after the sums have begun anew: with sample 32, which is beyond, or with the one behind it.
    assert ends(LONGEST_WAY + 2.0**-30) == [32 + 26] and ends(LONGEST_WAY) == [33 + 26]


@pytest.mark.parametrize("side", [1.0, -1.0])
def test_f10_the_largest_step_is_still_followed(form, side):
    """One step of exactly 0.3 rad, then the rest of a turn; one bit more and the turn begins behind it."""

    def ended(step):
        sensors = Sensors(form)
        for k, angle in enumerate([0.0, step, *(step + 0.25 * j for j in range(1, 60))]):
            sensors.send([side * angle, 0.0], [side * angle, 0.0], [8.0, 0.0])
            if not math.isnan(sensors.mean[0]):
                return k, float(sensors.mean[0])
        return None

    first, later = ended(LARGEST_STEP), ended(math.nextafter(LARGEST_STEP, 1.0))
    assert first == (25, pytest.approx(8.0)) and later == (27, pytest.approx(8.0))


@pytest.mark.parametrize(
    ("limit", "action"),
    [(8.0, None), (math.nextafter(8.0, 0.0), REPORT), (4.0, REPORT), (math.nextafter(4.0, 0.0), STOP)],
)
@pytest.mark.parametrize("sign", [1.0, -1.0])
def test_f10_a_mean_exactly_on_its_bounds(form, limit, action, sign):
    sensors, found = follow(form, [*QUARTERS, WHOLE_TURN], residual=sign * 8.0, residual_limit=limit)
    assert sensors.mean[0] == sign * 8.0 and not any(found[:-1])
    expected = [] if action is None else [(FaultCode.GAUGE_DRIFT, 0, sign * 8.0, limit, action)]
    assert [(f.code, f.joint, f.value, f.limit, f.action) for f in found[-1]] == expected


@pytest.mark.parametrize(("part", "action"), [(1.0, None), (1.0 - 1e-12, REPORT), (0.5, REPORT), (0.5 - 1e-12, STOP)])
def test_f09_a_ripple_exactly_on_its_bounds(form, part, action):
    def run(limit):
        wave = lambda angle: 3.0 * math.cos(2.0 * angle) - 4.0 * math.sin(2.0 * angle)  # noqa: E731 - short
        return follow(form, [*QUARTERS, WHOLE_TURN], 0.0, wave, ripple_limit=limit)

    size = float(run(1e9)[0].ripple[0])
    assert size == pytest.approx(5.0, rel=0.1)
    _, found = run(part * size)
    assert [(f.code, f.action) for f in found[-1]] == ([] if action is None else [(FaultCode.GAUGE_BRANCH, action)])


# ---- positions that repeat themselves ----------------------------------------------------------------------------


@pytest.mark.parametrize("still", [0, 1])
@pytest.mark.parametrize("side", [1.0, -1.0])
@pytest.mark.parametrize("over", [0.0, BIT])
def test_f03_a_position_that_missed_exactly_the_limit_is_not_stuck(form, still, side, over):
    """One position stands, the other moves; joint 1 further than joint 0."""
    for other in (STEP, 2.0 * STEP):
        sensors = Sensors(form, frozen_samples=16.0, stuck_motion_limit=STEP)
        places = np.ones((2, 2))
        for _ in range(9):
            sensors.send(*places, ZERO)
        places[1 - still] = 1.0 + side * np.array([STEP + over, other])
        faults = sensors.send(*places, ZERO)
        assert [(f.joint, f.code) for f in faults] == [
            (joint, FaultCode.VALUE_FROZEN) for joint, beyond in ((0, over), (1, other > STEP)) if beyond
        ]
        assert sensors.missed.tolist() == [STEP + over, other]


def test_f03_a_twist_of_the_spring_is_expected_of_both_positions(form):
    """motor - joint = torque / stiffness: a position that stands is expected at the other one and the twist."""
    for still in (0, 1):
        sensors, places = Sensors(form, frozen_samples=16.0, stuck_motion_limit=STEP), np.ones((2, 2))
        for _ in range(9):
            sensors.send(*places, ZERO)
        places[1 - still] = 1.0 + 4.0 * STEP
        twist = np.array([0.0, -4.0 * STEP if still == 0 else 4.0 * STEP])  # explains joint 1 away
        assert [f.joint for f in sensors.send(*places, STIFFNESS * twist)] == [0]


def test_f03_a_position_may_repeat_itself_one_look_less_often_than_the_limit(form):
    """Each look stands for four samples, the first among them."""
    sensors, seen = Sensors(form, frozen_samples=24.0, stuck_motion_limit=STEP), []
    for k in range(8):
        seen.append(len(sensors.send(ZERO + k, ZERO, ZERO)))
    assert seen == [0] * 5 + [2] * 3


def test_the_sensors_are_compared_every_fourth_tick(form):
    """The mean of a turn appears in a tick that four divides, and only there."""
    sensors, seen = Sensors(form), []
    sensors.send(ZERO, ZERO, ZERO)
    for k in range(1, 400):
        sensors.send([0.02 * k, 0.0], [0.02 * k, 0.0], [8.0, 0.0], ticks=1)
        seen.append(math.isnan(sensors.mean[0]))
    first = seen.index(False) + 1
    assert first % 4 == 0 and first == 4 * math.ceil(WHOLE_TURN / 0.08)
