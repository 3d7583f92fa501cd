"""The generated pages by file name."""

from __future__ import annotations

from collections.abc import Callable

from hd_control.reference.bench_page import bench_page
from hd_control.reference.command_page import command_page
from hd_control.reference.effect_page import effect_page
from hd_control.reference.glossary_page import glossary_page


def _nodes() -> str:
    """Needs ROS, which the other pages do not."""
    from hd_control.reference.node_page import node_page

    return node_page()


PAGES: dict[str, Callable[[], str]] = {
    "commands.md": command_page,
    "nodes.md": _nodes,
    "effects.md": effect_page,
    "glossary.md": glossary_page,
    "bench.md": bench_page,
}
