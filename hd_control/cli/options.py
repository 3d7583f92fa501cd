"""What every command shares: the output options, text for people, JSON for programs, progress on long work."""

from __future__ import annotations

import argparse
import json
import math
import os
import sys
import time
from collections.abc import Iterable, Iterator
from pathlib import Path
from typing import Any, TypeVar

from hd_control.core.errors import HdError

Item = TypeVar("Item")
PROGRESS_AFTER = 2.0  # seconds of work before a bar appears
PROGRESS_EVERY = 0.1


def add_output_options(parser: argparse.ArgumentParser) -> None:
    """Adds `--json FILE`, `--force` and `--quiet`, which every command has."""
    group = parser.add_argument_group("output")
    group.add_argument("--json", metavar="FILE", help="also write the result as JSON, - for standard output")
    group.add_argument("--force", action="store_true", help="overwrite an output file that exists")
    group.add_argument("--quiet", action="store_true", help="print nothing but errors")


def refuse_overwrite(path: str | Path, force: bool) -> None:
    """Raises HdError if the file or folder exists and `force` is not set, or its folder does not exist."""
    path = Path(path)
    if path.exists() and not force:
        raise HdError(f"{path}: exists already; choose another name or add --force")
    if not path.parent.is_dir():
        raise HdError(f"{path}: the folder {path.parent} does not exist")


def check_outputs(arguments: argparse.Namespace) -> None:
    """Refuses a `--json` file that exists, before any work is done."""
    target = getattr(arguments, "json", None)
    if target not in (None, "-"):
        refuse_overwrite(target, arguments.force)


def say(arguments: argparse.Namespace, text: str = "") -> None:
    """One line for people: not with `--quiet`, and on standard error when standard output carries the JSON."""
    if not arguments.quiet:
        print(text, file=sys.stderr if arguments.json == "-" else sys.stdout)


def plain(value: Any) -> Any:
    """The value in JSON's own types. Arrays become lists, NaN and infinities null (JSON has no word for them)."""
    if isinstance(value, dict):
        return {str(key): plain(item) for key, item in value.items()}
    if isinstance(value, (list, tuple)):
        return [plain(item) for item in value]
    if isinstance(value, float):
        return value if math.isfinite(value) else None
    if value is None or isinstance(value, (bool, int, str)):
        return value
    if isinstance(value, os.PathLike):
        return os.fspath(value)
    if hasattr(value, "tolist"):
        return plain(value.tolist())
    raise TypeError(f"{type(value).__name__} has no form in JSON")


def write_json(arguments: argparse.Namespace, document: dict[str, Any]) -> None:
    """Writes the document to the `--json` file, if one was asked for: whole or not at all.

    The document names its `schema` ("hd.compare/1"). Raises HdError if the file exists and `--force` was not given.
    """
    from hd_control.core.files import write_whole

    if "schema" not in document:
        raise ValueError("a JSON document names its schema")
    if arguments.json is None:
        return
    text = json.dumps(plain(document), indent=1, allow_nan=False) + "\n"
    if arguments.json == "-":
        sys.stdout.write(text)
        return
    path = Path(arguments.json)
    refuse_overwrite(path, arguments.force)
    write_whole(path, text)


class Progress:
    """A bar on standard error for work that takes longer than two seconds, only on a terminal, never with `--quiet`."""

    def __init__(self, arguments: argparse.Namespace, total: float, what: str) -> None:
        self.total, self.what = total, what
        self.enabled = not arguments.quiet and sys.stderr.isatty() and total > 0
        self.start = self.drawn = time.monotonic()
        self.visible = False

    def update(self, done: float) -> None:
        """Redraws the bar at `done` of `total`, at most ten times a second."""
        now = time.monotonic()
        if not self.enabled or now - self.start < PROGRESS_AFTER or now - self.drawn < PROGRESS_EVERY:
            return
        self.drawn, self.visible = now, True
        share = min(1.0, max(0.0, done / self.total))
        left = (now - self.start) * (1.0 - share) / share if share > 0.0 else math.inf
        remaining = f"{left:4.0f} s left" if math.isfinite(left) else ""
        bar = "#" * round(30 * share)
        sys.stderr.write(f"\r{self.what} [{bar:30}] {100 * share:3.0f} % {remaining:12}")
        sys.stderr.flush()

    def close(self) -> None:
        """Removes the bar from the terminal."""
        if self.visible:
            sys.stderr.write("\r\033[K")
            sys.stderr.flush()
            self.visible = False


def track(arguments: argparse.Namespace, items: Iterable[Item], total: float, what: str) -> Iterator[Item]:
    """The items one by one, with a progress bar that counts them."""
    progress = Progress(arguments, total, what)
    try:
        for done, item in enumerate(items):
            progress.update(done)
            yield item
    finally:
        progress.close()
