"""Forces the disk beside the recording loop: fsync can take seconds on a slow disk, the loop must not wait for it."""

from __future__ import annotations

import os
import threading


class DiskSync:
    """At most one fsync at a time, in a thread of its own; an error is told by the next call."""

    def __init__(self) -> None:
        self._thread: threading.Thread | None = None
        self._error: OSError | None = None

    def start(self, fileno: int) -> OSError | None:
        """Begins to force the file unless the last time still runs; returns the error of an earlier one."""
        if self._error is not None:
            return self._error
        if self._thread is None or not self._thread.is_alive():
            self._thread = threading.Thread(target=self._run, args=(fileno,), name="disk sync", daemon=True)
            self._thread.start()
        return None

    def wait(self) -> None:
        """Waits for the fsync that runs; the file may be closed then."""
        if self._thread is not None:
            self._thread.join()

    def _run(self, fileno: int) -> None:
        try:
            os.fsync(fileno)
        except OSError as error:
            self._error = error
