"""Guard: controlled stop, envelope, strongest action, latch and reset; limits of the guard; monitors of the loop."""

import math
from functools import lru_cache

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from monitors import FORMS, Loop
from oracles import guard_law
from oracles import loop_monitors_law as watchers

from hd_control.core.errors import ConfigError
from hd_control.core.faults import Action, Fault, FaultCode, strongest
from hd_control.core.resources import config_path
from hd_control.core.strict_yaml import load_params_file
from hd_control.laws import torque_adaptive
from hd_control.laws.torque import layout as torque_layout
from hd_control.safety.guard import Guard, Mode
from hd_control.safety.limits import GUARD_PARAMETERS, SafetyLimits, configure, select

DT, N = 1e-3, 2
NAMES = ["joint_3", "joint_5"]
LOW, HIGH = np.array([-3.0, -2.0]), np.array([3.0, 2.0])
SPEED = np.array([1.5, 2.5])
HOLD = np.array([40.0, -7.0])


@lru_cache
def limits():
    return configure(select(load_params_file(config_path("limits.yaml"), "limits"), NAMES), DT)


class Bench:
    """A guard with its tick; the motor is where the test puts it."""

    def __init__(self, hold_samples=0, active=True, bounds=None, low=LOW, high=HIGH):
        self.guard, self.tick = Guard(bounds or limits(), low, high, SPEED, DT, hold_samples), 0.0
        if active:
            self.guard.activate(HOLD)
            self.tick = 100.0
            for _ in range(300):
                self.send()

    def send(self, command=HOLD, ages=0.0, tick=None, demands=()):
        self.tick = self.tick + 1.0 if tick is None else tick
        full = [np.full(N, x) if np.isscalar(x) else np.array(x, dtype=float) for x in (command, ages, self.tick)]
        return self.guard.step(*full, demands)


def demand(action, code=FaultCode.GAUGE_DRIFT, joint=1):
    return Fault(code, joint, 2.0, 1.0, action)


def test_a_healthy_command_passes_bit_for_bit():
    bench = Bench()
    for command in (HOLD, HOLD + [3.0, -0.5], [0.0, -0.0], HOLD):
        out, faults = bench.send(command)
        assert out.tobytes() == np.array(command, dtype=float).tobytes() and faults == []
    assert bench.guard.mode is Mode.ACTIVE and not bench.guard.stopped


def test_before_activation_nothing_leaves_and_faults_only_report():
    bench = Bench(active=False)
    out, faults = bench.send([math.nan, 1.0], demands=[demand(Action.TORQUE_RAMP)])
    assert out.tolist() == [0.0, 0.0] and bench.guard.mode is Mode.INACTIVE and not bench.guard.stopped
    assert {fault.code for fault in faults} == {FaultCode.GAUGE_DRIFT, FaultCode.NOT_FINITE}
    assert {fault.action for fault in faults} == {Action.REPORT}


@pytest.mark.parametrize(
    ("case", "code", "value", "bound"),
    [
        ({"command": [40.0, math.nan]}, FaultCode.NOT_FINITE, math.nan, 0.0),
        ({"command": [40.0, math.inf]}, FaultCode.NOT_FINITE, math.inf, 0.0),
        ({"ages": [0.0, 10.0]}, FaultCode.NODE_KILLED, 10.0, 10.0),
        ({"ages": [0.0, -1.0]}, FaultCode.NODE_KILLED, -1.0, 10.0),
        ({"ages": [0.0, math.nan]}, FaultCode.NODE_KILLED, math.nan, 10.0),
        ({"tick": [401.0, 400.0]}, FaultCode.STAMP_STUCK, 400.0, 400.0),
        ({"tick": [401.0, math.nan]}, FaultCode.STAMP_STUCK, math.nan, 400.0),
        ({"tick": [401.0, 2.0**54]}, FaultCode.STAMP_STUCK, 2.0**54, 400.0),
    ],
)
def test_f02_f04_f18_a_bad_input_begins_a_controlled_stop_in_the_same_sample(case, code, value, bound):
    bench = Bench()
    out, faults = bench.send(**case)
    assert bench.guard.controlled and bench.guard.mode is Mode.HOLDING and not bench.guard.gate.stopped
    np.testing.assert_allclose(out, HOLD, rtol=1e-3)  # the arm is carried
    assert [(f.code, f.joint, f.limit, f.action) for f in faults] == [(code, 1, bound, Action.CONTROLLED_STOP)]
    np.testing.assert_equal(faults[0].value, value)


