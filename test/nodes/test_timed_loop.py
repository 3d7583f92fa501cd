"""The loop that sets the tick, on a clock that the test moves: order, deadlines, waiting, halting, faults."""

from __future__ import annotations

import threading
import time
from collections.abc import Callable

import pytest

from hd_control import _plane

PERIOD_NS = 1_000_000
START_NS = 10**12
SYSTEM_NS = 1_700_000_000 * 10**9
LEAD = 20
"""Ticks between the activation and the first one on the wall clock."""


class World:
    """Notes what the loop asks for; `on_send` is what the rest of the robot does."""

    def __init__(self, lockstep: bool, on_send: Callable[[World, int], None], ticks: int, lag: int = 0) -> None:
        self.table = _plane.CommandTable(2)
        self.loop = _plane.TimedLoop(PERIOD_NS, lockstep, lag, 100, 2, self.table.commands_capsule())
        self.loop.pretend_clock(START_NS, SYSTEM_NS - START_NS)
        self.done: list[tuple[str, int, int]] = []
        self.on_send, self.ticks = on_send, ticks
        self.loop.set_steps(lambda tick: self.note("measure", tick), lambda tick: self.note("advance", tick))
        self.loop.send.step(self.send)

    def note(self, what: str, tick: int) -> None:
        self.done.append((what, tick, self.loop.steady_ns))

    def send(self, tick: int) -> None:
        self.note("send", tick)
        if len(self.times("send")) >= self.ticks:
            self.loop.interrupt()
        self.on_send(self, tick)

    def command(self, tick: int) -> None:
        self.table.ticks[:] = tick

    def sleep(self, nanoseconds: int) -> None:
        self.loop.pretend_clock(self.loop.steady_ns + nanoseconds, SYSTEM_NS - START_NS)

    def run(self) -> None:
        self.loop.start()
        self.loop.run()

    def order(self) -> list[tuple[str, int]]:
        return [(what, tick) for what, tick, _ in self.done]

    def times(self, what: str) -> dict[int, int]:
        return {tick: time for each, tick, time in self.done if each == what}


def test_in_lockstep_a_tick_follows_the_command_of_the_one_before() -> None:
    world = World(True, World.command, 3)
    world.run()
    assert world.order()[:7] == [
        ("measure", 0), ("send", 0), ("advance", 0), ("measure", 1), ("send", 1), ("advance", 1), ("measure", 2),
    ]  # fmt: skip
    assert set(world.times("send").values()) == {START_NS}, "no time passes while commands are there"


def test_a_loop_that_never_sleeps_lets_others_in_between_two_ticks() -> None:
    world = World(True, World.command, 10**9)
    thread = threading.Thread(target=world.loop.run)
    thread.start()
    waited = []
    for _ in range(10):
        world.loop.start()
        first = world.loop.tick
        while world.loop.tick == first:
            time.sleep(0.001)
        before = world.loop.tick
        world.loop.stop()
        waited.append(world.loop.tick - before)
    world.loop.interrupt()
    thread.join(10.0)
    assert not thread.is_alive() and max(waited) < 500, "thousands of ticks, if it takes the lock again at once"


def test_lockstep_asks_again_waits_for_the_timeout_once_and_says_who_was_missing() -> None:
    def first_joint_only(world: World, tick: int) -> None:
        world.table.ticks[0] = tick

    world = World(True, first_joint_only, 12)
    world.loop.set_values(-1, 0, 1_000_000_000)
    world.run()
    sent = [tick for what, tick in world.order() if what == "send"]
    assert sent[:6] == [0, 0, 0, 0, 0, 1], "every 200 ms the readings are sent again"
    times = world.times("measure")
    assert times[1] - times[0] == 1_000_000_000
    assert times[3] - times[2] == 20_000_000, "once it has waited in vain it is impatient"
    kind, tick, limit_ns, missing, _ = world.loop.fault
    assert (kind, tick, limit_ns, missing) == (_plane.NO_COMMAND, 0, 1_000_000_000, 0b10)


