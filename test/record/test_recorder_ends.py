"""The recorder's duties in time: forced disk, stored drops, free-space floor; kill, power cut, slow and broken disk."""

from __future__ import annotations

import errno
import random
import signal
import subprocess
import sys
import threading
import time
from pathlib import Path

import numpy as np
import pytest
from small_bags import T0, TICK, payload_of

from hd_control.core.errors import BagError
from hd_control.record import recorder as recorder_module
from hd_control.record.reader import BagReader
from hd_control.record.recorder import Recorder
from hd_control.record.recover import recover
from hd_control.record.writer import BagWriter

HERE = Path(__file__).parent
TURN = 5  # ticks between two turns of the recording loop


def recording(path: Path, **options) -> Recorder:
    recorder = Recorder(BagWriter(path), **options)
    recorder.add_topic("/encoder")
    recorder.add_topic("/resolver", period_ns=1000 * TICK)
    return recorder


def offer(recorder: Recorder, k: int) -> None:
    """The samples of tick k: one topic at every tick, one once a second."""
    recorder.offer("/encoder", T0 + k * TICK, payload_of("encoder", k))
    if k % 1000 == 0:
        recorder.offer("/resolver", T0 + k * TICK, payload_of("resolver", k))


def power_cuts(folder: Path, monkeypatch, seed: int, ticks: int, cuts: int) -> list[int]:
    """Samples that each of `cuts` cuts loses. What a cut leaves is what was forced to the disk by the last fsync."""
    forced: list[int] = []
    recorder = recording(folder / "bag")
    monkeypatch.setattr(recorder_module.os, "fsync", lambda _: forced.append(recorder.bag.file_path.stat().st_size))
    rng, turns, lost = random.Random(seed), [], []
    for k in range(ticks):
        offer(recorder, k)
        if k % TURN == 0:
            recorder.tend(k * TICK)
            recorder._disk.wait()
            turns.append((k, forced[-1]))
    data = recorder.bag.file_path.read_bytes()
    recorder.bag.abandon()
    cut = folder / "cut.mcap"
    for k, length in [*rng.sample(turns[1:], min(cuts, len(turns)) - 1), turns[-1]]:
        cut.write_bytes(data[:length])
        reader = BagReader(cut)
        assert not reader.complete and reader.counts["/resolver"] >= k // 1000
        lost.append(k - int((reader.columns("encoder").stamps_ns[-1] - T0) // TICK))
    return lost


def test_a_power_cut_loses_less_than_a_second(tmp_path, monkeypatch):
    """The file is cut to its length at the last fsync before each of some times (goal G6)."""
    lost = power_cuts(tmp_path, monkeypatch, 7, 4000, 13)
    assert len(lost) == 13 and max(lost) < 1000


def test_a_slow_disk_does_not_hold_up_the_recording(tmp_path, monkeypatch):
    """fsync that never comes back until the end: everything is handed to the system all the same."""
    free = threading.Event()
    monkeypatch.setattr(recorder_module.os, "fsync", lambda _: free.wait(60.0))
    recorder = recording(tmp_path / "bag")
    for k in range(3000):
        offer(recorder, k)
        if k % TURN == 0:
            recorder.tend(k * TICK)
    assert BagReader(tmp_path / "bag").counts["/encoder"] > 3000 - TURN
    free.set()
    assert recorder.close() == "" and BagReader(tmp_path / "bag").complete


@pytest.mark.parametrize("code", [errno.EIO, errno.ENOSPC, errno.EDQUOT])
def test_an_error_while_forcing_the_disk_ends_the_recording(tmp_path, monkeypatch, code):
    def refuse(_):
        raise OSError(code, "made to fail")

    monkeypatch.setattr(recorder_module.os, "fsync", refuse)
    recorder = recording(tmp_path / "bag")
    for k in range(1001):
        offer(recorder, k)
        recorder.tend(k * TICK)
        recorder._disk.wait()
    assert "bag_0.mcap" in recorder.failure
    row = recorder.statistics()["/encoder"]
    assert row["published"] == 1001 == row["written"] + row["drops"]["disk"] and row["drops"]["disk"] >= 500
    assert recorder.close() == recorder.failure
    assert BagReader(tmp_path / "bag").counts["/encoder"] == row["written"]


def test_at_the_floor_the_bag_is_closed_whole(tmp_path, monkeypatch):
    states = iter(["ok", "low", "floor"])
    monkeypatch.setattr(recorder_module, "space_left", lambda _: next(states))
    recorder, warnings = recording(tmp_path / "bag"), []
    for k in range(2500):
        offer(recorder, k)
        recorder.tend(k * TICK)
        warnings.append(bool(recorder.warning))
    assert warnings.index(True) == 1000 and "disk_floor" in recorder.failure
    reader = BagReader(tmp_path / "bag")
    assert reader.complete and reader.counts["/encoder"] == 2001
    assert reader.metadata["hd_close"]["reason"] == "disk_floor"
    assert recorder.statistics()["/encoder"]["drops"]["disk"] == 499 and recorder.close() == recorder.failure


def test_drops_are_in_a_bag_that_was_never_closed(tmp_path):
    """Overload, then the end without a close: the last stored counts are at most a second old (rule 4)."""
    recorder = recording(tmp_path / "bag", queue_depth=10)
    for k in range(5000):
        offer(recorder, k)
        if k % 40 == 0:
            recorder.tend(k * TICK)
    recorder.bag.abandon()
    stored = BagReader(tmp_path / "bag").accounting["/encoder"]
    true = recorder.statistics()["/encoder"]["drops"]["queue"]
    assert true > 3000 and 0 <= true - stored["drops"]["queue"] <= 1000
    report = recover(tmp_path / "bag", tmp_path / "new")
    assert BagReader(tmp_path / "new").accounting["/encoder"] == stored and report.topics["/encoder"].kept > 1000


def test_five_times_too_many_samples_are_all_accounted_for(tmp_path):
    """Goal G8: the disk takes a fifth of what comes; every sample is written or counted, and the counts are kept."""
    recorder = recording(tmp_path / "bag", queue_depth=50, total_depth=60)
    for k in range(5000):
        offer(recorder, k)
        if k % 10 == 0:
            recorder.drain(limit=2)
    assert recorder.close() == ""
    reader = BagReader(tmp_path / "bag")
    for topic, published in (("/encoder", 5000), ("/resolver", 5)):
        drops = reader.accounting[topic]["drops"]
        assert reader.counts[topic] + sum(drops.values()) == published, topic
    assert reader.accounting["/encoder"]["drops"]["queue"] > 3500


def test_a_rewrite_that_is_given_up_leaves_the_plain_file_indexed(tmp_path):
    recorder = recording(tmp_path / "bag")
    for k in range(100):
        offer(recorder, k)
    assert recorder.close("asked", give_up=lambda: True) == ""
    reader = BagReader(tmp_path / "bag")
    assert reader.complete and reader.counts["/encoder"] == 100
    assert sorted(path.name for path in (tmp_path / "bag").iterdir()) == ["bag_0.mcap", "metadata.yaml"]


def test_a_folder_that_takes_no_bag(tmp_path, monkeypatch):
    def refuse(self, *_, **__):
        raise OSError(errno.EROFS, "Read-only file system")

    monkeypatch.setattr(Path, "mkdir", refuse)
    with pytest.raises(BagError, match="read-only; choose another disk"):
        BagWriter(tmp_path / "bag")


# ---- Writing beside: a thread writes what is queued --------------------------------------------------


def until(true, seconds: float = 20.0) -> bool:
    """Waits for a condition, with a limit that only a defect reaches."""
    end = time.monotonic() + seconds
    while not true() and time.monotonic() < end:
        time.sleep(0.005)
    return bool(true())


def test_what_is_queued_is_written_without_anybody_asking(tmp_path):
    recorder = recording(tmp_path / "bag")
    recorder.write_beside()
    for k in range(500):
        offer(recorder, k)
    assert until(lambda: recorder.statistics()["/encoder"]["written"] == 500)
    size = recorder.bag.file_path.stat().st_size
    assert BagReader(tmp_path / "bag").counts["/encoder"] == 500, "before it is closed"
    assert recorder.close() == "" and recorder.bag.file_path.stat().st_size != size
    assert BagReader(tmp_path / "bag").complete


def test_threads_offer_write_and_count_at_once(tmp_path):
    """Four threads offer, one writes, one stores counts and reads them: every sample once, counts in balance always."""
    recorder = recording(tmp_path / "bag", queue_depth=100, total_depth=250)
    topics = ("/encoder", "/resolver", "/gauge_bridge", "/joint_states")
    for topic in topics:
        recorder.add_topic(topic, period_ns=0)
    recorder.write_beside()
    payloads = {topic: payload_of(topic.strip("/"), 0) for topic in topics}

    def run(topic: str) -> None:
        for k in range(5000):
            recorder.offer(topic, T0 + k, payloads[topic])

    threads = [threading.Thread(target=run, args=(topic,)) for topic in topics]
    for thread in threads:
        thread.start()
    while any(thread.is_alive() for thread in threads):
        for row in recorder.statistics().values():
            assert row["published"] == row["written"] + sum(row["drops"].values()) + row["queued"]
        recorder.bag.set_metadata("test", {"a": "b"})
    assert recorder.close(compact=False) == ""
    reader = BagReader(tmp_path / "bag")
    assert reader.complete
    for topic in topics:
        row = recorder.statistics()[topic]
        assert row["received"] == 5000 == row["written"] + row["drops"]["queue"]
        assert reader.counts[topic] == row["written"]


class Failing:
    """A file that takes some bytes, then fails with an error."""

    def __init__(self, raw, room: int, error: BaseException) -> None:
        self.raw, self.room, self.error = raw, room, error

    def write(self, data) -> int:
        if self.room <= 0:
            raise self.error
        count = self.raw.write(data[: self.room])
        self.room -= count
        return count


@pytest.mark.parametrize(
    "error", [OSError(errno.ENOSPC, "No space"), OSError(errno.EIO, "Broken"), ZeroDivisionError("x")], ids=repr
)
@pytest.mark.parametrize("room", [0, 1, 5000])
def test_a_disk_that_refuses_the_writing_thread_ends_the_recording(tmp_path, error, room):
    """The counts are right from the moment of the error on; `tend` reports it; what was written stays readable."""
    recorder = recording(tmp_path / "bag")
    recorder.bag.flush()
    recorder.bag._file.redirect(Failing(recorder.bag._raw, room, error))
    recorder.write_beside()
    for k in range(100):
        offer(recorder, k)
    assert until(lambda: recorder.statistics()["/encoder"]["drops"]["disk"] > 0)
    for k in range(100, 200):
        offer(recorder, k)
    row = recorder.statistics()["/encoder"]
    assert row["published"] == 200 == row["written"] + row["drops"]["disk"] and row["queued"] == 0, "before it is known"
    recorder.tend(0)
    assert "bag_0.mcap" in recorder.failure and recorder.close() == recorder.failure
    row = recorder.statistics()["/encoder"]
    assert row["published"] == 200 == row["written"] + row["drops"]["disk"] and row["queued"] == 0
    assert BagReader(tmp_path / "bag").counts.get("/encoder", 0) == row["written"]


def test_an_error_between_the_last_look_and_the_close_is_reported(tmp_path):
    recorder = recording(tmp_path / "bag")
    recorder.bag.flush()
    recorder.bag._file.redirect(Failing(recorder.bag._raw, 0, OSError(errno.EIO, "Broken")))
    recorder.write_beside()
    offer(recorder, 0)
    assert until(lambda: recorder.statistics()["/encoder"]["drops"]["disk"] == 1)
    assert recorder.failure == "" and "bag_0.mcap" in recorder.close()


# ---- SIGKILL ---------------------------------------------------------------------------------------


KILLED = """
import sys, time
sys.path[:0] = [{folder!r}, {root!r}]
from pathlib import Path
from test_recorder_ends import recording, payload_of
recorder = recording(Path({path!r}))
if {beside!r}:
    recorder.write_beside()
number, tended = 0, 0
while True:
    now = time.time_ns()
    recorder.offer("/encoder", now, payload_of("encoder", number))
    if number % 1000 == 0:
        recorder.offer("/resolver", now, payload_of("resolver", number))
    print(number % 1000 == 0, now, flush=True)
    if time.monotonic_ns() >= tended + 5_000_000:
        tended = time.monotonic_ns()
        recorder.tend(tended)
    number += 1
    time.sleep(0.001)
"""


def kill_once(folder: Path, seconds: float, beside: bool = True) -> float:
    """Records until SIGKILL after `seconds`; the longest loss of any topic, s. What is there must be the beginning."""
    code = KILLED.format(folder=str(HERE), root=str(HERE.parents[1]), path=str(folder / "bag"), beside=beside)
    process = subprocess.Popen([sys.executable, "-c", code], stdout=subprocess.PIPE, text=True)
    lines = [process.stdout.readline()]
    time.sleep(seconds)
    process.send_signal(signal.SIGKILL)
    lines += process.stdout.read().splitlines(keepends=True)
    process.wait()
    taken = [(line.split()[0] == "True", int(line.split()[1])) for line in lines if line.endswith("\n")]
    reader = BagReader(folder / "bag")
    assert not reader.complete
    worst = 0
    for topic, offered in (("encoder", [t for _, t in taken]), ("resolver", [t for slow, t in taken if slow])):
        kept = reader.columns(topic).log_times_ns if reader.has(topic) else np.zeros(0, np.int64)
        lost = [t for t in offered if t not in set(kept.tolist())]
        assert lost == offered[len(offered) - len(lost) :], "only the end is missing"
        worst = max([worst, *(taken[-1][1] - t for t in lost)])
    return worst * 1e-9


@pytest.mark.process
@pytest.mark.parametrize("number", range(5))
def test_a_killed_recorder_loses_less_than_100_ms_also_of_a_slow_topic(tmp_path, number):
    """Random times, the first within the first second (goal G5); written by a thread, and by the loop itself."""
    assert kill_once(tmp_path, random.Random(number).uniform(0.0, 0.5 + 0.4 * number), number % 2 == 0) < 0.1
