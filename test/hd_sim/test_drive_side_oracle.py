"""The compiled drive side against its plain re-statement, test/oracles/drive_side_law.py, each in front of a plant."""

import numpy as np
import pytest
from bits import check, rows, seeds
from oracles import drive_side_law

from hd_control.core.faults import FaultCode
from hd_control.safety.limits import safety_limits
from hd_sim.drive_side import ARMING_SAMPLES, DriveSide
from hd_sim.plant import Plant
from hd_sim.plant_config import PlantConfig

TICKS = 900
ODD = (np.nan, np.inf, -np.inf, 1e308, 0.0, -0.0, 2000.0)
OFTEN = {FaultCode.LET_GO, FaultCode.NODE_KILLED, FaultCode.NOT_FINITE, FaultCode.RATE_LIMITED, FaultCode.STAMP_STUCK,
         FaultCode.STAMP_AHEAD}  # fmt: skip
"""What a few lives cannot miss."""


class Pair:
    """Both sides; what is done to one is done to the other, and everything is compared after it."""

    def __init__(self, config, limits, seed):
        self.side = DriveSide(Plant(config, seed), limits)
        self.oracle = drive_side_law.DriveSide(Plant(config, seed), limits)
        self.n, self.codes, self.modes, self.granted = config.joints, set(), set(), 0

    def offer(self, joints, torque, tick):
        self.side.offer(slice(None) if joints is None else joints, torque, tick)
        self.oracle.offer(joints, torque, tick)

    def stranger(self):
        self.side.stranger(), self.oracle.stranger()

    def push(self, torque):
        """A torque from outside on the links."""
        for each in (self.side, self.oracle):
            each.plant.external_torque(joint=torque)

    def tick(self, tick):
        with np.errstate(all="ignore"):
            found, expected = self.side.measure(tick), self.oracle.measure(tick)
        check(f"readings in tick {tick}", readings=(found.array, expected.array))
        self.look(tick)
        for each in (self.side, self.oracle):
            each.plant.advance()
        self.codes |= {fault.code for fault in self.oracle.found}
        self.modes.add(self.oracle.guard.mode)

    def look(self, tick):
        side, oracle, guard, wanted = self.side, self.oracle, self.side.guard, self.oracle.guard
        check(f"tick {tick}", applied=(side.native.applied, oracle.applied), command=(side.command, oracle.command),
              command_tick=(side.command_tick, oracle.command_tick), positions=(side.positions, oracle.positions),
              velocities=(side.velocities, oracle.velocities), gate=(guard.gate.array, wanted.gate.array),
              stop=(guard.stop.array, wanted.stop.array), measured=(guard.measured.array, wanted.measured.array),
              mean_torque=(guard.state.mean_torque, wanted.mean_torque), mode=(int(guard.mode), wanted.mode),
              faults=(side.native.rows, rows(oracle.found)),
              state=([side.armed, side.brake_closed, side.healthy, side.late, side.stale, side.ahead, side.stopped,
                      side.stands, side.native.strangers],
                     [oracle.open, oracle.brake_closed, oracle.healthy, oracle.late, oracle.stale, oracle.ahead,
                      wanted.stopped, oracle.stands, oracle.strangers]),
              complete=([side.complete(tick), side.complete(tick - 1)],
                        [oracle.complete(tick), oracle.complete(tick - 1)]))  # fmt: skip
        book = side.native.faults
        first = [] if oracle.faults.first_stop is None else [oracle.faults.first_stop]
        check(f"tick {tick}", stop_tick=(book.stop_tick, oracle.faults.first_stop_tick),
              first=(book.stop[None][: len(first)], rows(first)))  # fmt: skip

    def reset(self, velocity):
        found, expected = self.side.reset(velocity), self.oracle.reset(velocity)
        assert found == expected
        self.granted += not found
        if not found:
            self.side.native.faults.clear()
            self.oracle.faults.clear()


class Controller:
    """Commands as a careless process would send them: mostly the weight, sometimes late, odd, zero or in parts."""

    def __init__(self, pair, random, careless):
        self.pair, self.random, self.careless, self.silent, self.zero, self.joint = pair, random, careless, 0, 0, 0
        self.weight = pair.side.plant.gravity_torque(pair.side.plant.config.start_position)

    def send(self, tick):
        random, n = self.random, self.pair.n
        if random.random() < 0.01 * self.careless:
            self.silent = int(random.choice([1, 2, 8, 9, 10, 11]))
        if random.random() < 0.02 * self.careless:
            self.zero, self.joint = int(random.choice([1, 2, 3, 4])), int(random.integers(n))
            if random.random() < 0.7:  # while it moves
                self.pair.push(4000.0 * (np.arange(n) == self.joint))
        if self.silent:
            self.silent -= 1
            return
        torque = self.weight + random.normal(0.0, 1.0 + 30.0 * self.careless, n)
        if self.zero:
            self.zero -= 1
            torque[self.joint] = random.choice([0.0, -0.0])
            if not self.zero:
                self.pair.push(np.zeros(n))
        if random.random() < 0.01 * self.careless:
            torque[random.integers(n)] = random.choice(ODD)
        stamp = tick - int(random.choice([0, 0, 0, 1, 3, -1, -5, -(10**6)])) * (random.random() < 0.1 * self.careless)
        if n > 1 and random.random() < 0.2:
            order = random.permutation(n)
            for part in np.split(order, [int(random.integers(1, n))]):
                if random.random() > 0.05 * self.careless:
                    self.pair.offer([int(j) for j in part], torque[part], stamp)
        else:
            self.pair.offer(None, torque, stamp)


def live(config, limits, seed):
    """A random life of a drive side; the pair at its end."""
    random = np.random.default_rng([seed, 0xD21])
    pair = Pair(config, limits, seed)
    controller, careless, tick = Controller(pair, random, 0.0), float(random.choice([0.1, 0.5, 1.0])), 0
    for k in range(TICKS):
        controller.careless = careless if k > ARMING_SAMPLES + 20 or seed % 4 == 3 else 0.0
        pair.tick(tick)
        controller.send(tick)
        if random.random() < 0.0005:
            pair.stranger()
        tick += 1 if random.random() > 0.002 else int(random.choice([0, 2, 12, -40]))
        if random.random() < 0.003:
            pair.push(random.normal(0.0, 300.0, pair.n) * (random.random() < 0.5))
        if pair.oracle.guard.stopped and random.random() < 0.05:
            if random.random() < 0.7:  # a long rest on the brakes
                pair.side.guard.state.healthy, pair.oracle.guard.healthy = 1e4, 10_000
                for guard in (pair.side.guard, pair.oracle.guard):
                    guard.gate.last_torque = 0.0
            pair.reset(np.full(pair.n, float(random.choice([0.0, 0.0, 0.02]))))
            pair.look(tick)
    return pair


@pytest.mark.parametrize("name", ["single_joint_3", "single_joint_7", "arm_a"])
def test_the_drive_side_is_its_oracle_bit_for_bit(name):
    config = PlantConfig.from_file(name)
    limits = safety_limits("limits.yaml", config.robot.joint_names, config.period)
    pairs = [live(config, limits, seed) for seed in seeds(4)]
    modes, codes = (set().union(*(getattr(pair, what) for pair in pairs)) for what in ("modes", "codes"))
    if len(pairs) >= 4:
        assert modes >= {0, 1, 2, 3} and codes >= OFTEN and sum(pair.granted for pair in pairs) > 5
