"""How fast a ring of four processes is: the fast loop against the stock executor.

    ring(10.0)                  -> RingResult of this package's loop, paced at 1 kHz
    stock_executor_ring(10.0)   -> the same ring with message objects, callbacks and a SingleThreadedExecutor
    lockstep_ticks_per_second() -> the real nodes in lock-step

In `ring` each echo copies seven numbers, so its figures are those of the transport and the loop,
without the laws.
"""

from __future__ import annotations

import json
import os
import secrets
import subprocess
import sys
import threading
import time
from dataclasses import asdict, dataclass
from typing import TYPE_CHECKING, Any

import numpy as np

from hd_control.core import topics
from hd_control.core.errors import HdError
from hd_control.nodes.process import prepare_environment, request_real_time, sleep_until, stop_on_signals
from hd_control.record.cdr import new_run_id
from hd_control.record.schema import joint_state_codec
from hd_control.session.session import Children, RunPlan, Session, child_environment, log_folder

if TYPE_CHECKING:
    from hd_control import _plane

JOINTS = tuple(f"joint_{i}" for i in range(1, 8))
HOPS = (
    (topics.ENCODER, topics.JOINT_STATES),
    (topics.JOINT_STATES, topics.REQUIRED),
    (topics.REQUIRED, topics.COMMAND),
)
WARM_UP, LOCKSTEP_TICKS = 200, 2000


@dataclass(frozen=True)
class RingResult:
    """Time from a sample to its command over four hops, µs, and the ticks whose command came late or not at all."""

    p50: float
    p99: float
    missed_percent: float


def ring(seconds: float, period: float = 1e-3) -> RingResult:
    """The ring with this package's fast loop. Raises HdError if the processes do not find each other."""
    return _run("fast", seconds, period)


def stock_executor_ring(seconds: float) -> RingResult:
    """The same ring at 1 kHz with rclpy's own executor and message objects."""
    return _run("stock", seconds, 1e-3)


def _run(kind: str, seconds: float, period: float) -> RingResult:
    environment = child_environment(domain=1 + secrets.randbelow(100))
    command = [sys.executable, "-m", "hd_control.bench.ring", kind]
    with Children(environment) as children:
        for hop in range(len(HOPS)):
            children.start(f"echo_{hop}", [*command, "echo", str(hop)])
        source = children.start("source", [*command, "source", str(seconds), str(period)], stdout=subprocess.PIPE)
        try:
            text, _ = source.communicate(timeout=seconds + 60.0)
        except subprocess.TimeoutExpired:
            raise HdError(f"the {kind} ring did not finish within {seconds + 60:.0f} s") from None
    if source.returncode != 0:
        raise HdError(f"the {kind} ring failed with exit code {source.returncode}")
    return RingResult(**json.loads(text.splitlines()[-1]))


def lockstep_ticks_per_second() -> float:
    """Ticks per second of the real nodes in lock-step, four processes, without recorder."""
    plan = RunPlan(lockstep=True, parameters={"plant_node": {"pause_at_tick": WARM_UP}})
    with Session(plan, 1 + secrets.randbelow(100), log_folder()) as session:
        session.activate()
        session.wait_until_tick(WARM_UP)
        begun = time.monotonic()
        session.run_to(WARM_UP + LOCKSTEP_TICKS, 600.0)
        return LOCKSTEP_TICKS / (time.monotonic() - begun)


class _Ring:
    """What both kinds share: a node, the echo of one hop, the source's bookkeeping."""

    def __init__(self, role: str) -> None:
        import rclpy
        from rclpy.signals import SignalHandlerOptions

        prepare_environment()
        request_real_time()
        rclpy.init(signal_handler_options=SignalHandlerOptions.NO)
        self.node = rclpy.create_node(f"ring_{role}")


