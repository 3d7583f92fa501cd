"""The directory of a bag: made, replaced only on request, with its metadata.yaml and the software that made it.

Errors say what to do.
"""

from __future__ import annotations

import errno
import shutil
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from datetime import datetime, timezone
from pathlib import Path
from typing import Any

from hd_control.core.errors import BagError, ConfigError
from hd_control.core.faults import FaultCode
from hd_control.core.files import refusal, replaced, whole_folder

FLOOR_BYTES, FLOOR_SHARE = 1 << 30, 0.05


def write_error(path: Path, error: OSError) -> BagError:
    """The BagError of a recording that cannot go on: path, reason, remedy, and the fault code if there is no space."""
    what = f"{refusal(error)}; what was written stays"
    full = error.errno in (errno.ENOSPC, errno.EDQUOT)
    return BagError(FaultCode.DISK_FULL.line(what, str(path)) if full else f"{path}: {what}")


def attachment_bytes(path: Path) -> bytes:
    """A file to carry in a bag. Raises BagError if it cannot be read."""
    try:
        return path.read_bytes()
    except OSError as error:
        raise BagError(f"{path}: cannot be attached ({error.strerror}); give a readable file") from None


def space_left(path: Path) -> str:
    """`ok`, `low` (below twice the floor: warn) or `floor` (close the bag now) for the disk that holds `path`.

    The floor is `FLOOR_BYTES` or `FLOOR_SHARE` of the disk, whichever is smaller. Raises BagError without an answer.
    """
    try:
        usage = shutil.disk_usage(path)
    except OSError as error:
        raise write_error(path, error) from None
    floor = min(FLOOR_BYTES, FLOOR_SHARE * usage.total)
    return "floor" if usage.free < floor else "low" if usage.free < 2 * floor else "ok"


def make_folder(path: Path, force: bool) -> None:
    """Creates the bag's directory. Raises BagError if anything is there, unless `force` and it is a bag."""
    if path.exists() or path.is_symlink():
        if not force:
            raise BagError(f"{path}: exists already and is never overwritten; choose another name or remove it")
        _remove_bag(path)
    try:
        path.mkdir()
    except OSError as error:
        raise write_error(path, error) from None


def _remove_bag(path: Path) -> None:
    entries = list(path.iterdir()) if path.is_dir() and not path.is_symlink() else [path]
    foreign = [e.name for e in entries if e.is_dir() or not ("metadata.yaml" in e.name or ".mcap" in e.name)]
    if foreign:
        raise BagError(f"{path}: is not a bag ({foreign[0]}), so it is not replaced; choose another name")
    try:
        for entry in entries:
            entry.unlink()
        if path.is_dir():
            path.rmdir()
    except OSError as error:
        raise write_error(path, error) from None


# ---- metadata.yaml of a rosbag2 directory, version 9: written and read -----------------------------


VERSION = 9
FILE_NAME = "metadata.yaml"
_FOREVER = {"sec": 9223372036, "nsec": 854775807}


@dataclass(frozen=True)
class TopicEntry:
    """One topic of metadata.yaml."""

    name: str
    type_name: str
    type_hash: str
    message_count: int
    latched: bool = False


def qos_profile(latched: bool) -> dict[str, Any]:
    """The QoS a recorded topic was offered with, in rosbag2's words."""
    return {
        "history": "keep_last",
        "depth": 1,
        "reliability": "reliable",
        "durability": "transient_local" if latched else "volatile",
        "deadline": dict(_FOREVER),
        "lifespan": dict(_FOREVER),
        "liveliness": "automatic",
        "liveliness_lease_duration": dict(_FOREVER),
        "avoid_ros_namespace_conventions": False,
    }


def dump(data: Any) -> str:
    """YAML without anchors, keys in the given order."""
    import yaml

    class Plain(yaml.SafeDumper):  # type: ignore[misc]
        def ignore_aliases(self, data: Any) -> bool:
            return True

    return str(yaml.dump(data, Dumper=Plain, sort_keys=False, allow_unicode=True))


