"""The recorder: every published sample is written or counted as dropped, and the counts are in the bag."""

from __future__ import annotations

import errno
import random
import resource
import subprocess
import sys
from pathlib import Path

import pytest
from mcap.reader import NonSeekingReader
from small_bags import T0, TICK, file_of, payload_of

from hd_control.core.errors import BagError
from hd_control.record import recorder as recorder_module
from hd_control.record.cdr import encode_text
from hd_control.record.mcap_write import LONGEST_RECORD, MESSAGE
from hd_control.record.reader import BagReader
from hd_control.record.recorder import AWAITED, Recorder
from hd_control.record.writer import BagWriter

SENSORS = ("/encoder", "/resolver", "/joint_states")


def recorder_of(path: Path, **options) -> Recorder:
    recorder = Recorder(BagWriter(path), **options)
    for topic in (*SENSORS, "/robot_description"):
        recorder.add_topic(topic)
    return recorder


def balance(table) -> bool:
    """published = written + drops + queued, for every topic."""
    rows = table.values()
    return all(row["published"] == row["written"] + sum(row["drops"].values()) + row["queued"] for row in rows)


@pytest.mark.parametrize("seed", range(20))
def test_published_equals_written_plus_drops(tmp_path, seed):
    """Random interleaving of publishing, transport loss, overload and draining (goal G8)."""
    account_once(tmp_path / "bag", seed)


def account_once(path: Path, seed: int) -> None:
    """One random run into a bag at `path`; raises AssertionError unless every sample is accounted for."""
    rng = random.Random(seed)
    recorder = recorder_of(path, queue_depth=rng.choice([1, 5, 50]), total_depth=rng.choice([4, 100]))
    published = dict.fromkeys(SENSORS, 0)
    for k in range(300):
        for topic in SENSORS:
            published[topic] += 1
            if rng.random() > 0.1 or k in (0, 299):  # loss before the first or after the last sample leaves no hole
                recorder.offer(topic, T0 + k * TICK, payload_of(topic.strip("/"), k))
        if rng.random() < 0.2:
            recorder.drain(limit=rng.choice([1, 10, 1000]))
        assert balance(recorder.statistics())
    assert recorder.close() == ""
    table = recorder.statistics()
    assert balance(table)
    reader = BagReader(path)
    for topic in SENSORS:
        assert table[topic]["published"] == published[topic]
        assert reader.counts[topic] == table[topic]["written"]
        assert reader.accounting[topic]["drops"] == table[topic]["drops"]


