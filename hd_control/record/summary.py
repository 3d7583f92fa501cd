"""What a recording holds: topics, rates, gaps, drops, joints, possible residual channels, range of operation."""

from __future__ import annotations

from collections.abc import Collection
from typing import Any

import numpy as np

from hd_control.core.errors import BagError
from hd_control.record.cdr import JOINT_STATE
from hd_control.record.columns import Columns, has_fixed_layout
from hd_control.record.fixed_cdr import FloatArray
from hd_control.record.reader import BagReader
from hd_control.record.schema import topic_info
from hd_control.record.writer import SESSION

SCHEMA = "hd.info/1"
SPEED_WINDOW_NS = 20_000_000
SHOWN_GAPS = 20
STANDSTILL = 0.01
"""Below this share of the largest speed a joint counts as standing still."""

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
    """The document of `hd info --json`."""
    columns: dict[str, Columns] = {}
    topics = {name: _topic(bag, name, columns) for name in sorted(bag.topics)}
    joints = _joints(columns)
    times = [t for c in columns.values() if len(c) for t in (int(c.stamps_ns.min()), int(c.stamps_ns.max()))]
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


def _topic(bag: BagReader, name: str, kept: dict[str, Columns]) -> dict[str, Any]:
    """Counts, rate and holes of one topic; its columns go to `kept`, under the plain name if the schema knows it."""
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
    columns = bag.columns(name)
    kept.setdefault(name if known is None else known.name, columns)
    steps = np.diff(columns.stamps_ns)
    moving = steps[steps > 0]
    row["rate"] = 1e9 / float(np.median(moving)) if len(moving) else None
    period = _period_ns(known.period_ns if known else 0, int(np.median(moving)) if len(moving) else 0)
    if period and bag.topics[name] == JOINT_STATE:
        gaps = bag.gaps(name, period)
        row["gaps"], row["missing"] = len(gaps), sum(gap.missing for gap in gaps)
        row["first_gaps"] = [[gap.from_ns, gap.to_ns, gap.missing] for gap in gaps[:SHOWN_GAPS]]
    row["out_of_order"], row["duplicates"] = int((steps < 0).sum()), int((steps == 0).sum())
    if known is not None and known.name == "motor_temperature":
        row["duplicates"] = 0  # joints share the stamp
    return row


def _period_ns(nominal: int, median: int) -> int:
    """The nominal period unless the topic is a slower robot's; 0 if neither is known."""
    return median if median > 1.5 * nominal else nominal


def _series(columns: dict[str, Columns], joint: str, signal: str) -> tuple[str, Columns, FloatArray] | None:
    """(topic, columns, values of the joint) of the first topic that has the signal with any finite value."""
    for topic, field in SIGNALS[signal]:
        found = columns.get(topic)
        if found is not None and joint in found.names and field in found.values:
            values = found.values[field][:, found.names.index(joint)]
            if np.isfinite(values).any():
                return topic, found, values
    return None


def _joints(columns: dict[str, Columns]) -> dict[str, Any]:
    names = dict.fromkeys(
        n for topic, c in columns.items() if topic_info(topic) and "introspection" not in topic for n in c.names
    )
    result = {}
    for joint in names:
        series = {signal: found for signal in SIGNALS if (found := _series(columns, joint, signal)) is not None}
        result[joint] = {
            "signals": {signal: topic for signal, (topic, _, _) in series.items()},
            "channels": possible_channels(series.keys()),
            "coverage": _coverage(series),
        }
    return result


def _coverage(series: dict[str, tuple[str, Columns, FloatArray]]) -> dict[str, Any]:
    """Ranges of speed, load, angle and temperature of one joint; only what its signals tell."""
    found: dict[str, Any] = {}
    for signal, name, unit in (
        ("joint_position", "angle", "rad"),
        ("joint_torque", "load", "N·m"),
        ("motor_temperature", "temperature", "°C"),
    ):
        if signal in series:
            values = series[signal][2]
            found[name] = {"low": float(np.nanmin(values)), "high": float(np.nanmax(values)), "unit": unit}
    if "motor_shaft_position" in series:
        angle = series["motor_shaft_position"][2]
        found["wave_generator_turns"] = float(np.nanmax(angle) - np.nanmin(angle)) / (2 * np.pi)
    speed = _speed(series)
    if speed is not None:
        found["speed"] = speed
    return found


def _speed(series: dict[str, tuple[str, Columns, FloatArray]]) -> dict[str, Any] | None:
    """Speed range, decades between the fast and the slow end while moving, and reversals."""
    if "joint_velocity" in series:
        speed = series["joint_velocity"][2]
    elif "joint_position" in series:
        _, columns, angle = series["joint_position"]
        speed = _slope(columns.stamps_ns, angle)
    else:
        return None
    speed = speed[np.isfinite(speed)]
    if len(speed) == 0:
        return None
    moving = speed[np.abs(speed) > STANDSTILL * np.abs(speed).max()]
    slow, fast = np.percentile(np.abs(moving), [1, 99]) if len(moving) else (1.0, 1.0)
    decades = float(np.log10(fast / slow))
    return {
        "low": float(speed.min()),
        "high": float(speed.max()),
        "unit": "rad/s",
        "decades": decades,
        "reversals": int((np.diff(np.sign(moving)) != 0).sum()),
    }


def _slope(stamps_ns: Any, angle: FloatArray) -> FloatArray:
    """Difference quotient over `SPEED_WINDOW_NS`, long enough that quantisation does not dominate."""
    steps = np.diff(stamps_ns)
    step = float(np.median(steps[steps > 0])) if (steps > 0).any() else 0.0
    width = max(1, round(SPEED_WINDOW_NS / step)) if step else 1
    if len(angle) <= width:
        return np.zeros(0)
    time = (stamps_ns[width:] - stamps_ns[:-width]) * 1e-9
    difference: FloatArray = np.full(len(time), np.nan)
    np.divide(angle[width:] - angle[:-width], time, out=difference, where=time > 0)
    return difference


def open_and_summarize(path: str) -> dict[str, Any]:
    """Opens a recording and describes it. Raises BagError if there is nothing to describe."""
    bag = BagReader(path)
    document = summarize(bag)
    if not bag.topics and bag.complete:
        raise BagError(f"{path}: the recording is whole but has no topics")
    return document
