"""Monitors of encoder, resolver and gauge bridge: what they bridge, what stops, what they take over again.

Each in its compiled form and in that of the oracle.
"""

import math

import numpy as np
import pytest
from monitors import FORMS, STIFFNESS, Sensors
from oracles.sensor_monitors_law import LARGEST_STEP, LONGEST_WAY, WHOLE_TURN

from hd_control.core.faults import Action, FaultCode

STEPS = {"position_step_limit": [0.01, 0.02], "gauge_step_limit": [50.0, 20.0], "rejected_samples": 3.0}
REST = np.zeros(2)
REPORT, STOP = Action.REPORT, Action.CONTROLLED_STOP
pytestmark = pytest.mark.parametrize("form", FORMS)


def reading(**changes):
    """Resting sensors (3, 2) with some numbers changed, by `row_joint`."""
    numbers = np.array([[1.0, -2.0], [1.0, -2.0], [30.0, -5.0]])
    for place, value in changes.items():
        row, joint = place.split("_")
        numbers[("encoder", "resolver", "gauge").index(row), int(joint)] = value
    return numbers


def screened(form, rows, **options):
    """What becomes of a list of readings after the first: (used, faults) of each."""
    sensors, found = Sensors(form, **{**STEPS, **options}), []
    for row in rows:
        faults = sensors.send(*row)
        found.append((sensors.used, faults))
    assert found[0][1] == []
    return found[1:]


# ---- F04, F05, F06: single readings ------------------------------------------------------------------------------


def test_ordinary_motion_passes_bit_for_bit(form):
    rows = [reading(encoder_0=1.0 + 0.009 * k, gauge_1=-5.0 + 15.0 * k) for k in range(20)]
    for (used, faults), row in zip(screened(form, rows), rows[1:], strict=True):
        assert used.tobytes() == row.tobytes() and faults == []


def test_f06_an_encoder_wraps_at_its_own_period_whatever_the_gear(form):
    """At 2 pi of the rotor, so at a quarter of it on the output side of a gear of 4."""
    wrap = 2.0 * math.pi
    rows = [reading(encoder_0=((4.0 + 0.036 * k + math.pi) % wrap - math.pi) / 4.0) for k in range(300)]
    found = screened(form, rows, periods=(wrap, 0.0), gear=4.0)
    assert all(faults == [] for _, faults in found)
    assert sum(abs(b[0][0] - a[0][0]) > 1.0 for a, b in zip(rows, rows[1:], strict=False)) > 0, "it has wrapped"


def test_a_spike_of_one_joint_leaves_the_prediction_of_the_other_as_it_would_be(form):
    """0.027 rad per sample of joint 1, limit 0.02, while joint 0 has a spike every second sample."""
    place, rows = -2.0, []
    for k, speed in enumerate((0.0, 0.015, 0.027, 0.027, 0.027, 0.027, 0.027, 0.027)):
        place += speed
        rows.append(reading(resolver_1=place, encoder_0=1.0 + 0.5 * (k % 2)))
    for (used, faults), row in zip(screened(form, rows), rows[1:], strict=True):
        assert used[1, 1] == row[1, 1] and {f.joint for f in faults} <= {0}


def test_the_limit_is_against_the_prediction_not_the_last_value(form):
    """0.027 rad per sample is fine once it was reached in steps; a jump of that size from rest is not."""
    place, rows = 1.0, []
    for speed in (0.0, 0.009, 0.018, 0.027, 0.027, 0.027):
        place += speed
        rows.append(reading(encoder_0=place))
    assert all(faults == [] for _, faults in screened(form, rows))
    _, faults = screened(form, [reading(), reading(encoder_0=1.03)])[0]
    assert [(f.code, f.joint, f.action) for f in faults] == [(FaultCode.SPIKE, 0, REPORT)]
    assert faults[0].value == pytest.approx(0.03) and faults[0].limit == 0.01