@pytest.mark.parametrize("case", [{"ages": 9.0}, {"ages": 9.99}, {"tick": 402.0}, {"tick": 2.0**53}])
def test_what_is_still_allowed_does_not_stop(case):
    bench = Bench()
    _, faults = bench.send(**case)
    assert faults == [] and not bench.guard.stopped


def test_the_stop_decelerates_on_the_motor_side_then_holds():
    """A free rotor of 30 kg m^2 with a weight of 40 N m on it, caught at 1 rad/s."""
    bench = Bench()
    velocity, position, inertia, seen = np.array([1.0, 0.0]), np.zeros(N), np.array([30.0, 5.0]), []
    for k in range(1500):
        bench.guard.measured.motor_position, bench.guard.measured.motor_velocity = position, velocity
        out, _ = bench.send(demands=[demand(Action.CONTROLLED_STOP)] if k == 0 else ())
        velocity = velocity + DT * (out - HOLD) / inertia
        position = position + DT * velocity
        seen.append((velocity[0], bench.guard.mode))
    speeds = np.array([row[0] for row in seen])
    assert speeds.max() <= 1.05 and abs(speeds[300]) < 0.2 and abs(speeds[-1]) < 1e-3
    assert seen[0][1] is Mode.STOPPING and seen[50][1] is Mode.STOPPING and seen[101][1] is Mode.HOLDING
    assert abs(bench.guard.stop.reference_position[0] - 0.05) < 2e-3, "v^2 / 2a"
    np.testing.assert_allclose(position, bench.guard.stop.reference_position, atol=2e-3)


def test_the_stop_torque_is_the_formula():
    """u = hold - damping (v - v_r) - stiffness (x - x_r), v_r falling by 0.01 rad/s a sample, two samples of it."""
    limit, bench = limits().guard, Bench()
    held, place = bench.guard.state.mean_torque.copy(), np.array([0.1, 0.2])
    for velocity, position, reference in (
        ([0.5, -0.01], [0.1, 0.2], [0.49, 0.0]),
        ([0.6, -0.02], [0.11, 0.2], [0.48, 0.0]),
    ):
        bench.guard.measured.motor_velocity, bench.guard.measured.motor_position = velocity, position
        out, _ = bench.send(demands=[demand(Action.CONTROLLED_STOP)])
        place = place + np.array(reference) * DT
        expected = held - limit.stop_damping * (np.array(velocity) - reference)
        expected -= limit.stop_stiffness * (position - place)
        np.testing.assert_allclose(out, expected, rtol=1e-12)
        np.testing.assert_allclose(bench.guard.stop.reference_velocity, reference, rtol=1e-12, atol=1e-15)
    assert bench.guard.stop.elapsed == 2.0 and bench.guard.mode is Mode.STOPPING


@pytest.mark.parametrize(
    ("velocity", "joint"),
    [([0.79, 0.3], None), ([0.5 + guard_law.SPEED_MARGIN, 0.0], None), ([-0.81, 0.0], 0), ([0.0, math.nan], 1),
     ([math.nan, 0.0], 0), ([0.0, math.nextafter(0.31, 1.0)], 1), ([0.0, -0.01 - guard_law.SPEED_MARGIN], None)],
)  # fmt: skip
def test_a_stop_is_left_by_a_joint_that_is_faster_than_at_its_begin(velocity, joint):
    bench = Bench()
    bench.guard.measured.motor_velocity = [0.5, -0.01]
    bench.send(demands=[demand(Action.CONTROLLED_STOP)])
    bench.guard.measured.motor_velocity = velocity
    _, faults = bench.send()
    assert [f.joint for f in faults if f.code is FaultCode.STOP_LEFT] == ([] if joint is None else [joint])
    assert bench.guard.mode is (Mode.STOPPING if joint is None else Mode.STOPPED)


