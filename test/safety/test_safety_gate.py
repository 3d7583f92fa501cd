"""Safety gate: finite, bounded, rate-bounded, transparent, idempotent, latched; equal to the plain law bit for bit."""

import dataclasses
import math
import re
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays
from oracles import gate_law
from oracles.unsafe_torque import judge

from hd_control.core.errors import ConfigError
from hd_control.core.faults import Action, Fault, FaultCode
from hd_control.core.resources import config_path
from hd_control.core.strict_yaml import load_params_file
from hd_control.safety import gate as sg
from hd_control.safety import limits as limits_module
from hd_control.safety.guard import Guard

DT = 1e-3
LIMIT, STEP = np.array([100.0, 50.0, 20.0]), np.array([10.0, 4.0, 0.7])
N = 3
ODD = [math.nan, math.inf, -math.inf, -0.0, 5e-324, -5e-324, 1e308, -1e308, 100.0, -100.0, 20.0, 10.0, 0.7]
any_number = st.one_of(st.sampled_from(ODD), st.floats(-150, 150), st.floats())
vectors = arrays(float, N, elements=any_number)
GATES = [gate_law.safety_gate, sg.safety_gate]


def limits(**changes):
    values = {
        "age_limit": 10.0, "rate_excess_limit": 20.0, "reset_samples": 5.0, "standstill_velocity": 0.01,
        "torque_limit": LIMIT, "torque_step": STEP,
    }  # fmt: skip
    return limits_module.limits_layout(N).pack(values | changes)


def opened(applied=(0.0, 0.0, 0.0), tick=-1.0):
    """A gate in normal work: active, commands already caught up with."""
    state = gate_law.activate(sg.initial_gate_state(N), limits(), np.array(applied))
    state.catch_up = 0.0
    state.last_tick = tick
    return state


def send(gate, command, state, ages=0.0, tick=None, bounds=None):
    tick = float(np.max(state.last_tick)) + 1 if tick is None else tick
    full = [
        np.full(N, value) if np.isscalar(value) else np.array(value, dtype=float) for value in (command, ages, tick)
    ]
    return gate(*full, bounds or limits(), state)


@st.composite
def states(draw):
    state = sg.state_layout(N).zeros()
    for name in ("active", "stopped", "brake_requested"):
        state.view(name)[...] = draw(st.sampled_from([0.0, 1.0]))
    state.healthy_samples = draw(st.sampled_from([0.0, 7.0]))
    state.last_torque = draw(vectors)
    state.last_tick = draw(arrays(float, N, elements=st.sampled_from([-1.0, 0.0, 5.0, 2.0**53, math.nan])))
    state.rate_excess_run = draw(arrays(float, N, elements=st.sampled_from([0.0, 18.0, 19.0, 20.0])))
    state.catch_up = draw(arrays(float, N, elements=st.sampled_from([0.0, 1.0, 30.0])))
    return state


inputs = st.tuples(
    vectors,
    arrays(float, N, elements=st.sampled_from([0.0, 1.0, 9.0, 9.99, 10.0, 11.0, -1.0, math.nan, math.inf])),
    arrays(float, N, elements=st.sampled_from([0.0, 5.0, 6.0, 2.0**53, 2.0**54, -1.0, math.nan, math.inf])),
)


def same(a, b):
    return a.tobytes() == b.tobytes()


def same_faults(a, b):
    def bits(fault):
        return [np.float64(x).tobytes() for x in dataclasses.astuple(fault)]

    return [bits(f) for f in a] == [bits(f) for f in b]


@settings(max_examples=200, deadline=None)
@given(states(), inputs)
def test_the_gate_has_the_bits_of_the_plain_law(state, case):
    command, ages, ticks = case
    results = [gate(command, ages, ticks, limits(), state) for gate in GATES]
    (out_a, state_a, faults_a), (out_b, state_b, faults_b) = results
    assert same(out_a, out_b) and same(state_a.array, state_b.array) and same_faults(faults_a, faults_b)


