"""A system clock that jumps by seconds and hours while the robot runs; the steady clock goes on."""

import hashlib
import time

import numpy as np
from fault_injection import Case, Injection, make_runner, start_motion

JUMPS = (1.0, -1.0, 3600.0, -3600.0)
TICKS = 700


class FakeClock:
    """Clock functions of the module `time`; `jump` moves the system clock only."""

    def __init__(self):
        self.offset_ns, self.steady_ns = 0, 10**12

    def jump(self, seconds):
        self.offset_ns += round(seconds * 1e9)

    def time_ns(self):
        return 1_700_000_000 * 10**9 + self.steady_ns + self.offset_ns

    def time(self):
        return self.time_ns() * 1e-9

    def monotonic_ns(self):
        return self.steady_ns

    def monotonic(self):
        return self.steady_ns * 1e-9


def hash_of_run(clock=None, jumps=()):
    """Hash of every number of every topic of a run with a motion and a stop at the end."""
    case = Case(1, 0, "single_joint_5", 0.1, 0.3, (Injection("motor_torque_command", "off", -1, 600, 1000, 1.0),))
    runner, digest = make_runner(case), hashlib.sha256()
    ticks = dict(jumps)
    for tick in range(TICKS):
        if tick in ticks:
            clock.jump(ticks[tick])
        if clock is not None:
            clock.steady_ns += 1_000_000
        if tick == 120:
            start_motion(runner, case)
        bus = runner.step()
        for topic in sorted(bus):
            for name in sorted(bus[topic]):
                digest.update(np.ascontiguousarray(bus[topic][name]).tobytes())
        digest.update(runner.given.tobytes() + runner.torque.mode.encode())
    assert runner.world.seam.stopped
    return digest.hexdigest()


def put_in_place(monkeypatch, clock):
    """Every clock function of `time` is the fake one, for whoever calls it."""
    for name in ("time", "time_ns", "monotonic", "monotonic_ns", "perf_counter", "perf_counter_ns"):
        source = name.replace("perf_counter", "monotonic")
        monkeypatch.setattr(time, name, getattr(clock, source))


def random_jumps(seed, count):
    """`count` random ticks, each with one of the jumps."""
    random = np.random.default_rng(seed)
    ticks = random.choice(TICKS, size=count, replace=False)
    return [(int(tick), float(random.choice(JUMPS))) for tick in ticks]


def wall_ticks(jumps, count=300):
    """Tick numbers and stamps that the plant's loop on the wall clock publishes while the system clock jumps."""
    from hd_control import _plane

    table = _plane.CommandTable(1)
    table.ticks[:] = 2**60  # every command is there
    loop = _plane.TimedLoop(1_000_000, False, 0, 100, 1, table.commands_capsule())
    clock, sent, pending = FakeClock(), [], dict(jumps)
    loop.pretend_clock(clock.steady_ns, clock.time_ns() - clock.steady_ns)

    def send(tick):
        sent.append((tick, tick * 1_000_000))
        if len(sent) in pending:
            clock.jump(pending[len(sent)])
            loop.pretend_clock(loop.steady_ns, clock.time_ns() - clock.steady_ns)
        if len(sent) == count:
            loop.interrupt()

    loop.send.step(send)
    loop.start()
    loop.run()
    assert loop.skipped == 0
    loop.close()
    return sent
