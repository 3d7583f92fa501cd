"""Monitors beside their compiled short way: ordinary samples judged the long way, and numbers exactly on a limit."""

import math
from dataclasses import fields, replace

import numpy as np
import pytest

from hd_control import _laws
from hd_control.core.faults import Action, FaultCode
from hd_control.safety import sensor_monitors as m
from hd_control.safety import sensor_monitors as sm

STEP = 2.0**-7
"""A limit without rounding."""
LIMITS = m.SensorLimits(
    twist_limit=np.array([STEP, STEP]),
    gauge_rail=np.array([200.0, 100.0]),
    residual_limit=np.array([10.0, 5.0]),
    ripple_limit=np.array([20.0, 8.0]),
    stuck_motion_limit=np.array([STEP, STEP]),
    disagree_samples=5.0,
    frozen_samples=4.0,
    rail_samples=3.0,
)
ZERO = np.zeros(2)


def long_way(monkeypatch, name):
    """From now on a compiled look finds nothing ordinary; what it calculates stays."""
    real = getattr(_laws, name)

    def never(*given):
        found = real(*given)
        return (False, *found[1:]) if isinstance(found, tuple) else False

    monkeypatch.setattr(_laws, name, never)


def bits(found):
    """Everything that a monitor returned, as bytes and texts."""
    if isinstance(found, np.ndarray):
        return found.tobytes()
    if isinstance(found, m.Screen | m.Frozen | m.Redundancy | sm.Stuck):
        return tuple(bits(getattr(found, field.name)) for field in fields(found))
    return tuple(map(bits, found)) if isinstance(found, tuple | list) else str(found)


def both_ways(monkeypatch, name, run):
    short = run()
    long_way(monkeypatch, name)
    assert bits(run()) == bits(short)
    return short


def test_screen(monkeypatch, rng):
    """Counters that wrap at a period, also at one below 1 rad, beside a reading that does not."""
    period = np.array([[0.5, 2.0 * math.pi], [0.5, 0.0], [0.0, 0.0]])
    rows = np.cumsum(rng.normal(0.0, 0.02, (200, 3, 2)), axis=0)
    wrapped = np.where(period > 0.0, np.mod(rows, np.where(period > 0.0, period, 1.0)), rows)

    def run():
        memory, found = m.first_screen(wrapped[0]), []
        for row in wrapped[1:]:
            used, memory, faults = m.screen(row, memory, np.full((3, 2), 0.2), period, 3.0)
            found.append((used, memory, faults))
        return found

    assert all(not faults for *_, faults in both_ways(monkeypatch, "readings_follow", run))
    assert np.abs(np.diff(wrapped[:, 0, 0])).max() > 0.4, "it wraps"


def test_comparisons_of_positions_gauge_and_rail(monkeypatch, rng):
    motor = np.cumsum(rng.normal(0.0, 0.001, (100, 2)), axis=0) + [1.0, -2.0]
    joint, gauge = motor + rng.uniform(-STEP, STEP, motor.shape), rng.normal(0.0, 20.0, motor.shape)

    def run():
        frozen, found = m.Frozen(gauge[0].copy(), np.zeros(2), motor[0].copy()), []
        for k in range(1, 100):
            reading = np.where(k % 5 == 1, gauge[k], frozen.reading)
            stuck, frozen, faults = m.frozen(reading, motor[k], frozen, LIMITS)
            found += [stuck, frozen, faults]
        apart = [m.disagree(a, b, np.zeros(2), LIMITS) for a, b in zip(motor, joint, strict=True)]
        return [*found, *apart, *(m.at_rail(row, np.zeros(2), LIMITS) for row in gauge)]

    for name in ("gauge_changes", "all_near", "all_below"):
        both_ways(monkeypatch, name, run)


def test_the_relation_between_the_sensors(monkeypatch, rng):
    shaft = np.cumsum(rng.uniform(0.05, 0.15, (60, 2)), axis=0)

    def run():
        memory, found = m.first_redundancy(shaft[0]), []
        for k in range(1, 60):
            memory, faults = m.redundancy(np.sin(shaft[k]), shaft[k], 0.5 * shaft[k], memory, LIMITS)
            found += [memory, faults]
        return found

    assert shaft[-1].max() < 2.0 * math.pi, "less than a turn is ordinary"
    both_ways(monkeypatch, "sum_turn", run)


def test_motion_that_a_sensor_missed(monkeypatch, rng):
    positions = np.cumsum(rng.normal(0.0, 0.0005, (100, 1, 2)), axis=0) + np.zeros((1, 2, 1))

    def run():
        memory, found = sm.first_stuck(positions[0]), []
        for row in positions[1:]:
            found.append(sm.stuck(row, ZERO, memory, 4.0, LIMITS.stuck_motion_limit))
            memory = found[-1][1]
        return found

    both_ways(monkeypatch, "missed_motion", run)


def test_a_jump_of_exactly_the_limit_is_none():
    """The other joint jumps further, so that the sample is judged."""
    memory, limit = m.first_screen(np.zeros((3, 2))), np.full((3, 2), STEP)
    row = np.zeros((3, 2))
    row[0] = [STEP, 1.0]
    used, _, faults = m.screen(row, memory, limit, None, 3.0)
    assert [(f.joint, f.code) for f in faults] == [(1, FaultCode.SPIKE)] and used[0, 0] == STEP


