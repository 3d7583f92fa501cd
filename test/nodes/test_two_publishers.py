"""F24: a second source of commands is dropped, counted, and told with the names of all sources."""

from types import SimpleNamespace

from hd_control.nodes.fast_loop import LoopStatistics
from hd_sim.nodes.plant_topics import TopicSeam, plant_status


def status(foreign):
    """The plant's diagnostics with some foreign commands and two publishers in the graph."""
    graph = [
        SimpleNamespace(node_namespace="/", node_name="torque_node"),
        SimpleNamespace(node_namespace="/x", node_name="mine"),
    ]
    seam = SimpleNamespace(commands=SimpleNamespace(foreign=foreign, subscription=SimpleNamespace(topic_name="/c")))
    seam._node = SimpleNamespace(get_publishers_info_by_topic=lambda topic: graph)
    seam.publishers = lambda: TopicSeam.publishers(seam)
    turn = SimpleNamespace(statistics=LoopStatistics(1_000_000), tick=5, skipped=0, fault="")
    world = SimpleNamespace(report=lambda: ("", {}), seam=SimpleNamespace(late=0))
    return plant_status(turn, world, seam)


def test_f24_a_second_source_is_told_with_the_names_of_both():
    level, text, values = status(7)
    told = values["two_publishers"]
    assert told.startswith("HD-F24 two_publishers: publishers 2 > 1. Stop the second source of commands.")
    assert told.endswith("There are /torque_node, /x/mine; 7 dropped.") and "foreign" in text


def test_f24_nothing_is_told_of_one_source():
    assert "two_publishers" not in status(0)[2]
