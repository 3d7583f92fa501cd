"""`chain`: the control chain in one process and one thread; parameter `with_plant` puts the plant into the same thread.

Every topic is still published. Exit codes: 0 stopped on request, 1 internal fault, 2 bad configuration.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Any

from rclpy.node import Node

from hd_control.chain.black_box import BlackBox
from hd_control.chain.chain import shipped_values
from hd_control.core import topics
from hd_control.core.robot import Robot
from hd_control.nodes.chain import ChainNode
from hd_control.nodes.fast_loop import wait_matched
from hd_control.nodes.process import run_node
from hd_control.safety.limits import safety_limits
from hd_sim.nodes.plant_node import PARAMETERS, plant_config
from hd_sim.nodes.plant_topics import PlantTopics, plant_status
from hd_sim.nodes.plant_turn import PlantTurn
from hd_sim.plant_config import PlantConfig
from hd_sim.world import World, sensor_arrays


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
        self.make_outputs()
        self.plant_turn = turn = PlantTurn(self.world, self.dt_ns, lockstep, self.values["lockstep_recorder_lag"])
        self.seam = PlantTopics(self, self.world, turn, lockstep, commands=False)
        self._add_chain(turn)
        turn.live_values(self.values)
        return turn

    def _add_chain(self, turn: PlantTurn) -> None:
        """All stages on the readings of the plant, after these are sent; the command needs no topic."""
        self.seam.send_readings(turn)
        send, first = turn.plane.send, self.stages[0]
        held = turn.sensors.view("motor_temperature")
        for _, source, target in first.copies({topics.TEMPERATURE: {"temperature": held}}):
            turn.plane.temperature.copy(source, target)
        self.add_stages(turn.plane, send, sensor_arrays(turn.sensors))
        turn.plane.offer(self.torque.allowed)
        self._wired = [stage.native for stage in self.stages]

    def begin(self) -> None:
        wait_matched([], [] if self.values["lockstep_recorder_lag"] == 0 else self.seam.sensor_publishers)
        for stage in self.stages:
            stage.start()
        if self.plant_turn is not None:
            if self._wired != [stage.native for stage in self.stages]:
                self._add_chain(self.plant_turn)
            self.plant_turn.start()

    def end(self) -> None:
        if self.plant_turn is not None:
            self.plant_turn.stop()

    def dismantle(self) -> None:
        if self.plant_turn is not None:
            self.plant_turn.close()
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
