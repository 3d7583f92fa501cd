"""The control chain and the plant in one process and one thread, still publishing every topic."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Any

import numpy as np

from hd_control.core.blocks import Block
from hd_control.core.robot import Robot
from hd_control.nodes.chain import ChainNode
from hd_control.nodes.lifecycle_shell import Introspection
from hd_control.nodes.ros_loop import wait_matched
from hd_control.stages import topics
from hd_control.stages.black_box import BlackBox
from hd_control.stages.gate_values import safety_limits
from hd_control.stages.stage import Bus
from hd_sim.nodes.plant_parameters import PARAMETERS, plant_config
from hd_sim.nodes.plant_turn import PlantTurn
from hd_sim.nodes.topic_seam import TopicSeam, plant_status
from hd_sim.plant_config import PlantConfig
from hd_sim.world import World, sensor_arrays


class InnerSeam(TopicSeam):
    """Publishes the plant's topics and runs the chain on the readings at once; the command needs no topic."""

    def __init__(self, node: ChainWithPlant, world: World, lockstep: bool) -> None:
        super().__init__(node, world, lockstep)
        self._chain = node
        self._held = {"temperature": np.full(len(world.joint_names), np.nan)}
        self._pending: tuple[int, Any] | None = None

    def send_temperature(self, stamp_ns: int, temperature: Any) -> None:
        super().send_temperature(stamp_ns, temperature)
        self._held = {"temperature": temperature}

    def send(self, tick: int, stamp_ns: int, sample: Block) -> None:
        super().send(tick, stamp_ns, sample)
        bus: Bus = {**sensor_arrays(sample), topics.TEMPERATURE: self._held}
        self._chain.stages[0].read(bus)
        self._chain.run_stages(tick, stamp_ns, bus)
        self._pending = tick, self._chain.torque.allowed

    def collect(self, timeout_ns: int) -> None:
        if self._pending is not None:
            tick, torque = self._pending
            self._pending = None
            self._world.command(slice(None), torque, tick)
        elif timeout_ns > 0:
            self._node.loop.waiter.wait((), timeout_ns)


class ChainWithPlant(ChainNode):
    """`chain` with `with_plant: true`. The joints of the torque law must be all joints."""

    def __init__(self) -> None:
        self.world: World | None = None
        self.plant_turn: PlantTurn | None = None
        super().__init__(PARAMETERS)

    def boxes(self) -> dict[str, BlackBox]:
        found = super().boxes()
        return found if self.world is None else {**found, "drive": self.world.black_box}

    def find_robot(self) -> Robot:
        return PlantConfig.from_file(str(self.first_value("plant"))).robot

    def prepare(self, values: Mapping[str, Any]) -> list[Any]:
        self.config = plant_config(values)
        return super().prepare(values)

    def adopt(self, prepared: list[Any]) -> None:
        super().adopt(prepared)
        if self.plant_turn is not None:
            self.plant_turn.live_values(self.values)

    def build(self) -> Callable[[], None]:
        limits = safety_limits(self.values["limits"], self.robot.joint_names, self.dt)
        self.world = World(self.config, limits, self.values["seed"])
        lockstep = self.values["clock"] == "lockstep"
        self.inputs, self.temperature = [], None
        self.introspection = Introspection(self, [name for stage in self.stages for name in stage.names()])
        self.outputs = self.make_outputs()
        self.seam = InnerSeam(self, self.world, lockstep)
        lag = self.values["lockstep_recorder_lag"]
        self.plant_turn = PlantTurn(self.loop, self.world, self.seam, self.dt_ns, lockstep, lag)
        self.plant_turn.live_values(self.values)
        return self.plant_turn

    def begin(self) -> None:
        wait_matched([], [] if self.values["lockstep_recorder_lag"] == 0 else self.seam.sensor_publishers)
        for stage in self.stages:
            stage.start()
        if self.plant_turn is not None:
            self.plant_turn.start()
            self.plant_turn.active = True

    def end(self) -> None:
        if self.plant_turn is not None:
            self.plant_turn.active = False

    def dismantle(self) -> None:
        super().dismantle()
        self.black_boxes.collect(True)
        self.seam.destroy()
        self.world = self.plant_turn = None

    def status(self) -> tuple[bytes, str, dict[str, Any]]:
        level, text, values = super().status()
        if self.plant_turn is None or self.world is None:
            return level, text, values
        plant_level, plant_text, plant_values = plant_status(self.plant_turn, self.world, self.seam)
        return max(level, plant_level), "; ".join(filter(None, [text, plant_text])), values | plant_values
