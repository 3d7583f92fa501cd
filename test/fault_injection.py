"""Faults as values, put into a lock-step run: on readings, on messages between the laws, on commands, on the laws.

A case is a plant, a motion and a list of injections, all drawn from one seed; `HD_SEED` and `HD_CASE` repeat it. A
message that is missing stops everything behind it for that tick, as the join of the nodes does.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import lru_cache

import numpy as np

from hd_control.chain.stage import Bus, Stage
from hd_control.core import topics
from hd_control.core.arrays import FloatArray
from hd_control.core.errors import ConfigError
from hd_control.laws.trajectory import quintic_move
from hd_sim.plant_config import PlantConfig
from hd_sim.runner import Runner, RunSetup
from hd_sim.world import sensor_arrays

SENSORS = ("encoder", "resolver", "gauge_bridge")
MESSAGES = ("joint_states", "motor_states", "joint_reference", "joint_torque_required", "motor_torque_command")
LAWS = ("fusion", "motion", "torque")
KINDS = ("ok", "off", "stuck", "not_finite", "garbage", "wrong", "slow", "delayed", "intermittent")
LAW_KINDS = ("off", "exception")
SINGLE_PLANTS = ("single_joint_3", "single_joint_4", "single_joint_5", "single_joint_7")
ARM = "arm_a"
ARMED, FIRST_ONSET, LAST_ONSET, AFTER = 120, 250, 700, 400
SIZES = {"position": 0.02, "velocity": 1.0, "effort": 100.0}
"""Size of a wrong or random value of magnitude 1, by array."""


@dataclass(frozen=True)
class Injection:
    """One fault. `joint` -1: all. `onset` tick, `length` ticks; `magnitude` scales what is wrong, slow or late."""

    target: str
    kind: str
    joint: int
    onset: int
    length: int
    magnitude: float

    def __post_init__(self) -> None:
        known = LAW_KINDS if self.target in LAWS else KINDS if self.target in (*SENSORS, *MESSAGES) else ()
        if self.kind not in known:
            raise ConfigError(
                f"{self.target}: cannot inject {self.kind!r}; possible is {', '.join(known) or 'nothing'}"
            )

    def on(self, tick: int) -> bool:
        """Does it act in this tick?"""
        return self.onset <= tick < self.onset + self.length


@dataclass(frozen=True)
class Case:
    """A run with faults: `index` of a seed. `velocity` rad/s and `distance` rad of the move that goes on meanwhile."""

    seed: int
    index: int
    plant: str
    distance: float
    velocity: float
    injections: tuple[Injection, ...]

    @property
    def ticks(self) -> int:
        """Length of the run."""
        return max((injection.onset for injection in self.injections), default=LAST_ONSET) + AFTER

    @property
    def text(self) -> str:
        """What repeats it, and what it is."""
        faults = "; ".join(
            f"{i.target} {i.kind} joint {i.joint} at {i.onset} for {i.length} x{i.magnitude:.3g}"
            for i in self.injections
        )
        return f"HD_SEED={self.seed} HD_CASE={self.index} {self.plant} {self.distance:.3g} rad: {faults}"


def draw_case(seed: int, index: int) -> Case:
    """Case `index` of a seed: one joint in nine of ten, one fault in two of three, else a pair."""
    random = np.random.default_rng([seed, index, 0xFA17])
    plant = ARM if index % 10 == 9 else SINGLE_PLANTS[int(random.integers(len(SINGLE_PLANTS)))]
    joints = 7 if plant == ARM else 1
    count = 1 if random.random() < 2.0 / 3.0 else 2
    faults = tuple(_draw_injection(random, joints) for _ in range(count))
    distance = float(random.choice([-1.0, 0.0, 1.0]) * random.uniform(0.05, 0.3))
    # The peak acceleration of a quintic is 1.64 velocity^2 / distance: at most 3.3 rad/s^2.
    velocity = float(random.uniform(0.1, 1.0) * np.sqrt(2.0 * abs(distance)))
    return Case(seed, index, plant, distance, velocity, faults)


def _draw_injection(random: np.random.Generator, joints: int) -> Injection:
    targets = (*SENSORS, *SENSORS, *MESSAGES, *LAWS)
    target = targets[int(random.integers(len(targets)))]
    kinds = LAW_KINDS if target in LAWS else KINDS
    return Injection(
        target,
        kinds[int(random.integers(len(kinds)))],
        int(random.integers(-1, joints)),
        int(random.integers(FIRST_ONSET, LAST_ONSET)),
        int(random.choice([1, 2, 3, 5, 9, 10, 11, 20, 50, 1000])),
        float(10.0 ** random.uniform(-2.0, 2.0)),
    )


class InjectedExceptionError(RuntimeError):
    """What a node raises on request of an injection."""


class FaultyRunner(Runner):
    """A runner whose inputs go through injections. `given` is the torque of the last gate in this tick, (n,) N m.

    `seen` lists per injection the ticks in which its change reached everything that waits for the topic: where another
    fault keeps that message, or one it is joined with, away, there was nothing to be seen.
    """

    def __init__(self, setup: RunSetup, injections: Sequence[Injection], seed: int) -> None:
        super().__init__(setup)
        self.random = np.random.default_rng([seed, 0x5EED])
        self.used_tick = -1
        self.given: FloatArray = np.zeros(setup.config.joints)
        self._stuck: dict[tuple[Injection, str], FloatArray] = {}
        self._history: dict[tuple[str, str], list[FloatArray]] = {}
        self.inject(injections)
        self._needed = {
            stage.wiring.name: [topic for topic in stage.wiring.inputs if topic not in stage.wiring.optional]
            for _, stage in self.stages
        }

    def inject(self, injections: Sequence[Injection]) -> None:
        """From now on these faults, instead of those before."""
        self._faults: dict[str, list[Injection]] = {}
        self.seen: dict[Injection, list[int]] = {injection: [] for injection in injections}
        for injection in injections:
            self._faults.setdefault(injection.target, []).append(injection)

    def step(self) -> Bus:
        """One tick; a topic that is missing is not in the result."""
        tick = self.tick
        bus = self._corrupt(tick, sensor_arrays(self.world.measure(tick)))
        self.given = self.world.seam.native.applied.copy()
        silent: set[str] = set()
        for _, stage in self.stages:
            name = stage.wiring.name
            if all(topic in bus for topic in self._needed[name]) and not self._acts(tick, name, "off"):
                bus.update(self._corrupt(tick, self._stepped(tick, stage, bus)))
            else:
                silent.update(self._needed[name])
        for injection, ticks in self.seen.items():
            if injection.on(tick) and injection.target in bus and injection.target not in silent:
                ticks.append(tick)
        self.world.advance()
        if topics.COMMAND in bus:
            self.world.command(slice(None), bus[topics.COMMAND]["effort"], tick)
            self.used_tick = tick
        self.motion.controller_mode = self.torque.mode
        self.tick = tick + 1
        return bus

    def _stepped(self, tick: int, stage: Stage, bus: Bus) -> Bus:
        raising = [i for i in self._faults.get(stage.wiring.name, ()) if i.kind == "exception" and i.on(tick)]
        if not raising:
            return stage.step(tick, bus)
        for injection in raising:
            self.seen[injection].append(tick)
        if stage is not self.torque:
            return {}  # the node's loop ends its turn: silence
        try:
            raise InjectedExceptionError("injected")
        except InjectedExceptionError as error:
            stage.emergency(error)
        return stage.step(tick, bus)

    def reached(self, tick: int) -> FloatArray:
        """The torque (n,) N m that the plant has taken for a tick, cut to its own limit; one of the last 32."""
        commands = self.world.seam.plant.state.commands
        return np.array(commands.reshape(len(commands), -1)[:, tick % 32])

    def _acts(self, tick: int, target: str, kind: str) -> bool:
        return any(i.kind == kind and i.on(tick) for i in self._faults.get(target, ()))

    def _corrupt(self, tick: int, bus: Bus) -> Bus:
        """The topics as they arrive. Those that no injection touches are handed on as they are."""
        found: Bus = {}
        for topic, arrays in bus.items():
            faults = self._faults.get(topic)
            if faults is None:
                found[topic] = arrays
                continue
            copied = {name: values.copy() for name, values in arrays.items()}
            for name, values in copied.items():
                history = self._history.setdefault((topic, name), [])
                history.append(values.copy())
                del history[:-52]
            if all(self._apply(tick, topic, copied, i) for i in faults if i.on(tick)):
                found[topic] = copied
        return found

    def _apply(self, tick: int, topic: str, arrays: dict[str, FloatArray], fault: Injection) -> bool:
        """Changes the arrays in place; False: the message does not arrive."""
        if fault.kind == "off":
            return False
        if fault.kind == "intermittent":
            return bool(self.random.random() < 0.5)
        if fault.kind == "slow":
            return (tick - fault.onset) % (1 + min(12, int(1 + fault.magnitude))) == 0
        for name, values in arrays.items():
            history, size = self._history[topic, name], SIZES.get(name, 1.0) * fault.magnitude
            part = slice(None) if fault.joint < 0 else slice(fault.joint, fault.joint + 1)
            if fault.kind == "stuck":
                values[part] = self._stuck.setdefault((fault, name), history[max(0, len(history) - 2)])[part]
            elif fault.kind == "delayed":
                values[part] = history[max(0, len(history) - 1 - min(50, int(1 + fault.magnitude)))][part]
            elif fault.kind == "not_finite":
                values[part] = (np.nan, np.inf, -np.inf)[int(self.random.integers(3))]
            elif fault.kind == "garbage":
                values[part] += self.random.normal(0.0, 10.0 * size, values[part].shape)
            elif fault.kind == "wrong":
                values[part] += size
        return True


def make_runner(case: Case) -> FaultyRunner:
    """The runner of a case, before its first tick."""
    return FaultyRunner(RunSetup(_plant(case.plant), case.seed + case.index), case.injections, case.index)


@lru_cache
def _plant(name: str) -> PlantConfig:
    """A campaign reads each plant once."""
    return PlantConfig.from_file(name)


def start_motion(runner: FaultyRunner, case: Case) -> None:
    """Gives the goal of a case; called once the drives obey."""
    if case.distance == 0.0:
        return
    start = runner.torque.sample.joint_position.copy()
    goal = quintic_move(runner.robot.joint_names, start, start + case.distance, case.velocity, "move")
    runner.offer(replace(goal, start_tick=None))
