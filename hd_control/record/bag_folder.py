"""The directory of a bag: made, replaced only on request, with errors that say what to do."""

from __future__ import annotations

import errno
import shutil
from pathlib import Path

from hd_control.core.errors import BagError

FLOOR_BYTES, FLOOR_SHARE = 1 << 30, 0.05

_REMEDY = {
    errno.ENOSPC: "free some space or record to another disk",
    errno.EDQUOT: "the quota is used up; record elsewhere",
    errno.EROFS: "the file system is read-only; record elsewhere",
    errno.EACCES: "no permission; choose a folder of your own",
    errno.EPERM: "no permission; choose a folder of your own",
    errno.EFBIG: "the file size limit is reached; raise it or split the recording",
    errno.ENOENT: "the parent folder does not exist; make it first",
    errno.ENOTDIR: "part of the path is a file; choose another path",
    errno.EIO: "the disk reports an error; check it and record elsewhere",
}


def write_error(path: Path, error: OSError) -> BagError:
    """The BagError of a failed write: path, reason, remedy."""
    remedy = _REMEDY.get(error.errno or 0, "choose another place to record to")
    return BagError(f"{path}: cannot be written ({error.strerror or error}); {remedy}; what was written stays")


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
    foreign = [e.name for e in entries if e.is_dir() or not (e.name.startswith("metadata.yaml") or ".mcap" in e.name)]
    if foreign:
        raise BagError(f"{path}: is not a bag ({foreign[0]}), so it is not replaced; choose another name")
    try:
        for entry in entries:
            entry.unlink()
        if path.is_dir():
            path.rmdir()
    except OSError as error:
        raise write_error(path, error) from None
