"""The recorder: every published sample is written or counted as dropped, and the counts are in the bag."""

from __future__ import annotations

import errno
import random
import resource
import subprocess
import sys
from pathlib import Path

import pytest
from small_bags import T0, TICK, file_of, payload_of

from hd_control.core.errors import BagError
from hd_control.record.cdr import encode_text
from hd_control.record.reader import BagReader
from hd_control.record.recorder import Recorder
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
