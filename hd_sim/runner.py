"""The whole robot in one process without ROS: world, laws and gate in lock-step, faster than real time.

The stages are those that the nodes run, called in the order in which their messages would arrive. So a run here and a
lock-step run over ROS give the same torques, bit for bit.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np

from hd_control import _chain
from hd_control.chain.chain import LAWS, add_stages, chain_stages, shipped_values
from hd_control.chain.stage import Bus
from hd_control.core import topics
from hd_control.core.arrays import FloatArray
from hd_control.core.errors import ConfigError
from hd_control.core.parameters import ParameterSet
from hd_control.laws.goals import GoalLimits, check_goal
from hd_control.laws.trajectory import Goal
from hd_control.safety.limits import safety_limits
from hd_sim.plant_config import PlantConfig
from hd_sim.scenario import Plan
from hd_sim.world import World, sensor_arrays

TEMPERATURE_PERIOD = 0.1
"""s between two messages of a joint's temperature."""

LOOK_TICKS = 1000
"""Ticks between two looks for stops in a compiled run: less than a black box keeps."""

Observer = Callable[[int, Bus], None]
"""Called after every tick with its number and the arrays of every topic."""


@dataclass(frozen=True)
class RunSetup:
    """What a run is made of. `values` overrides parameters by node name; missing ones are the shipped ones."""

    config: PlantConfig
    seed: int = 0
    values: Mapping[str, Mapping[str, Any]] = field(default_factory=dict)

    def node_values(self, node: str) -> dict[str, Any]:
        """Complete values of one node for the joints of this robot. Raises ConfigError for an unknown parameter."""
        parameters: ParameterSet = LAWS[node].PARAMETERS
        shipped = {name: value for name, value in shipped_values(node).items() if name in parameters.names}
        own = self.values.get(node, {})
        unknown = [name for name in own if name not in parameters.names]
        if unknown:
            raise ConfigError(f"{node}: no parameter {unknown[0]!r}; there is {', '.join(parameters.names)}")
        return parameters.select({**shipped, **own}, self.config.robot.joint_names)

    def all_values(self) -> dict[str, dict[str, Any]]:
        """Complete values of every node that holds a law, by node name."""
        return {node: self.node_values(node) for node in LAWS}


@dataclass(frozen=True)
class RunRows:
    """Rows (ticks, n) of a recorded run: rad, rad, N m; `states` (ticks, size) of the torque law.

    `stopped`: the run ended before its time; rows after that are not numbers.
    """

    true_position: FloatArray
    desired: FloatArray
    command: FloatArray
    states: FloatArray
    stopped: bool


