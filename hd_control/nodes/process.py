"""One node process: environment, priority, signals, executor thread, exit code.

Exit codes: 0 stopped on request, 1 internal fault (an exception in the loop or a callback, a recording that failed),
2 bad configuration (one line on stderr, no traceback). SIGINT and SIGTERM stop cleanly within 2 s.
"""

from __future__ import annotations

import ctypes
import gc
import os
import re
import signal
import sys
import tempfile
import threading
import time
from collections.abc import Callable, Sequence
from typing import TYPE_CHECKING, NoReturn

from hd_control.core.errors import ConfigError, HdError

if TYPE_CHECKING:
    from rclpy.executors import SingleThreadedExecutor

    from hd_control.nodes.shell import Shell


# ---- What the operating system can do for a 1 kHz loop: priority, memory locking, affinity, absolute deadlines ----
#
# Everything here is optional and asked for before `rclpy.init`, so that the middleware's threads inherit it. What the
# system refuses is reported and the loop runs without it.
#
# Environment: `HD_REAL_TIME` = `auto` (default: take what is permitted) or `off`; `HD_AFFINITY` = list of cores, `0,1`.


_LIBC = ctypes.CDLL(None, use_errno=True)
_MCL_CURRENT, _MCL_FUTURE, _TIMER_ABSTIME = 1, 2, 1
PRIORITY, RECEIVING_PRIORITY = 40, 20
"""Of a control loop, and of the threads that receive for a process without one."""
BESIDE = -10
"""Nice value of the threads beside the loop."""
SWITCH_INTERVAL = 1e-4
MIDDLEWARE = "dds."
"""Beginning of the names of Fast DDS's threads."""
DATA_RECEIVER = re.compile(r"dds\.(shm|udp)\.\d*[13579]")
"""Threads that receive data: their ports are odd (RTPS 9.6.1.1), those of discovery even."""


class _Timespec(ctypes.Structure):
    _fields_ = [("seconds", ctypes.c_long), ("nanoseconds", ctypes.c_long)]


def request_real_time(only_receiving: bool = False) -> list[str]:
    """Takes SCHED_FIFO, locked memory and affinity where permitted; returns one line for each thing that was done.

    `only_receiving`: for a process without a control loop, whose receiving threads shall not be held up by ordinary
    programs, below the loops of others and without locked memory. While such a thread stands still its queue in shared
    memory runs over, and it may hold a lock that a sender of the control chain wants.

    A shorter interpreter switch interval keeps the executor thread from holding the loop up for the default 5 ms.
    """
    sys.setswitchinterval(SWITCH_INTERVAL)
    done = []
    cores = os.environ.get("HD_AFFINITY", "")
    if cores:
        try:
            os.sched_setaffinity(0, {int(core) for core in cores.split(",")})
            done.append(f"cores {cores}")
        except (OSError, ValueError) as error:
            done.append(f"cores {cores} refused ({error})")
    if os.environ.get("HD_REAL_TIME", "auto") == "off":
        return [*done, "real time off"]
    priority = receiving_priority() if only_receiving else PRIORITY
    try:
        os.sched_setscheduler(0, os.SCHED_FIFO, os.sched_param(priority))
        done.append(f"SCHED_FIFO {priority}" + (" for receiving" if only_receiving else ""))
    except OSError:
        done.append("SCHED_FIFO not permitted")
    if only_receiving:
        return done
    locked = _LIBC.mlockall(_MCL_CURRENT | _MCL_FUTURE) == 0
    done.append("memory locked" if locked else "mlockall not permitted")
    return done


def receiving_priority() -> int:
    """Of SCHED_FIFO, for the threads that receive for a process without control loop; 0 where real time is off."""
    return 0 if os.environ.get("HD_REAL_TIME", "auto") == "off" else RECEIVING_PRIORITY


def leave_real_time(thread: int = 0) -> None:
    """For a thread beside the loop, by its kernel id (0: this one): ordinary scheduling, ahead of other programs.

    A thread under SCHED_FIFO is not interrupted by its equals: half a second of set-up or goal checking in the executor
    would hold up the loops of all nodes on that processor, and the kernel's limit for real-time threads (95 %) with it.
    """
    try:
        if os.sched_getscheduler(thread) not in (os.SCHED_FIFO, os.SCHED_RR):
            return  # real time is off or was not permitted
        os.sched_setscheduler(thread, os.SCHED_OTHER, os.sched_param(0))
        os.setpriority(os.PRIO_PROCESS, thread or threading.get_native_id(), BESIDE)
    except OSError:
        pass  # nothing more is permitted, or the thread has ended


def demote_middleware() -> list[str]:
    """Takes real time from the middleware's threads but those that receive data; returns the names of those demoted.

    An equal does not interrupt an equal. Its sender thread may spin for a lock that another holds on the same processor
    and never let it go; threads of discovery work for tens of milliseconds when something new appears in the graph.
    """
    found = []
    for entry in os.scandir("/proc/self/task"):
        try:
            with open(f"{entry.path}/comm") as file:
                name = file.read().strip()
        except OSError:
            continue
        if name.startswith(MIDDLEWARE) and not DATA_RECEIVER.fullmatch(name):
            leave_real_time(int(entry.name))
            found.append(name)
    return found


