"""Damaged and unfinished recordings: the whole part is read, the rest is named, nothing else happens."""

from __future__ import annotations

import os
import random
import shutil
import signal
import subprocess
import sys
import time

import numpy as np
import pytest
from small_bags import T0, TICK, TOPICS, file_of, payload_of, tick_values, write_bag

from hd_control.core.errors import BagError
from hd_control.record.mcap_write import MAGIC
from hd_control.record.reader import BagReader
from hd_control.record.writer import BagWriter

TICKS = 6
HEADER_END = len(MAGIC)


@pytest.mark.parametrize("options", [{"compact": False}, {"live": False}], ids=["plain", "chunks"])
def test_truncation_at_every_byte_gives_a_prefix_and_a_stated_loss(tmp_path, options):
    topics = ("encoder",)  # one topic keeps the file, and with it the number of cuts, small
    bag = BagWriter(tmp_path / "bag", **options)
    for k in range(TICKS):
        bag.write("encoder", None, T0 + k * TICK, payload_of("encoder", k))
    data = file_of(bag.close()).read_bytes()
    truth = {topic: [payload_of(topic, k) for k in range(TICKS)] for topic in topics}
    cut, most = tmp_path / "cut.mcap", 0
    for length in range(len(data)):
        cut.write_bytes(data[:length])
        if length < HEADER_END:
            with pytest.raises(BagError):
                BagReader(cut)
            continue
        reader = BagReader(cut)
        assert not reader.complete, length
        total = 0
        for topic in topics:
            read = [payload for _, payload in reader.raw(topic)] if f"/{topic}" in reader.topics else []
            assert read == truth[topic][: len(read)]
            total += len(read)
        assert total >= most, "a longer file never gives less"
        most = total
    assert most == len(topics) * TICKS


def test_every_flipped_byte_is_noticed_or_harmless(tmp_path):
    """Chunks and the data section have checksums, the index has one: no damage is silently short or changes a value."""
    path = file_of(write_bag(tmp_path / "bag", TICKS, live=False))
    data = path.read_bytes()
    truth = {topic: list(BagReader(path).raw(topic)) for topic in TOPICS}
    bad = tmp_path / "bad.mcap"
    for at in range(0, len(data), 7):  # 7 has no common factor with the record and field lengths: every kind is met
        bad.write_bytes(data[:at] + bytes([data[at] ^ (1 << at % 8)]) + data[at + 1 :])
        try:
            reader = BagReader(bad)
            read = {topic: list(reader.raw(topic)) for topic in TOPICS if f"/{topic}" in reader.topics}
        except BagError:
            continue
        if not reader.problems:
            assert read == truth, f"byte {at} changed silently"


@pytest.mark.parametrize("seed", range(40))
def test_f27_random_damage_gives_a_result_or_a_bag_error(tmp_path, seed):
    rng = random.Random(seed)
    data = bytearray(file_of(write_bag(tmp_path / "bag", 30, live=seed % 2 == 0, compact=seed % 4 == 0)).read_bytes())
    kind, at = seed % 5, rng.randrange(9, len(data) - 64)
    size = rng.randrange(1, 64)
    if kind == 0:
        data[at : at + size] = bytes(size)
    elif kind == 1:
        data[at : at + size] = rng.randbytes(size)
    elif kind == 2:
        del data[at : at + size]
    elif kind == 3:
        data[at:at] = data[at : at + size]
    else:
        data[at : at + 8] = b"\xff" * 8
    bad = tmp_path / "bad.mcap"
    bad.write_bytes(data)
    try:
        reader = BagReader(bad)
        total = 0
        for topic in reader.topics:
            total += sum(1 for _ in reader.raw(topic))
            if reader.topics[topic].endswith("JointState"):
                reader.columns(topic)
            list(reader.messages(topic))
    except BagError:
        return
    assert total >= 30 * len(TOPICS) + 4 or not reader.complete, "silently short"


def test_a_damaged_chunk_is_skipped_and_the_others_are_kept(tmp_path):
    from mcap.reader import make_reader

    path = file_of(write_bag(tmp_path / "bag", 40, live=False))
    with path.open("rb") as stream:
        chunks = make_reader(stream).get_summary().chunk_indexes
    data = bytearray(path.read_bytes())
    data[chunks[1].chunk_start_offset + 80] ^= 0xFF
    path.write_bytes(data)
    reader = BagReader(path)
    counts = BagReader(write_bag(tmp_path / "whole", 40)).counts
    lost = [topic for topic in counts if reader.counts.get(topic, 0) != counts[topic]]
    assert len(lost) == 1 and reader.counts.get(lost[0], 0) == 0
    assert any(lost[0] in str(problem) and f"of {counts[lost[0]]}" in str(problem) for problem in reader.problems)


def test_checksums_are_compared(tmp_path):
    """A changed payload bit in an uncompressed chunk, and one in a plain closed file: only the checksum shows it."""
    import struct
    import zlib

    from hd_control.record.mcap_read import ChunkError, chunk_data, chunk_place

    data = bytes(range(200))
    for crc, good in ((zlib.crc32(data), True), (zlib.crc32(data) ^ 1, False), (0, True)):
        record = struct.pack("<QQQII", 0, 0, len(data), crc, 0) + struct.pack("<Q", len(data)) + data
        if good:
            assert chunk_data(record, chunk_place(record, 0, len(record))) == data
        else:
            with pytest.raises(ChunkError, match="checksum"):
                chunk_data(record, chunk_place(record, 0, len(record)))

    path = file_of(write_bag(tmp_path / "bag", 5, compact=False))
    raw = bytearray(path.read_bytes())
    raw[raw.index(payload_of("encoder", 3)) + 150] ^= 1
    path.write_bytes(raw)
    reader = BagReader(path)
    assert not reader.complete and any("checksum of the data section" in str(problem) for problem in reader.problems)


