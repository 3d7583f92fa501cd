"""`chain`: the control chain in one process and one thread; parameter `with_plant` puts the plant into the same thread.

Every topic is still published. Exit codes: 0 stopped on request, 1 internal fault, 2 bad configuration.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Any

import numpy as np
from rclpy.node import Node

from hd_control.chain.black_box import BlackBox
from hd_control.chain.chain import shipped_values
from hd_control.chain.stage import Bus
from hd_control.core import topics
from hd_control.core.blocks import Block
from hd_control.core.robot import Robot
from hd_control.nodes.chain import ChainNode
from hd_control.nodes.fast_loop import wait_matched
from hd_control.nodes.process import run_node
from hd_control.nodes.shell import Introspection
from hd_control.safety.limits import safety_limits
from hd_sim.nodes.plant_node import PARAMETERS, plant_config
from hd_sim.nodes.plant_topics import TopicSeam, plant_status
from hd_sim.nodes.plant_turn import PlantTurn
from hd_sim.plant_config import PlantConfig
from hd_sim.world import World, sensor_arrays

# ---- Chain and plant in one thread -----------------------------------------------------------------


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
        self._chain.stages[0].read(bus, tick)
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


def make_chain() -> ChainNode:
    """The chain, with the plant if its shipped or given parameters ask for it."""
    probe = Node("chain", start_parameter_services=False, enable_rosout=False)
    given = getattr(probe, "_parameter_overrides", {})
    wanted = given["with_plant"].value if "with_plant" in given else shipped_values("chain")["with_plant"]
    probe.destroy_node()
    return ChainWithPlant() if wanted else ChainNode()


def main() -> None:
    """Entry point; ends the process with the exit code."""
    run_node(make_chain)


if __name__ == "__main__":
    main()
