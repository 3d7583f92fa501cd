"""Monitors of encoder, resolver and gauge bridge: what they bridge, what stops, what they take over again."""

import math

import numpy as np
import pytest

from hd_control.core.faults import Action, FaultCode
from hd_control.safety import sensor_monitors as m
from hd_control.safety import sensor_monitors as sm

LIMIT = np.array([[0.01, 0.02], [0.01, 0.02], [50.0, 20.0]])
NO_WRAP = None
LIMITS = m.SensorLimits(
    twist_limit=np.array([0.01, 0.02]),
    gauge_rail=np.array([200.0, 100.0]),
    residual_limit=np.array([10.0, 5.0]),
    ripple_limit=np.array([20.0, 8.0]),
    disagree_samples=5.0,
    frozen_samples=4.0,
    rail_samples=3.0,
    stuck_motion_limit=np.array([0.002, 0.002]),
)
NOTHING = np.zeros(2)


def reading(**changes):
    """Resting sensors (3, 2) with some numbers changed, by `row_joint`."""
    numbers = np.array([[1.0, -2.0], [1.0, -2.0], [30.0, -5.0]])
    for place, value in changes.items():
        row, joint = place.split("_")
        numbers[("encoder", "resolver", "gauge").index(row), int(joint)] = value
    return numbers


def screened(rows, period=NO_WRAP, allowed=3.0):
    """What `screen` makes of a list of readings after the first: (used, faults) of each."""
    memory, found = m.first_screen(rows[0]), []
    for row in rows[1:]:
        used, memory, faults = m.screen(row, memory, LIMIT, period, allowed)
        found.append((used, faults))
    return found


def test_ordinary_motion_passes_bit_for_bit():
    rows = [reading(encoder_0=1.0 + 0.009 * k, gauge_1=-5.0 + 15.0 * k) for k in range(20)]
    for (used, faults), row in zip(screened(rows), rows[1:], strict=True):
        assert used.tobytes() == row.tobytes() and faults == []


def test_the_limit_is_against_the_prediction_not_the_last_value():
    """0.027 rad per sample is fine once it was reached in steps; a jump of that size from rest is not."""
    place, rows = 1.0, []
    for speed in (0.0, 0.009, 0.018, 0.027, 0.027, 0.027):
        place += speed
        rows.append(reading(encoder_0=place))
    assert all(faults == [] for _, faults in screened(rows))
    _, faults = screened([reading(), reading(encoder_0=1.03)])[0]
    assert [(f.code, f.joint, f.action) for f in faults] == [(FaultCode.SPIKE, 0, Action.REPORT)]
    assert faults[0].value == pytest.approx(0.03) and faults[0].limit == 0.01


@pytest.mark.parametrize("bad", [math.nan, math.inf, -math.inf, 1.5])
def test_f04_f05_two_bad_readings_are_bridged_by_the_prediction(bad):
    rows = [reading(encoder_0=1.0), reading(encoder_0=1.004), reading(encoder_0=bad), reading(encoder_0=bad + 0.1),
            reading(encoder_0=1.01)]  # fmt: skip
    found = screened(rows)
    assert found[1][0][0, 0] == pytest.approx(1.008) and found[2][0][0, 0] == pytest.approx(1.010)
    assert found[3][1] == [] and found[3][0][0, 0] == 1.01
    code = FaultCode.SPIKE if math.isfinite(bad) else FaultCode.NOT_FINITE
    for _, faults in found[1:3]:
        assert [(f.code, f.joint, f.action) for f in faults] == [(code, 0, Action.REPORT)]
    assert found[1][0][1:].tobytes() == rows[0][1:].tobytes(), "the other sensors are used as they are"


def test_f04_the_third_in_a_row_is_withheld_and_stops():
    found = screened([reading()] + [reading(gauge_1=math.nan)] * 4)
    assert [f.action for _, faults in found for f in faults] == [Action.REPORT] * 2 + [Action.CONTROLLED_STOP] * 2
    assert all(math.isnan(used[2, 1]) for used, _ in found[2:]) and not math.isnan(found[1][0][2, 1])


def test_f05_a_jump_that_stays_stops_once_and_is_taken_over():
    found = screened([reading()] + [reading(resolver_1=-2.5)] * 5)
    assert [len(faults) for _, faults in found] == [1, 1, 1, 0, 0]
    assert math.isnan(found[2][0][1, 1]) and found[3][0][1, 1] == -2.5
    assert found[2][1][0].action is Action.CONTROLLED_STOP
    again = screened(
        [reading()] + [reading(resolver_1=-2.5)] * 3 + [reading(resolver_1=-9.0), reading(resolver_1=-7.0)]
    )
    assert [faults[0].action for _, faults in again[3:]] == [Action.REPORT] * 2, "the count begins anew"


