"""Files and folders that appear whole or not at all: written beside their place, moved there when they are complete.

    write_whole(path, text)                  # text or bytes in one go
    with whole_file(path) as place:          # anything that writes to a path: CSV, NPZ
        write_csv(place, columns)
    with whole_folder(path, make_room) as place:
        ...

Whatever ends the writing early, an exception or Ctrl-C, the old file stays as it was and nothing half lies beside it.
Only a killed process leaves its `.NAME.….partial`. Whether an old file may be replaced is the caller's question.
"""

from __future__ import annotations

import errno
import os
import secrets
import shutil
import stat
import tempfile
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from pathlib import Path

from hd_control.core.errors import HdError

PARTIAL = ".partial"
"""Ending of what is not complete yet."""
_REMEDIES = {
    errno.ENOSPC: "free some space or choose another disk",
    errno.EDQUOT: "the quota is used up; choose another disk",
    errno.EROFS: "the file system is read-only; choose another disk",
    errno.EACCES: "no permission; choose a folder of your own",
    errno.EPERM: "no permission; choose a folder of your own",
    errno.EFBIG: "the file size limit is reached; raise it",
    errno.ENOENT: "the parent folder does not exist; make it first",
    errno.ENOTDIR: "part of the path is a file; choose another path",
    errno.EISDIR: "it is a folder; choose another name",
    errno.EIO: "the disk reports an error; check it and choose another one",
}


def refusal(error: OSError) -> str:
    """Why a write was refused and what to do, for a message that names the path."""
    return f"cannot be written ({error.strerror or error}); {_REMEDIES.get(error.errno or 0, 'choose another place')}"


def write_whole(path: str | Path, content: str | bytes, error: type[HdError] = HdError) -> None:
    """Makes or replaces a file; text becomes UTF-8. Raises `error`, which names the path and what to do."""
    with whole_file(path, error) as place:
        place.write_bytes(content.encode("utf-8") if isinstance(content, str) else content)


@contextmanager
def whole_file(path: str | Path, error: type[HdError] = HdError) -> Iterator[Path]:
    """Gives the path to write to; at the end of the block that file replaces `path`, after an exception it is gone.

    A disk that refuses raises `error`, which names `path` and what to do; an OSError about another file passes through.
    """
    path, place = Path(path), None
    try:
        with replaced(path) as place:
            yield place
    except OSError as refused:
        if refused.filename is not None and os.fspath(refused.filename) not in (str(place), str(path)):
            raise
        raise error(f"{path}: {refusal(refused)}") from None


@contextmanager
def replaced(path: Path, durable: bool = False) -> Iterator[Path]:
    """`whole_file` for callers with words of their own: every OSError passes through.

    The mode of a file that is replaced stays. `durable`: on the disk before the old file is gone, so that a power cut
    leaves one of the two.
    """
    if path.exists() and not path.is_file():  # a device, a pipe or a folder: moving a file there would destroy it
        raise OSError(errno.EISDIR if path.is_dir() else errno.EPERM, "not an ordinary file", str(path))
    place = path.with_name(f".{path.name[:100]}.{secrets.token_hex(4)}{PARTIAL}")
    try:
        yield place
        if path.is_file():
            place.chmod(stat.S_IMODE(path.stat().st_mode))
        if durable:
            _force(place)
        os.replace(place, path)
        if durable:
            _force(path.parent)
    finally:
        with suppress(OSError):
            place.unlink(missing_ok=True)


def _force(path: Path) -> None:
    """What the system holds of a file or folder goes to the disk."""
    handle = os.open(path, os.O_RDONLY)
    try:
        os.fsync(handle)
    finally:
        os.close(handle)


@contextmanager
def whole_folder(path: Path, make_room: Callable[[], None], error: type[HdError] = HdError) -> Iterator[Path]:
    """Gives the path to make a folder at; at the end of the block it is moved to `path`, after an exception it is gone.

    `make_room` is called right before the move, to remove what is there or to refuse. Raises `error` if there is no
    place beside `path`, or no way to move; OSErrors of the block pass through.
    """
    try:
        beside = Path(tempfile.mkdtemp(prefix=f".{path.name[:100]}.", suffix=PARTIAL, dir=path.parent))
    except OSError as refused:
        raise error(f"{path}: {refusal(refused)}") from None
    try:
        yield beside / path.name
        make_room()
        try:
            os.replace(beside / path.name, path)
        except OSError as refused:
            raise error(f"{path}: {refusal(refused)}") from None
    finally:
        shutil.rmtree(beside, ignore_errors=True)
