"""What the operating system can do for a 1 kHz loop: priority, memory locking, core affinity, absolute deadlines.

Everything here is optional and asked for before `rclpy.init`, so that the middleware's threads inherit it. What the
system refuses is reported and the loop runs without it.

Environment: `HD_REAL_TIME` = `auto` (default: take what is permitted) or `off`; `HD_AFFINITY` = list of cores, `0,1`.
"""

from __future__ import annotations

import ctypes
import os
import re
import sys
import threading
import time

_LIBC = ctypes.CDLL(None, use_errno=True)
_MCL_CURRENT, _MCL_FUTURE, _TIMER_ABSTIME = 1, 2, 1
PRIORITY = 40
BESIDE = -10
"""Nice value of the threads beside the loop."""
SWITCH_INTERVAL = 1e-4
MIDDLEWARE = "dds."
"""Beginning of the names of Fast DDS's threads."""
DATA_RECEIVER = re.compile(r"dds\.(shm|udp)\.\d*[13579]")
"""Threads that receive data: their ports are odd (RTPS 9.6.1.1), those of discovery even."""


class _Timespec(ctypes.Structure):
    _fields_ = [("seconds", ctypes.c_long), ("nanoseconds", ctypes.c_long)]


def request_real_time() -> list[str]:
    """Takes SCHED_FIFO, locked memory and affinity where permitted; returns one line for each thing that was done.

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
    try:
        os.sched_setscheduler(0, os.SCHED_FIFO, os.sched_param(PRIORITY))
        done.append(f"SCHED_FIFO {PRIORITY}")
    except OSError:
        done.append("SCHED_FIFO not permitted")
    locked = _LIBC.mlockall(_MCL_CURRENT | _MCL_FUTURE) == 0
    done.append("memory locked" if locked else "mlockall not permitted")
    return done


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