class _FastRing(_Ring):
    def echo(self, hop: int) -> None:
        from sensor_msgs.msg import JointState

        from hd_control.nodes.fast_loop import FastLoop, HandsOff, JoinedTurn, RawInput, chain_qos, message_runs

        source, target = HOPS[hop]
        loop, numbers = FastLoop(self.node), np.zeros(len(JOINTS))
        raw = RawInput(self.node, source, JOINTS, HandsOff())
        turn = JoinedTurn([raw], [{topics.fields(source)[0]: [(numbers, range(len(JOINTS)))]}], 1_000_000)
        codec = joint_state_codec(target, JOINTS)
        runs = message_runs(codec, dict.fromkeys(topics.fields(target), numbers))
        publisher = self.node.create_publisher(JointState, target, chain_qos())
        plane = turn.plane
        plane.program.send(plane.outbox(publisher.handle, codec.encode(0, new_run_id()), codec.stamp_place, runs))
        turn.active = True
        stop_on_signals(loop.stop)
        loop.install(turn)
        loop.run()

    def source(self, seconds: float, period: float) -> RingResult:
        from sensor_msgs.msg import JointState

        from hd_control import _plane
        from hd_control.nodes.fast_loop import HandsOff, RawInput, chain_qos

        dt_ns = round(period * 1e9)
        table = _plane.CommandTable(len(JOINTS))
        plane = _plane.TimedLoop(dt_ns, False, 0, 100, len(JOINTS), table.commands_capsule())
        back = RawInput(self.node, topics.COMMAND, JOINTS, HandsOff())
        plane.listen(back.subscription.handle, JOINTS)
        publisher = self.node.create_publisher(JointState, topics.ENCODER, chain_qos())
        codec = joint_state_codec(topics.ENCODER, JOINTS)
        plane.send.send(plane.outbox(publisher.handle, codec.encode(0, new_run_id()), codec.stamp_place, []))
        plane.start()
        thread = threading.Thread(target=plane.run)
        thread.start()
        try:
            return self.watch(plane, seconds)
        finally:
            plane.close()
            thread.join()

    def watch(self, plane: _plane.TimedLoop, seconds: float) -> RingResult:
        """What the loop of the source counts, from the time when the ring is closed."""
        end = time.monotonic() + 30.0
        while plane.statistics.answers_after(0)[0] < WARM_UP:
            if time.monotonic() > end:
                raise SystemExit("ring not closed")
            time.sleep(0.05)
        count, _ = plane.statistics.answers_after(0)
        first, late = plane.tick, plane.late + plane.skipped
        trips: list[int] = []
        end = time.monotonic() + seconds
        while time.monotonic() < end:
            time.sleep(0.2)
            count, new = plane.statistics.answers_after(count)
            trips += new
        sent = plane.tick - first
        good = np.array(trips if trips else [np.nan]) / 1000.0
        missed = 100.0 * (plane.late + plane.skipped - late) / max(1, sent)
        return RingResult(float(np.percentile(good, 50)), float(np.percentile(good, 99)), missed)


class _StockRing(_Ring):
    def echo(self, hop: int) -> None:
        import rclpy
        from sensor_msgs.msg import JointState

        source, target = HOPS[hop]
        publisher = self.node.create_publisher(JointState, target, 1)

        def callback(message: JointState) -> None:
            publisher.publish(message)

        self.node.create_subscription(JointState, source, callback, 1)
        try:
            rclpy.spin(self.node)
        except KeyboardInterrupt:
            pass

    def source(self, seconds: float, period: float) -> RingResult:
        from rclpy.executors import SingleThreadedExecutor
        from sensor_msgs.msg import JointState

        publisher = self.node.create_publisher(JointState, topics.ENCODER, 1)
        seen = [0]

        def callback(message: JointState) -> None:
            seen[0] = message.header.stamp.sec * 1_000_000_000 + message.header.stamp.nanosec

        self.node.create_subscription(JointState, topics.COMMAND, callback, 1)
        executor = SingleThreadedExecutor()
        executor.add_node(self.node)
        dt_ns = round(period * 1e9)

        def send(tick: int) -> None:
            message = JointState(name=list(JOINTS), position=[0.0] * 7, effort=[0.0] * 7)
            message.header.stamp.sec, message.header.stamp.nanosec = divmod(tick * dt_ns, 1_000_000_000)
            publisher.publish(message)

        def wait(tick: int, deadline: int) -> bool:
            while (left := deadline - time.monotonic_ns()) > 0:
                executor.spin_once(timeout_sec=left / 1e9)
                if seen[0] == tick * dt_ns:
                    return True
            return False

        return self.pace(send, wait, seconds, dt_ns)

    def summary(self, trips: list[int], sent: int) -> RingResult:
        good = np.array(trips[WARM_UP:] if trips[WARM_UP:] else [np.nan]) / 1000.0
        sent_counted = max(1, sent - WARM_UP)
        missed = 100.0 * max(0, sent_counted - len(trips[WARM_UP:])) / sent_counted
        return RingResult(float(np.percentile(good, 50)), float(np.percentile(good, 99)), missed)

    def pace(self, send: Any, wait: Any, seconds: float, dt_ns: int) -> RingResult:
        tick = 0
        while True:  # until the ring is closed
            tick += 1
            send(tick)
            if wait(tick, time.monotonic_ns() + 100_000_000):
                break
            if tick > 300:
                raise SystemExit("ring not closed")
        trips: list[int] = []
        sent, start = 0, time.monotonic_ns()
        deadline = start + dt_ns
        while time.monotonic_ns() - start < seconds * 1e9:
            tick, sent = tick + 1, sent + 1
            sleep_until(deadline)
            begun = time.monotonic_ns()
            send(tick)
            if wait(tick, deadline + dt_ns):
                trips.append(time.monotonic_ns() - begun)
            deadline += dt_ns
            while deadline + dt_ns < time.monotonic_ns():  # overslept: those ticks are missed
                deadline, tick, sent = deadline + dt_ns, tick + 1, sent + 1
        return self.summary(trips, sent)


def main() -> int:
    kind, role, *rest = sys.argv[1:]
    kinds: dict[str, type[_FastRing] | type[_StockRing]] = {"fast": _FastRing, "stock": _StockRing}
    ring_kind = kinds[kind](f"{role}_{os.getpid()}")
    if role == "echo":
        ring_kind.echo(int(rest[0]))
        return 0
    result = ring_kind.source(float(rest[0]), float(rest[1]))
    print(json.dumps(asdict(result)), flush=True)
    return 0


if __name__ == "__main__":
    sys.exit(main())
