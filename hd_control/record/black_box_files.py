"""Black boxes as bags: one folder of a few, the oldest removed when a new one is whole, never a newer one.

    bags/black_box/torque_node/000017_HD-F18/      readable by hd info and hd compare as any other bag

The number in the name gives the order, so a clock that jumps cannot make an old box look new.
"""

from __future__ import annotations

import re
import shutil
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from hd_control.core.errors import BagError
from hd_control.record.bag_folder import write_error
from hd_control.record.cdr import encode_text
from hd_control.record.schema import joint_state_codec
from hd_control.record.writer import BagWriter

KEPT = 20
"""Black boxes that are kept, in a folder and in memory."""
_NAME = re.compile(r"^(\d{6})_HD-F\d{2}$")


@dataclass(frozen=True)
class Incident:
    """Rows around one stop: ticks (r,), and per topic its joints and arrays (r, n). `code` HD-F18, `text` why."""

    ticks: NDArray[np.int64]
    topics: Mapping[str, tuple[tuple[str, ...], Mapping[str, NDArray[np.float64]]]]
    stop_tick: int
    code: str
    text: str


@dataclass(frozen=True)
class Origin:
    """Where incidents come from: node, run id, period in ns, URDF, parameters as text of a params file."""

    node: str
    run_id: str
    period_ns: int
    urdf: str
    parameters: str


def black_boxes(folder: Path) -> list[Path]:
    """The boxes in a folder, oldest first; anything with another name is not one."""
    if not folder.is_dir():
        return []
    return sorted(path for path in folder.iterdir() if _NAME.match(path.name) and path.is_dir())


def write_incident(folder: Path, incident: Incident, origin: Origin) -> Path:
    """Writes one incident as a bag, then removes the oldest above `KEPT`. Raises BagError and leaves nothing half."""
    try:
        folder.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise write_error(folder, error) from None
    there = black_boxes(folder)
    number = 1 + max((int(path.name[:6]) for path in there), default=0)
    path = folder / f"{number:06d}_{incident.code}"
    try:
        _write(path, incident, origin)
    except (BagError, OSError) as error:
        shutil.rmtree(path, ignore_errors=True)
        raise error if isinstance(error, BagError) else write_error(path, error) from None
    for old in there[: max(0, len(there) + 1 - KEPT)]:
        shutil.rmtree(old, ignore_errors=True)
    return path


def _write(path: Path, incident: Incident, origin: Origin) -> None:
    notes = {
        "kind": "black_box",
        "node": origin.node,
        "run_id": origin.run_id,
        "period": f"{origin.period_ns * 1e-9:g}",
        "stop_tick": str(incident.stop_tick),
        "stop": incident.text,
    }
    writer = BagWriter(path, live=False, metadata=notes)
    try:
        writer.attach("robot.urdf", origin.urdf, "application/xml")
        name = origin.node.rpartition("/")[2]  # as a recording carries it, so that hd replay finds it
        writer.attach(f"{name}.yaml", origin.parameters, "application/yaml")
        stamps = incident.ticks * origin.period_ns
        first = int(stamps[0]) if len(stamps) else 0
        writer.write("robot_description", None, first, encode_text(origin.urdf))
        for topic, (joints, arrays) in incident.topics.items():
            codec = joint_state_codec(topic, joints)
            whole = {name: arrays.get(name, np.full((len(stamps), len(joints)), np.nan)) for name in codec.fields}
            writer.write_columns(topic, codec, stamps, frame_id=origin.run_id, **whole)
        writer.close(f"black box: {incident.code}")
    except BaseException:
        if not writer.closed:
            writer.abandon()
        raise
