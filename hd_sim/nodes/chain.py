"""`chain`: the control chain in one process and one thread; parameter `with_plant` puts the plant into the same thread.

Exit codes: 0 stopped on request, 1 internal fault, 2 bad configuration.
"""

from __future__ import annotations

from rclpy.node import Node

from hd_control.nodes.chain import ChainNode
from hd_control.nodes.process import run_node
from hd_control.stages.node_parameters import shipped_values


def make_chain() -> ChainNode:
    """The chain, with the plant if its shipped or given parameters ask for it."""
    probe = Node("chain", start_parameter_services=False, enable_rosout=False)
    given = getattr(probe, "_parameter_overrides", {})
    wanted = given["with_plant"].value if "with_plant" in given else shipped_values("chain")["with_plant"]
    probe.destroy_node()
    if not wanted:
        return ChainNode()
    from hd_sim.nodes.chain_with_plant import ChainWithPlant  # a chain on a real robot needs no world

    return ChainWithPlant()


def main() -> None:
    """Entry point; ends the process with the exit code."""
    run_node(make_chain)


if __name__ == "__main__":
    main()