@pytest.mark.parametrize("bad", [math.nan, math.inf, -math.inf, 1.5])
def test_f04_f05_two_bad_readings_are_bridged_by_the_prediction(form, bad):
    rows = [reading(encoder_0=1.0), reading(encoder_0=1.004), reading(encoder_0=bad), reading(encoder_0=bad + 0.1),
            reading(encoder_0=1.01)]  # fmt: skip
    found = screened(form, rows)
    assert found[1][0][0, 0] == pytest.approx(1.008) and found[2][0][0, 0] == pytest.approx(1.010)
    assert found[3][1] == [] and found[3][0][0, 0] == 1.01
    code = FaultCode.SPIKE if math.isfinite(bad) else FaultCode.NOT_FINITE
    for _, faults in found[1:3]:
        assert [(f.code, f.joint, f.action) for f in faults] == [(code, 0, REPORT)]
    assert found[1][0][1:].tobytes() == rows[0][1:].tobytes(), "the other sensors are used as they are"


def test_f04_the_third_in_a_row_is_withheld_and_stops(form):
    found = screened(form, [reading()] + [reading(gauge_1=math.nan)] * 4)
    assert [f.action for _, faults in found for f in faults] == [REPORT] * 2 + [STOP] * 2
    assert all(math.isnan(used[2, 1]) for used, _ in found[2:]) and not math.isnan(found[1][0][2, 1])


def test_f05_a_jump_that_stays_stops_once_and_is_taken_over(form):
    found = screened(form, [reading()] + [reading(resolver_1=-2.5)] * 5)
    assert [len(faults) for _, faults in found] == [1, 1, 1, 0, 0]
    assert math.isnan(found[2][0][1, 1]) and found[3][0][1, 1] == -2.5
    assert found[2][1][0].action is STOP
    rows = [reading()] + [reading(resolver_1=-2.5)] * 3 + [reading(resolver_1=-9.0), reading(resolver_1=-7.0)]
    assert [faults[0].action for _, faults in screened(form, rows)[3:]] == [REPORT] * 2, "the count begins anew"


def test_f05_a_run_of_different_nonsense_goes_on_stopping(form):
    found = screened(form, [reading()] + [reading(resolver_1=3.0 * k) for k in range(1, 7)])
    assert [faults[0].action for _, faults in found[2:]] == [STOP] * 4
    assert all(math.isnan(used[1, 1]) for used, _ in found[2:])


def test_f05_a_long_gap_does_not_run_away(form):
    """Bridged readings go on with half the slope, a quarter, an eighth."""
    found = screened(form, [reading(), reading(encoder_0=1.008)] + [reading(encoder_0=9.0)] * 4, rejected_samples=9.0)
    steps = np.diff([1.0, *(used[0, 0] for used, _ in found)])
    np.testing.assert_allclose(steps, [0.008, 0.008, 0.004, 0.002, 0.001], rtol=1e-9)


def test_good_readings_between_bad_ones_begin_the_count_anew(form):
    bad, good = reading(encoder_0=9.0), reading()
    found = screened(form, [good, bad, bad, good, bad, bad, good, bad])
    assert all(f.action is REPORT for _, faults in found for f in faults)
    assert all(np.isfinite(used).all() for used, _ in found)


def test_a_first_reading_that_is_no_number_stops_until_there_is_one(form):
    found = screened(form, [reading(encoder_0=math.inf)] + [reading()] * 4)
    assert [len(faults) for _, faults in found] == [1, 1, 1, 0] and np.isfinite(found[0][0][1:]).all()


@pytest.mark.parametrize("row", ["encoder", "resolver"])
def test_f06_the_wrap_of_a_counter_is_no_spike(form, row):
    def counts(places, period):
        rows = [reading(**{f"{row}_0": place}) for place in places]
        both = (period, 0.0) if row == "encoder" else (0.0, period)
        return [len(faults) for _, faults in screened(form, rows, periods=both)]

    assert counts((1.99, 1.998, 0.006, 0.014, 1.998, 1.99), [2.0, 0.0]) == [0, 0, 0, 1, 1]
    assert counts((0.01, 0.004, 1.998, 1.992), [2.0, 0.0]) == [0, 0, 0]
    assert counts((0.49, 0.498, 0.006, 0.014), [0.5, 0.0]) == [0, 0, 0], "also below 1 rad"
    assert counts((1.99, 1.998, 0.006), [0.0, 2.0])[1] == 1, "without a period of its own it is one"


def test_f06_the_wrap_of_a_counter_is_no_spike_beside_a_jump_of_the_other_joint(form):
    rows = [reading(encoder_0=place) for place in (1.99, 1.998, 0.006, 0.014)]
    rows[2][1, 1] = 9.0
    found = screened(form, rows, periods=([2.0, 0.0], 0.0))
    assert [[f.joint for f in faults] for _, faults in found] == [[], [1], []]
    assert [used[0, 0] for used, _ in found] == [1.998, 0.006, 0.014]


