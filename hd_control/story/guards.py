"""What must be right before a story starts: alone on this machine, a free ROS domain, room on the disk."""

from __future__ import annotations

import errno
import fcntl
import os
import random
import shutil
import socket
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from hd_control.core.errors import HdError
from hd_control.record.bag_folder import FLOOR_BYTES, FLOOR_SHARE

DOMAINS = range(1, 101)
"""Above, the ports of the middleware run into those that the system hands out."""
BYTES_PER_JOINT_SECOND, BYTES_PER_SECOND = 250_000, 600_000
"""Recorded: seven joints at 1 kHz take 2.3 MB/s."""


@contextmanager
def alone(what: str) -> Iterator[None]:
    """Only one demo of a user at a time: two would take each other's milliseconds. Raises HdError if one runs."""
    folder = Path(os.environ.get("XDG_RUNTIME_DIR") or tempfile.gettempdir())
    path = folder / f"hd_demo_{os.getuid()}.lock"
    handle = os.open(path, os.O_RDWR | os.O_CREAT | os.O_CLOEXEC | os.O_NOFOLLOW, 0o600)
    try:
        try:
            fcntl.flock(handle, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except OSError as error:
            if error.errno not in (errno.EAGAIN, errno.EACCES):
                raise
            owner = os.pread(handle, 200, 0).decode(errors="replace").strip() or "of an unknown process"
            raise HdError(f"another hd demo runs ({owner}); wait for its end or stop it") from None
        os.ftruncate(handle, 0)
        os.pwrite(handle, f"process {os.getpid()}, {what}".encode(), 0)
        yield
    finally:
        os.close(handle)  # releases the lock; the empty file stays, removing it would race with the next one


def domain_in_use(domain: int) -> bool:
    """Does a process of this machine take part in a ROS domain? Each binds one of the domain's unicast ports."""
    base = 7400 + 250 * domain
    return any(_taken(base + offset) for offset in (10, 11, 12, 13))


def _taken(port: int) -> bool:
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as probe:
        try:
            probe.bind(("0.0.0.0", port))
        except OSError as error:
            return error.errno == errno.EADDRINUSE
        return False


def free_domain(wanted: int | None) -> int:
    """The wanted ROS domain, or a random one that nobody uses. Raises HdError if it, or all of them, are in use."""
    if wanted is not None:
        if not 0 <= wanted <= DOMAINS[-1]:
            raise HdError(f"--domain {wanted} is outside [0, {DOMAINS[-1]}]")
        if domain_in_use(wanted):
            raise HdError(f"ROS domain {wanted} is in use on this machine; leave --domain out, or name another one")
        return wanted
    chosen = random.SystemRandom().sample(DOMAINS, len(DOMAINS))
    found = next((domain for domain in chosen if not domain_in_use(domain)), None)
    if found is None:
        raise HdError(f"all ROS domains from {DOMAINS[0]} to {DOMAINS[-1]} are in use on this machine")
    return found


def enough_disk(folder: Path, seconds: float, joints: int) -> None:
    """Is there room for the recordings, above what the recorder leaves free? Raises HdError with the numbers."""
    usage = shutil.disk_usage(folder)
    floor = min(FLOOR_BYTES, FLOOR_SHARE * usage.total)
    needed = floor + seconds * (BYTES_PER_SECOND + joints * BYTES_PER_JOINT_SECOND)
    if usage.free < needed:
        raise HdError(
            f"{folder}: {usage.free / 1e6:.0f} MB are free, {needed / 1e6:.0f} MB are needed "
            f"(the recorder leaves {floor / 1e6:.0f} MB free); free some space or choose another disk with -o"
        )