@settings(max_examples=200, deadline=None)
@given(states(), inputs)
def test_no_unsafe_torque_for_any_number_and_any_state(state, case):
    """P1. The reference of the rate is the last torque cut to the limits; a torque above the limits is no reference."""
    command, ages, ticks = case
    before_bits = state.array.copy()
    out, new, _ = sg.safety_gate(command, ages, ticks, limits(), state)
    assert same(state.array, before_bits), "the gate is a pure function"
    last = [min(max(x, -b), b) if math.isfinite(x) else math.copysign(b, x) if not math.isnan(x) else 0.0
            for x, b in zip(state.last_torque.tolist(), LIMIT.tolist(), strict=True)]  # fmt: skip
    name = "ACTIVE" if new.active == 1.0 and new.stopped == 0.0 else "STOPPING" if new.active == 1.0 else "INACTIVE"
    checked = {"ages": ages, "age_limit": 10.0, "ticks": ticks, "used": state.last_tick} if name == "ACTIVE" else {}
    assert judge(out.tolist(), last, LIMIT.tolist(), STEP.tolist(), name, **checked) == []
    assert same(out, new.last_torque)


@settings(max_examples=120, deadline=None)
@given(states(), inputs)
def test_the_gate_applied_twice_is_the_gate_applied_once(state, case):
    """gate(gate(x)) = gate(x): what may leave passes unchanged."""
    command, ages, ticks = case
    out, new, _ = sg.safety_gate(command, ages, ticks, limits(), state)
    again, _, _ = sg.safety_gate(out, ages, ticks, limits(), state)
    if new.stopped == state.stopped:
        assert same(again, out)
    else:
        # the stop came in this sample: what left was the ramp, and as a command the ramp is compliant
        assert np.array_equal(again, out)


@given(st.lists(arrays(float, N, elements=st.floats(-0.5, 0.5)), min_size=1, max_size=30))
def test_a_compliant_stream_leaves_bit_for_bit(changes):
    """P2, with -0.0 and subnormal numbers in it."""
    state, torque = opened(), np.zeros(N)
    for k, change in enumerate(changes):
        torque = np.clip(torque + change * STEP, -LIMIT, LIMIT)
        torque[k % N] = -0.0 if abs(torque[k % N]) < 0.1 * STEP[k % N] else torque[k % N]
        for gate in GATES:
            out, new, faults = send(gate, torque, state)
            assert same(out, torque) and faults == [] and new.stopped == 0.0
        state = new