def test_f06_a_jump_that_stays_behind_a_wrap_is_taken_over(form):
    """Raw readings on both sides of the wrap are neighbours."""
    rows = [reading(encoder_0=1.0), *(reading(encoder_0=place) for place in (1.999, 0.001, 1.999, 0.001))]
    assert [len(faults) for _, faults in screened(form, rows, periods=([2.0, 0.0], 0.0))] == [1, 1, 1, 0]


# ---- F03 for the gauge -------------------------------------------------------------------------------------------

GAUGE = {"twist_limit": [0.01, 0.02], "frozen_samples": 4.0}


def frozen(form, gauges, positions):
    """Faults of each sample; gauges and positions are lists of (2,)."""
    sensors = Sensors(form, **{**GAUGE, "disagree_samples": 1e9})
    return [
        (sensors.send(place, place, gauge), sensors.withheld) for gauge, place in zip(gauges, positions, strict=True)
    ]


def test_f03_a_gauge_that_repeats_itself_in_motion(form):
    """Joint 0 repeats itself and moves by 0.01 rad per sample: five twist limits of motion are exceeded after 6."""
    seen = frozen(form, [(3.0, 1.0 * k) for k in range(12)], [(0.01 * k, 0.02 * k) for k in range(12)])
    assert [len(faults) for faults, _ in seen] == [0] * 6 + [1] * 6
    assert all(withheld.tolist() == [bool(faults), False] for faults, withheld in seen)
    fault = seen[-1][0][0]
    assert (fault.code, fault.joint, fault.value, fault.limit) == (FaultCode.VALUE_FROZEN, 0, 12.0, 4.0)
    assert fault.action is STOP


def test_f03_another_reading_of_the_gauge_begins_the_count_anew(form):
    gauges = [(3.0, 0.0)] * 8 + [(3.1, 0.0)] * 8
    seen = frozen(form, gauges, [(0.01 * k, 0.0) for k in range(16)])
    assert [len(faults) for faults, _ in seen] == [0] * 6 + [1] * 2 + [0] * 6 + [1] * 2


def test_f03_never_at_standstill_and_not_after_a_few_samples(form):
    rest = frozen(form, [(0.0, 0.0)] * 500, [(0.0, 0.0)] + [(0.05, -0.09)] * 499)
    assert all(faults == [] for faults, _ in rest)
    quick = frozen(form, [(0.0, 0.0)] * 5, [(1.0 * k, 0.0) for k in range(5)])
    assert [len(faults) for faults, _ in quick] == [0, 0, 0, 1, 1], "four repeats, however far it moved"


# ---- F07 and F08 -------------------------------------------------------------------------------------------------


def test_f08_the_rail_of_the_gauge(form):
    sensors, actions = Sensors(form, gauge_rail=[200.0, 100.0], rail_samples=3.0, rejected_samples=1.0), []
    for value in (197.9, 198.0, -199.0, 250.0, 197.9, 250.0, math.nan, 250.0):
        faults = [f for f in sensors.send(REST, REST, [value, 0.0]) if f.code is FaultCode.GAUGE_RAIL]
        actions.append([f.action for f in faults])
        assert sensors.withheld.tolist() == [actions[-1] == [STOP] or math.isnan(value), False]
    assert actions == [[], [REPORT], [REPORT], [STOP], [], [REPORT], [], [REPORT]]
    assert [(f.joint, f.value, f.limit) for f in faults] == [(0, 250.0, 200.0)]


def test_f07_positions_that_no_twist_explains(form):
    sensors, seen = Sensors(form, twist_limit=[0.01, 0.02], disagree_samples=5.0, rejected_samples=1.0), []
    for difference in (0.02, 0.021, -0.021, 0.021, 0.021, 0.021, 0.02, 0.021, math.nan, *([-0.03] * 5)):
        faults = sensors.send([0.5, difference], [0.5, 0.0], REST)
        faults = [f for f in faults if f.code is FaultCode.POSITION_DISAGREE]
        seen.append(len(faults))
        assert sensors.withheld.tolist() == [False, bool(faults) or math.isnan(difference)]
    assert seen == [0] * 5 + [1] + [0] * 7 + [1], "the fifth in a row, and from the first again after a good one"
    assert [(f.joint, f.value, f.limit, f.action) for f in faults] == [(1, -0.03, 0.02, STOP)]


