"""Messages of another run id are dropped, counted, and reported: F24 with the names of two sources, F19 for one that
came back. F17: late and skipped ticks are reported with their number.
"""

from types import SimpleNamespace

from hd_control.nodes.fast_loop import LoopStatistics
from hd_control.nodes.shell import foreign_report
from hd_sim.nodes.plant_topics import PlantTopics, plant_status

TORQUE = SimpleNamespace(node_namespace="/", node_name="torque_node")
MINE = SimpleNamespace(node_namespace="/x", node_name="mine")


def node_with(*publishers):
    """A node whose graph has these publishers on every topic."""
    return SimpleNamespace(get_publishers_info_by_topic=lambda topic: list(publishers))


def status(foreign, late=0, skipped=0, unreadable=0):
    """The plant's diagnostics with some foreign commands and two publishers in the graph."""
    statistics = LoopStatistics()
    statistics.foreign = foreign
    plane = SimpleNamespace(statistics=statistics, unreadable=unreadable)
    seam = SimpleNamespace(_plane=plane, _node=node_with(MINE, TORQUE))
    seam.foreign_report = lambda: PlantTopics.foreign_report(seam)
    table = SimpleNamespace(stale=0)
    turn = SimpleNamespace(statistics=statistics, table=table, kind="", tick=5, skipped=skipped, fault="")
    world = SimpleNamespace(report=lambda: ("", {"stale": 0}), seam=SimpleNamespace(late=late))
    return plant_status(turn, world, seam)


def test_f24_a_second_source_is_reported_with_the_names_of_both():
    level, text, values = status(7)
    line = values["two_publishers"]
    assert line.startswith("HD-F24 two_publishers: publishers 2 > 1. Stop the second source of this topic.")
    assert line.endswith("On motor_torque_command there are /torque_node, /x/mine; 7 dropped.") and "foreign" in text
    assert "node_back" not in values


def test_f24_nothing_is_reported_of_one_source():
    assert not {"two_publishers", "node_back", "overrun"} & set(status(0)[2])


def test_f24_a_message_that_cannot_be_read_shows_no_second_source():
    assert "two_publishers" not in status(7, unreadable=7)[2]


def test_f19_one_source_with_another_run_id_has_come_back():
    found = foreign_report(node_with(TORQUE), {"/a": 250, "/b": 0})
    assert set(found) == {"node_back"}
    assert found["node_back"] == (
        "HD-F19 node_back: messages of another run id 250 > 0. Check why the sending node restarted. "
        "On /a there is /torque_node; 250 dropped."
    )


def test_f19_f24_every_topic_has_its_own_line():
    ends = {"/a": [TORQUE], "/b": [TORQUE, MINE], "/c": []}
    node = SimpleNamespace(get_publishers_info_by_topic=ends.__getitem__)
    found = foreign_report(node, {"/a": 1, "/b": 2, "/c": 3})
    assert "On /a there is" in found["node_back"] and "On /c there is none; 3 dropped." in found["node_back"]
    assert "On /b there are" in found["two_publishers"] and "/a" not in found["two_publishers"]


def test_f17_late_and_skipped_ticks_are_reported_together():
    level, text, values = status(0, late=8, skipped=4)
    assert values["overrun"] == "HD-F17 overrun: late and skipped ticks 12 > 0. Lower the load of this computer."
    assert "late" in text
