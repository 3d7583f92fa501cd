"""`plant_node`: the simulated drives, arm and sensors; sets the tick.

`~/reset` ends a latched stop of its gate, `~/black_box` writes what a stop has left. `~/progress` (latched) gives the
next tick, every 50 ticks and whenever the plant stands still. Exit codes: 0 stopped on request, 1 internal fault,
2 bad configuration.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from typing import Any

from hd_control.core.errors import ConfigError
from hd_control.core.parameters import Change, Parameter, ParameterSet, Shape
from hd_control.core.robot import Robot
from hd_control.nodes.fast_loop import wait_matched
from hd_control.nodes.process import run_node
from hd_control.nodes.shell import OK, Shell
from hd_control.nodes.stop_services import BLACK_BOX, serve_black_box, serve_reset
from hd_control.safety.limits import LIMITS, safety_limits
from hd_sim.nodes.plant_topics import PlantTopics, plant_status
from hd_sim.nodes.plant_turn import PlantTurn
from hd_sim.plant_config import PlantConfig
from hd_sim.truth import HiddenEffect, apply_hidden, nominal
from hd_sim.world import World

# ---- Parameters ------------------------------------------------------------------------------------


CLOCKS = ("wall", "lockstep")


def _hide_rule(values: Mapping[str, Any]) -> list[str]:
    found = []
    for text in filter(None, values["hide"]):
        parts = text.split(":")
        if len(parts) not in (2, 3) or (len(parts) == 3 and not _is_number(parts[2])):
            found.append(f"hide: {text!r} is not joint:effect or joint:effect:strength")
    return found


def _is_number(text: str) -> bool:
    try:
        float(text)
    except ValueError:
        return False
    return True


PARAMETERS = ParameterSet(
    "plant_node",
    (
        Parameter("plant", "plant file: shipped name or path", kind=str, change=Change.FIXED),
        Parameter(
            "clock",
            "wall: period by deadlines; lockstep: wait for the command of each tick",
            kind=str,
            choices=CLOCKS,
            change=Change.FIXED,
        ),
        Parameter(
            "seed", "seed of the sensor noise and of hidden effects", kind=int, low=0, high=2**31, change=Change.FIXED
        ),
        Parameter("nominal", "strip the plant of everything beyond the usual model", kind=bool, change=Change.FIXED),
        Parameter(
            "hide",
            "effects to add, joint:effect:strength; an empty text adds none",
            kind=str,
            shape=Shape.LIST,
            change=Change.FIXED,
        ),
        Parameter("stop_after_tick", "ticks to run; 0: endless", kind=int, low=0, high=2**53, change=Change.HOT),
        Parameter(
            "pause_at_tick",
            "lock-step waits before this tick until the value is raised; -1: never",
            kind=int,
            low=-1,
            high=2**53,
            change=Change.HOT,
        ),
        Parameter(
            "lockstep_timeout", "longest wait for a command in lock-step", "s", low=0.01, high=3600.0, change=Change.HOT
        ),
        Parameter(
            "lockstep_recorder_lag",
            "ticks that a recorder may lag in lock-step; 0: no recorder is waited for",
            kind=int,
            low=0,
            high=100_000,
            change=Change.FIXED,
        ),
    ),
    (_hide_rule,),
)


def plant_config(values: Mapping[str, Any]) -> PlantConfig:
    """The world that these values describe. Raises ConfigError."""
    config = PlantConfig.from_file(values["plant"])
    if abs(config.period - values["period"]) > 1e-12:
        raise ConfigError(
            f"period: {values['period']:g} s, but plant {values['plant']} has {config.period:g} s; set period"
        )
    if values["nominal"]:
        config = nominal(config)
    return apply_hidden(config, hidden_effects(values["hide"]), values["seed"])


def hidden_effects(texts: Sequence[str]) -> list[HiddenEffect]:
    """`joint:effect:strength` as values; strength 1 if left out."""
    found = []
    for text in filter(None, texts):
        joint, name, *strength = text.split(":")
        found.append(HiddenEffect(joint, name, float(strength[0]) if strength else 1.0))
    return found


# ---- The node --------------------------------------------------------------------------------------


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
        self.turn = PlantTurn(self.world, self.dt_ns, lockstep, self.values["lockstep_recorder_lag"])
        self.seam = PlantTopics(self, self.world, self.turn, lockstep)
        self.turn.live_values(self.values)
        return self.turn

    def begin(self) -> None:
        if self.turn is None:
            raise ConfigError("plant_node is not configured")
        self.turn.plane.release()
        wait_matched([self.seam.commands], self.seam.sensor_publishers)
        self.turn.start()

    def end(self) -> None:
        if self.turn is not None:
            self.turn.stop()

    def dismantle(self) -> None:
        if self.turn is not None:
            self.turn.close()
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