# ---- F09 and F10 -------------------------------------------------------------------------------------------------

TURN = {"residual_limit": [10.0, 5.0], "ripple_limit": [20.0, 8.0], "rejected_samples": 1.0}


def turned(form, residual, angles, sensors=None):
    """All faults of a motion over these angles of the shaft, joint 1 backwards, and the monitors after it.

    Encoder and resolver agree, so what the gauge reads is the residual; residual(beta) -> (2,).
    """
    sensors = sensors or Sensors(form, **TURN)
    found = []
    for angle in angles:
        shaft = np.array([angle, -angle])
        found += sensors.send(shaft, shaft, residual(shaft))
    return sensors, found


def turn(form, residual, turns=1.05, steps=400):
    """The same over some turns."""
    return turned(form, residual, np.linspace(0.0, 2.0 * np.pi * turns, steps + 1))


def test_f10_the_mean_residual_over_a_turn(form):
    sensors, faults = turn(form, lambda beta: np.array([9.0, -5.5]))
    assert sensors.mean == pytest.approx([9.0, -5.5]) and np.all(sensors.ripple < 0.5)
    assert [(f.code, f.joint, f.limit, f.action) for f in faults] == [(FaultCode.GAUGE_DRIFT, 1, 5.0, REPORT)]
    assert faults[0].value == pytest.approx(-5.5)
    _, faults = turn(form, lambda beta: np.array([20.1, -9.9]))
    assert [f.action for f in faults] == [STOP, REPORT]


def test_f10_a_residual_that_stops_withholds_the_torque(form):
    sensors, seen = Sensors(form, **TURN), []
    for angle in np.linspace(0.0, 6.5, 400):
        faults = sensors.send([angle, 0.0], [angle, 0.0], [20.1, 0.0])
        seen.append(sensors.withheld.tolist())
        assert seen[-1] == [bool(faults), False]
    assert sum(joint for joint, _ in seen) == 1, "in the sample that ends the turn"


@pytest.mark.parametrize("phase", [0.0, 0.7, 1.6])
def test_f09_the_ripple_of_an_open_branch(form, phase):
    sensors, faults = turn(form, lambda beta: np.array([15.0, 9.0]) * np.cos(2.0 * beta - phase))
    assert sensors.ripple == pytest.approx([15.0, 9.0], rel=0.03) and np.all(np.abs(sensors.mean) < 0.5)
    assert [(f.code, f.joint, f.limit) for f in faults] == [(FaultCode.GAUGE_BRANCH, 1, 8.0)]
    _, quiet = turn(form, lambda beta: 100.0 * np.cos(beta) * np.array([1.0, 1.0]))
    assert quiet == [], "other orders are the gear, not the bridge"


def test_f09_f10_less_than_a_turn_is_not_observed_and_standstill_never_is(form):
    sensors, faults = turn(form, lambda beta: np.array([1e3, 1e3]), turns=0.99)
    assert faults == [] and np.isnan(sensors.mean).all() and np.isnan(sensors.ripple).all()
    sensors, faults = turned(form, lambda beta: REST + 1e6, [0.0] * 100)
    assert faults == [] and np.isnan(sensors.mean).all()


def test_f09_f10_each_turn_counts_anew_and_a_gap_begins_anew(form):
    residual = lambda beta: np.where(np.abs(beta) < 2.0 * np.pi, 6.0, 1.0) * np.ones(2)  # noqa: E731 - short
    sensors, faults = turn(form, residual, turns=2.1)
    assert [f.joint for f in faults] == [1] and sensors.mean == pytest.approx([1.0, 1.0], abs=0.1)
    for gap in ("encoder", "gauge"):
        sensors, faults = turn(form, lambda beta: np.array([90.0, 4.0]), turns=0.6)
        end, bad = np.array([1.2, -1.2]) * np.pi, np.array([math.nan, 0.0])
        sensors.send(end + bad * (gap == "encoder"), end, 90.0 + bad * (gap == "gauge"))
        _, more = turned(form, lambda beta: np.array([90.0, 4.0]), np.linspace(3.8, 3.8 + 3.9, 100), sensors)
        assert not [f for f in more if f.code is not FaultCode.NOT_FINITE], "neither part is a turn"
    sensors, _ = turn(form, lambda beta: np.array([3.0, 4.0]))
    before = sensors.mean
    sensors.send([math.nan, 0.0], REST, REST)
    assert sensors.mean.tolist() == before.tolist(), "the last turn is still known"