def test_a_jump_that_stays_within_exactly_the_limit_is_taken_over():
    memory, limit, row = m.first_screen(np.zeros((3, 2))), np.full((3, 2), STEP), np.zeros((3, 2))
    for value in (2.0, 2.0, 2.0 + STEP):
        row[0, 0] = value
        _, memory, faults = m.screen(row, memory, limit, None, 3.0)
    assert [f.action for f in faults] == [Action.CONTROLLED_STOP]
    assert m.screen(row, memory, limit, None, 3.0)[2] == []


@pytest.mark.parametrize("start", [0.0, 1.0])
def test_f03_a_gauge_that_slept_through_exactly_the_limit_is_not_frozen(start):
    motion = LIMITS.gauge_motion
    memory = m.Frozen(np.array([5.0, 5.0]), np.array([9.0, 9.0]), np.array([start, 0.0]))
    position = np.array([start, 0.0]) + motion * [1.0, 2.0]
    found, _, faults = m.frozen(np.array([5.0, 5.0]), position, memory, LIMITS)
    assert found.tolist() == [False, True] and [f.joint for f in faults] == [1]


def test_f07_positions_apart_by_exactly_the_limit_agree():
    _, run, _ = m.disagree(np.array([STEP, 2.0 * STEP]), ZERO, np.array([3.0, 3.0]), LIMITS)
    assert run.tolist() == [0.0, 4.0]


def turning(travel, way, angle=ZERO):
    """Memory of a relation that has been followed for some way."""
    first = m.first_redundancy(np.array(angle))
    sums = np.array([[1.0, 1.0], [0.0, 0.0], [0.0, 0.0], way])
    return replace(first, terms=np.zeros((3, 2)), travel=np.array(travel), sums=sums)


def test_f10_a_turn_is_whole_at_exactly_two_pi_and_the_other_joint_goes_on():
    memory = turning([m.WHOLE_TURN - 0.25, 1.0], [m.WHOLE_TURN - 0.25, 1.0])
    new, _ = m.redundancy(ZERO, np.array([0.25, 0.25]), ZERO, memory, LIMITS)
    assert new.mean[0] == 1.0 / m.WHOLE_TURN and math.isnan(new.mean[1])
    assert new.travel.tolist() == [0.0, 1.25] and new.sums[3].tolist() == [0.0, 1.25]


def test_f10_the_longest_way_and_the_largest_step_still_count():
    """Exactly on both limits; the other joint ends its turn, so that the sample is judged."""
    memory = turning([1.0, m.WHOLE_TURN - 0.25], [m.LONGEST_WAY - 0.25, m.WHOLE_TURN - 0.25])
    new, _ = m.redundancy(ZERO, np.array([0.25, 0.25]), ZERO, memory, LIMITS)
    assert new.sums[3, 0] == m.LONGEST_WAY and new.travel[0] == 1.25
    memory = turning([1.0, m.WHOLE_TURN - 0.25], [1.0, m.WHOLE_TURN - 0.25])
    new, _ = m.redundancy(ZERO, np.array([m.LARGEST_STEP, 0.25]), ZERO, memory, LIMITS)
    assert new.travel[0] == 1.0 + m.LARGEST_STEP


def test_f10_a_way_of_one_and_a_quarter_turns_without_a_turn_begins_anew():
    assert pytest.approx(1.25 * 2.0 * math.pi) == m.LONGEST_WAY
    memory = turning([1.0, 1.0], [1.26 * m.WHOLE_TURN, 1.0])
    new, _ = m.redundancy(ZERO, np.array([0.1, 0.1]), ZERO, memory, LIMITS)
    assert new.travel.tolist() == [0.0, 1.1]


@pytest.mark.parametrize(("factor", "action"), [(1.0, None), (2.0, Action.REPORT), (2.01, Action.CONTROLLED_STOP)])
def test_f09_f10_exactly_on_the_bounds(factor, action):
    """A whole turn with a mean and with a 2 beta part of so many times the bound."""
    whole = np.array([True, False])
    mean, ripple = factor * LIMITS.residual_limit, -factor * LIMITS.ripple_limit
    faults = m._judge_turn(whole, mean, ripple, LIMITS)
    expected = [] if action is None else [FaultCode.GAUGE_DRIFT, FaultCode.GAUGE_BRANCH]
    assert [(f.code, f.joint, f.action) for f in faults] == [(code, 0, action) for code in expected]


def test_f03_a_position_that_missed_exactly_the_limit_is_not_stuck():
    still = np.array([[1.0, 1.0], [1.0, 1.0]])
    memory = sm.Stuck(still.copy(), np.full((2, 2), 9.0), still.copy(), still.copy())
    moved = np.array([[1.0, 1.0], [1.0 + STEP, 1.0 + 2.0 * STEP]])
    _, _, faults = sm.stuck(moved, ZERO, memory, 4.0, LIMITS.stuck_motion_limit)
    assert [(f.joint, f.code) for f in faults] == [(1, FaultCode.VALUE_FROZEN)]
