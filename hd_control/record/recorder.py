"""The recorder without ROS, thread or clock: bounded queues in front of a bag, with honest counts.

    recorder = Recorder(bag)
    recorder.offer("/encoder", log_time_ns, payload)    # from the subscriptions; never blocks, never raises on data
    recorder.tend(steady_ns)                            # from the recording loop, at least every 20 ms
    recorder.statistics()

Every sample that was published is written or counted as dropped: by transport (holes in the ticks), by the queue
(overload, oldest first), by the disk.
"""

from __future__ import annotations

import os
import threading
from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Any

from hd_control._pump import SampleQueues, Writer
from hd_control.core.errors import BagError
from hd_control.core.faults import FaultCode
from hd_control.core.topics import COMMAND, JOINT_STATE_TYPE, SENSORS, topic_info
from hd_control.record.accounting import head_kind, header_of
from hd_control.record.bag_folder import space_left, write_error
from hd_control.record.cdr import Buffer
from hd_control.record.mcap_write import LONGEST_RECORD
from hd_control.record.writer import BagWriter

# ---- Forces the disk beside the loop: fsync can take seconds on a slow disk, the loop must not wait for it ----


class DiskSync:
    """At most one fsync at a time, in a thread of its own; an error is reported by the next call."""

    def __init__(self) -> None:
        self._thread: threading.Thread | None = None
        self._error: OSError | None = None

    def start(self, fileno: int) -> OSError | None:
        """Begins to force the file unless the last time still runs; returns the error of an earlier one."""
        if self._error is not None:
            return self._error
        if self._thread is None or not self._thread.is_alive():
            self._thread = threading.Thread(target=self._run, args=(fileno,), name="disk sync", daemon=True)
            self._thread.start()
        return None

    def wait(self) -> None:
        """Waits for the fsync that runs; the file may be closed then."""
        if self._thread is not None:
            self._thread.join()

    def _run(self, fileno: int) -> None:
        try:
            os.fsync(fileno)
        except OSError as error:
            self._error = error


# ---- The recorder ----------------------------------------------------------------------------------


QUEUE_DEPTH = 2000
EVENT_DEPTH = 100_000
QUEUE_BYTES = 256 << 20
SYNC_NS, COUNT_NS = 500_000_000, 1_000_000_000
DISK_FLOOR = "disk_floor"
AWAITED = (*SENSORS, COMMAND)
"""Topics without which a recording has no progress."""