def test_f31_overload_drops_the_oldest(tmp_path):
    recorder = recorder_of(tmp_path / "bag", queue_depth=3)
    for k in range(10):
        recorder.offer("/encoder", T0 + k * TICK, payload_of("encoder", k))
    assert recorder.drain() == 3
    recorder.close()
    stamps = BagReader(tmp_path / "bag").columns("encoder").stamps_ns
    assert ((stamps - T0) // TICK).tolist() == [7, 8, 9]


def test_samples_are_written_in_order_of_log_time_over_all_topics(tmp_path):
    """Topics are emptied one after the other; in the file their samples stand as they came, equal times by topic."""
    recorder = recorder_of(tmp_path / "bag")
    for topic, times in (("/encoder", (1, 5, 7)), ("/resolver", (2, 5, 6)), ("/joint_states", (0, 9))):
        for time in times:
            recorder.offer(topic, T0 + time, payload_of(topic.strip("/"), time))
    assert recorder.close(compact=False) == ""
    with file_of(tmp_path / "bag").open("rb") as stream:
        read = [
            (c.topic, m.log_time - T0, m.sequence)
            for _, c, m in NonSeekingReader(stream).iter_messages(log_time_order=False)
        ]
    assert read == [
        ("/joint_states", 0, 0),
        ("/encoder", 1, 0),
        ("/resolver", 2, 0),
        ("/encoder", 5, 1),
        ("/resolver", 5, 1),
        ("/resolver", 6, 2),
        ("/encoder", 7, 2),
        ("/joint_states", 9, 1),
    ]


def test_events_outlive_sensor_samples(tmp_path):
    recorder = recorder_of(tmp_path / "bag", queue_depth=100, total_depth=10)
    for k in range(8):
        recorder.offer("/robot_description", T0 + k, encode_text(str(k)))
    for k in range(50):
        recorder.offer("/encoder", T0 + k * TICK, payload_of("encoder", k))
    for k in range(8, 12):
        recorder.offer("/robot_description", T0 + 50 * TICK + k, encode_text(str(k)))
    recorder.close()
    table = recorder.statistics()
    assert table["/robot_description"]["written"] == 12 and table["/robot_description"]["drops"]["queue"] == 0
    assert table["/encoder"]["drops"]["queue"] == 50


def test_a_record_that_no_reader_would_take_is_refused_and_counted(tmp_path, monkeypatch):
    """A goal of a million points: written, the whole bag behind it would be unreadable."""
    monkeypatch.setattr(recorder_module, "LONGEST_RECORD", 10_000)
    recorder = recorder_of(tmp_path / "bag")
    fits = 10_000 - MESSAGE.size - len(encode_text(""))
    for number, length in enumerate((10, fits + 1, fits, 50_000)):
        recorder.offer("/robot_description", T0 + number, encode_text("x" * length))
    recorder.offer("/encoder", T0, payload_of("encoder", 0))
    assert "2 samples lost on /robot_description" in recorder.losses()
    assert recorder.close() == ""
    row = recorder.statistics()["/robot_description"]
    assert balance(recorder.statistics()) and row["drops"] == {"transport": 0, "queue": 0, "disk": 0, "size": 2}
    reader = BagReader(tmp_path / "bag")
    assert reader.complete and reader.counts["/robot_description"] == 2 and reader.counts["/encoder"] == 1
    assert reader.accounting["/robot_description"]["drops"]["size"] == 2


def test_the_longest_record_is_one_that_the_reader_takes(tmp_path):
    """Also behind others and in the compact form, where bytes that zstd cannot shorten make a chunk of their own."""
    recorder = recorder_of(tmp_path / "bag")
    longest = LONGEST_RECORD - MESSAGE.size
    noise = random.Random(1).randbytes(longest + 1)
    recorder.offer("/robot_description", T0, noise[:1000])
    for number, length in enumerate((longest + 1, longest), 1):
        recorder.offer("/robot_description", T0 + number, noise[:length])
    for number in range(60):
        recorder.offer("/robot_description", T0 + 10 + number, noise[: 50_000 + number])
    assert recorder.close(compact=True) == ""
    reader = BagReader(tmp_path / "bag")
    assert recorder.statistics()["/robot_description"]["drops"]["size"] == 1
    assert [len(data) for _, data in reader.raw("robot_description")] == [
        *(1000, longest),
        *range(50_000, 50_060),
    ]
    assert reader.complete and "not protected" not in str(reader.problems)


def test_what_no_reader_would_take_is_not_written_either(tmp_path):
    too_long = bytes(LONGEST_RECORD + 1)
    with BagWriter(tmp_path / "bag") as bag:
        with pytest.raises(BagError, match="attach a smaller file"):
            bag.attach("model.urdf", too_long)
        with pytest.raises(BagError, match="split it"):
            bag.write("/robot_description", None, T0, too_long)
    assert BagReader(tmp_path / "bag").complete


def test_memory_of_the_queues_is_bounded(tmp_path):
    """Large events push out the oldest sensor samples first, then each other."""
    recorder = recorder_of(tmp_path / "bag", total_bytes=100_000)
    for k in range(20):
        recorder.offer("/encoder", T0 + k * TICK, payload_of("encoder", k))
    for k in range(6):
        recorder.offer("/robot_description", T0 + 20 * TICK + k, encode_text(f"{k}" * 30_000))
    recorder.close()
    table = recorder.statistics()
    assert balance(table) and table["/encoder"]["drops"]["queue"] == 20
    assert table["/robot_description"]["written"] == 3 and table["/robot_description"]["drops"]["queue"] == 3
    kept = [data for _, data in BagReader(tmp_path / "bag").raw("robot_description")]
    assert kept == [encode_text(f"{k}" * 30_000) for k in (3, 4, 5)]


def test_progress_is_that_of_the_slowest_topic(tmp_path):
    """A lock-step plant runs at most the recorder's lag ahead of it: a topic that is late must hold it back, or its
    publisher overwrites what was not delivered yet. A topic that never came is not waited for, unless it must come."""
    recorder = Recorder(BagWriter(tmp_path / "bag"))
    for topic in (*AWAITED, "joint_states", "robot_description"):
        recorder.add_topic(topic)
    for topic in AWAITED[:-1]:
        recorder.offer(topic, T0, payload_of(topic, 300))
    assert recorder.newest_ns == -1
    recorder.offer(AWAITED[-1], T0, payload_of(AWAITED[-1], 120))
    assert recorder.newest_ns == T0 + 120 * TICK
    recorder.offer(AWAITED[-1], T0, payload_of(AWAITED[-1], 310))
    recorder.offer(AWAITED[-1], T0, payload_of(AWAITED[-1], 50))
    assert recorder.newest_ns == T0 + 300 * TICK
    recorder.offer("joint_states", T0, payload_of("joint_states", 200))
    assert recorder.newest_ns == T0 + 200 * TICK
    recorder.close()


def test_two_publishers_one_after_the_other_are_not_a_gap(tmp_path):
    """A restarted publisher has a new run id: the jump of its stamps is not transport loss."""
    from hd_control.record.cdr import new_run_id
    from hd_control.record.schema import joint_state_codec

    recorder = recorder_of(tmp_path / "bag")
    codec = joint_state_codec("encoder", ["a"])
    for run, start in ((new_run_id(), 0), (new_run_id(), 5000)):
        for k in range(start, start + 10):
            recorder.offer("/encoder", T0 + k * TICK, codec.encode(T0 + k * TICK, run, position=[0.0]))
    recorder.close()
    row = recorder.statistics()["/encoder"]
    assert row["missing"] == 0 and row["written"] == 20 and len(row["run_ids"]) == 2


class FullDisk:
    """A file that takes `room` bytes and then fails, after a short write."""

    def __init__(self, raw, room: int, code: int) -> None:
        self.raw, self.room, self.code = raw, room, code

    def write(self, data) -> int:
        if self.room <= 0:
            raise OSError(self.code, "made to fail")
        count = self.raw.write(data[: self.room])
        self.room -= count
        return count


@pytest.mark.parametrize("code", [errno.ENOSPC, errno.EIO, errno.EROFS])
@pytest.mark.parametrize("room", [0, 1, 100, 1000, 4321])
def test_a_disk_that_fills_up_keeps_the_whole_part_and_counts_the_rest(tmp_path, code, room):
    recorder = recorder_of(tmp_path / "bag")
    recorder.bag.flush()
    recorder.bag._file.redirect(FullDisk(recorder.bag._raw, room, code))
    for k in range(200):
        recorder.offer("/encoder", T0 + k * TICK, payload_of("encoder", k))
        if k % 5 == 4:
            recorder.drain()
    assert recorder.failure and "metadata" not in recorder.failure and str(tmp_path) in recorder.failure
    assert recorder.close() == recorder.failure
    row = recorder.statistics()["/encoder"]
    assert balance(recorder.statistics()) and row["drops"]["disk"] > 0
    reader = BagReader(tmp_path / "bag")
    assert reader.counts.get("/encoder", 0) == row["written"] and not reader.complete
    assert [p for _, p in reader.raw("encoder")] == [payload_of("encoder", k) for k in range(row["written"])]


def test_the_space_floor(tmp_path, monkeypatch):
    from collections import namedtuple

    from hd_control.record import bag_folder

    usage = namedtuple("usage", "total used free")
    large = [(1 << 40, 1 << 31, "ok"), (1 << 40, (1 << 31) - 1, "low"), (1 << 40, 1 << 29, "floor")]
    for total, free, expected in [*large, (1000, 101, "ok"), (1000, 99, "low"), (1000, 49, "floor")]:
        disk = usage(total, total - free, free)
        monkeypatch.setattr(bag_folder.shutil, "disk_usage", lambda _, disk=disk: disk)
        assert bag_folder.space_left(tmp_path) == expected
    monkeypatch.undo()
    with pytest.raises(BagError):
        bag_folder.space_left(tmp_path / "missing")


def test_a_write_error_of_the_bag_names_path_and_remedy(tmp_path):
    bag = BagWriter(tmp_path / "bag")
    bag._file.redirect(FullDisk(bag._raw, 0, errno.ENOSPC))
    with pytest.raises(BagError, match=r"bag_0\.mcap.*free some space.*what was written stays"):
        for k in range(1000):
            bag.write("encoder", None, T0 + k * TICK, payload_of("encoder", k))
    with pytest.raises(BagError, match="start a new bag"):
        bag.write("encoder", None, T0, payload_of("encoder", 0))
    assert bag.accounts["/encoder"].written == 0 and bag.accounts["/encoder"].drops.disk > 0
    bag.abandon()


LIMITED = """
import resource, signal, sys
signal.signal(signal.SIGXFSZ, signal.SIG_IGN)
resource.setrlimit(resource.RLIMIT_FSIZE, (60000, 60000))
sys.path[:0] = [{folder!r}, {root!r}]
from pathlib import Path
from test_recorder import recorder_of, balance, payload_of, T0, TICK
recorder = recorder_of(Path({path!r}))
for k in range(2000):
    recorder.offer("/encoder", T0 + k * TICK, payload_of("encoder", k))
    recorder.drain()
print(recorder.close()); print(balance(recorder.statistics()), recorder.statistics()["/encoder"]["written"])
"""


@pytest.mark.process
def test_a_real_file_size_limit(tmp_path):
    assert resource.RLIMIT_FSIZE is not None
    here = Path(__file__).parent
    code = LIMITED.format(folder=str(here), root=str(here.parents[1]), path=str(tmp_path / "bag"))
    result = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, timeout=60, check=True)
    failure, counts = result.stdout.splitlines()[-2:]
    assert "file size limit" in failure and counts.startswith("True")
    assert BagReader(tmp_path / "bag").counts["/encoder"] == int(counts.split()[1]) > 100
    assert file_of(tmp_path / "bag").stat().st_size <= 60000
