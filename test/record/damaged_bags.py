"""Seeded damage of recordings, class by class, and what must hold for each case.

A case is a number: `check_case(folder, bags, number)` makes the damage, reads the bag in every way, and raises
AssertionError with the case's text if anything but a BagError leaves the reader, if a bag with something missing says
it is complete, if an untouched chunk is not read, or if the original changes.
"""

from __future__ import annotations

import random
import shutil
import time
from dataclasses import dataclass
from pathlib import Path

from small_bags import T0, TICK, file_of, payload_of, write_bag

from hd_control.core.errors import BagError
from hd_control.record.reader import BagReader
from hd_control.record.summary import summarize
from hd_control.record.writer import BagWriter

TICKS = 24
MOST_SECONDS = 2.0
FORMS = ("plain", "chunks", "compact", "killed", "db3")


@dataclass(frozen=True)
class Chunk:
    """One chunk of a whole file: its bytes, topic and number of messages."""

    data: bytes
    topic: str
    count: int


@dataclass(frozen=True)
class Original:
    """A bag before the damage."""

    folder: Path
    file: str
    truth: dict[str, list[bytes]]
    chunks: tuple[Chunk, ...]


def originals(folder: Path) -> dict[str, Original]:
    """One small bag of each form."""
    paths = {
        "plain": write_bag(folder / "plain", TICKS, compact=False),
        "chunks": write_bag(folder / "chunks", TICKS, live=False),
        "compact": write_bag(folder / "compact", TICKS),
        "killed": _killed(folder / "killed"),
        "db3": _database(folder / "db3"),
    }
    return {form: _original(path) for form, path in paths.items()}


def _killed(path: Path) -> Path:
    bag = BagWriter(path)
    for k in range(TICKS):
        for topic in ("encoder", "resolver"):
            bag.write(topic, None, T0 + k * TICK, payload_of(topic, k))
    bag.flush()
    bag.abandon()
    return path


def _database(path: Path) -> Path:
    from rosbags.rosbag2 import StoragePlugin, Writer

    from hd_control.core.topics import JOINT_STATE_TYPE
    from hd_control.record.cdr import typestore

    with Writer(path, version=8, storage_plugin=StoragePlugin.SQLITE3) as writer:
        connection = writer.add_connection("/encoder", JOINT_STATE_TYPE, typestore=typestore())
        for k in range(TICKS):
            writer.write(connection, T0 + k * TICK, payload_of("encoder", k))
    return path


def _original(path: Path) -> Original:
    from mcap.reader import make_reader

    reader = BagReader(path)
    truth = {topic: [data for _, data in reader.raw(topic)] for topic in reader.topics}
    files = [*path.glob("*.mcap"), *path.glob("*.db3")]
    chunks = []
    if files[0].suffix == ".mcap" and reader.complete:
        data = files[0].read_bytes()
        with files[0].open("rb") as stream:
            summary = make_reader(stream).get_summary()
        for index in summary.chunk_indexes:
            (number,) = index.message_index_offsets
            topic = summary.channels[number].topic
            part = data[index.chunk_start_offset : index.chunk_start_offset + index.chunk_length]
            chunks.append(Chunk(part, topic, len(truth[topic])))
    return Original(path, files[0].name, truth, tuple(chunks))


def damage(data: bytes, rng: random.Random) -> tuple[str, bytes]:
    """One damaged version of a file and its name."""
    at, size = rng.randrange(len(data)), min(len(data), rng.choice([1, 2, 8, 31, 200, 1000]))
    end = min(len(data), at + size)
    other = rng.randrange(len(data))
    huge = rng.choice([b"\xff" * 8, (1 << 40).to_bytes(8, "little"), (len(data) * 2).to_bytes(8, "little"), bytes(8)])
    makers = {
        "truncated": lambda: data[:at],
        "bit flip": lambda: data[:at] + bytes([data[at] ^ 1 << rng.randrange(8)]) + data[at + 1 :],
        "three bit flips": lambda: flipped(data, 3, rng),
        "wrong length": lambda: with_length(data, huge, rng),
        "cut out": lambda: data[:at] + data[end:],
        "doubled": lambda: data[:end] + data[at:],
        "moved": lambda: data[:other] + data[at:end] + data[other:],
        "random block": lambda: data[:at] + rng.randbytes(end - at) + data[end:],
        "zero block": lambda: data[:at] + bytes(end - at) + data[end:],
        "wrong compression": lambda: data.replace(b"zstd", rng.choice([b"lz4\0", b"none", b"zst\xff"]), 1),
        "tail of another": lambda: data[:at] + data[other:],
        "only a head": lambda: data[: rng.randrange(64)],
    }
    kind = rng.choice(list(makers))
    return f"{kind} at {at}, {end - at} bytes, {other}", makers[kind]()


