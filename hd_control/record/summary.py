"""What a recording holds: topics, rates, gaps, drops, joints, possible residual channels, range of operation."""

from __future__ import annotations

from collections.abc import Collection
from typing import Any

import numpy as np

from hd_control.core.errors import BagError
from hd_control.record.cdr import JOINT_STATE
from hd_control.record.columns import has_fixed_layout
from hd_control.record.gaps import find_gaps, streams_of
from hd_control.record.reader import BagReader
from hd_control.record.schema import topic_info
from hd_control.record.speed_scan import SpeedScan
from hd_control.record.topic_scan import Range, TopicScan, scan_topic, speeds_from_angles
from hd_control.record.writer import SESSION

SCHEMA = "hd.info/1"
Sources = dict[str, tuple[TopicScan, Range]]
"""Where each signal of a joint comes from, and its range."""
SHOWN_GAPS = 20

# signal: where it may come from, the first that is there counts
SIGNALS: dict[str, tuple[tuple[str, str], ...]] = {
    "motor_shaft_position": (("encoder", "position"),),
    "joint_position": (("resolver", "position"), ("joint_states", "position")),
    "joint_velocity": (("joint_states", "velocity"),),
    "joint_torque": (("gauge_bridge", "effort"), ("joint_states", "effort")),
    "motor_torque": (("motor_torque_applied", "effort"), ("motor_torque_command", "effort")),
    "motor_temperature": (("motor_temperature", "temperature"),),
    "desired_position": (("joint_reference", "position"),),
}


def possible_channels(signals: Collection[str]) -> dict[str, str]:
    """The residual channels that the signals of one joint allow, each with what it rests on."""
    rotor, joint, torque, motor = (
        name in signals for name in ("motor_shaft_position", "joint_position", "joint_torque", "motor_torque")
    )
    found = {}
    if rotor and torque and motor:
        found["motor_torque"] = "measured"
    elif motor and (joint or rotor):
        found["motor_torque"] = "load torque from the link model"
    if rotor and joint and (torque or motor):
        found["transmission"] = "measured" if torque else "torque from the link model"
    if joint and torque:
        found["link_torque"] = "measured"
    elif rotor and torque:
        found["link_torque"] = "rotor angle for joint angle, below a third of the joint resonance"
    return found


def summarize(bag: BagReader) -> dict[str, Any]:
    """The document of `hd info --json`. The recording is gone through block by block."""
    scans: dict[str, TopicScan] = {}
    topics = {name: _topic(bag, name, scans) for name in sorted(bag.topics)}
    joints = _joints(bag, scans)
    times = [time for scan in scans.values() if scan.count for time in (scan.first_ns, scan.last_ns)]
    return {
        "schema": SCHEMA,
        "bag": str(bag.path),
        "complete": bag.complete,
        "problems": [str(problem) for problem in bag.problems],
        "messages": sum(bag.counts.values()),
        "duration": (max(times) - min(times)) * 1e-9 if times else 0.0,
        "topics": topics,
        "joints": joints,
        "attachments": {name: len(data) for name, data in bag.attachments.items()},
        "session": bag.metadata.get(SESSION, {}),
    }


def _topic(bag: BagReader, name: str, kept: dict[str, TopicScan]) -> dict[str, Any]:
    """Counts, rate and holes of one topic; its scan goes to `kept`, under the plain name if the schema knows it."""
    known = topic_info(name)
    row: dict[str, Any] = {
        "type": bag.topics[name],
        "messages": bag.counts[name],
        "rate": None,
        "gaps": None,
        "missing": None,
        "drops": bag.accounting.get(name, {}).get("drops"),
    }
    if not bag.counts[name] or not has_fixed_layout(bag.topics[name]):
        return row
    plain = name if known is None else known.name
    scan, stamps, streams = scan_topic(bag, name, (plain, "velocity") in SIGNALS["joint_velocity"])
    kept.setdefault(plain, scan)
    row["rate"] = 1e9 / scan.step_ns if scan.step_ns else None
    period = _period_ns(known.period_ns if known else 0, int(scan.step_ns))
    if period and bag.topics[name] == JOINT_STATE:
        gaps = find_gaps(stamps, streams_of(streams), period)
        row["gaps"], row["missing"] = len(gaps), sum(gap.missing for gap in gaps)
        row["first_gaps"] = [[gap.from_ns, gap.to_ns, gap.missing] for gap in gaps[:SHOWN_GAPS]]
    steps = np.diff(stamps)
    row["out_of_order"], row["duplicates"] = int((steps < 0).sum()), int((steps == 0).sum())
    if known is not None and known.name == "motor_temperature":
        row["duplicates"] = 0  # joints share the stamp
    return row