@pytest.mark.parametrize("field", ["motor_position", "motor_velocity"])
def test_without_a_motor_position_the_torque_ramps_to_zero(field):
    bench = Bench()
    bench.guard.measured.view(field)[0] = math.nan
    out, _ = bench.send(demands=[demand(Action.CONTROLLED_STOP)])
    assert bench.guard.mode is Mode.STOPPED and out.tolist() == [0.0, 0.0] and not bench.guard.controlled
    assert bench.guard.gate.stop_code == FaultCode.GAUGE_DRIFT and bench.guard.gate.stop_joint == 1.0
    assert bench.guard.gate.brake_requested == 1.0


def test_the_strongest_action_wins_and_is_never_weakened():
    bench = Bench()
    bench.send(demands=[demand(Action.REPORT), demand(Action.DEGRADE)])
    assert bench.guard.mode is Mode.ACTIVE
    bench.send(demands=[demand(Action.CONTROLLED_STOP), demand(Action.REPORT)])
    assert bench.guard.controlled
    bench.send(demands=[demand(Action.DEGRADE)])
    assert bench.guard.controlled
    bench.send(demands=[demand(Action.TORQUE_RAMP, FaultCode.POSITION_DISAGREE, 0), demand(Action.CONTROLLED_STOP)])
    assert bench.guard.mode is Mode.STOPPED and bench.guard.gate.stop_code == FaultCode.POSITION_DISAGREE
    bench.send(demands=[demand(Action.CONTROLLED_STOP)])
    assert bench.guard.mode is Mode.STOPPED and bench.guard.gate.stop_code == FaultCode.POSITION_DISAGREE


def test_a_running_stop_does_not_begin_anew():
    bench = Bench()
    for k in range(5):
        bench.send(demands=[demand(Action.CONTROLLED_STOP)])
        assert bench.guard.stop.elapsed == k + 1.0


def test_f42_leaving_the_stop_makes_it_a_ramp():
    bench = Bench()
    bench.send(demands=[demand(Action.CONTROLLED_STOP)])
    bench.guard.measured.motor_velocity = [0.0, 0.4]
    out, faults = bench.send()
    assert bench.guard.mode is Mode.STOPPED and out.tolist() == [0.0, 0.0]
    assert [(f.code, f.joint, f.value, f.limit) for f in faults] == [(FaultCode.STOP_LEFT, 1, 0.4, 0.3)]


@pytest.mark.parametrize("joint", [0, 1])
def test_f42_names_the_joint_that_left(joint):
    bench = Bench()
    bench.send(demands=[demand(Action.CONTROLLED_STOP)])
    bench.guard.measured.motor_velocity[joint] = 0.4
    _, faults = bench.send()
    assert [(f.code, f.joint) for f in faults] == [(FaultCode.STOP_LEFT, joint)]
    assert bench.guard.gate.stop_joint == joint


@pytest.mark.parametrize(("offset", "stops"), [(0.0, False), (2.0**-40, True), (-(2.0**-40), False)])
def test_exactly_on_its_bounds_a_joint_may_be(offset, stops):
    """Numbers that have no rounding: with 2a = 16 rad/s^2 and 1 rad/s the way to stop is 1/16 rad."""
    guard = limits().guard.copy()
    guard.stop_deceleration = 8.0
    for side in (1.0, -1.0):
        bounds = SafetyLimits(limits().gate, guard)
        bench = Bench(bounds=bounds, low=np.array([-3.0, -10.0]), high=np.array([3.0, 10.0]))
        bench.guard.measured.joint_position = [side * (3.0 - 1.0 / 16.0 + offset), 0.0]
        bench.guard.measured.joint_velocity = [side, side * guard_law.SPEED_SHARE * SPEED[1]]
        for demands in ([], [demand(Action.REPORT)]):
            _, faults = bench.send(demands=demands)
            found = [f.code for f in faults if f.code is not FaultCode.GAUGE_DRIFT]
            assert found == [FaultCode.ENVELOPE] * (stops and not demands), "reported once"
        assert bench.guard.controlled is stops


