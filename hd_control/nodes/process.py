"""One node process: environment, priority, signals, executor thread, exit code.

Exit codes: 0 stopped on request, 1 internal fault (an exception in the loop or a callback, a recording that failed),
2 bad configuration (one line on stderr, no traceback). SIGINT and SIGTERM stop cleanly within 2 s.
"""

from __future__ import annotations

import gc
import os
import signal
import sys
import tempfile
import threading
from collections.abc import Callable, Sequence
from typing import TYPE_CHECKING, NoReturn

from hd_control.core.errors import ConfigError, HdError
from hd_control.nodes.real_time import demote_middleware, leave_real_time, request_real_time

if TYPE_CHECKING:
    from rclpy.executors import SingleThreadedExecutor

    from hd_control.nodes.lifecycle_shell import Shell

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


def run_node(make: Callable[[], Shell], arguments: Sequence[str] | None = None) -> NoReturn:
    """Runs the node that `make` builds until a signal asks it to stop, and ends the process with the exit code.

    The process ends without the interpreter's own clean-up: threads of the middleware can hold that up for seconds
    after everything has been closed in order.
    """
    code = _run(make, arguments)
    sys.stdout.flush()
    sys.stderr.flush()
    os._exit(code)


def _run(make: Callable[[], Shell], arguments: Sequence[str] | None) -> int:
    warning = prepare_environment()
    notes = request_real_time()
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