@pytest.mark.parametrize("gate", GATES)
class TestBothForms:
    def test_f37_too_large_is_cut_counted_and_reported(self, gate):
        state = opened(applied=(95.0, -48.0, 0.0))
        out, new, faults = send(gate, [101.0, -51.0, 0.5], state)
        assert out.tolist() == [100.0, -50.0, 0.5]
        assert [(f.code, f.joint, f.value, f.limit, f.action) for f in faults] == [
            (FaultCode.TORQUE_LIMITED, 0, 101.0, 100.0, Action.REPORT),
            (FaultCode.TORQUE_LIMITED, 1, -51.0, 50.0, Action.REPORT),
        ]
        assert new.saturated_samples.tolist() == [1, 1, 0] and new.rate_limited_samples.tolist() == [0, 0, 0]

    def test_f38_rate_is_measured_from_the_torque_that_left(self, gate):
        """Asked for 40 twice with a step of 10: 10, then 20. Measured from the request the second would be 40."""
        out, state, faults = send(gate, [40.0, 0.0, 0.0], opened())
        assert out[0] == 10.0 and faults[0].code is FaultCode.RATE_LIMITED
        out, state, _ = send(gate, [40.0, 0.0, 0.0], state)
        assert out[0] == 20.0 and state.rate_excess_run.tolist() == [2, 0, 0]
        out, state, _ = send(gate, [-40.0, 0.0, 0.0], state)
        assert out[0] == 10.0
        out, state, _ = send(gate, [12.0, 0.0, 0.0], state)
        assert out[0] == 12.0 and state.rate_excess_run[0] == 0 and state.rate_limited_samples[0] == 3

    def test_twenty_rate_excesses_in_a_row_stop_nineteen_do_not(self, gate):
        state = opened()
        for k in range(19):
            _, state, _ = send(gate, [0.0, 0.0, 10.0 if k % 2 == 0 else -10.0], state)
        assert state.stopped == 0.0
        _, calm, _ = send(gate, [0.0, 0.0, float(state.last_torque[2])], state)
        assert calm.rate_excess_run[2] == 0.0
        _, state, faults = send(gate, [0.0, 0.0, -10.0], state)
        assert state.stopped == 1.0 and state.stop_code == FaultCode.RATE_PERSISTENT and state.stop_joint == 2
        assert faults[-1].action is Action.TORQUE_RAMP

    @pytest.mark.parametrize(
        ("case", "code"),
        [
            ({"command": [0.0, math.nan, 0.0]}, FaultCode.NOT_FINITE),
            ({"command": [0.0, -math.inf, 0.0]}, FaultCode.NOT_FINITE),
            ({"ages": [0.0, 10.0, 0.0]}, FaultCode.NODE_KILLED),
            ({"ages": [0.0, math.nan, 0.0]}, FaultCode.NODE_KILLED),
            ({"tick": [8.0, 7.0, 8.0]}, FaultCode.STAMP_STUCK),
            ({"tick": [8.0, 6.0, 8.0]}, FaultCode.STAMP_STUCK),
            ({"tick": [8.0, math.nan, 8.0]}, FaultCode.STAMP_STUCK),
        ],
    )
    def test_f04_f18_f02_stop_every_joint_in_the_same_sample(self, gate, case, code):
        state = opened(applied=(35.0, -3.0, 0.1), tick=7.0)
        arguments = {"command": [35.0, -3.0, 0.1], "tick": [8.0, 8.0, 8.0]} | case
        out, new, faults = send(gate, arguments.pop("command"), state, **arguments)
        assert new.stopped == 1.0 == new.brake_requested and new.stop_code == code and new.stop_joint == 1
        assert out.tolist() == [25.0, 0.0, 0.0], "the ramp starts at once and does not cross zero"
        assert [(f.code, f.joint, f.action) for f in faults] == [(code, 1, Action.TORQUE_RAMP)]

    def test_the_first_cause_keeps_its_name(self, gate):
        """Two joints fail in one sample, a third later: the stop is called by the first."""
        _, state, faults = send(
            gate, [0.0, math.nan, 0.0], opened(tick=7.0), ages=[0.0, 0.0, 12.0], tick=[8.0, 8.0, 8.0]
        )
        assert [f.code for f in faults] == [FaultCode.NOT_FINITE, FaultCode.NODE_KILLED]
        _, state, _ = send(gate, [math.inf, 0.0, 0.0], state)
        assert (state.stop_code, state.stop_joint) == (FaultCode.NOT_FINITE, 1)

    def test_a_tick_is_used_once(self, gate):
        _, state, _ = send(gate, 0.0, opened(tick=7.0), tick=8.0)
        assert state.stopped == 0.0 and state.last_tick.tolist() == [8.0, 8.0, 8.0]
        _, state, faults = send(gate, 0.0, state, tick=[9.0, 9.0, 8.0])
        assert state.stop_code == FaultCode.STAMP_STUCK and [f.joint for f in faults] == [2]

    def test_an_age_of_nine_samples_is_fine(self, gate):
        out, new, faults = send(gate, [1.0, 1.0, 0.1], opened(), ages=9.0)
        assert new.stopped == 0.0 and faults == [] and out[0] == 1.0

    def test_a_stop_stays_when_its_cause_is_gone(self, gate):
        _, state, _ = send(gate, math.nan, opened(applied=(35.0, 0.0, 0.0)))
        seen = []
        for _ in range(50):
            out, state, faults = send(gate, [35.0, 1.0, 0.1], state)
            seen.append(out.tolist())
            assert faults == []
        assert [row[0] for row in seen[:4]] == [15.0, 5.0, 0.0, 0.0]
        assert state.stopped == 1.0 == state.brake_requested and not any(any(row) for row in seen[3:])

    def test_not_active_means_exactly_zero(self, gate):
        closed = gate_law.deactivate(opened(applied=(35.0, 0.0, 0.0)))
        for command in (5.0, math.nan):
            out, new, _ = send(gate, command, closed)
            assert same(out, np.zeros(N)) and new.stopped == 0.0

    def test_after_activation_the_command_may_catch_up(self, gate):
        """From zero to a gravity torque of 95 N m takes 10 steps, joint 3 needs 29: no stop, all counted."""
        state = gate_law.activate(sg.initial_gate_state(N), limits(), np.zeros(N))
        for _ in range(40):
            out, state, _ = send(gate, [95.0, 0.0, 20.0], state)
        assert out.tolist() == [95.0, 0.0, 20.0] and state.stopped == 0.0
        assert state.rate_limited_samples.tolist() == [9, 0, 28] and np.all(state.catch_up == 0.0)

    def test_catching_up_does_not_last_for_ever(self, gate):
        state = gate_law.activate(sg.initial_gate_state(N), limits(), np.zeros(N))
        for k in range(200):
            _, state, _ = send(gate, [100.0 if k % 2 == 0 else -100.0, 0.0, 0.0], state)
            if state.stopped == 1.0:
                break
        # 2 * 100 / 10 samples to catch up, then 20 in a row
        assert k + 1 == 20 + 20

    def test_each_joint_has_its_own_limits(self, gate):
        """Joints and limits permuted together: the result is permuted."""
        state, command, order = opened(applied=(95.0, 45.0, 19.0)), np.array([120.0, 60.0, 30.0]), [1, 0, 2]
        out, new, _ = send(gate, command, state)
        moved = state.copy()
        for name in ("last_torque", "last_tick", "rate_excess_run", "catch_up"):
            moved.view(name)[...] = state.view(name)[order]
        bounds = limits(torque_limit=LIMIT[order], torque_step=STEP[order])
        turned, new_turned, _ = send(gate, command[order], moved, bounds=bounds)
        assert same(turned, out[order]) and same(new_turned.saturated_samples.copy(), new.saturated_samples[order])

    def test_at_the_limit_and_exactly_one_step_away_nothing_is_limited(self, gate):
        top, bottom = LIMIT.copy(), -LIMIT
        for applied, command in ((top, top), (bottom, bottom), (top, top - STEP), (bottom, bottom + STEP)):
            out, _, faults = send(gate, command, opened(applied=applied))
            assert same(out, command) and faults == []

    def test_a_limit_below_one_keeps_its_sign(self, gate):
        small = limits(torque_limit=np.full(N, 0.5), torque_step=np.full(N, 2.0))
        out, _, _ = send(gate, [0.7, -0.7, 0.2], opened(), bounds=small)
        assert out.tolist() == [0.5, -0.5, 0.2]

    def test_f38_says_how_far_the_command_was_from_the_torque_that_left(self, gate):
        _, _, faults = send(gate, [60.0, -20.0, 0.0], opened(applied=(80.0, -10.0, 0.0)))
        assert [(f.code, f.joint, f.value, f.limit) for f in faults] == [
            (FaultCode.RATE_LIMITED, 0, -20.0, 10.0),
            (FaultCode.RATE_LIMITED, 1, -10.0, 4.0),
        ]

    @pytest.mark.parametrize(
        ("memory", "first"), [(1e308, 90.0), (-1e308, -90.0), (math.nan, 0.0), (100.0, 90.0), (-10.0, 0.0), (10.0, 0.0)]
    )
    def test_the_ramp_begins_inside_the_limit_whatever_the_memory_holds(self, gate, memory, first):
        state = gate_law.stopped_by(opened(), FaultCode.GAUGE_DRIFT, 0)
        state.last_torque[0] = memory
        out, _, _ = send(gate, 0.0, state)
        assert same(out, np.array([first, 0.0, 0.0]))