def test_the_last_tick_that_a_double_counts_is_used_beside_another_finding():
    bench = Bench()
    bench.send(tick=2.0**53 - 1.0)
    _, faults = bench.send(tick=2.0**53, demands=[demand(Action.REPORT)])
    assert [f.code for f in faults] == [FaultCode.GAUGE_DRIFT] and not bench.guard.stopped


def test_a_stop_that_loses_its_sensor_becomes_a_ramp():
    bench = Bench()
    bench.send(demands=[demand(Action.CONTROLLED_STOP)])
    bench.guard.measured.motor_position = [math.nan, 0.0]
    bench.send()
    assert bench.guard.mode is Mode.STOPPED and bench.guard.gate.stop_joint == 0.0


def test_the_drive_side_holds_only_while_its_brakes_close():
    bench = Bench(hold_samples=5)
    outs = [bench.send(math.nan)[0][0] for _ in range(7)]
    np.testing.assert_allclose(outs[:4], HOLD[0], rtol=1e-3)
    assert outs[4:] == [0.0, 0.0, 0.0] and bench.guard.mode is Mode.STOPPED
    assert (bench.guard.gate.stop_code, bench.guard.gate.stop_joint) == (FaultCode.STOP_LEFT, -1.0)
    shortest = Bench(hold_samples=1)
    shortest.send(math.nan)
    assert shortest.guard.mode is Mode.STOPPED


def test_the_law_side_holds_without_end_and_counts_its_own_samples():
    guard = Guard(limits(), LOW, HIGH, SPEED, DT)
    assert guard.healthy == 0 and guard.last_tick.tolist() == [-1.0] * N
    guard.activate(HOLD)
    for tick in range(50):
        guard.step(np.full(N, math.nan), np.zeros(N), np.full(N, float(tick)))
        assert guard.controlled and guard.gate.last_tick.tolist() == [float(tick)] * N
    assert [mode.value for mode in Mode] == [0, 1, 2, 3, 4]


def test_f39_twenty_rate_excesses_in_a_row_become_a_controlled_stop():
    bench = Bench()
    for k in range(25):
        held = bench.guard.state.mean_torque.copy()
        out, faults = bench.send([1200.0 if k % 2 else -1200.0, -7.0])
        if bench.guard.stopped:
            break
    assert k == 19 and bench.guard.controlled
    np.testing.assert_allclose(out, held, rtol=1e-3)  # the stop acts in this sample, not the command
    assert (FaultCode.RATE_PERSISTENT, Action.CONTROLLED_STOP) in [(f.code, f.action) for f in faults]
    assert bench.guard.healthy == 0 and np.all(np.abs(out) < 1200.0)


@pytest.mark.parametrize(
    ("position", "velocity", "stops"),
    [
        ([2.9, 0.0], [1.3, 0.0], False),  # 2.9 + 1.3^2 / 20 = 2.98
        ([2.9, 0.0], [1.5, 0.0], True),
        ([-2.9, 0.0], [-1.5, 0.0], True),
        ([-2.9, 0.0], [1.5, 0.0], False),
        ([0.0, 2.1], [0.0, -0.5], False),  # on its way back
        ([0.0, 2.1], [0.0, 0.04], False),  # noise
        ([0.0, 2.1], [0.0, 0.06], True),
        ([0.0, -2.1], [0.0, -0.06], True),
        ([0.0, -2.1], [0.0, -0.04], False),
        ([0.0, 2.1], [0.0, 0.05], False),
        ([0.0, -2.1], [0.0, -0.05], False),
    ],
)
def test_f40_the_braking_envelope(position, velocity, stops):
    bench = Bench()
    bench.guard.measured.joint_position, bench.guard.measured.joint_velocity = position, velocity
    _, faults = bench.send()
    assert bench.guard.controlled is stops and [f.code for f in faults] == [FaultCode.ENVELOPE] * stops
    if stops:
        j = faults[0].joint
        assert abs(faults[0].limit) == HIGH[j] and math.copysign(1.0, faults[0].limit) == np.sign(position[j])
        assert bench.send()[1] == [], "reported once; the stop is latched"


