"""The whole robot in one process without ROS: world, laws and gate in lock-step, faster than real time.

The stages are those that the nodes run, called in the order in which their messages would arrive. So a run here and a
lock-step run over ROS give the same torques, bit for bit.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, replace
from typing import Any

from hd_control.chain.chain import LAWS, chain_stages, shipped_values
from hd_control.chain.stage import Bus
from hd_control.core import topics
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


class Runner:
    """One robot in lock-step. `tick` is the next tick to run."""

    def __init__(self, setup: RunSetup) -> None:
        robot, dt = setup.config.robot, setup.config.period
        values = setup.all_values()
        names = robot.joint_names
        limits = safety_limits(str(setup.values.get("limits", {}).get("file", "limits.yaml")), names, dt)
        self.robot, self.period, self.tick = robot, dt, 0
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
        """Runs one tick; returns the arrays of every topic, which the next tick may overwrite."""
        tick = self.tick
        sample = self.world.measure(tick)
        bus: Bus = sensor_arrays(sample)
        if tick % self.temperature_ticks == 0:
            bus[topics.TEMPERATURE] = {"temperature": sample.motor_temperature}
        for _, stage in self.stages:
            bus.update(stage.step(tick, bus))
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
            tick, bus = self.tick, self.step()
            if observe is not None:
                observe(tick, bus)
