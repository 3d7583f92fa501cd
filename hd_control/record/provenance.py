"""Which software made a recording: version and commit, read without running anything."""

from __future__ import annotations

from datetime import datetime, timezone
from pathlib import Path


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