@pytest.mark.parametrize(("velocity", "stops"), [(2.99, False), (3.01, True), (-2.99, False), (-3.01, True)])
def test_f43_a_joint_that_is_too_fast(velocity, stops):
    bench = Bench()
    bench.guard.measured.joint_velocity = [0.0, velocity]
    _, faults = bench.send()
    assert bench.guard.controlled is stops
    if stops:
        assert [(f.code, f.joint, f.value, f.limit) for f in faults] == [(FaultCode.OVERSPEED, 1, velocity, 3.0)]


def test_a_stop_stays_until_a_reset_that_all_agree_to():
    bench = Bench()
    bench.send(demands=[demand(Action.CONTROLLED_STOP)])
    for _ in range(499):
        bench.send()
    assert bench.guard.healthy == 499
    assert bench.guard.reset() == ["inputs healthy for 499 samples, 500 needed; wait or repair them"]
    bench.send()
    assert bench.guard.reset(["a goal is active"]) == ["a goal is active"] and bench.guard.controlled
    bench.guard.measured.joint_velocity = [0.0, 0.02]
    assert len(bench.guard.reset()) == 1
    bench.guard.measured.joint_velocity = [0.0, 0.0]
    before = bench.guard.gate.last_torque.copy()
    assert bench.guard.reset() == [] and bench.guard.mode is Mode.ACTIVE
    out, faults = bench.send(before + [700.0, 0.0])
    assert out[0] == pytest.approx(before[0] + 670.0) and out[1] == before[1], "at the rate limit, from what was held"
    assert [fault.code for fault in faults] == [FaultCode.RATE_LIMITED]


def test_reset_after_a_ramp_and_reset_of_nothing():
    bench = Bench()
    assert bench.guard.reset(["anything"]) == []
    bench.send(demands=[demand(Action.TORQUE_RAMP)])
    for _ in range(600):
        bench.send()
    assert bench.guard.reset() == [] and bench.guard.mode is Mode.ACTIVE
    out, _ = bench.send()
    assert out.tolist() == HOLD.tolist()


def test_a_reset_waits_for_the_end_of_the_ramp():
    bench = Bench()
    bench.guard.gate.last_torque = [1150.0, 0.0]
    bench.send(demands=[demand(Action.TORQUE_RAMP)])
    bench.guard.state.healthy = 10_000
    assert bench.guard.reset() == ["joint_1 torque ramp runs at 480 N m; wait for zero"]
    bench.send()
    bench.guard.state.healthy = 10_000
    assert bench.guard.reset() == []


def test_ticks_that_stood_during_a_stop_go_on_after_the_reset():
    """While stopped the gate counts its own ticks; after the reset those of the source count again."""
    bench = Bench()
    for _ in range(50):
        bench.send(tick=400.0)
    for _ in range(600):
        bench.send()
    assert bench.guard.reset() == []
    _, faults = bench.send()
    assert faults == [] and not bench.guard.stopped


def test_deactivation_ends_the_torque_and_keeps_the_latch():
    bench = Bench()
    bench.send(demands=[demand(Action.CONTROLLED_STOP)])
    bench.guard.deactivate()
    assert (bench.guard.gate.stop_code, bench.guard.gate.stop_joint) == (FaultCode.STOP_LEFT, -1.0)
    assert bench.send()[0].tolist() == [0.0, 0.0] and bench.guard.mode is Mode.INACTIVE
    bench.guard.activate(np.zeros(N))
    assert bench.guard.mode is Mode.STOPPED and bench.send()[0].tolist() == [0.0, 0.0]
    calm = Bench()
    calm.guard.deactivate()
    assert not calm.guard.stopped and calm.send()[0].tolist() == [0.0, 0.0]


