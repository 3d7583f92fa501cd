"""Wrong inputs of reader and writer: one BagError that names the path and what to do, and nothing is changed."""

from __future__ import annotations

import os

import numpy as np
import pytest
from small_bags import NAMES, RUN, T0, file_of, payload_of, write_bag

from hd_control.core.errors import BagError
from hd_control.record.reader import BagReader
from hd_control.record.schema import joint_state_codec
from hd_control.record.writer import BagWriter


def test_paths_that_are_no_bags(tmp_path):
    (tmp_path / "empty_folder").mkdir()
    (tmp_path / "empty.mcap").touch()
    (tmp_path / "text.mcap").write_text("this is not a recording")
    (tmp_path / "text.db3").write_text("this is not a database")
    for name, said in {
        "nothing": "no such bag",
        "empty_folder": "no .mcap or .db3",
        "empty.mcap": "empty",
        "text.mcap": "does not begin like",
        "text.db3": "cannot be read",
    }.items():
        with pytest.raises(BagError, match=said) as caught:
            BagReader(tmp_path / name)
        assert str(tmp_path / name) in str(caught.value) and "\n" not in str(caught.value)


@pytest.mark.parametrize("text", ["", "}{", "a: 1", "rosbag2_bagfile_information: 7", "a: &x 1\nb: *x", "\x00"])
def test_unusable_metadata_yaml_is_said_and_the_data_are_read(tmp_path, text):
    bag = write_bag(tmp_path / "bag", 3)
    (bag / "metadata.yaml").write_text(text)
    reader = BagReader(bag)
    assert reader.counts["/encoder"] == 3 and not reader.complete
    assert any("metadata.yaml" in str(problem) for problem in reader.problems)


def test_metadata_yaml_never_leads_out_of_the_folder(tmp_path):
    bag, other = write_bag(tmp_path / "bag", 3), write_bag(tmp_path / "other", 5)
    metadata = bag / "metadata.yaml"
    metadata.write_text(metadata.read_text().replace(file_of(bag).name, f"../other/{file_of(other).name}"))
    reader = BagReader(bag)
    assert reader.counts["/encoder"] == 3 and not reader.complete


def test_a_missing_file_of_two_is_said(tmp_path):
    bag = write_bag(tmp_path / "bag", 3)
    metadata = bag / "metadata.yaml"
    metadata.write_text(
        metadata.read_text().replace(f"  - {file_of(bag).name}\n", f"  - {file_of(bag).name}\n  - second.mcap\n", 1)
    )
    reader = BagReader(bag)
    assert reader.counts["/encoder"] == 3
    assert any("second.mcap" in str(problem) and "missing" in str(problem) for problem in reader.problems)


def test_an_existing_bag_is_never_overwritten(tmp_path):
    bag = write_bag(tmp_path / "bag", 3)
    before = file_of(bag).read_bytes()
    with pytest.raises(BagError, match="never overwritten"):
        BagWriter(bag)
    assert file_of(bag).read_bytes() == before
    assert BagReader(write_bag(bag, 5, force=True)).counts["/encoder"] == 5


def test_force_replaces_bags_only(tmp_path):
    (tmp_path / "home").mkdir()
    (tmp_path / "home" / "thesis.txt").write_text("years of work")
    (tmp_path / "file").write_text("more work")
    for name in ("home", "file"):
        with pytest.raises(BagError, match="not a bag"):
            BagWriter(tmp_path / name, force=True)
    assert (tmp_path / "home" / "thesis.txt").read_text() == "years of work"
    assert (tmp_path / "file").exists()


def test_a_missing_parent_is_said(tmp_path):
    with pytest.raises(BagError, match="parent folder does not exist"):
        BagWriter(tmp_path / "no" / "bag")


@pytest.mark.skipif(os.geteuid() == 0, reason="the super-user may write anywhere")
def test_a_folder_without_permission_is_said(tmp_path):
    (tmp_path / "locked").mkdir(mode=0o500)
    with pytest.raises(BagError, match="permission"):
        BagWriter(tmp_path / "locked" / "bag")


def test_the_writer_refuses_what_it_cannot_describe(tmp_path):
    with BagWriter(tmp_path / "bag", live=False) as bag:
        with pytest.raises(BagError, match="add_topic with its type"):
            bag.write("wheel", 0, T0, b"")
        with pytest.raises(BagError, match="not a message type"):
            bag.add_topic("wheel", "my_msgs/msg/Wheel")
        with pytest.raises(BagError, match="log time"):
            bag.write("encoder", 0, -1, payload_of("encoder", 0))
        codec = joint_state_codec("encoder", NAMES)
        with pytest.raises(BagError, match="log times"):
            bag.write_columns("encoder", codec, [1, 2], [1], RUN, position=np.zeros((2, 3)))
        with pytest.raises(BagError, match="the codec makes"):
            bag.write_columns("robot_description", codec, [1], None, RUN, position=np.zeros((1, 3)))
        with pytest.raises(BagError, match="cannot be attached"):
            bag.attach_file(tmp_path / "missing.yaml")
    with pytest.raises(BagError, match="closed"):
        bag.write("encoder", 0, T0, b"")
    assert BagReader(tmp_path / "bag").counts.get("/encoder", 0) == 0
