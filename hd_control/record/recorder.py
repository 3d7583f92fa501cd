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
from collections import deque
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from itertools import islice
from operator import itemgetter
from typing import Any

from hd_control.core.errors import BagError
from hd_control.core.faults import FaultCode
from hd_control.core.topics import topic_info
from hd_control.record.accounting import TopicAccount, header_of
from hd_control.record.bag_folder import space_left, write_error
from hd_control.record.cdr import Buffer
from hd_control.record.writer import BagWriter

# ----------------------------------------------------------------------------------------------------
# Forces the disk beside the recording loop: fsync can take seconds on a slow disk, the loop must not wait for it.


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


# ----------------------------------------------------------------------------------------------------


QUEUE_DEPTH = 2000
EVENT_DEPTH = 100_000
SYNC_NS, COUNT_NS = 500_000_000, 1_000_000_000
DISK_FLOOR = "disk_floor"


@dataclass
class _Queue:
    """One topic in front of the bag."""

    topic: str
    type_name: str
    depth: int
    event: bool
    account: TopicAccount
    samples: deque[tuple[int, int | None, bytes]] = field(default_factory=deque)


@dataclass
class Recorder:
    """Queues samples and writes them; `offer` and `drain` may run in two threads, the disk never blocks `offer`.

    `failure` says why the recording ended by itself, `warning` that the disk is nearly full.
    `queue_depth` bounds each sensor topic, `total_depth` everything together. Events (goals, faults, descriptions) are
    never dropped before a sensor sample; their queues are bounded by `EVENT_DEPTH`.
    """

    bag: BagWriter
    queue_depth: int = QUEUE_DEPTH
    total_depth: int = 20_000
    failure: str = ""
    warning: str = ""
    _next_sync: int = 0
    _next_count: int = 0
    _counted: dict[str, int] = field(default_factory=dict)
    _disk: DiskSync = field(default_factory=DiskSync)
    _queues: dict[str, _Queue] = field(default_factory=dict)
    _by_any_name: dict[str, _Queue] = field(default_factory=dict)
    _queued: int = 0
    _in_flight: dict[str, int] = field(default_factory=dict)
    _lock: threading.Lock = field(default_factory=threading.Lock)

    def add_topic(self, topic: str, type_name: str = "", definition: str = "", period_ns: int | None = None) -> None:
        """Announces a topic; those of the schema need no type. Raises BagError for an unknown one."""
        name = "/" + topic.strip("/")
        if name in self._queues:
            self._by_any_name[topic] = self._queues[name]
            return
        self.bag.add_topic(name, type_name, definition, period_ns)
        known = topic_info(name)
        event = bool(known and known.event)
        self._queues[name] = _Queue(
            name, self.bag.type_of(name), EVENT_DEPTH if event else self.queue_depth, event, self.bag.accounts[name]
        )
        self._by_any_name[topic] = self._by_any_name[name] = self._queues[name]

    def offer(self, topic: str, log_time_ns: int, payload: Buffer) -> None:
        """Takes one sample of an announced topic; drops the oldest sensor sample when there is no room."""
        queue = self._by_any_name[topic]
        stamp, frame_id = header_of(queue.type_name, payload)
        account = queue.account
        with self._lock:
            missing = account.missing
            account.see(stamp, frame_id)
            account.drops.transport += account.missing - missing
            if self.failure:
                account.drops.disk += 1
                return
            queue.samples.append((log_time_ns, stamp, bytes(payload)))
            self._queued += 1
            if len(queue.samples) > queue.depth:
                self._drop_oldest(queue)
            elif self._queued > self.total_depth and (longest := self._longest_sensor()):
                self._drop_oldest(longest)

    def tend(self, now_ns: int) -> None:
        """Writes what is queued; every half second also starts to force the disk; every second looks at the space and
        stores the drops if there are new ones. `now_ns` is any clock that does not jump.
        """
        self.drain()
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
        with self._lock:
            drops = {name: queue.account.drops.total for name, queue in self._queues.items()}
        if self.failure or drops == self._counted or not any(drops.values()):
            return
        try:
            self.bag.store_accounts()
            self._counted = drops
        except BagError as error:
            self._fail(str(error))

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
        batch = self._take(limit)
        done = 0
        try:
            for log_time_ns, queue, stamp, payload in batch:
                done += 1
                self.bag.append(queue.topic, stamp, log_time_ns, payload)
            self.bag.flush()
        except BagError as error:
            self._fail(str(error), [queue for _, queue, _, _ in batch[done:]])
        with self._lock:
            self._in_flight = {}
        return len(batch)

    def _take(self, limit: int) -> list[tuple[int, _Queue, int | None, bytes]]:
        batch: list[tuple[int, _Queue, int | None, bytes]] = []
        with self._lock:
            for queue in self._queues.values():
                number = min(len(queue.samples), limit - len(batch))
                batch += [(log, queue, stamp, data) for log, stamp, data in islice(queue.samples, number)]
                for _ in range(number):
                    queue.samples.popleft()
                self._in_flight[queue.topic] = number
            self._queued -= len(batch)
        batch.sort(key=itemgetter(0))
        return batch

    def close(self, reason: str = "", compact: bool | None = None, give_up: Callable[[], bool] | None = None) -> str:
        """Writes the rest, the counts and the index; returns the failure text, empty if all is well.

        `give_up` is asked during the rewrite into the compact form; true leaves the plain file.
        """
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
        with self._lock:
            drops = {name: queue.account.drops.total for name, queue in self._queues.items()}
        if not any(drops.values()):
            return ""
        what = f"{sum(drops.values())} samples lost on {', '.join(name for name, count in drops.items() if count)}"
        return FaultCode.RECORDER_SLOW.line(f"{what}. Record fewer topics or use a faster disk.")

    def statistics(self) -> dict[str, dict[str, Any]]:
        """Per topic: the account (received, written, missing, drops, …), `published` and `queued` now.

        Between two drains `published` = `written` + drops + `queued`.
        """
        table = {}
        with self._lock:
            for name, queue in self._queues.items():
                account = queue.account
                table[name] = {
                    **account.as_dict(),
                    "queued": len(queue.samples) + self._in_flight.get(name, 0),
                    "published": account.received + account.drops.transport,
                }
        return table

    def _longest_sensor(self) -> _Queue | None:
        candidates = [q for q in self._queues.values() if q.samples and not q.event]
        return max(candidates, key=lambda q: len(q.samples), default=None)

    def _drop_oldest(self, queue: _Queue) -> None:
        queue.samples.popleft()
        queue.account.drops.queue += 1
        self._queued -= 1

    def _fail(self, text: str, lost: Sequence[_Queue] = ()) -> None:
        """Ends the recording. `lost` are the queues of samples that were taken but never reached the writer."""
        with self._lock:
            self.failure = text
            for queue in lost:
                queue.account.drops.disk += 1
            for queue in self._queues.values():
                queue.account.drops.disk += len(queue.samples)
                queue.samples.clear()
            self._queued = 0