def test_a_fault_is_reported_once_also_when_the_gate_sees_it_too():
    bench = Bench()
    bench.guard.measured.motor_position = math.nan
    _, faults = bench.send([40.0, math.nan])
    assert [f.code for f in faults] == [FaultCode.NOT_FINITE]


def test_limits_file_is_checked_as_a_whole():
    values = select(load_params_file(config_path("limits.yaml"), "limits"), NAMES)
    found = configure(values, DT)
    assert found.joints == 2 and found.guard.twist_limit.tolist() == [8.5e-3, 1.3e-2]
    for name, bad in (("twist_limit", [0.0, 1.0]), ("rail_samples", 0), ("stop_damping", [math.nan, 1.0])):
        with pytest.raises(ConfigError, match=name):
            configure(values | {name: bad}, DT)
    with pytest.raises(ConfigError, match="twist_limt: unknown parameter of guard, did you mean twist_limit"):
        configure(values | {"twist_limt": [1.0, 1.0]}, DT)
    with pytest.raises(ConfigError, match="joint_9"):
        select(values, ["joint_9"])


@pytest.fixture(params=FORMS)
def loop(request):
    """The monitors around the torque law, compiled and plain."""
    return Loop(request.param)


@pytest.mark.parametrize(
    ("gap", "level", "new", "action"),
    [
        (0, 0.0, 0.0, None), (0, 5.0, 4.9, None), (0, 0.05, 0.0, None), (1, 0.0, 1.0, Action.REPORT),
        (2, 0.0, 2.0, Action.REPORT), (3, 0.0, 3.0, Action.DEGRADE), (10, 0.0, 10.0, Action.CONTROLLED_STOP),
        (9, 0.0, 9.0, Action.DEGRADE), (1, 9.1, 10.0, Action.CONTROLLED_STOP), (1, 9.0, 9.9, Action.REPORT),
    ],
)  # fmt: skip
def test_f01_lost_ticks(loop, gap, level, new, action):
    found, faults = loop.lost_ticks(gap, level, limits())
    assert found == pytest.approx(new)
    assert [f.action for f in faults] == ([] if action is None else [action])
    if action is not None:
        bound = {Action.REPORT: 1.0, Action.DEGRADE: 3.0, Action.CONTROLLED_STOP: 10.0}[action]
        assert faults[0].code is FaultCode.FRAME_LOST and faults[0].limit == bound and faults[0].value == found
        assert faults[0].joint == -1, "a lost tick is lost for all joints"


def blocks():
    """Empty sample and reference of the torque law."""
    return torque_layout("TorqueSample", N).zeros(), torque_layout("TorqueReference", N).zeros()


def adaptation_case(at_bound="coulomb_torque", side="high"):
    assert torque_adaptive.PARAMETERS
    params, state = torque_layout("TorqueParams", N).zeros(), torque_layout("TorqueState", N).zeros()
    for stem in set(watchers.ESTIMATES.values()):
        params.view(f"{stem}_low")[...], params.view(f"{stem}_high")[...] = -1.0, 1.0
    if at_bound:
        state.view(at_bound)[1] = 1.0 if side == "high" else -1.0
    return params, state