def test_the_gate_before_activation_remembers_nothing():
    state = sg.initial_gate_state(N)
    assert state.stop_joint == -1.0 and state.last_tick.tolist() == [-1.0] * N and state.active == 0.0
    assert same(state.array, gate_law.initial_gate_state(N).array)
    assert state.layout == gate_law.initial_gate_state(N).layout


class Opened:
    """A guard, which is where the gate is opened, stopped and reset; a demand stops it by the ramp."""

    def __init__(self, applied=(0.0, 0.0, 0.0)):
        guard = limits_module.guard_layout(N).zeros()
        guard.array[:] = 1e9
        bounds, wide = limits_module.SafetyLimits(limits(), guard), np.full(N, 1e9)
        self.guard, self.tick = Guard(bounds, -wide, wide, wide, DT), 0.0
        self.guard.activate(np.array(applied, dtype=float))

    def send(self, command, demands=()):
        self.tick += 1.0
        command = np.full(N, command) if np.isscalar(command) else np.array(command, dtype=float)
        return self.guard.step(command, np.zeros(N), np.full(N, self.tick), demands)

    def stopped(self, healthy=5):
        """Stopped by a ramp, then so many healthy samples."""
        self.send(0.0, [Fault(FaultCode.GAUGE_DRIFT, 0, 2.0, 1.0, Action.TORQUE_RAMP)])
        for _ in range(healthy):
            self.send(0.0)
        assert self.guard.gate.stopped == 1.0
        return self.guard


