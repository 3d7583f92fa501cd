"""`plant_node`: the simulated drives, arm and sensors; sets the tick. `~/reset` ends a latched stop of its gate,
`~/black_box` writes what a stop has left.

`~/progress` (latched) tells the next tick, every 50 ticks and whenever the plant stands still. Exit codes: 0 stopped on
request, 1 internal fault, 2 bad configuration.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Any

from hd_control.core.errors import ConfigError
from hd_control.core.parameters import ParameterSet
from hd_control.core.robot import Robot
from hd_control.nodes.black_box_desk import BLACK_BOX, serve_black_box
from hd_control.nodes.lifecycle_shell import OK, Shell
from hd_control.nodes.process import run_node
from hd_control.nodes.reset_service import serve_reset
from hd_control.nodes.ros_loop import wait_matched
from hd_control.stages.gate_values import LIMITS, safety_limits
from hd_sim.nodes.plant_parameters import PARAMETERS, plant_config
from hd_sim.nodes.plant_turn import PlantTurn
from hd_sim.nodes.topic_seam import TopicSeam, plant_status
from hd_sim.plant_config import PlantConfig
from hd_sim.world import World


class PlantNode(Shell):
    """The world behind its own gate."""

    def __init__(self) -> None:
        self.turn: PlantTurn | None = None
        self.world: World | None = None
        own = (*PARAMETERS.parameters, LIMITS, *BLACK_BOX)
        super().__init__("plant_node", ParameterSet("plant_node", own, PARAMETERS.rules))
        self.black_boxes = serve_black_box(self, lambda: {} if self.world is None else {"": self.world.black_box})
        serve_reset(self, lambda: self.world)

    def find_robot(self) -> Robot:
        return PlantConfig.from_file(str(self.first_value("plant"))).robot

    def prepare(self, values: Mapping[str, Any]) -> Any:
        return plant_config(values), safety_limits(values["limits"], self.robot.joint_names, values["period"])

    def adopt(self, prepared: Any) -> None:
        self.prepared = prepared
        if self.turn is not None:
            self.turn.live_values(self.values)

    def build(self) -> Callable[[], None]:
        config, limits = self.prepared
        self.world = World(config, limits, self.values["seed"])
        lockstep = self.values["clock"] == "lockstep"
        self.seam = TopicSeam(self, self.world, lockstep)
        lag = self.values["lockstep_recorder_lag"]
        self.turn = PlantTurn(self.loop, self.world, self.seam, self.dt_ns, lockstep, lag)
        self.turn.live_values(self.values)
        return self.turn

    def begin(self) -> None:
        if self.turn is None:
            raise ConfigError("plant_node is not configured")
        self.seam.commands.release()
        wait_matched([self.seam.commands.subscription], self.seam.sensor_publishers)
        self.turn.start()
        self.turn.active = True

    def end(self) -> None:
        if self.turn is not None:
            self.turn.active = False

    def dismantle(self) -> None:
        self.seam.destroy()
        self.black_boxes.collect(True)
        self.turn = self.world = None

    def status(self) -> tuple[bytes, str, dict[str, Any]]:
        if self.turn is None or self.world is None:
            return OK, "", {}
        level, text, values = plant_status(self.turn, self.world, self.seam)
        return level, text, values | self.black_boxes.values()

    def leave(self) -> None:
        super().leave()
        self.black_boxes.stop()


def main() -> None:
    """Entry point; ends the process with the exit code."""
    run_node(PlantNode)


if __name__ == "__main__":
    main()