@pytest.mark.parametrize("name", [*watchers.ESTIMATES, ""])
@pytest.mark.parametrize("side", ["low", "high"])
@pytest.mark.parametrize(("growth", "action"), [(1.5, None), (2.5, Action.DEGRADE), (8.0, Action.CONTROLLED_STOP)])
def test_f34_an_estimate_at_its_bound_with_a_growing_error(loop, name, side, growth, action):
    params, state = adaptation_case(name, side)
    sample, reference = blocks()
    memory, seen = watchers.initial(N), []
    sample.joint_position = 0.02
    for k in range(600):
        sample.joint_position = 0.02 if k < 100 else 0.02 * growth
        held = state.copy()
        if k < 100:
            held.view(name or "coulomb_torque")[1] = 0.0
        memory, faults = loop.watch(memory, held, params, sample, reference, limits().guard, 0.01)
        seen += [(k, f.joint, f.code, f.action) for f in faults]
    if action is None or not name:
        assert seen == []
    else:
        assert seen[0][0] == 199 and {row[1] for row in seen} == {1}
        assert seen[-1][2:] == (FaultCode.ADAPTATION, action)


def test_f34_the_error_is_a_mean_of_about_ten_looks(loop):
    params, state = adaptation_case("")
    sample, reference = blocks()
    sample.joint_position, reference.desired_position = [0.03, 0.05], [0.05, 0.03]
    memory = watchers.initial(N)
    for expected in (0.002, 0.0038):
        memory, _ = loop.watch(memory, state, params, sample, reference, limits().guard, 0.01)
        np.testing.assert_allclose(memory.error, expected, rtol=1e-12)


@pytest.mark.parametrize(
    ("error", "then", "since", "action"),
    [
        (0.04, 0.02, 1.0, Action.DEGRADE),
        (0.08, 0.02, 1.0, Action.CONTROLLED_STOP),
        (0.0799, 0.02, 1.0, Action.DEGRADE),
        (0.0399, 0.02, 1.0, None),
        (0.01, 0.001, 1.0, None),
        (0.08, 0.02, 0.5, None),
    ],
)
def test_f34_exactly_on_its_thresholds(loop, error, then, since, action):
    """Growth counts from its threshold on; the time and the smallest error must be exceeded."""
    params, state = adaptation_case()
    sample, reference = blocks()
    memory, bounds = watchers.initial(N), limits().guard.copy()
    bounds.adaptation_time = 1.0
    sample.joint_position, memory.error, memory.error_at_bound, memory.time_at_bound = error, error, then, since
    _, faults = loop.watch(memory, state, params, sample, reference, bounds, 0.5)
    assert [(f.joint, f.action) for f in faults] == ([] if action is None else [(1, action)])


def test_f34_small_errors_missing_bounds_and_missing_readings_do_not_count(loop):
    params, state = adaptation_case()
    sample, reference = blocks()
    memory = watchers.initial(N)
    for k in range(400):
        sample.joint_position = 0.0001 * k / 40.0
        memory, faults = loop.watch(memory, state, params, sample, reference, limits().guard, 0.01)
        assert faults == []
    sample.joint_position = math.nan
    new, _ = loop.watch(memory, state, params, sample, reference, limits().guard, 0.01)
    assert new.error.tolist() == memory.error.tolist()
    params.coulomb_torque_low = params.coulomb_torque_high = 1.0
    free, _ = loop.watch(memory, state, params, sample, reference, limits().guard, 0.01)
    assert free.time_at_bound.tolist() == [0.0, 0.0], "a fixed estimate is not at a bound"


def test_twenty_rate_excesses_without_a_motor_position_become_a_ramp():
    bench = Bench()
    bench.guard.measured.motor_position = math.nan
    for k in range(25):
        out, faults = bench.send([1200.0 if k % 2 else -1200.0, -7.0])
        if bench.guard.stopped:
            break
    assert FaultCode.STOP_LEFT not in [fault.code for fault in faults], "no stop began that could be left"
    assert k == 19 and bench.guard.mode is Mode.STOPPED and not bench.guard.controlled and abs(out[0]) < 670.0


def test_a_reset_while_inactive_does_not_activate():
    bench = Bench()
    bench.send(demands=[demand(Action.TORQUE_RAMP)])
    bench.guard.deactivate()
    for _ in range(600):
        bench.send()
    assert bench.guard.reset() == [] and bench.guard.mode is Mode.INACTIVE
    assert bench.send()[0].tolist() == [0.0, 0.0]