class TestReset:
    def test_granted_when_healthy_and_still(self):
        case = Opened()
        guard = case.stopped()
        assert guard.reset() == []
        assert guard.gate.stopped == 0.0 == guard.gate.brake_requested and guard.gate.stop_joint == -1.0
        assert guard.gate.stop_code == 0.0
        out, _ = case.send([30.0, 0.0, 0.0])
        assert out[0] == 10.0 and guard.gate.stopped == 0.0, "torque comes back at the rate limit"

    def test_granted_at_exactly_the_standstill_velocity_and_time_to_catch_up_is_given(self):
        guard = Opened().stopped()
        guard.measured.joint_velocity = [0.01, -0.01, 0.0]
        assert guard.reset() == [] and guard.gate.catch_up.tolist() == [20.0, 25.0, 58.0]
        closed = Opened().stopped()
        closed.deactivate()
        closed.gate.catch_up = 0.0
        assert closed.reset() == []
        assert closed.gate.catch_up.tolist() == [0.0, 0.0, 0.0] and closed.gate.active == 0.0

    def test_refused_one_healthy_sample_short(self):
        guard = Opened().stopped(healthy=4)
        before = guard.gate.array.copy()
        assert guard.reset() == ["inputs healthy for 4 samples, 5 needed; wait or repair them"]
        assert same(guard.gate.array, before)

    @pytest.mark.parametrize("velocity", [0.02, -0.02, math.nan])
    def test_refused_while_a_joint_moves(self, velocity):
        guard = Opened().stopped()
        guard.measured.joint_velocity[1] = velocity
        reasons = guard.reset()
        assert guard.gate.stopped == 1.0 and len(reasons) == 1 and reasons[0].startswith("joint_2 moves with")

    def test_refused_during_the_ramp_with_every_reason(self):
        guard = Opened(applied=(95.0, 0.0, 0.0)).stopped(healthy=0)
        guard.measured.joint_velocity[2] = 1.0
        assert guard.reset() == [
            "inputs healthy for 0 samples, 5 needed; wait or repair them",
            "joint_1 torque ramp runs at 85 N m; wait for zero",
            "joint_3 moves with 1 rad/s, limit 0.01 rad/s; wait for rest",
        ]

    def test_activation_does_not_end_a_stop(self):
        case = Opened()
        guard = case.stopped()
        guard.activate(np.zeros(N))
        out, _ = case.send([5.0, 0.0, 0.0])
        assert guard.gate.stopped == 1.0 and out[0] == 0.0


def test_random_service_calls_never_let_a_stop_end_without_reset():
    """P4 in small: any order of sending, corrupting, closing, opening, stopping and resetting."""
    rng, case, stops, resets = np.random.default_rng(11), Opened(), 0, 0
    guard, ramp = case.guard, Fault(FaultCode.GAUGE_DRIFT, 0, 2.0, 1.0, Action.TORQUE_RAMP)
    for _ in range(2500):
        stopped, ramping, last = guard.stopped, guard.gate.stopped == 1.0, guard.gate.last_torque.copy()
        action, granted = rng.choice(["send"] * 40 + ["nan", "ramp", "close", "open", "reset"]), False
        guard.measured.joint_velocity = rng.choice([0.0, 0.05])
        if action == "close":
            guard.deactivate()
        elif action == "open":
            guard.activate(last)
        elif action == "reset":
            granted = not guard.reset()
            resets += granted and stopped
        else:
            command = np.full(N, math.nan) if action == "nan" else rng.normal(0, 3, N)
            active = guard.gate.active == 1.0
            out, _ = case.send(command, [ramp] if action == "ramp" else [])
            name = "INACTIVE" if not active else "STOPPING" if guard.gate.stopped == 1.0 else "ACTIVE"
            assert judge(out.tolist(), last.tolist(), LIMIT.tolist(), STEP.tolist(), name) == []
            if ramping and active:
                assert np.all(np.abs(out) <= np.maximum(0.0, np.abs(last) - STEP))
        assert guard.stopped or granted or not stopped
        stops += guard.stopped and not stopped
    assert stops > 10 and resets > 5, "the walk must stop and reset often, or it shows nothing"