def _period_ns(nominal: int, median: int) -> int:
    """The nominal period unless the topic is a slower robot's; 0 if neither is known."""
    return median if median > 1.5 * nominal else nominal


def _source(scans: dict[str, TopicScan], joint: str, signal: str) -> tuple[TopicScan, Range] | None:
    """The first topic that has the signal of the joint with any finite value, and its range."""
    for topic, field in SIGNALS[signal]:
        found = scans.get(topic)
        if found is not None and found.has(joint, field):
            return found, found.ranges[field, joint]
    return None


def _joints(bag: BagReader, scans: dict[str, TopicScan]) -> dict[str, Any]:
    ours = [scan for topic, scan in scans.items() if topic_info(topic) and "introspection" not in topic]
    sources = {
        joint: {signal: found for signal in SIGNALS if (found := _source(scans, joint, signal)) is not None}
        for joint in dict.fromkeys(name for scan in ours for name in scan.names)
    }
    speeds = _speeds(bag, sources)
    return {
        joint: {
            "signals": {signal: _plain_name(scan.topic) for signal, (scan, _) in series.items()},
            "channels": possible_channels(series.keys()),
            "coverage": _coverage(series, speeds.get(joint)),
        }
        for joint, series in sources.items()
    }


def _plain_name(topic: str) -> str:
    known = topic_info(topic)
    return topic if known is None else known.name


def _speeds(bag: BagReader, sources: dict[str, Sources]) -> dict[str, SpeedScan]:
    """Recorded speeds; for joints without them those of their angle, each topic read once more."""
    found: dict[str, SpeedScan] = {}
    angles: dict[str, tuple[TopicScan, list[str]]] = {}
    for joint, series in sources.items():
        if "joint_velocity" in series:
            found[joint] = series["joint_velocity"][0].speeds[joint]
        elif "joint_position" in series:
            scan = series["joint_position"][0]
            angles.setdefault(scan.topic, (scan, []))[1].append(joint)
    for scan, joints in angles.values():
        found |= speeds_from_angles(bag, scan, joints)
    return found


def _coverage(series: Sources, speed: SpeedScan | None) -> dict[str, Any]:
    """Ranges of speed, load, angle and temperature of one joint; only what its signals tell."""
    found: dict[str, Any] = {}
    for signal, name, unit in (
        ("joint_position", "angle", "rad"),
        ("joint_torque", "load", "N·m"),
        ("motor_temperature", "temperature", "°C"),
    ):
        if signal in series:
            _, values = series[signal]
            found[name] = {"low": values.low, "high": values.high, "unit": unit}
    if "motor_shaft_position" in series:
        _, angle = series["motor_shaft_position"]
        found["wave_generator_turns"] = (angle.high - angle.low) / (2 * np.pi)
    moved = speed.result() if speed is not None else None
    if moved is not None:
        found["speed"] = moved
    return found


def open_and_summarize(path: str) -> dict[str, Any]:
    """Opens a recording and describes it. Raises BagError if there is nothing to describe."""
    bag = BagReader(path)
    document = summarize(bag)
    if not bag.topics and bag.complete:
        raise BagError(f"{path}: the recording is whole but has no topics")
    return document