def test_f05_a_run_of_different_nonsense_goes_on_stopping():
    found = screened([reading()] + [reading(resolver_1=3.0 * k) for k in range(1, 7)])
    assert [faults[0].action for _, faults in found[2:]] == [Action.CONTROLLED_STOP] * 4
    assert all(math.isnan(used[1, 1]) for used, _ in found[2:])


def test_good_readings_between_bad_ones_begin_the_count_anew():
    bad, good = reading(encoder_0=9.0), reading()
    found = screened([good, bad, bad, good, bad, bad, good, bad])
    assert all(f.action is Action.REPORT for _, faults in found for f in faults)
    assert all(np.isfinite(used).all() for used, _ in found)


def test_a_first_reading_that_is_no_number_stops_until_there_is_one():
    found = screened([reading(encoder_0=math.inf)] + [reading()] * 4)
    assert [len(faults) for _, faults in found] == [1, 1, 1, 0] and np.isfinite(found[0][0][1:]).all()


def test_f06_the_wrap_of_a_counter_is_no_spike():
    period = np.array([[2.0, 0.0], [0.0, 0.0], [0.0, 0.0]])
    rows = [reading(encoder_0=place) for place in (1.99, 1.998, 0.006, 0.014, 1.998, 1.99)]
    assert [len(faults) for _, faults in screened(rows, period)] == [0, 0, 0, 1, 1]
    turned = screened([reading(encoder_0=place) for place in (0.01, 0.004, 1.998, 1.992)], period)
    assert all(faults == [] for _, faults in turned)
    assert len(screened(rows)[1][1]) == 1, "without a period it is one"


def test_f03_a_gauge_that_repeats_itself_in_motion():
    memory = m.Frozen(NOTHING + 3.0, NOTHING.copy(), NOTHING.copy())
    seen = []
    for k in range(1, 12):
        found, memory, faults = m.frozen(np.array([3.0, k * 1.0]), np.array([0.01 * k, 0.02 * k]), memory, LIMITS)
        seen.append((k, bool(found[0]), bool(found[1]), len(faults)))
    assert [k for k, first, _, _ in seen if first] == [6, 7, 8, 9, 10, 11], "five twist limits of motion"
    assert not any(second for _, _, second, _ in seen)
    assert [count for *_, count in seen] == [0] * 5 + [1] * 6
    assert (faults[0].code, faults[0].joint, faults[0].value, faults[0].limit) == (FaultCode.VALUE_FROZEN, 0, 11.0, 4.0)
    assert faults[0].action is Action.CONTROLLED_STOP
    _, memory, faults = m.frozen(np.array([3.1, 0.0]), np.array([0.2, 0.2]), memory, LIMITS)
    assert faults == [] and memory.repeats.tolist() == [0.0, 0.0] and memory.position.tolist() == [0.2, 0.2]


def test_f03_never_at_standstill_and_not_after_a_few_samples():
    memory = m.Frozen(NOTHING.copy(), NOTHING.copy(), NOTHING.copy())
    for _ in range(500):
        found, memory, faults = m.frozen(NOTHING, np.array([0.05, -0.09]), memory, LIMITS)
        assert not found.any() and faults == []
    quick = m.Frozen(NOTHING.copy(), NOTHING.copy(), NOTHING.copy())
    counts = []
    for k in range(5):
        _, quick, faults = m.frozen(NOTHING, np.array([1.0 + k, 0.0]), quick, LIMITS)
        counts.append(len(faults))
    assert counts == [0, 0, 0, 1, 1], "four repeats, however far it moved"


def test_f08_the_rail_of_the_gauge():
    run, actions = NOTHING, []
    for value in (197.9, 198.0, -199.0, 250.0, 197.9, 250.0, math.nan, 250.0):
        stops, run, faults = m.at_rail(np.array([value, 0.0]), run, LIMITS)
        actions.append((bool(stops[0]), [f.action for f in faults]))
        assert not stops[1]
    report, stop = [Action.REPORT], [Action.CONTROLLED_STOP]
    assert actions == [(False, []), (False, report), (False, report), (True, stop), (False, []), (False, report),
                       (False, []), (False, report)]  # fmt: skip
    assert (faults[0].code, faults[0].joint, faults[0].value, faults[0].limit) == (
        FaultCode.GAUGE_RAIL,
        0,
        250.0,
        200.0,
    )


