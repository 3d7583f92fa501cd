"""Which node a params file belongs to: shared by the commands that take `--params`."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from collections.abc import Mapping
    from pathlib import Path

    from hd_control.core.parameters import ParameterSet


def node_of(source: Path, known: Mapping[str, ParameterSet]) -> tuple[str, dict[str, Any]]:
    """The node whose parameters a file holds, with them. Raises ConfigError if it is none of `known`, or several."""
    from hd_control.core.errors import ConfigError
    from hd_control.core.strict_yaml import load_params_file

    hits = {}
    for node, about in known.items():
        try:
            values = load_params_file(source, node)
        except ConfigError:
            continue
        others = {name for other, them in known.items() if other != node for name in them.names}
        if any(name in about.names and name not in others for name in values):
            hits[node] = values
    named = [node for node in hits if node in source.stem]
    if len(hits) > 1 and len(named) == 1:
        return named[0], hits[named[0]]
    if len(hits) != 1:
        load_params_file(source, next(iter(hits or known)))
        what = "of more than one node" if hits else "of no node that counts here"
        raise ConfigError(f"{source}: parameters {what}; expected those of {' or '.join(known)}")
    return next(iter(hits.items()))
