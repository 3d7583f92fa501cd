"""The plant's fast loop: wall clock with absolute deadlines, or lock-step that waits for the command of each tick.

Tick k: the command of tick k-1 is latched, the sensors are sampled and published with stamp k * period, then
[k, k+1) is integrated: in lock-step at once, on the wall clock when the command of tick k is there, so that the chain
need not wait for it. In lock-step tick k+1 waits for the complete command of tick k.
"""

from __future__ import annotations

import time
from collections.abc import Mapping
from typing import Any, Protocol

from hd_control.core.arrays import FloatArray
from hd_control.core.blocks import Block
from hd_control.nodes.fast_loop import WAIT_NS, FastLoop, LoopStatistics
from hd_control.nodes.process import sleep_until
from hd_sim.world import World

IMPATIENT_NS = 20_000_000
"""Wait per tick in lock-step once a command has been missing for the whole timeout."""
ASK_AGAIN_NS = 200_000_000
"""Lock-step repeats the readings of a tick that nobody answered: a message was lost to discovery."""
TEMPERATURE_PERIOD_NS = 100_000_000
START_LEAD_TICKS = 20


class Seam(Protocol):
    """How the plant meets the control chain: over topics, or in the same process."""

    def send(self, tick: int, stamp_ns: int, sample: Block) -> None:
        """Gives the sensor readings of a tick to the chain."""

    def send_temperature(self, stamp_ns: int, temperature: FloatArray) -> None:
        """Gives the temperatures, before the readings of the same tick."""

    def collect(self, timeout_ns: int) -> None:
        """Takes the commands that are there; waits for one at most `timeout_ns`."""

    def recorded(self) -> int:
        """The newest tick that the recorder has; -1 before it is ready."""

    def progress(self, tick: int) -> None:
        """Reports how far the plant is."""


