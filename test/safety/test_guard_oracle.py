"""The compiled guard against its plain re-statement, test/oracles/guard_law.py, bit for bit over random samples."""

from functools import lru_cache

import numpy as np
import pytest
from bits import check, rows, seeds
from oracles import guard_law

from hd_control.core.faults import Action, Fault, FaultCode
from hd_control.core.resources import config_path
from hd_control.core.strict_yaml import load_params_file
from hd_control.safety.guard import Guard
from hd_control.safety.limits import configure, select

N, LOW, HIGH, SPEED, DT = 2, np.array([-3.0, -2.0]), np.array([3.0, 2.0]), np.array([1.5, 2.5]), 1e-3
SAMPLES = 300
ODD = [np.nan, np.inf, -np.inf, 0.0, -0.0, 1e308, 2.0**53, 2.0**53 + 2.0, -1.0, 9.0, 10.0]
FIELDS = ("motor_position", "motor_velocity", "joint_position", "joint_velocity")
CODES = (FaultCode.GAUGE_DRIFT, FaultCode.GAUGE_BRANCH, FaultCode.ADAPTATION, FaultCode.LET_GO, FaultCode.NOT_FINITE)


@lru_cache
def limits():
    return configure(select(load_params_file(config_path("limits.yaml"), "limits"), ["joint_3", "joint_5"]), DT)


class Pair:
    """The guard and its oracle, which get the same; every look compares everything that the next sample depends on."""

    def __init__(self, hold_samples=0):
        arguments = limits(), LOW, HIGH, SPEED, DT, hold_samples
        self.guard, self.oracle, self.stops, self.modes = Guard(*arguments), guard_law.Guard(*arguments), 0, set()

    def both(self, method, *arguments):
        """What both answer."""
        found, expected = (getattr(each, method)(*arguments) for each in (self.guard, self.oracle))
        assert found == expected, method
        return found

    def see(self, measured):
        for each in (self.guard, self.oracle):
            for name, values in measured.items():
                each.measured.view(name)[:] = values

    def step(self, where, command, ages, ticks, demands):
        out, faults = self.guard.step(command.copy(), ages.copy(), ticks.copy(), demands)
        with np.errstate(all="ignore"):
            expected, wanted = self.oracle.step(command.copy(), ages.copy(), ticks.copy(), demands)
        check(where, torque=(out, expected), faults=(rows(faults), rows(wanted)))
        self.look(where)

    def look(self, where):
        guard, oracle = self.guard, self.oracle
        check(where, gate=(guard.gate.array, oracle.gate.array), stop=(guard.stop.array, oracle.stop.array),
              measured=(guard.measured.array, oracle.measured.array),
              mean_torque=(guard.state.mean_torque, oracle.mean_torque), last_tick=(guard.last_tick, oracle.last_tick),
              state=([guard.healthy, guard.controlled, guard.stopped, int(guard.mode), bool(guard.state.emitting)],
                     [oracle.healthy, oracle.controlled, oracle.stopped, oracle.mode, oracle.emitting]))  # fmt: skip
        self.modes.add(oracle.mode)

    def calm(self, random):
        """A robot that has rested for long: what a reset asks for, or nearly."""
        torque = 0.0 if random.random() < 0.8 else 5.0
        healthy = float(random.choice([499.0, 500.0, 1e4]))
        speed = float(random.choice([0.0, 0.0, 0.01, 0.02, np.nan]))
        for each in (self.guard, self.oracle):
            each.measured.array[:] = 0.0
            each.measured.joint_velocity[0] = speed
            each.gate.last_torque = torque
        self.guard.state.healthy, self.oracle.healthy = healthy, int(healthy)


def demand(random):
    """What a monitor may ask for."""
    action = Action(int(random.choice([1, 2, 3, 4], p=[0.5, 0.2, 0.2, 0.1])))
    return Fault(CODES[random.integers(len(CODES))], int(random.integers(-1, N)), 2.0, 1.0, action)


def strike(random, inputs, measured):
    """Now and then an odd number somewhere."""
    if random.random() < 0.008:
        inputs[random.integers(3)][random.integers(N)] = random.choice(ODD)
    if random.random() < 0.008:
        measured[FIELDS[random.integers(4)]][random.integers(N)] = random.choice(ODD)


def between_samples(pair, random, where):
    """Resets, and a side that is closed and opened again."""
    if pair.oracle.stopped and random.random() < 0.03:
        if random.random() < 0.7:
            pair.calm(random)
        if pair.both("reset", ["a goal is active"] if random.random() < 0.2 else []) == []:
            pair.stops += 1
    if random.random() < 0.002:
        pair.both("deactivate")
    if random.random() < (0.02 if pair.oracle.mode == guard_law.INACTIVE else 0.001):
        pair.both("activate", random.normal(0.0, 5.0, N))
    pair.look(where)


def walk(seed):
    """One pair through a random life; the pair at its end."""
    random = np.random.default_rng([seed, 0x6A12D])
    pair = Pair(int(random.choice([0, 0, 1, 60])))
    noise, speed, reach = random.choice([0.02, 0.5, 3.0]), random.choice([0.01, 0.1, 0.3]), random.choice([0.0, 2.9])
    command, tick = random.normal(0.0, 5.0, N), 0
    if random.random() < 0.9:
        pair.both("activate", command)
    for k in range(SAMPLES):
        tick = tick + 1 if random.random() > 0.01 else int(random.integers(0, 4))
        command = command + random.normal(0.0, noise, N)
        if random.random() < 0.004 or 100 < k < 125 and seed % 8 == 0:  # once in eight lives: too fast for 25 samples
            command = random.choice([-1.0, 1.0], N) * 1200.0
        measured = {name: random.normal(0.0, speed, N) for name in FIELDS}
        measured["joint_position"] += reach * (random.random() < 0.05)
        inputs = [command.copy(), np.zeros(N), np.full(N, float(tick))]
        strike(random, inputs, measured)
        pair.see(measured)
        demands = [demand(random) for _ in range(random.integers(1, 3))] if random.random() < 0.01 else []
        pair.step(f"case {seed}, sample {k}", *inputs, demands)
        between_samples(pair, random, f"case {seed} after sample {k}")
        if pair.oracle.stopped and random.random() < 0.02:
            command = np.zeros(N)
    return pair


def test_the_guard_is_its_oracle_bit_for_bit():
    pairs = [walk(seed) for seed in seeds(60)]
    modes = set().union(*(pair.modes for pair in pairs))
    assert modes == {0, 1, 2, 3, 4} or len(pairs) < 60, "every mode is seen"
    assert sum(pair.stops for pair in pairs) > 20 or len(pairs) < 60, "robots are stopped and come back"


@pytest.mark.parametrize("field", ["gate", "stop", "measured"])
def test_blocks_have_the_fields_of_the_oracle(field):
    pair = Pair()
    one, other = (getattr(each, field).layout for each in (pair.guard, pair.oracle))
    assert one == other


def test_a_difference_is_seen():
    """The comparison fails for one bit, one sign of zero and one fault."""
    pair = Pair()
    pair.both("activate", np.zeros(N))
    pair.oracle.mean_torque[0] = np.nextafter(0.0, 1.0)
    with pytest.raises(AssertionError, match="mean_torque"):
        pair.look("")
    for one, other in (([0.0], [-0.0]), ([1.0], [np.nan]), ([1.0], [1.0, 1.0])):
        with pytest.raises(AssertionError, match="numbers"):
            check("", numbers=(np.array(one), np.array(other)))