class Runner:
    """One robot in lock-step. `tick` is the next tick to run.

    `prompt`: the command of a sample acts at once, without the delay that every real loop has.
    """

    def __init__(self, setup: RunSetup, prompt: bool = False) -> None:
        robot, dt = setup.config.robot, setup.config.period
        values = setup.all_values()
        names = robot.joint_names
        limits = safety_limits(str(setup.values.get("limits", {}).get("file", "limits.yaml")), names, dt)
        self.robot, self.period, self.tick, self.prompt = robot, dt, 0, prompt
        self.world = World(setup.config, limits, setup.seed)
        chain = chain_stages(robot, dt, values, limits)
        self.fusion, self.motion, self.torque = chain.fusion, chain.motion, chain.torque
        self.stages = chain.by_node()
        self.goal_limits = GoalLimits.from_values(values["motion_node"], robot)
        self.temperature_ticks = max(1, round(TEMPERATURE_PERIOD / dt))

    def offer(self, goal: Goal) -> None:
        """Checks a goal against the present state and hands it over; without a start tick it starts with the next one.

        Raises GoalError.
        """
        follower = self.motion.follower
        if follower is None:
            raise ConfigError("the first tick must run before a goal is given")
        if goal.start_tick is None:
            goal = replace(goal, start_tick=self.tick)
        self.motion.refuse_unless_ready()
        measured = self.motion.sample.joint_position.copy()
        self.motion.hand_over(check_goal(goal, follower.copy(), self.goal_limits, measured, self.motion.tick))

    def step(self) -> Bus:
        """Runs one tick; returns the arrays of every topic: copies, but for the sensors' views."""
        tick = self.tick
        sample = self.world.measure(tick)
        bus: Bus = sensor_arrays(sample)
        if tick % self.temperature_ticks == 0:
            bus[topics.TEMPERATURE] = {"temperature": sample.motor_temperature}
        for _, stage in self.stages:
            bus.update(stage.step(tick, bus))
        if self.prompt:
            self.world.seam.plant.latch(self.torque.allowed)
        self.world.advance()
        self.world.command(slice(None), bus[topics.COMMAND]["effort"], tick)
        self.motion.controller_mode = self.torque.mode
        self.tick = tick + 1
        return bus

    def run(self, plan: Plan, observe: Observer | None = None) -> None:
        """Runs a plan to its end. Raises GoalError if the robot refuses a goal of the plan."""
        goals = dict(plan.goals)
        while self.tick < plan.ticks:
            if self.tick in goals:
                self.offer(goals[self.tick])
            if observe is None:
                later = [tick for tick in goals if tick > self.tick]
                self.run_on(min([plan.ticks, *later]) - self.tick)
                continue
            tick, bus = self.tick, self.step()
            observe(tick, bus)

    def run_on(self, ticks: int) -> None:
        """Runs some ticks at once, compiled: the same bits as `step`, black boxes and fault books included."""
        end = self.tick + ticks
        if self.torque.plug_in is not None:  # a law in Python has no compiled list
            while self.tick < end:
                self.step()
            return
        sequence = self._sequence()
        while self.tick < end:
            self.tick += sequence.run(self.tick, min(LOOK_TICKS, end - self.tick))
            self.world.black_box.look()
            self.torque.black_box.look()

    def record(self, goals: Mapping[int, Goal], ticks: int) -> RunRows:
        """Runs from tick 0 to `ticks` or to a stop, compiled, and keeps what a comparison needs.

        `goals` by the tick at which they are offered. Raises GoalError if the robot refuses one, ConfigError for a law
        in Python.
        """
        if self.torque.plug_in is not None:
            raise ConfigError("plug_in: a law in Python runs step by step only, use run")
        rows = np.full((3, ticks, self.robot.joints), np.nan)
        state = self.torque.native.state
        states = np.full((ticks, state.size), np.nan)
        native, motion = self.world.seam.native, self.motion.native
        desired = motion.reference[: self.robot.joints]
        flag, stopped = _chain.StopFlag([native.guard, self.torque.native.guard]), False
        while self.tick < ticks and not stopped:
            first = self.tick
            if first in goals:
                self.offer(goals[first])
            end = min([ticks, *(tick for tick in goals if tick > first), first + LOOK_TICKS])
            sequence = self._sequence()
            watched = (native.true_position, desired, self.torque.allowed)
            for table, numbers in zip(rows, watched, strict=True):
                sequence.record(numbers, table[first:end])
            sequence.record(state, states[first:end])
            sequence.call(flag.step_capsule())
            self.tick += sequence.run(first, end - first, flag.value)
            stopped = bool(flag.value[0])
        return RunRows(rows[0], rows[1], rows[2], states, stopped)

    def _sequence(self) -> Any:
        """Everything that `step` does in one tick, as a compiled list. The true position is looked at first."""
        found, drive = _chain.Sequence(), self.world.seam.native
        chain = sensor_arrays(self.world.seam.readings)
        chain[topics.TEMPERATURE] = {"temperature": self.world.seam.readings.motor_temperature}
        found.call(drive.look_capsule())
        found.call(drive.measure_capsule())
        add_stages(found, [stage for _, stage in self.stages], chain, self.temperature_ticks)
        found.copy(self.torque.allowed, drive.incoming)
        found.call(drive.advance_promptly_capsule() if self.prompt else drive.advance_capsule())
        found.call(drive.take_capsule())
        found.call(_chain.ModeLink(self.torque.native, self.motion.native).step_capsule())
        return found
