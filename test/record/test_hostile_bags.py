"""Files made to do harm: bombs, endless small records, wrong sizes in messages, types that are not what they say."""

from __future__ import annotations

import struct
import time
import tracemalloc
from pathlib import Path

import pytest
from small_bags import T0, TICK, payload_of

from hd_control.core.errors import BagError
from hd_control.record.mcap_write import MAGIC, McapFile, message_record
from hd_control.record.reader import BagReader
from hd_control.record.schema import message_definition
from hd_control.record.summary import summarize
from hd_control.record.writer import BagWriter

MOST_CPU, MOST_MEMORY = 2.0, 200 << 20


def read_all(path: Path) -> BagReader:
    """Reads in every way, within the limits of processor time, and once more within those of memory."""
    start = time.process_time()
    reader = _read(path)
    assert time.process_time() - start < MOST_CPU
    tracemalloc.start()
    _read(path)
    peak = tracemalloc.get_traced_memory()[1]
    tracemalloc.stop()
    assert peak < MOST_MEMORY
    return reader


def _read(path: Path) -> BagReader:
    reader = BagReader(path)
    for topic in reader.topics:
        for _ in reader.raw(topic):
            pass
    summarize(reader)
    return reader


def chunk(data: bytes, packed: bytes, compression: bytes, stated: int | None = None, crc: int = 0) -> bytes:
    size = len(data) if stated is None else stated
    content = struct.pack("<QQQII", 0, 0, size, crc, len(compression)) + compression
    content += struct.pack("<Q", len(packed)) + packed
    return struct.pack("<BQ", 6, len(content)) + content


@pytest.mark.parametrize("compression", ["zstd", "lz4"])
@pytest.mark.parametrize("stated", [1 << 20, 60 << 20, 1 << 60])
def test_f29_decompression_bombs(tmp_path, compression, stated):
    import lz4.frame
    import zstandard

    zeros = bytes(60 << 20)
    packed = zstandard.ZstdCompressor().compress(zeros) if compression == "zstd" else lz4.frame.compress(zeros)
    path = tmp_path / "bomb.mcap"
    path.write_bytes(MAGIC + 5 * chunk(b"", packed, compression.encode(), stated))
    reader = read_all(path)
    assert not reader.complete and not reader.topics


def test_endless_small_records_are_cut_off_and_said(tmp_path):
    path = tmp_path / "small.mcap"
    path.write_bytes(MAGIC + (struct.pack("<BQ", 4, 3) + b"abc") * 100_000)
    reader = read_all(path)
    assert not reader.complete and len(reader.problems) < 200
    assert any("descriptions" in str(p) for p in reader.problems) or any(
        "more of such" in str(p) for p in reader.problems
    )


def test_places_that_look_like_records_do_not_take_long(tmp_path):
    path = tmp_path / "looks.mcap"
    path.write_bytes(MAGIC + b"\x00" + (struct.pack("<BQ", 5, 40) + bytes(3)) * 100_000)
    assert not read_all(path).complete


@pytest.mark.parametrize("place", range(4, 76, 8))
def test_huge_lengths_inside_messages(tmp_path, place):
    """Every 32-bit word of a JointState may be a length: counts of names and numbers, lengths of strings."""
    path = tmp_path / "bag"
    with BagWriter(path, live=False) as bag:
        bag.add_topic("encoder")
        for k in range(50):
            payload = bytearray(payload_of("encoder", k))
            payload[place : place + 4] = b"\xff\xff\xff\x7f"
            bag.write("encoder", T0 + k * TICK, T0 + k * TICK, bytes(payload))
    reader = read_all(path)
    assert len(list(reader.messages("encoder"))) in (0, 50)


FOREIGN = {
    "recursive": ("p/msg/A", "p/A a\n"),
    "two that need each other": ("p/msg/A", f"p/B b\n{'=' * 80}\nMSG: p/B\np/A a\n"),
    "garbage": ("p/msg/A", "\x00\xff{{{"),
    "code": ("p/msg/A", "int32 a=__import__('os').system('true')\n"),
    "name with code": ("p/msg/A", "int32 a);import os;(b\n"),
    "nothing": ("p/msg/A", ""),
    "no name": ("", "int32 a\n"),
    "name of code": ("x;import os/msg/A", "int32 a\n"),
    "our name, other fields": ("sensor_msgs/msg/JointState", "int32 a\n"),
    "huge array": ("p/msg/A", "int64[2000000000] a\n"),
    "deep": ("p/msg/A0", "".join(f"p/A{k + 1} a\n{'=' * 80}\nMSG: p/A{k + 1}\n" for k in range(500)) + "int32 a\n"),
    "idl": ("p/msg/A", "=" * 80 + "\nIDL: p/msg/A\nmodule p {{{"),
}


@pytest.mark.parametrize("name", FOREIGN)
def test_f28_foreign_types_are_data(tmp_path, name):
    """Read, or refused by a BagError, or reported as messages that do not fit; raw bytes stay readable always."""
    type_name, definition = FOREIGN[name]
    path = tmp_path / "foreign.mcap"
    with path.open("wb", buffering=0) as raw:
        file = McapFile(raw)
        number = file.add_channel("/foreign", file.add_schema(type_name, definition), {})
        file.add_message(number, 0, T0, T0, b"\x00\x01\x00\x00\x07\x00\x00\x00")
        file.finish()
    reader = read_all(path)
    assert len(list(reader.raw("foreign"))) == 1
    start = time.process_time()
    try:
        list(reader.messages("foreign"))
    except BagError as error:
        assert "/foreign" in str(error)
    assert time.process_time() - start < MOST_CPU


def test_another_encoding_is_listed_and_not_guessed(tmp_path):
    path = tmp_path / "json.mcap"
    with path.open("wb", buffering=0) as raw:
        file = McapFile(raw)
        number = file.add_channel("/json", file.add_schema("a", "{}", "jsonschema"), {}, "json")
        file.add_message(number, 0, T0, T0, b'{"a": 1}')
        file.finish()
    reader = read_all(path)
    assert any("encoding 'json'" in str(problem) for problem in reader.problems) and not reader.complete


def test_a_chunk_full_of_tiny_messages_stays_small_in_memory(tmp_path):
    import zstandard

    record = message_record(1, 0, T0, T0, b"")
    data = record * ((32 << 20) // len(record))
    path = tmp_path / "tiny.mcap"
    with path.open("wb", buffering=0) as raw:
        file = McapFile(raw)
        file.add_channel("/a", file.add_schema("std_msgs/msg/Empty", message_definition("std_msgs/msg/Empty")), {})
        file.flush()
        raw.write(chunk(data, zstandard.ZstdCompressor().compress(data), b"zstd"))
    tracemalloc.start()
    reader = BagReader(path)
    assert reader.counts["/a"] == 0 or reader.counts["/a"] == len(data) // len(record)
    assert tracemalloc.get_traced_memory()[1] < MOST_MEMORY
    tracemalloc.stop()
