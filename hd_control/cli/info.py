"""`hd info BAG`: what a recording holds and what can be asked of it."""

from __future__ import annotations

import argparse
from collections.abc import Iterator
from typing import Any

NAME = "info"
HELP = "topics, rates, gaps, drops, joints, channels and coverage of a recording"
EXAMPLE = """hd info bags/run1 --json info.json
  hd info bags/run1 --tracking"""
PARTLY_READ = 3


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """The options of the command."""
    parser.add_argument("bag", metavar="BAG", help="bag folder, .mcap or .db3 file")
    parser.add_argument("--tracking", action="store_true", help="also how well the joints followed their reference")


def run(arguments: argparse.Namespace) -> int:
    """Prints the description; 0 if the recording is whole, 3 if something of it is missing."""
    from hd_control.cli.options import say, write_json
    from hd_control.record.summary import open_and_summarize

    document = open_and_summarize(arguments.bag)
    if arguments.tracking:
        document["tracking"] = _tracking(arguments.bag)
    for line in lines(document):
        say(arguments, line)
    write_json(arguments, document)
    return 0 if document["complete"] else PARTLY_READ


def lines(document: dict[str, Any]) -> Iterator[str]:
    """The description as text for people."""
    session = document["session"]
    yield f"{document['bag']}: {document['messages']} messages, {document['duration']:.3f} s"
    made = " ".join(session.get(key, "") for key in ("software", "software_version", "git_commit")).split()
    yield f"recorded {session.get('start_time_utc') or 'at an unknown time'} by {' '.join(made) or 'unknown software'}"
    if session.get("kind") == "black_box":
        first = str(session.get("stop", "")).splitlines() or ["an unknown stop"]
        yield f"black box of {session.get('node')}, stopped in tick {session.get('stop_tick')}: {first[0]}"
    for problem in document["problems"]:
        yield f"  ! {problem}"
    yield ""
    yield from _topic_lines(document["topics"])
    for joint, row in document["joints"].items():
        yield ""
        yield from _joint_lines(joint, row)
    if "tracking" in document:
        yield from ("", "error of the joint position against its reference:")
        for joint, row in document["tracking"].items():
            yield f"  {joint}: rms {row['rms'] * 1e3:.4f} mrad, largest {row['largest'] * 1e3:.4f} mrad"
    if document["attachments"]:
        yield ""
        yield "attached: " + ", ".join(f"{name} ({size} bytes)" for name, size in document["attachments"].items())


def _tracking(bag: str) -> dict[str, dict[str, float]]:
    """Errors in rad by joint. Raises BagError if reference or measurement was not recorded."""
    from hd_control.lab.signals.tracking import tracking_of
    from hd_control.record.reader import BagReader

    with BagReader(bag) as reader:
        found = tracking_of(reader)
    rms, largest = found.rms(), found.maximum()
    return {joint: {"rms": rms[joint], "largest": largest[joint]} for joint in found.joint_names}


def _topic_lines(topics: dict[str, Any]) -> Iterator[str]:
    width = max((len(name) for name in topics), default=0)
    for name, row in topics.items():
        parts = [f"{row['messages']:>9} messages"]
        if row["rate"]:
            parts.append(f"{row['rate']:7.1f} Hz")
        if row["missing"]:
            never = f", {row['never_published']} never published" if row["never_published"] else ""
            parts.append(f"{row['missing']} missing in {row['gaps']} gaps{never}")
        drops = {where: count for where, count in (row["drops"] or {}).items() if count}
        if drops:
            parts.append("dropped " + ", ".join(f"{count} by {where}" for where, count in drops.items()))
        yield f"{name:<{width}}  {'  '.join(parts)}  {row['type']}"


def _joint_lines(joint: str, row: dict[str, Any]) -> Iterator[str]:
    yield f"{joint}: {', '.join(row['signals']) or 'no signal'}"
    channels = [f"{name} ({basis})" for name, basis in row["channels"].items()]
    yield f"  channels: {', '.join(channels) or 'none; no two signals that a balance needs'}"
    parts = []
    for name in ("angle", "speed", "load", "temperature"):
        if name in row["coverage"]:
            entry = row["coverage"][name]
            parts.append(f"{name} {entry['low']:.4g} … {entry['high']:.4g} {entry['unit']}")
    if "speed" in row["coverage"]:
        parts.append(f"{row['coverage']['speed']['reversals']} reversals")
    if "wave_generator_turns" in row["coverage"]:
        parts.append(f"{row['coverage']['wave_generator_turns']:.1f} wave-generator turns")
    if parts:
        yield f"  covers: {', '.join(parts)}"
