"""metadata.yaml of a rosbag2 directory, version 9: written and read."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from hd_control.core.errors import ConfigError

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
    """Writes metadata.yaml beside itself and renames it. OSError passes through."""
    temporary = folder / (FILE_NAME + ".tmp")
    temporary.write_text(dump({"rosbag2_bagfile_information": dict(info)}), "utf-8")
    temporary.replace(folder / FILE_NAME)


@dataclass(frozen=True)
class BagIndex:
    """What metadata.yaml says about a bag: its files, counts by topic, custom texts, storage."""

    files: tuple[str, ...]
    counts: Mapping[str, int]
    custom_data: Mapping[str, str]
    storage: str


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
        return BagIndex(files, counts, custom, str(info["storage_identifier"]))
    except (KeyError, TypeError, ValueError, AttributeError) as error:
        raise ConfigError(f"{path}: not a rosbag2 metadata file ({type(error).__name__}: {error})") from None