def flipped(data: bytes, number: int, rng: random.Random) -> bytes:
    """Some bits changed."""
    changed = bytearray(data)
    for _ in range(number):
        changed[rng.randrange(len(data))] ^= 1 << rng.randrange(8)
    return bytes(changed)


def with_length(data: bytes, length: bytes, rng: random.Random) -> bytes:
    """A length of a record head (or of something that looks like one) replaced."""
    places = [at for at in range(len(data) - 9) if 1 <= data[at] <= 15 and data[at + 5 : at + 9] == bytes(4)]
    at = rng.choice(places) if places else 0
    return data[: at + 1] + length + data[at + 9 :]


def damage_metadata(folder: Path, rng: random.Random) -> str:
    """Now and then metadata.yaml is missing, damaged, or contradicts the file."""
    path, kind = folder / "metadata.yaml", rng.randrange(12)
    if kind == 0:
        path.unlink(missing_ok=True)
    elif kind == 1 and path.exists():
        path.write_bytes(flipped(path.read_bytes(), 5, rng))
    elif kind == 2 and path.exists():
        path.write_text(path.read_text().replace(f"message_count: {TICKS}", "message_count: 7"))
    elif kind == 3 and path.exists():
        path.write_text(path.read_text().replace("_0.", "_1."))
    return f"metadata {kind}" if kind < 4 else ""


def check_case(folder: Path, bags: dict[str, Original], number: int) -> str:
    """Runs one case; returns `complete`, `partial` or `refused`. Raises AssertionError with the text of the case."""
    rng = random.Random(number)
    form = rng.choice(FORMS)
    original, case = bags[form], folder / f"case_{number}"
    shutil.copytree(original.folder, case)
    whole = (original.folder / original.file).read_bytes()
    words, data = damage(whole, rng)
    (case / original.file).write_bytes(data)
    words = f"case {number}: {form}, {words}, {damage_metadata(case, rng)}"
    before = {path.name: path.read_bytes() for path in case.iterdir()}
    start = time.process_time()
    try:
        result = _check_reader(BagReader(case), original, data, words)
    except BagError as error:
        assert "\n" not in str(error), words
        result = "refused"
    except Exception as error:
        raise AssertionError(f"{words}: {type(error).__name__}: {error} left the reader") from error
    assert time.process_time() - start < MOST_SECONDS, f"{words}: took too long"
    assert {path.name: path.read_bytes() for path in case.iterdir()} == before, f"{words}: the original changed"
    shutil.rmtree(case)
    return result


def _check_reader(reader: BagReader, original: Original, data: bytes, words: str) -> str:
    read = {topic: [payload for _, payload in reader.raw(topic)] for topic in reader.topics}
    for topic in reader.topics:
        try:
            list(reader.messages(topic))
        except BagError:  # a type that is not known after the damage
            continue
    summarize(reader)
    if reader.complete:
        short = {topic: len(rows) for topic, rows in original.truth.items() if len(read.get(topic, [])) != len(rows)}
        assert not short, f"{words}: silently short {short}"
        protected = not any("not protected" in str(problem) for problem in reader.problems)
        assert not protected or read == original.truth, f"{words}: a value changed silently"
    first = data.find(original.chunks[0].data) if original.chunks else -1
    described = first > 0 and data[:first] == (original.folder / original.file).read_bytes()[:first]
    if described:
        for topic in original.truth:
            kept = sum(chunk.count for chunk in original.chunks if chunk.topic == topic and chunk.data in data)
            assert len(read.get(topic, [])) >= kept, f"{words}: an untouched chunk of {topic} is not read"
    return "complete" if reader.complete else "partial"


def campaign(folder: Path, numbers: range) -> dict[str, int]:
    """Runs the cases; counts of each result. The first failing case raises AssertionError."""
    folder.mkdir(parents=True, exist_ok=True)
    bags = originals(folder)
    counts = {"complete": 0, "partial": 0, "refused": 0}
    for number in numbers:
        counts[check_case(folder, bags, number)] += 1
    return counts


def file_and_size(bag: Path) -> tuple[Path, int]:
    """The MCAP file of a bag and its length."""
    path = file_of(bag)
    return path, path.stat().st_size