class PlantTurn:
    """One turn of the plant's loop."""

    def __init__(self, loop: FastLoop, world: World, seam: Seam, dt_ns: int, lockstep: bool, recorder_lag: int) -> None:
        self._loop, self._world, self._seam, self._dt_ns = loop, world, seam, dt_ns
        self._lockstep, self._lag = lockstep, recorder_lag
        self._temperature_ticks = max(1, TEMPERATURE_PERIOD_NS // dt_ns)
        self.pause_at, self.stop_after, self.timeout_ns = -1, 0, 10_000_000_000
        self.active, self.fault = False, ""
        self.statistics = LoopStatistics(dt_ns)
        self.start()

    def start(self) -> None:
        """A new activation. Lock-step counts on from where it was, from 0 the first time; wall time starts anew."""
        self.first_tick = self.tick = getattr(self, "tick", 0) if self._lockstep else 0
        self._deadline = self._published = self._measured = -1
        self._waiting_since, self._impatient, self.skipped, self.fault = 0, False, 0, ""
        self._reported = -1
        self._ask_again = 0
        self._sensors: Any = None

    def live_values(self, values: Mapping[str, Any]) -> None:
        """Takes over the parameters that may change while the plant runs; from any thread."""
        self.pause_at, self.stop_after = values["pause_at_tick"], values["stop_after_tick"]
        self.timeout_ns = round(values["lockstep_timeout"] * 1e9)
        self._loop.waiter.wake()

    def __call__(self) -> None:
        if not self.active:
            self._seam.collect(WAIT_NS)
        elif self._lockstep:
            self._lockstep_turn()
        else:
            self._wall_turn()

    def _halted(self) -> bool:
        """True while the plant stands still on purpose."""
        paused = self._lockstep and 0 <= self.pause_at <= self.tick
        finished = 0 < self.stop_after <= self.tick - self.first_tick
        if not (paused or finished):
            return False
        if self._reported != self.tick:
            self._reported = self.tick
            self._seam.progress(self.tick)
        self._seam.collect(WAIT_NS)
        return True

    # Lock-step ------------------------------------------------------------------------------------------------------

    def _lockstep_turn(self) -> None:
        tick = self.tick
        if self._published < tick:
            if self._halted() or self._recorder_behind():
                return
            self._measure(tick)
            self._publish(tick)
            self._world.advance()
            self._waiting_since = time.monotonic_ns()
            self._ask_again = self._waiting_since + ASK_AGAIN_NS
        if self._world.seam.complete(tick):
            self._impatient = False
            self.statistics.answer(time.monotonic_ns() - self._waiting_since)
            self._finish(tick)
            return
        limit = IMPATIENT_NS if self._impatient else self.timeout_ns
        left = self._waiting_since + limit - time.monotonic_ns()
        if left > 0:
            self._seam.collect(min(left, WAIT_NS))
            if time.monotonic_ns() > self._ask_again:
                self._ask_again += ASK_AGAIN_NS
                self._seam.send(tick, tick * self._dt_ns, self._sensors)
            return
        if not self._impatient:
            missing = ", ".join(self._world.missing(tick))
            self.fault = (
                f"no command of tick {tick} for {missing} within {limit / 1e9:g} s; check the torque node, then reset"
            )
        self._impatient = True
        self._finish(tick)

    def _recorder_behind(self) -> bool:
        recorded = self._seam.recorded() if self._lag else 0
        if self._lag == 0 or (recorded >= 0 and self.tick - max(recorded, self.first_tick) <= self._lag):
            self._waiting_since = 0
            return False
        now = time.monotonic_ns()
        self._waiting_since = self._waiting_since or now
        if now - self._waiting_since > self.timeout_ns:
            self.fault = f"the recorder stands at tick {recorded}, the plant at {self.tick}; it goes on with losses"
            self._lag = 0
        self._seam.collect(1_000_000)
        return True

    # Wall clock -----------------------------------------------------------------------------------------------------

    def _wall_turn(self) -> None:
        if self._halted():
            self._deadline = -1
            return
        if self._deadline < 0:
            self._set_out()
        left = self._deadline - time.monotonic_ns()
        if left > 0 and not self._world.seam.complete(self.tick - 1):
            self._seam.collect(left)
            if self._world.seam.complete(self.tick - 1):
                self.statistics.answer(time.monotonic_ns() - self._waiting_since)
            return
        self._prepare(self.tick)
        sleep_until(self._deadline)
        while time.monotonic_ns() >= self._deadline + self._dt_ns:  # overslept: a gap that everybody can see
            self.skipped += 1
            self.tick += 1
            self._deadline += self._dt_ns
            self._prepare(self.tick)
        self._waiting_since = time.monotonic_ns()
        self._publish(self.tick)
        self._deadline += self._dt_ns
        self._finish(self.tick)

    def _prepare(self, tick: int) -> None:
        """Integrates up to the tick, latches the newest command for it and reads the sensors: all but the publishing.

        It is done once the command is there, or at the deadline without it, so that nothing but publishing stands
        between the deadline and the control chain.
        """
        if self._measured >= self.first_tick:
            self._world.advance()
        self._seam.collect(0)
        self._measure(tick)

    def _set_out(self) -> None:
        """Binds tick numbers to the wall clock and deadlines to the steady clock, once per activation."""
        now, wall = time.monotonic_ns(), time.time_ns()
        self.tick = wall // self._dt_ns + START_LEAD_TICKS
        self.first_tick = self.tick
        self._deadline = now + self.tick * self._dt_ns - wall

    # Both -----------------------------------------------------------------------------------------------------------

    def _measure(self, tick: int) -> None:
        self._sensors = self._world.measure(tick)
        self._measured = tick

    def _publish(self, tick: int) -> None:
        stamp_ns = tick * self._dt_ns
        if tick % self._temperature_ticks == 0:
            self._seam.send_temperature(stamp_ns, self._sensors.motor_temperature)
        self._seam.send(tick, stamp_ns, self._sensors)
        self._published = tick

    def _finish(self, tick: int) -> None:
        self.statistics.tick(tick, self._waiting_since, time.monotonic_ns())
        self.tick = tick + 1
        if self.tick % 50 == 0:
            self._seam.progress(self.tick)