@dataclass
class Recorder:
    """Queues samples and writes them; `offer` and the writing may be in two threads, the disk never blocks `offer`.

    `failure` says why the recording ended by itself, `warning` that the disk is nearly full.
    `queue_depth` bounds each sensor topic, `total_depth` and `total_bytes` everything together. Events (goals, faults,
    descriptions) are never dropped before a sensor sample; their queues are bounded by `EVENT_DEPTH`.
    """

    bag: BagWriter
    queue_depth: int = QUEUE_DEPTH
    total_depth: int = 20_000
    total_bytes: int = QUEUE_BYTES
    failure: str = ""
    warning: str = ""
    _next_sync: int = 0
    _next_count: int = 0
    _counted: dict[str, int] = field(default_factory=dict)
    _disk: DiskSync = field(default_factory=DiskSync)
    _numbers: dict[str, int] = field(default_factory=dict)
    _by_any_name: dict[str, int] = field(default_factory=dict)
    _writer: Writer | None = None

    def __post_init__(self) -> None:
        self.queues = SampleQueues(self.total_depth, self.total_bytes, LONGEST_RECORD)

    def add_topic(self, topic: str, type_name: str = "", definition: str = "", period_ns: int | None = None) -> None:
        """Announces a topic; those of the schema need no type. Raises BagError for an unknown one."""
        name = "/" + topic.strip("/")
        if name not in self._numbers:
            channel = self.bag.add_topic(name, type_name, definition, period_ns)
            known = topic_info(name)
            event = bool(known and known.event)
            self._numbers[name] = self.queues.add(
                channel=channel.number,
                head=head_kind(channel.type_name),
                depth=EVENT_DEPTH if event else self.queue_depth,
                event=event,
                awaited=bool(known and known.name in AWAITED),
                paced=channel.type_name == JOINT_STATE_TYPE,
                account=channel.account,
            )
        self._by_any_name[topic] = self._by_any_name[name] = self._numbers[name]

    def offer(self, topic: str, log_time_ns: int, payload: Buffer, number: int | None = None) -> None:
        """Takes one sample of an announced topic; drops the oldest sensor sample when there is no room.

        `number` is the how-manieth message of its publisher it is, for messages that begin with the run id of their
        publisher. It is known then whether a missing tick was lost on the way or never published.
        """
        publisher = b"" if number is None else header_of(JOINT_STATE_TYPE, payload)[1]
        self.queues.offer(self._by_any_name[topic], log_time_ns, payload, number, publisher)

    def write_beside(self) -> None:
        """From now on what is queued is written by a thread of its own, every 10 ms, until `close`."""
        self._writer = Writer(self.queues, self.bag.growing)
        self._writer.start()

    @property
    def newest_ns(self) -> int:
        """The newest stamp [ns] of the slowest topic of the chain; -1 while sensors or commands are missing."""
        return self.queues.slowest_ns()

    def tend(self, now_ns: int) -> None:
        """Writes what is queued unless a thread does; every half second also starts to force the disk; every second
        looks at the space and stores the drops if there are new ones. `now_ns` is any clock that does not jump.
        """
        if self._writer is None:
            self.drain()
        else:
            self._look_at(self._writer)
        if now_ns >= self._next_sync and not self.failure:
            self._next_sync = now_ns + SYNC_NS
            if error := self._disk.start(self.bag.fileno):
                self._fail(str(write_error(self.bag.file_path, error)))
        if now_ns >= self._next_count and not self.failure:
            self._next_count = now_ns + COUNT_NS
            self.store_drops()
            self._watch_space()

    def store_drops(self) -> None:
        """Writes the counts into the bag if drops were added since the last time: a killed bag holds them too."""
        drops = self._drops()
        if self.failure or drops == self._counted or not any(drops.values()):
            return
        try:
            self.bag.store_accounts()
            self._counted = drops
        except BagError as error:
            self._fail(str(error))

    def _drops(self) -> dict[str, int]:
        return {name: sum(row["drops"].values()) for name, row in self.statistics().items()}

    def _watch_space(self) -> None:
        """At the floor the bag is closed whole, without the rewrite that would need more space."""
        try:
            state = space_left(self.bag.path)
        except BagError as error:
            self.warning = str(error)
            return
        self.warning = "" if state == "ok" else f"{self.bag.path}: the disk is nearly full; free some space"
        if state == "floor":
            self.close(DISK_FLOOR, compact=False)
            what = f"the disk is full ({DISK_FLOOR}); the bag was closed whole, free some space"
            self._fail(FaultCode.DISK_FULL.line(what, str(self.bag.path)))

    def drain(self, limit: int = 1_000_000) -> int:
        """Writes what is queued, in order of log time over all topics, and flushes; returns how many were taken.

        A disk error stops the recording: it is kept in `failure`, and everything from then on counts as dropped by the
        disk. Nothing is raised.
        """
        try:
            return self.queues.drain(self.bag.growing, limit)
        except OSError as error:
            self._fail(str(self.bag.refused(error)))
            return 0

    def close(self, reason: str = "", compact: bool | None = None, give_up: Callable[[], bool] | None = None) -> str:
        """Writes the rest, the counts and the index; returns the failure text, empty if all is well.

        `give_up` is asked during the rewrite into the compact form; true leaves the plain file.
        """
        if self._writer is not None:
            self._writer.end()
            self._look_at(self._writer)
            self._writer = None
        self._disk.wait()
        if not self.failure:
            self.drain()
        if not self.failure:
            try:
                self.bag.close(reason, compact, give_up)
            except BagError as error:
                self._fail(str(error))
        if self.failure:
            self.bag.abandon()
        return self.failure

    def losses(self) -> str:
        """What was dropped before it reached the disk, in one line; empty if nothing was."""
        drops = self._drops()
        if not any(drops.values()):
            return ""
        what = f"{sum(drops.values())} samples lost on {', '.join(name for name, count in drops.items() if count)}"
        return FaultCode.RECORDER_SLOW.line(f"{what}. Record fewer topics or use a faster disk.")

    def statistics(self) -> dict[str, dict[str, Any]]:
        """Per topic: the account (received, written, missing, drops, …), `published` and `queued` now.

        At any moment `published` = `written` + drops + `queued`.
        """
        accounts = self.bag.accounts
        table = {}
        for name, row in zip(self._numbers, self.queues.table(), strict=True):
            published = row["received"] + row["drops"]["transport"]
            table[name] = {**accounts[name].as_dict(), **row, "published": published}
        return table

    def _look_at(self, writer: Writer) -> None:
        if (refused := writer.failure) is not None and not self.failure:
            self._fail(str(self.bag.refused(OSError(*refused))))

    def _fail(self, text: str) -> None:
        """Ends the recording: what is queued and what comes from now on counts as lost on the disk."""
        self.failure = text
        self.queues.fail()