def test_shipped_limits_and_their_refusals():
    values = load_params_file(config_path("limits.yaml"), "torque_node")
    bounds = limits_module.configure_gate(values, DT)
    assert bounds.torque_step.tolist() == pytest.approx([670, 670, 670, 260, 70, 70, 30])
    assert bounds.age_limit == 10 and bounds.rate_excess_limit == 20
    small = limits_module.configure_gate(values | {"motor_torque_limit": [0.5] * 7, "age_limit_samples": 1}, DT)
    assert small.torque_limit.tolist() == [0.5] * 7 and small.age_limit == 1
    for name, bad in [
        ("motor_torque_limit", [0.0] * 7),
        ("motor_torque_rate_limit", [math.nan] * 7),
        ("age_limit_samples", 0),
    ]:
        with pytest.raises(ConfigError, match=name):
            limits_module.configure_gate(values | {name: bad}, DT)


@pytest.mark.parametrize(
    ("name", "good", "bad"),
    [
        ("age_limit_samples", (1, 2, 999, 1000), (0, 1001)),
        ("rate_excess_limit", (1, 2, 999, 1000), (0, 1001)),
        ("reset_samples", (2, 3, 10**6), (1, 10**6 + 1)),
        ("standstill_velocity", (1e-9, 0.1), (0.0, 0.1000001, -0.01)),
        ("motor_torque_limit", ([1e-9] * 7, [0.5] * 7), ([0.0] * 7, [1.0] * 6 + [-1.0])),
        ("motor_torque_rate_limit", ([1e-9] * 7, [0.5] * 7), ([0.0] * 7, [1.0] * 6 + [math.inf])),
    ],
)
def test_each_limit_of_the_gate_has_its_bounds(name, good, bad):
    names = limits_module.GATE_PARAMETERS.names
    shipped = load_params_file(config_path("limits.yaml"), "limits")
    values = {key: value for key, value in shipped.items() if key in names}
    for value in good:
        limits_module.configure_gate(values | {name: value}, 1e-3)
    for value in bad:
        with pytest.raises(ConfigError, match=name):
            limits_module.configure_gate(values | {name: value}, 1e-3)


def test_the_oracle_sees_what_it_should():
    limit, step = [10.0], [1.0]
    assert judge([math.nan], [0.0], limit, step) == [("a", 0)]
    assert judge([-10.5], [-10.0], limit, step) == [("b", 0)]
    assert judge([2.0], [0.5], limit, step) == [("c", 0)]
    assert judge([1e-9], [0.0], limit, step, "INACTIVE") == [("g", 0)]
    assert judge([0.5], [0.0], limit, step, ages=[10], age_limit=10, ticks=[3], used=[2]) == [("f", 0)]
    assert judge([0.5], [0.0], limit, step, ages=[9], age_limit=10, ticks=[3], used=[3]) == [("f", 0)]
    assert judge([0.5], [0.0], limit, step, ages=[9], age_limit=10, ticks=[3], used=[2]) == []


def test_no_comparison_lets_a_nan_through():
    """`x < low or x > high` and `max(min(x, high), low)` are false for NaN; gate code may not use them."""
    texts = [Path(module.__file__).read_text() for module in (sg, limits_module, gate_law)]
    header = (Path(sg.__file__).parents[1] / "cpp" / "safety.hpp").read_text()
    compiled = header[header.index("struct SafetyGate {") :]
    texts.append(compiled[: compiled.index("\n};")])
    careless = re.compile(
        r"\bf?m(ax|in)\(|\bclamp\(|np\.(clip|maximum|minimum)\(|if [^\n]*[<>][^\n]* (or|\|\|) [^\n]*[<>]"
    )
    for text in texts:
        assert not careless.search(text), careless.search(text)
    for text in ("y = max(min(x, high), low)", "std::clamp(x, low, high)", "if (x < low || x > high)", "fmin(x, high)"):
        assert careless.search(text), text


def test_faults_of_the_gate_are_values_with_names():
    _, _, faults = send(sg.safety_gate, math.nan, opened())
    assert all(isinstance(f, Fault) and isinstance(f.code, FaultCode) and isinstance(f.action, Action) for f in faults)