def test_f07_positions_that_no_twist_explains():
    run, seen = NOTHING, []
    for difference in (0.02, 0.021, -0.021, 0.021, 0.021, 0.021, 0.02, 0.021, math.nan, 0.021):
        stops, run, faults = m.disagree(np.array([0.5, difference]), np.array([0.5, 0.0]), run, LIMITS)
        seen.append((bool(stops[1]), len(faults), run[1]))
        assert not stops[0]
    assert [row[0] for row in seen] == [False] * 5 + [True] + [False] * 4
    assert [row[1] for row in seen] == [0] * 5 + [1] + [0] * 4
    assert [row[2] for row in seen] == [0, 1, 2, 3, 4, 5, 0, 1, 0, 1]
    stops, _, faults = m.disagree(np.array([0.5, -0.03]), np.array([0.5, 0.0]), NOTHING + 4.0, LIMITS)
    assert (faults[0].code, faults[0].joint, faults[0].value, faults[0].limit) == (
        FaultCode.POSITION_DISAGREE, 1, -0.03, 0.02)  # fmt: skip
    assert faults[0].action is Action.CONTROLLED_STOP and stops[1]


def turn(residual, turns=1.05, steps=400):
    """`redundancy` over a motion of the motor shaft; residual(beta) -> (2,). Returns memory and all faults."""
    memory, found = m.first_redundancy(NOTHING), []
    for angle in np.linspace(0.0, 2.0 * np.pi * turns, steps + 1)[1:]:
        shaft = np.array([angle, -angle])
        memory, faults = m.redundancy(residual(shaft), shaft, shaft, memory, LIMITS)
        found += faults
    return memory, found


def test_f10_the_mean_residual_over_a_turn():
    memory, faults = turn(lambda beta: np.array([9.0, -5.5]))
    assert memory.mean == pytest.approx([9.0, -5.5]) and np.all(memory.ripple < 0.5)
    assert [(f.code, f.joint, f.limit, f.action) for f in faults] == [(FaultCode.GAUGE_DRIFT, 1, 5.0, Action.REPORT)]
    assert faults[0].value == pytest.approx(-5.5)
    _, faults = turn(lambda beta: np.array([20.1, -9.9]))
    assert [f.action for f in faults] == [Action.CONTROLLED_STOP, Action.REPORT]


@pytest.mark.parametrize("phase", [0.0, 0.7, 1.6])
def test_f09_the_ripple_of_an_open_branch(phase):
    memory, faults = turn(lambda beta: np.array([15.0, 9.0]) * np.cos(2.0 * beta - phase))
    assert memory.ripple == pytest.approx([15.0, 9.0], rel=0.03) and np.all(np.abs(memory.mean) < 0.5)
    assert [(f.code, f.joint, f.limit) for f in faults] == [(FaultCode.GAUGE_BRANCH, 1, 8.0)]
    _, quiet = turn(lambda beta: 100.0 * np.cos(beta) * np.array([1.0, 1.0]))
    assert quiet == [], "other orders are the gear, not the bridge"


def test_f09_f10_less_than_a_turn_is_not_observed_and_standstill_never_is():
    memory, faults = turn(lambda beta: np.array([1e3, 1e3]), turns=0.99)
    assert faults == [] and np.isnan(memory.mean).all() and np.isnan(memory.ripple).all()
    memory = m.first_redundancy(NOTHING)
    for _ in range(100):
        memory, faults = m.redundancy(NOTHING + 1e6, NOTHING, NOTHING, memory, LIMITS)
        assert faults == []
    assert np.isnan(memory.mean).all() and memory.travel.tolist() == [0.0, 0.0]


def test_f09_f10_each_turn_counts_anew_and_a_gap_begins_anew():
    memory, faults = turn(lambda beta: np.where(np.abs(beta) < 2.0 * np.pi, 6.0, 1.0) * np.ones(2), turns=2.1)
    assert [f.joint for f in faults] == [1] and memory.mean == pytest.approx([1.0, 1.0], abs=0.1)
    half, _ = turn(lambda beta: np.array([9.0, 4.0]), turns=0.6)
    for shaft, residual in ((np.array([math.nan, 0.0]), NOTHING), (NOTHING, np.array([0.0, math.inf]))):
        empty, faults = m.redundancy(residual, shaft, NOTHING, half, LIMITS)
        assert faults == [] and empty.travel.tolist() == [0.0, 0.0] and not empty.sums.any()
        assert np.array_equal(empty.mean, half.mean, equal_nan=True)