def document(
    file_name: str, topics: Sequence[TopicEntry], first_ns: int, last_ns: int, custom_data: Mapping[str, str]
) -> dict[str, Any]:
    """The content of `rosbag2_bagfile_information` for a bag of one MCAP file."""
    count = sum(topic.message_count for topic in topics)
    start, duration = {"nanoseconds_since_epoch": first_ns}, {"nanoseconds": last_ns - first_ns}
    return {
        "version": VERSION,
        "storage_identifier": "mcap",
        "duration": duration,
        "starting_time": start,
        "message_count": count,
        "topics_with_message_count": [
            {
                "topic_metadata": {
                    "name": topic.name,
                    "type": topic.type_name,
                    "serialization_format": "cdr",
                    "offered_qos_profiles": [qos_profile(topic.latched)],
                    "type_description_hash": topic.type_hash,
                },
                "message_count": topic.message_count,
            }
            for topic in topics
        ],
        "compression_format": "",
        "compression_mode": "",
        "relative_file_paths": [file_name],
        "files": [{"path": file_name, "starting_time": start, "duration": duration, "message_count": count}],
        "custom_data": dict(custom_data),
        "ros_distro": "jazzy",
    }


def save(folder: Path, info: Mapping[str, Any]) -> None:
    """Writes metadata.yaml, whole or not at all. OSError passes through."""
    with replaced(folder / FILE_NAME) as place:
        place.write_text(dump({"rosbag2_bagfile_information": dict(info)}), "utf-8")


@dataclass(frozen=True)
class BagIndex:
    """What metadata.yaml says about a bag: its files, counts by topic, custom texts."""

    files: tuple[str, ...]
    counts: Mapping[str, int]
    custom_data: Mapping[str, str]


def load(path: Path) -> BagIndex:
    """Reads metadata.yaml. Raises ConfigError for anything that is not one; trusts no path in it (names only)."""
    from hd_control.core.strict_yaml import load_yaml

    data = load_yaml(path)
    try:
        info = data["rosbag2_bagfile_information"]
        files = tuple(Path(str(name)).name for name in info["relative_file_paths"])
        counts: dict[str, int] = {}
        for entry in info["topics_with_message_count"]:
            name = str(entry["topic_metadata"]["name"])
            counts[name] = counts.get(name, 0) + int(entry["message_count"])
        custom = {str(key): str(value) for key, value in (info.get("custom_data") or {}).items()}
        return BagIndex(files, counts, custom)
    except (KeyError, TypeError, ValueError, AttributeError) as error:
        raise ConfigError(f"{path}: not a rosbag2 metadata file ({type(error).__name__}: {error})") from None


# ---- Which software made a recording: version and commit, read without running anything ------------


def software_version() -> str:
    """The installed version of hd_control; `unknown` in a checkout that was never installed."""
    from importlib.metadata import PackageNotFoundError, version

    try:
        return version("hd_control")
    except PackageNotFoundError:
        return "unknown"


def git_commit() -> str:
    """The commit of the checkout that this file belongs to; empty when it is not one."""
    folder = Path(__file__).resolve().parents[2] / ".git"
    try:
        head = (folder / "HEAD").read_text().strip()
        if not head.startswith("ref: "):
            return head
        name = head.removeprefix("ref: ")
        if (folder / name).is_file():
            return (folder / name).read_text().strip()
        packed = (line.split() for line in (folder / "packed-refs").read_text().splitlines())
        return next((line[0] for line in packed if line[1:] == [name]), "")
    except OSError:
        return ""


def now_utc() -> str:
    """The present time as ISO 8601 text in UTC."""
    return datetime.now(timezone.utc).isoformat(timespec="milliseconds")


def provenance(start_time_utc: str | None = None) -> dict[str, str]:
    """What every recording carries: `software_version`, `git_commit`, `start_time_utc` (given, or now)."""
    return {
        "software": "hd_control",
        "software_version": software_version(),
        "git_commit": git_commit(),
        "start_time_utc": now_utc() if start_time_utc is None else start_time_utc,
    }


@contextmanager
def whole_bag(path: str | Path, force: bool = False) -> Iterator[Path]:
    """Gives the path to write a bag to; at the end of the block the bag is at `path`, after an exception nothing is.

    Raises BagError if `path` exists (with `force`: if what is there is no bag).
    """
    path = Path(path)
    with whole_folder(path, lambda: make_folder(path, force), BagError) as place:
        yield place
