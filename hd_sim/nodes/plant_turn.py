"""The plant's work in the fast loop: wall clock with absolute deadlines, or lock-step that waits for each command.

Tick k: the command of tick k-1 is latched, the sensors are sampled and published with stamp k * period, then
[k, k+1) is integrated: in lock-step at once, on the wall clock when the command of tick k is there, so that the chain
need not wait for it. In lock-step tick k+1 waits for the complete command of tick k. The loop itself is compiled:
`hd_control/cpp/timed.hpp`.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from hd_control import _plane
from hd_control.nodes.fast_loop import NativeTurn
from hd_sim.world import World

TEMPERATURE_PERIOD_NS = 100_000_000


class PlantTurn(NativeTurn):
    """The world in a loop that sets the tick. What is sent per tick is added to `plane.send` by its topics.

    `sensors` are the readings of the present tick, always in the same memory; `drives` is the compiled drive side.
    """

    plane: _plane.TimedLoop

    def __init__(self, world: World, dt_ns: int, lockstep: bool, recorder_lag: int) -> None:
        self.drives, joints = world.seam.native, len(world.joint_names)
        self.temperature_ticks = max(1, TEMPERATURE_PERIOD_NS // dt_ns)
        commands = self.drives.commands_capsule()
        super().__init__(_plane.TimedLoop(dt_ns, lockstep, recorder_lag, self.temperature_ticks, joints, commands))
        self._world = world
        self.sensors = world.seam.readings
        self.plane.set_steps(self.drives.measure_capsule(), self.drives.advance_capsule())

    def start(self) -> None:
        """A new activation. Lock-step counts on from where it was, from 0 the first time; wall time starts anew."""
        self.plane.start()

    def stop(self) -> None:
        """No tick after this."""
        self.plane.stop()

    def live_values(self, values: Mapping[str, Any]) -> None:
        """Takes over the parameters that may change while the plant runs; from any thread."""
        timeout_ns = round(values["lockstep_timeout"] * 1e9)
        self.plane.set_values(values["pause_at_tick"], values["stop_after_tick"], timeout_ns)

    @property
    def tick(self) -> int:
        """The next tick."""
        return self.plane.tick

    @property
    def skipped(self) -> int:
        """Ticks that the plant has overslept since its activation."""
        return self.plane.skipped

    @property
    def fault(self) -> str:
        """Why lock-step went on without what it waited for; empty if it did not."""
        kind, tick, limit_ns, missing, recorded = self.plane.fault
        if kind == _plane.NO_COMMAND:
            names = [name for joint, name in enumerate(self._world.joint_names) if missing >> joint & 1]
            within = f"{limit_ns / 1e9:g} s; check the torque node, then reset"
            return f"no command of tick {tick} for {', '.join(names)} within {within}"
        if kind == _plane.RECORDER_BEHIND:
            return f"the recorder stands at tick {recorded}, the plant at {tick}; it goes on with losses"
        return ""