def sleep_until(deadline_ns: int) -> None:
    """Sleeps until an absolute time of the monotonic clock, in nanoseconds; returns at once if it has passed."""
    if deadline_ns <= time.monotonic_ns():
        return
    moment = _Timespec(deadline_ns // 1_000_000_000, deadline_ns % 1_000_000_000)
    while _LIBC.clock_nanosleep(time.CLOCK_MONOTONIC, _TIMER_ABSTIME, ctypes.byref(moment), None) == 4:  # EINTR
        pass


# ---- The process -----------------------------------------------------------------------------------


STOP_LIMIT = 8.0
"""s after a signal until the process ends itself; it takes less than 2 s unless a busy disk holds a black box up."""
DISCOVERY = "ROS_AUTOMATIC_DISCOVERY_RANGE"


def prepare_environment() -> str:
    """Keeps discovery on this computer unless the user said otherwise; returns a warning or an empty text."""
    if not os.environ.get("HOME") and not os.environ.get("ROS_LOG_DIR"):
        os.environ["ROS_LOG_DIR"] = tempfile.gettempdir()
    value = os.environ.setdefault(DISCOVERY, "LOCALHOST")
    if value in ("LOCALHOST", "OFF"):
        return ""
    return (
        f"{DISCOVERY}={value}: nodes of other computers can join and stop this robot; "
        "set it to LOCALHOST unless that is wanted, and use a firewall"
    )


def run_node(
    make: Callable[[], Shell], arguments: Sequence[str] | None = None, only_receiving: bool = False
) -> NoReturn:
    """Runs the node that `make` builds until a signal asks it to stop, and ends the process with the exit code.

    `only_receiving`: its loop is no control loop, see `request_real_time`.

    The process ends without the interpreter's own clean-up: threads of the middleware can hold that up for seconds
    after everything has been closed in order.
    """
    code = _run(make, arguments, only_receiving)
    sys.stdout.flush()
    sys.stderr.flush()
    os._exit(code)


def _run(make: Callable[[], Shell], arguments: Sequence[str] | None, only_receiving: bool) -> int:
    warning = prepare_environment()
    notes = request_real_time(only_receiving)
    import rclpy
    from rclpy.signals import SignalHandlerOptions

    try:
        rclpy.init(
            args=list(arguments) if arguments is not None else None, signal_handler_options=SignalHandlerOptions.NO
        )
    except Exception as error:  # rcl reports bad arguments and unreadable params files with several types
        return _complain(ConfigError(f"ROS arguments: {str(error).strip().splitlines()[0]}"))
    try:
        node = make()
        demote_middleware()
        if only_receiving:
            leave_real_time()
        if warning:
            node.get_logger().warning(warning)
        node.get_logger().info(f"run {node.run_id}: {', '.join(notes)}")
        return _serve(node)
    except HdError as error:
        return _complain(error)
    finally:
        rclpy.try_shutdown()


def _complain(error: HdError) -> int:
    print(f"error: {error}".replace("\n", " "), file=sys.stderr, flush=True)
    return error.exit_code


def _serve(node: Shell) -> int:
    from rclpy.executors import SingleThreadedExecutor

    executor = SingleThreadedExecutor()
    executor.add_node(node)
    stop_on_signals(node.loop.stop)
    if node.values["autostart"]:
        node.start_by_itself()
    gc.collect()
    gc.freeze()
    gc.set_threshold(100_000, 50, 100)  # the loop makes no cycles; a collection in it is a late tick

    def serve() -> None:
        leave_real_time()
        while not node.loop.stopping:
            spin_guarded(node, executor, 1.0)

    thread = threading.Thread(target=serve, name="executor", daemon=True)
    thread.start()
    node.loop.run()
    executor.wake()
    thread.join(1.0)
    node.leave()
    executor.shutdown(0.2)
    code = 1 if node.fault else 0
    node.destroy_node()
    return code


def spin_guarded(node: Shell, executor: SingleThreadedExecutor, timeout: float) -> None:
    """The next callback, waited for `timeout` s. What it raises is F33: the node reports it, stops and lives on."""
    try:
        executor.spin_once(timeout_sec=timeout)
    except Exception as error:
        node.report_fault(error)


def _give_up() -> None:
    print(f"error: not ended in order within {STOP_LIMIT:g} s of the signal", file=sys.stderr, flush=True)
    os._exit(1)


def stop_on_signals(stop: Callable[[], None]) -> None:
    """Calls `stop` from a thread of its own on SIGINT or SIGTERM: the main thread may wait inside the middleware."""
    reader, writer = os.pipe()
    os.set_blocking(writer, False)
    for number in (signal.SIGINT, signal.SIGTERM):
        signal.signal(number, lambda *_: None)
    signal.set_wakeup_fd(writer)

    def watch() -> None:
        os.read(reader, 1)
        stop()
        guard = threading.Timer(STOP_LIMIT, _give_up)
        guard.daemon = True
        guard.start()

    threading.Thread(target=watch, name="signals", daemon=True).start()