def test_lockstep_stands_still_before_the_tick_it_is_given() -> None:
    world = World(True, World.command, 8)
    world.loop.set_values(5, 0, 1_000_000_000)
    thread = threading.Thread(target=world.run, daemon=True)
    thread.start()
    end = time.monotonic() + 10.0
    while world.loop.tick < 5 and time.monotonic() < end:
        time.sleep(0.001)
    time.sleep(0.02)
    assert world.loop.tick == 5 and sorted(world.times("send")) == list(range(5))
    world.loop.set_values(8, 0, 1_000_000_000)
    thread.join(10.0)
    assert sorted(world.times("send")) == list(range(8)) and not thread.is_alive()


def test_on_the_wall_clock_each_tick_is_sent_at_its_deadline() -> None:
    world = World(False, World.command, 5)
    world.run()
    first = SYSTEM_NS // PERIOD_NS + LEAD
    sent = world.times("send")
    assert list(sent) == [first + k for k in range(5)]
    assert list(sent.values()) == [START_NS + (LEAD + k) * PERIOD_NS for k in range(5)]
    measured = world.times("measure")
    assert measured[first + 1] == sent[first], "with the command there everything but sending is done before"
    assert world.loop.late == world.loop.skipped == 0
    assert world.loop.statistics.answers_after(0) == (4, [0] * 4)


def test_without_its_command_a_tick_is_late_and_the_next_one_is_sent_in_time() -> None:
    def sometimes(world: World, tick: int) -> None:
        if tick % 2:
            world.command(tick)

    world = World(False, sometimes, 9)
    world.run()
    sent = list(world.times("send").values())
    assert [after - before for before, after in zip(sent[:-1], sent[1:], strict=True)] == [PERIOD_NS] * 8
    assert world.loop.late == 4 and world.loop.skipped == 0


def test_f17_ticks_that_are_slept_through_are_a_gap_that_everybody_can_see() -> None:
    first = SYSTEM_NS // PERIOD_NS + LEAD

    def oversleep(world: World, tick: int) -> None:
        world.command(tick)
        if tick == first + 2:
            world.sleep(4 * PERIOD_NS + 1000)

    world = World(False, oversleep, 5)
    world.run()
    sent = world.times("send")
    assert list(sent) == [first, first + 1, first + 2, first + 6, first + 7]
    assert world.loop.skipped == 3 and world.loop.statistics.summary()["missed"] == 3
    assert sent[first + 7] - sent[first + 1] == 6 * PERIOD_NS, "back on its deadlines"
    assert set(range(first, first + 7)) <= set(world.times("measure")), "the world went on in the ticks between"


def test_it_halts_after_the_ticks_it_was_given_and_starts_with_a_new_clock() -> None:
    world = World(False, World.command, 1000)
    world.loop.set_values(-1, 3, 1_000_000_000)
    last: list[int] = []

    def count(tick: int) -> None:
        last.append(tick)
        if len(last) == 3:
            world.loop.interrupt()

    world.loop.send.step(count)
    world.run()
    world.loop.rearm()
    world.loop.set_values(-1, 0, 1_000_000_000)
    world.sleep(500 * PERIOD_NS)
    world.ticks = 4
    world.loop.start()
    world.loop.run()
    sent = list(world.times("send"))
    assert sent[3] - sent[2] > 500


def test_f33_a_world_that_raises_ends_the_loop_with_its_error() -> None:
    world = World(False, World.command, 1000)

    def broken(tick: int) -> None:
        raise RuntimeError("a bug in the world")

    world.loop.set_steps(broken, broken)
    with pytest.raises(RuntimeError, match="a bug in the world"):
        world.run()
    assert not world.times("send")


def test_a_loop_that_is_closed_runs_no_more() -> None:
    world = World(False, World.command, 1000)
    world.loop.close()
    world.loop.rearm()
    world.run()
    assert not world.done