def test_f10_motion_to_and_fro_is_no_turn():
    """A hysteresis of 8 N m swung to and fro adds up to any mean; only a way without detours counts."""
    memory, place, seen = m.first_redundancy(NOTHING), 0.0, []
    for k in range(4000):
        step = 0.02 if (k // 100) % 2 == 0 else -0.018
        place += step
        shaft = np.array([place, place])
        memory, faults = m.redundancy(NOTHING + math.copysign(8.0, step), shaft, shaft, memory, LIMITS)
        seen += faults
    assert seen == [] and np.isnan(memory.mean).all() and np.all(memory.sums[3] <= m.LONGEST_WAY)


def test_f09_f10_fast_motion_is_not_observed():
    for steps, observed in ((23, True), (21, False)):
        memory, faults = turn(lambda beta: np.array([15.0, 9.0]), turns=1.05, steps=steps)
        assert np.isfinite(memory.mean).all() == observed and bool(faults) == observed


def stuck_run(encoder, resolver, torque=0.0, ticks=200):
    """Tick and joint of the first fault; positions are functions of the tick, joint 0 stays at rest."""
    memory = sm.first_stuck(np.array([[1.0, encoder(0)], [1.0, resolver(0)]]))
    for k in range(1, ticks):
        positions = np.array([[1.0, encoder(k)], [1.0, resolver(k)]])
        twist = np.array([0.0, torque(k) if callable(torque) else torque])
        missed, memory, faults = sm.stuck(positions, twist, memory, 20.0, np.array([0.002, 0.002]))
        if faults:
            fault = faults[0]
            assert (fault.code, fault.limit, fault.action) == (FaultCode.VALUE_FROZEN, 20.0, Action.CONTROLLED_STOP)
            assert missed[fault.joint] > 0.002 and fault.value >= 20.0
            return k, fault.joint
    return None


@pytest.mark.parametrize(("speed", "found"), [(1e-3, 20), (-1e-3, 20), (0.9e-4, 24), (0.45e-4, 46), (1e-6, None)])
def test_f03_a_position_sensor_that_repeats_itself_while_the_other_moves(speed, found):
    """20 equal readings, or as many as 0.002 rad take; never without motion."""
    moves, rests = lambda k: speed * k, lambda k: 0.0
    expected = None if found is None else (found, 1)
    assert stuck_run(moves, rests) == stuck_run(rests, moves) == expected


def test_f03_a_blocked_joint_that_is_wound_up_is_no_stuck_sensor():
    """The motor moves by what the spring twists: the joint is expected to stand; and the other way round."""
    assert stuck_run(lambda k: 0.3 + 0.9e-4 * k, lambda k: 0.0, torque=lambda k: 0.9e-4 * k) is None
    assert stuck_run(lambda k: 0.3, lambda k: 0.9e-4 * k, torque=lambda k: -0.9e-4 * k) is None


def test_f03_a_gauge_that_drifts_at_rest_is_no_motion():
    """Also when the readings change now and then, and motor and joint are far apart."""
    drift = lambda k: 0.9e-4 * k  # noqa: E731 - as short as the others
    for encoder in (lambda k: 0.3, lambda k: 0.3 + 1e-9 * (k // 90)):
        assert stuck_run(encoder, lambda k: 0.0, torque=drift) is None
        assert stuck_run(lambda k: 0.0, encoder, torque=drift) is None


def test_f03_exactly_the_limit_is_no_fault():
    limit, memory = np.full(2, 2.0**-9), sm.first_stuck(np.zeros((2, 2)))
    for k in range(1, 40):
        positions = np.array([[0.0, min(k - 1, 32) * 2.0**-14], [0.0, 0.0]])
        missed, memory, faults = sm.stuck(positions, np.zeros(2), memory, 20.0, limit)
        assert faults == []
    assert missed.tolist() == [0.0, 2.0**-9]


def test_f03_one_other_reading_begins_the_count_anew_and_no_number_expects_nothing():
    assert stuck_run(lambda k: 0.9e-4 * k, lambda k: 1e-9 * (k // 20)) is None
    assert stuck_run(lambda k: 0.9e-4 * k, lambda k: 0.0, torque=math.nan) is None
    gap = stuck_run(lambda k: 0.9e-4 * k, lambda k: 0.0, torque=lambda k: math.nan if k < 30 else 0.0)
    assert gap == (53, 1), "expected from the first number on"