def test_f10_motion_to_and_fro_is_no_turn(form):
    """A hysteresis of 8 N m swung to and fro adds up to any mean; only a way without detours counts."""
    steps = np.where(np.arange(4000) // 100 % 2 == 0, 0.02, -0.018)
    angles, signs = np.cumsum(steps), iter(np.sign(steps))
    sensors, faults = turned(form, lambda beta: REST + 8.0 * next(signs), angles)
    assert faults == [] and np.isnan(sensors.mean).all()


def test_f09_f10_fast_motion_is_not_observed(form):
    for steps, observed in ((23, True), (21, False)):
        sensors, faults = turn(form, lambda beta: np.array([15.0, 9.0]), steps=steps)
        assert np.isfinite(sensors.mean).all() == observed and bool(faults) == observed
    assert 6.6 / 23 < LARGEST_STEP < 6.6 / 21 and LONGEST_WAY == 1.25 * WHOLE_TURN


# ---- F03 for the positions ---------------------------------------------------------------------------------------


def stuck_run(form, encoder, resolver, twist=0.0, samples=200):
    """Sample and joint of the first fault; positions are functions of the sample's number, joint 0 stays at rest."""
    sensors = Sensors(form, frozen_samples=80.0, stuck_motion_limit=0.002, rejected_samples=1.0)
    for k in range(samples):
        gauge = STIFFNESS * (twist(k) if callable(twist) else twist)
        faults = sensors.send([1.0, encoder(k)], [1.0, resolver(k)], [0.0, gauge])
        faults = [fault for fault in faults if fault.code is FaultCode.VALUE_FROZEN]
        if faults:
            assert [(f.limit, f.action, f.value >= 80.0) for f in faults] == [(80.0, STOP, True)]
            assert sensors.missed[faults[0].joint] > 0.002 and sensors.withheld[faults[0].joint]
            return k, faults[0].joint
    return None


@pytest.mark.parametrize(("speed", "found"), [(1e-3, 19), (-1e-3, 19), (0.9e-4, 23), (0.45e-4, 45), (1e-6, None)])
def test_f03_a_position_sensor_that_repeats_itself_while_the_other_moves(form, speed, found):
    """20 equal looks, or as many as 0.002 rad take; never without motion."""
    moves, rests = lambda k: speed * k, lambda k: 0.0
    expected = None if found is None else (found, 1)
    assert stuck_run(form, moves, rests) == stuck_run(form, rests, moves) == expected


def test_f03_a_blocked_joint_that_is_wound_up_is_no_stuck_sensor(form):
    """The motor moves by what the spring twists: the joint is expected to stand; and the other way round."""
    wound = lambda k: 0.9e-4 * k  # noqa: E731 - as short as the others
    assert stuck_run(form, lambda k: 0.3 + 0.9e-4 * k, lambda k: 0.0, wound) is None
    assert stuck_run(form, lambda k: 0.3, lambda k: 0.9e-4 * k, lambda k: -0.9e-4 * k) is None


def test_f03_a_gauge_that_drifts_at_rest_is_no_motion(form):
    """Also when the readings change now and then, and motor and joint are far apart."""
    drift = lambda k: 0.9e-4 * k  # noqa: E731 - as short as the others
    for position in (lambda k: 0.3, lambda k: 0.3 + 1e-9 * (k // 90)):
        assert stuck_run(form, position, lambda k: 0.0, drift) is None
        assert stuck_run(form, lambda k: 0.0, position, drift) is None


def test_f03_one_other_reading_begins_the_count_anew_and_no_number_expects_nothing(form):
    assert stuck_run(form, lambda k: 0.9e-4 * k, lambda k: 1e-9 * (k // 20)) is None
    assert stuck_run(form, lambda k: 0.9e-4 * k, lambda k: 0.0, math.nan) is None
    gap = stuck_run(form, lambda k: 0.9e-4 * k, lambda k: 0.0, lambda k: math.nan if k < 30 else 0.0)
    assert gap == (55, 1), "expected from the first torque on, which is used from the third reading on"
