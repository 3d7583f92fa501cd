"""`hd recover`: a new, whole bag with everything readable, words for what is lost, and an untouched original."""

from __future__ import annotations

import hashlib
import json
import random
from pathlib import Path

import pytest
from small_bags import T0, TICK, file_of, payload_of, write_bag

from hd_control.cli.main import main
from hd_control.core.errors import BagError
from hd_control.record.mcap_read import McapSource
from hd_control.record.reader import BagReader
from hd_control.record.recover import recover
from hd_control.record.writer import BagWriter


def contents(bag: Path) -> dict[str, list[tuple[int, bytes]]]:
    reader = BagReader(bag)
    return {topic: list(reader.raw(topic)) for topic in reader.topics}


def state(folder: Path) -> dict[str, tuple[str, int]]:
    return {p.name: (hashlib.sha256(p.read_bytes()).hexdigest(), p.stat().st_mtime_ns) for p in folder.iterdir()}


@pytest.mark.parametrize("options", [{"compact": False}, {"live": False}, {}], ids=["plain", "chunks", "compact"])
def test_a_whole_bag_is_copied_exactly(tmp_path, options):
    bag = write_bag(tmp_path / "bag", 30, **options)
    report = recover(bag, tmp_path / "new")
    assert report.complete and all(row.lost == 0 for row in report.topics.values())
    assert contents(tmp_path / "new") == contents(bag)
    new, old = BagReader(tmp_path / "new"), BagReader(bag)
    assert (
        new.complete and new.attachments == old.attachments and new.metadata["hd_session"] == old.metadata["hd_session"]
    )
    assert new.accounting == old.accounting


def test_a_recording_that_was_killed_becomes_an_indexed_one(tmp_path):
    from mcap.reader import make_reader

    bag = BagWriter(tmp_path / "bag")
    for k in range(50):
        bag.write("encoder", None, T0 + k * TICK, payload_of("encoder", k))
    bag.flush()
    bag.abandon()
    before = state(tmp_path / "bag")
    report = recover(tmp_path / "bag", tmp_path / "new")
    assert state(tmp_path / "bag") == before
    assert not report.complete and report.topics["/encoder"].kept == 50 and report.topics["/encoder"].lost is None
    with file_of(tmp_path / "new").open("rb") as stream:
        summary = make_reader(stream).get_summary()
    assert summary.statistics.message_count == 50 and summary.chunk_indexes
    reader = BagReader(tmp_path / "new")
    assert reader.damage == () or not any(problem.loses_data for problem in reader.damage)
    assert not reader.complete and any("was not closed" in str(problem) for problem in reader.problems)


def test_damage_in_the_middle_of_a_plain_file_costs_only_the_damaged_messages(tmp_path):
    """The walk finds the next records behind a wrong length; without that everything behind would be lost."""
    bag = write_bag(tmp_path / "bag", 200, compact=False)
    whole, file = contents(bag), file_of(bag)
    data = bytearray(file.read_bytes())
    at = data.index(payload_of("encoder", 100)) - 31  # the record's opcode; its length follows
    data[at + 1 : at + 9] = b"\xff" * 8
    file.write_bytes(data)
    report = recover(bag, tmp_path / "new")
    assert {topic: row.lost for topic, row in report.topics.items() if row.lost} == {"/encoder": 1}
    kept = contents(tmp_path / "new")
    assert kept["/encoder"] == [row for k, row in enumerate(whole["/encoder"]) if k != 100]
    assert kept["/joint_states"] == whole["/joint_states"]
    assert any("record length above the cap" in text for text in report.problems)


def test_a_damaged_chunk_costs_only_that_chunk(tmp_path):
    bag = write_bag(tmp_path / "bag", 40, live=False)
    whole, file = contents(bag), file_of(bag)
    place = next(piece for piece, _ in McapSource(file)._pieces)
    data = bytearray(file.read_bytes())
    data[place.data_offset + 20] ^= 0xFF
    file.write_bytes(data)
    report = recover(bag, tmp_path / "new")
    lost = [topic for topic, row in report.topics.items() if row.lost]
    assert len(lost) == 1 and report.topics[lost[0]].kept == 0
    kept = contents(tmp_path / "new")
    assert {t: rows for t, rows in kept.items() if rows} == {t: rows for t, rows in whole.items() if t != lost[0]}


@pytest.mark.parametrize("seed", range(12))
def test_random_damage_never_invents_and_never_hides(tmp_path, seed):
    rng = random.Random(seed)
    bag = write_bag(tmp_path / "bag", 40, live=seed % 2 == 0, compact=seed % 4 == 0)
    whole, file = contents(bag), file_of(bag)
    data = bytearray(file.read_bytes())
    for _ in range(rng.randrange(1, 4)):
        at = rng.randrange(9, len(data) - 64)
        data[at : at + rng.randrange(1, 64)] = rng.randbytes(rng.randrange(0, 64))
    file.write_bytes(data)
    before = state(bag)
    try:
        report = recover(bag, tmp_path / "new")
    except BagError:
        assert not (tmp_path / "new").exists() and state(bag) == before
        return
    assert state(bag) == before and not report.complete
    kept = contents(tmp_path / "new")
    assert sum(map(len, kept.values())) == sum(row.kept for row in report.topics.values())
    if seed % 2 or seed % 4 == 0:  # in chunks, with checksums: no value can have changed
        assert all(is_part_in_order(rows, whole[topic]) for topic, rows in kept.items() if rows)


def is_part_in_order(part: list, whole: list) -> bool:
    """True if `part` is `whole` with some entries left out."""
    rest = iter(whole)
    return all(row in rest for row in part)


def test_the_original_and_other_files_are_never_overwritten(tmp_path, capsys):
    bag = write_bag(tmp_path / "bag", 5)
    (tmp_path / "link").symlink_to(bag)
    (tmp_path / "there").mkdir()
    before = state(bag)
    for target in (bag, bag / "inside", tmp_path, tmp_path / "link", tmp_path / "there"):
        for force in (False, True) if target != tmp_path / "there" else (False,):
            with pytest.raises(BagError):
                recover(bag, target, force)
    assert main(["recover", str(bag), "-o", str(bag)]) == 2
    assert main(["recover", str(bag), "-o", str(bag), "--force"]) == 2
    assert "never changed" in capsys.readouterr().err
    assert state(bag) == before and sorted(p.name for p in tmp_path.iterdir()) == ["bag", "link", "there"]


def test_the_command_says_what_is_lost(tmp_path, capsys):
    bag = write_bag(tmp_path / "bag", 20, compact=False)
    assert main(["recover", str(bag), "-o", str(tmp_path / "whole")]) == 0
    assert "nothing is missing" in capsys.readouterr().out
    file = file_of(bag)
    file.write_bytes(file.read_bytes()[:9000])
    assert main(["recover", str(bag), "-o", str(tmp_path / "new"), "--json", "-"]) == 3
    document = json.loads(capsys.readouterr().out)
    row = document["topics"]["/encoder"]
    assert document["schema"] == "hd.recover/1" and row["kept"] + row["lost"] == row["expected"] == 20 and row["lost"]
    assert main(["info", str(tmp_path / "new")]) == 3
    assert "lost before the recovery" in capsys.readouterr().out


def test_nothing_to_recover(tmp_path, capsys):
    (tmp_path / "empty.mcap").touch()
    assert main(["recover", str(tmp_path / "empty.mcap"), "-o", str(tmp_path / "new")]) == 2
    assert "nothing was recorded" in capsys.readouterr().err and not (tmp_path / "new").exists()