def test_a_broken_frame_is_passed_by_the_index(tmp_path):
    from mcap.reader import make_reader

    path = file_of(write_bag(tmp_path / "bag", 40, live=False))
    with path.open("rb") as stream:
        first = make_reader(stream).get_summary().chunk_indexes[0]
    data = bytearray(path.read_bytes())
    data[first.chunk_start_offset + 5] = 0xFF
    path.write_bytes(data)
    reader = BagReader(path)
    assert not reader.complete and sum(count > 0 for count in reader.counts.values()) == len(TOPICS) + 1


def test_a_recording_that_was_not_closed_is_read(tmp_path):
    bag = BagWriter(tmp_path / "bag")
    for k in range(50):
        bag.write("encoder", None, T0 + k * TICK, payload_of("encoder", k))
    bag.flush()
    bag.abandon()
    reader = BagReader(tmp_path / "bag")
    assert np.array_equal(reader.columns("encoder").position, [tick_values(k) for k in range(50)])
    texts = " ".join(map(str, reader.problems))
    assert not reader.complete and "not closed" in texts and "metadata.yaml" in texts and "checksums" in texts


def test_what_metadata_yaml_promises_is_compared(tmp_path):
    bag, more = write_bag(tmp_path / "bag", 5), write_bag(tmp_path / "more", 9)
    shutil.copy(file_of(bag), file_of(more))
    reader = BagReader(more)
    assert any("/encoder" in str(p) and "states 9 messages, 5" in str(p) for p in reader.problems)


def test_the_original_is_never_changed(tmp_path):
    bag = write_bag(tmp_path / "bag", 5)
    file = file_of(bag)
    file.write_bytes(file.read_bytes()[:-100])
    before, time_before = file.read_bytes(), file.stat().st_mtime_ns
    file.chmod(0o400)
    reader = BagReader(bag)
    reader.columns("encoder")
    assert file.read_bytes() == before and file.stat().st_mtime_ns == time_before


KILLED = """
import sys, time
sys.path[:0] = [{folder!r}, {root!r}]
from small_bags import payload_of
from hd_control.record.writer import BagWriter
payload = payload_of("encoder", 0)
bag = BagWriter({path!r})
number = 0
while True:
    now = time.time_ns()
    bag.write("encoder", now, now, payload)
    if number % 100 == 0:
        bag.write("resolver", now, now, payload)
    print(number % 100 == 0, now, flush=True)
    number += 1
    time.sleep(0.001)
"""


@pytest.mark.process
@pytest.mark.parametrize("seconds", [0.05, 0.4, 0.9])
def test_a_killed_recorder_loses_less_than_100_ms(tmp_path, seconds):
    """The writer prints the time of each sample it has taken; what is not in the file is the loss (recorder rule 2).

    The second topic has about ten samples a second: a slow topic loses no more than a fast one.
    """
    here = os.path.dirname(__file__)
    root = os.path.dirname(os.path.dirname(here))
    code = KILLED.format(folder=here, root=root, path=str(tmp_path / "bag"))
    process = subprocess.Popen([sys.executable, "-c", code], stdout=subprocess.PIPE, text=True)
    lines = [process.stdout.readline()]
    time.sleep(seconds)
    process.send_signal(signal.SIGKILL)
    lines += process.stdout.read().splitlines(keepends=True)
    process.wait()
    taken = [(line.split()[0] == "True", int(line.split()[1])) for line in lines if line.endswith("\n")]
    reader = BagReader(tmp_path / "bag")
    assert not reader.complete and len(taken) > 5
    for topic, offered in (("encoder", [t for _, t in taken]), ("resolver", [t for slow, t in taken if slow])):
        kept = set(reader.columns(topic).log_times_ns.tolist()) if reader.has(topic) else set()
        lost = [t for t in offered if t not in kept]
        assert all(taken[-1][1] - t < 100_000_000 for t in lost), topic
        assert lost == offered[len(offered) - len(lost) :], "only the end is missing"


def test_hostile_sizes_are_refused(tmp_path):
    """A record that claims 1 TB and a chunk that claims to expand a thousandfold: refused by the caps, at once."""
    import struct

    from hd_control.record.mcap_read import ChunkError, ChunkPlace, chunk_data, chunk_place

    path = tmp_path / "bad.mcap"
    path.write_bytes(MAGIC + struct.pack("<BQ", 5, 1 << 40) + bytes(100))
    assert any("above the cap" in str(problem) for problem in BagReader(path).problems)
    head = struct.pack("<QQQII", 0, 0, 1 << 26, 0, 4) + b"zstd" + struct.pack("<Q", 4) + bytes(4)
    with pytest.raises(ChunkError, match="expands"):
        chunk_place(head, 0, len(head))
    with pytest.raises(ChunkError, match="above the cap"):
        chunk_place(head[:16] + struct.pack("<Q", 1 << 40) + head[24:], 0, len(head))
    import zstandard

    bomb = zstandard.ZstdCompressor().compress(bytes(1 << 22))
    with pytest.raises(ChunkError, match="states"):
        chunk_data(bomb, ChunkPlace(0, 0, len(bomb), "zstd", 1000, 0))
