"""Outputs that appear whole or not at all: written beside their place, moved there when they are complete."""

from __future__ import annotations

import os
import shutil
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from hd_control.record.bag_folder import make_folder, write_error


@contextmanager
def whole_bag(path: str | Path, force: bool = False) -> Iterator[Path]:
    """Gives the path to write a bag to; at the end of the block the bag is at `path`, after an exception nothing is.

    Raises BagError if `path` exists (with `force`: if what is there is no bag).
    """
    path = Path(path)
    with _beside(path) as folder:
        yield folder / path.name
        make_folder(path, force)
        os.replace(folder / path.name, path)


@contextmanager
def whole_file(path: str | Path) -> Iterator[Path]:
    """Gives the path to write a file to; at the end of the block it replaces `path`, after an exception it is gone."""
    path = Path(path)
    with _beside(path) as folder:
        yield folder / path.name
        os.replace(folder / path.name, path)


@contextmanager
def _beside(path: Path) -> Iterator[Path]:
    try:
        folder = Path(tempfile.mkdtemp(prefix=f".{path.name}.", suffix=".partial", dir=path.parent))
    except OSError as error:
        raise write_error(path, error) from None
    try:
        yield folder
    finally:
        shutil.rmtree(folder, ignore_errors=True)