def test_f36_the_last_tick_that_a_double_counts_is_used_the_next_is_not():
    bench = Bench()
    bench.send(tick=2.0**53 - 1.0)
    _, faults = bench.send(tick=2.0**53)
    assert faults == [] and not bench.guard.stopped
    _, faults = bench.send(tick=2.0**53 + 2.0)
    assert {fault.code for fault in faults} == {FaultCode.STAMP_STUCK} and bench.guard.stopped


@pytest.mark.parametrize("torque", [594.0, -594.0, 700.0])
def test_f08_three_readings_at_the_rail_degrade(loop, torque):
    bounds, run = limits().guard, np.zeros(N)
    rail = float(bounds.gauge_rail[1])
    assert rail == 600.0
    for k in range(1, 5):
        run, faults = loop.gauge_rail(np.array([0.0, torque]), run, bounds)
        assert run.tolist() == [0.0, k]
        expected = [(FaultCode.GAUGE_RAIL, 1, torque, rail, Action.DEGRADE)] if k >= 3 else []
        assert [(f.code, f.joint, f.value, f.limit, f.action) for f in faults] == expected
    assert loop.gauge_rail(np.array([0.0, 593.9]), run, bounds) == (pytest.approx(np.zeros(N)), [])
    for free in ([0.0, math.nan], [2300.0, 0.0]):
        after, faults = loop.gauge_rail(np.array(free), run, bounds)
        assert after.tolist() == [0.0, 0.0] and faults == []


def test_f01_a_tenth_is_forgiven_exactly(loop):
    assert loop.lost_ticks(0, 0.1, limits())[0] == 0.0 and loop.lost_ticks(1, 0.1, limits())[0] == 1.0


BOUNDS = [
    *((name, 1, 10**6) for name in ("degrade_gap_samples", "recover_samples", "brake_samples", "rejected_samples",
                                    "disagree_samples", "frozen_samples", "rail_samples", "rail_degrade_samples")),
    ("adaptation_time", 0.01, 1e3),
]  # fmt: skip


@pytest.mark.parametrize(("name", "low", "high"), BOUNDS)
def test_each_limit_of_the_guard_has_its_bounds(name, low, high):
    values = select(load_params_file(config_path("limits.yaml"), "limits"), NAMES)
    step = 1 if isinstance(low, int) else 1e-6
    for good in (low, low + step, high - step, high):
        assert float(configure(values | {name: good}, DT).guard.view(name)) == good
    for bad in (low - step, high + step):
        with pytest.raises(ConfigError, match=name):
            configure(values | {name: bad}, DT)


def test_limits_per_joint_are_above_zero_and_may_be_small():
    values = select(load_params_file(config_path("limits.yaml"), "limits"), NAMES)
    for name in GUARD_PARAMETERS.names:
        if isinstance(values[name], list):
            found = configure(values | {name: [1e-9, 0.5]}, DT).guard.view(name)
            assert found.tolist() == [1e-9, 0.5]
            with pytest.raises(ConfigError, match=name):
                configure(values | {name: [0.0, 0.5]}, DT)


def test_the_torque_that_is_held_is_the_mean_of_about_fifty_samples():
    bench = Bench()
    before = bench.guard.state.mean_torque.copy()
    bench.send(HOLD + [5.0, -1.0])
    np.testing.assert_allclose(bench.guard.state.mean_torque, before + (HOLD + [5.0, -1.0] - before) / 50.0, rtol=1e-15)


@pytest.mark.parametrize("form", FORMS)
@given(st.integers(0, 12), st.integers(0, 12), st.floats(0.0, 12.0))
def test_a_longer_gap_never_gives_a_weaker_action(form, one, other, level):
    short, long = sorted((one, other))
    actions = [strongest(Loop(form).lost_ticks(gap, level, limits())[1]) for gap in (short, long)]
    assert actions[0] <= actions[1]
