"""Reads a recording for the analysis: every joint's signals on one even time base, and what is wrong with them.

    recording = read_recording("bags/run1")
    recording.joints["joint_3"].gauge_torque        # (n,) N m, NaN inside gaps
    recording.problems, recording.notes             # what could not be read; what was repaired

Nothing but the bag (and the mapping) is opened; other files beside it are not looked at.
"""

from __future__ import annotations

import hashlib
from collections.abc import Sequence
from pathlib import Path

from hd_control.analysis.collector import Collector
from hd_control.analysis.mapping import load_mapping
from hd_control.analysis.signals import JointSignals, Recording
from hd_control.analysis.sources import STANDARD, SignalSource, SourceMap
from hd_control.core.errors import BagError
from hd_control.record.reader import BagReader

DESCRIPTION, ATTACHED_DESCRIPTION = "robot_description", "robot.urdf"


def read_recording(
    path: str | Path,
    mapping: SourceMap | str | Path | None = None,
    joints: Sequence[str] | None = None,
    start_s: float = 0.0,
    seconds: float | None = None,
) -> Recording:
    """The joints of a bag (all, or those named) within [start_s, start_s + seconds). `mapping`: file or shipped name.

    A recording of more than 20 min at 1 kHz is decimated, with a note. Raises BagError if the bag cannot be read, has
    no position together with a torque, or lacks a joint that was asked for.
    """
    source_map = STANDARD if mapping is None else mapping if isinstance(mapping, SourceMap) else load_mapping(mapping)
    with BagReader(path) as bag:
        collector = Collector(bag, source_map, joints, start_s, seconds)
        collector.collect()
        found = {name: collector.joint(name) for name in collector.joint_names()}
        _check(bag, found, joints, source_map)
        problems = [str(problem) for problem in bag.problems if problem.loses_data]
        base = collector.base
        return Recording(
            path=str(path),
            sha256=bag_sha256(path),
            joints=found,
            robot=robot_text(bag),
            notes=tuple(dict.fromkeys(collector.notes)),
            problems=tuple(dict.fromkeys([*problems, *collector.problems])),
            start_ns=0 if base is None else base.start_ns,
        )


def bag_sha256(path: str | Path) -> str:
    """SHA-256 of the storage files of a bag, in the order of their names; of the file itself if it is one."""
    path = Path(path)
    files = [path] if path.is_file() else sorted([*path.glob("*.mcap"), *path.glob("*.db3")])
    digest = hashlib.sha256()
    for file in files:
        with file.open("rb") as stream:
            while block := stream.read(1 << 20):
                digest.update(block)
    return digest.hexdigest()


def robot_text(bag: BagReader) -> str | None:
    """The robot description that the bag carries: the last message, else the attachment; None if there is none."""
    if bag.has(DESCRIPTION):
        texts = [str(message.data) for _, message in bag.messages(DESCRIPTION) if hasattr(message, "data")]
        if texts:
            return texts[-1]
    attached = bag.attachments.get(ATTACHED_DESCRIPTION)
    return None if attached is None else attached.decode("utf-8", "replace")


def _check(bag: BagReader, found: dict[str, JointSignals], joints: Sequence[str] | None, source_map: SourceMap) -> None:
    """Raises BagError if no balance can be made of what was found."""
    there = ", ".join(sorted(bag.topics)) or "no topic"
    hint = "; a foreign bag needs --map" if source_map is STANDARD else f"; the mapping is {source_map.name}"
    if joints is not None:
        unknown = [name for name in joints if name not in found]
        if unknown and found:
            raise BagError(f"{bag.path}: no signals of joint {unknown[0]}; there is {', '.join(found)}")
        if unknown:
            known = dict.fromkeys(name for s in source_map.signals.values() for name in _joints_of(bag, s, source_map))
            raise BagError(f"{bag.path}: no joint {unknown[0]}; there is {', '.join(known) or there}{hint}")
    if not found:
        raise BagError(f"{bag.path}: no signal of a joint; there is {there}{hint}")
    angle = any({"motor_shaft_position", "joint_position"} & set(joint.present) for joint in found.values())
    torque = any({"gauge_torque", "motor_torque"} & set(joint.present) for joint in found.values())
    if not angle or not torque:
        what = (
            "neither a position nor a torque" if not angle and not torque else "no torque" if angle else "no position"
        )
        raise BagError(f"{bag.path}: {what} of a joint is recorded; there is {there}{hint}")


def _joints_of(bag: BagReader, sources: Sequence[SignalSource], source_map: SourceMap) -> list[str]:
    names = [name for source in sources if bag.has(source.topic) for name in bag.columns(source.topic).names]
    return [ours for name in names if (ours := source_map.ours(name)) is not None]
