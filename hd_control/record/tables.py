"""Tables of numbers: CSV and NPZ files in and out."""

from __future__ import annotations

import csv
from collections.abc import Callable, Iterator, Mapping
from itertools import islice
from pathlib import Path
from typing import Any

import numpy as np

from hd_control.core.arrays import FloatArray
from hd_control.core.errors import BagError

NAMES = "joints"
"""Key of an NPZ file that holds the joint names."""
DELIMITERS = ",;\t"
ROWS_AT_ONCE = 20_000


def read_table(path: str | Path) -> tuple[dict[str, FloatArray], tuple[str, ...]]:
    """(columns by name, joint names): CSV columns are (n,), NPZ arrays (n,) or (n, joints), float64.

    The joint names are empty if the file does not say them. Raises BagError with line or key for what is no table.
    """
    path = Path(path)
    if not path.is_file():
        raise BagError(f"{path}: no such file; give a .csv or .npz file")
    if path.suffix.lower() == ".npz":
        return _read_npz(path)
    if path.suffix.lower() in (".csv", ".tsv", ".txt"):
        return _read_csv(path), ()
    raise BagError(f"{path}: {path.suffix or 'a file without an ending'} is not read; give a .csv or .npz file")


def _read_npz(path: Path) -> tuple[dict[str, FloatArray], tuple[str, ...]]:
    found: dict[str, FloatArray] = {}
    names: tuple[str, ...] = ()
    try:
        with np.load(path, allow_pickle=False) as archive:
            for key in archive.files:
                array = archive[key]
                if key == NAMES and array.dtype.kind in "US":
                    names = tuple(str(name) for name in np.atleast_1d(array).astype(str))
                elif array.dtype.kind in "fiub" and array.ndim in (1, 2):
                    found[key] = array.astype(np.float64)
    except Exception as error:  # zipfile, numpy and zlib leak errors of their own
        raise BagError(f"{path}: not a readable NPZ file ({type(error).__name__}: {error})") from None
    if not found:
        raise BagError(f"{path}: no array of numbers with one or two dimensions")
    return found, names


def _read_csv(path: Path) -> dict[str, FloatArray]:
    try:
        with path.open(encoding="utf-8-sig", newline="") as stream:
            header, delimiter, line = _header(stream, path)
            rows = csv.reader(stream, delimiter=delimiter)
            table = np.concatenate([np.empty((0, len(header))), *_blocks(rows, len(header), delimiter, path, line)])
    except (OSError, UnicodeDecodeError, csv.Error) as error:
        raise BagError(f"{path}: not a readable CSV file ({error})") from None
    if not len(table):
        raise BagError(f"{path}: a header but no row of numbers")
    return {name: np.ascontiguousarray(table[:, k]) for k, name in enumerate(header)}


def _header(stream: Iterator[str], path: Path) -> tuple[list[str], str, int]:
    """Column names, delimiter and line number of the first line that is no comment."""
    for line, text in enumerate(stream, 1):
        if not text.strip() or text.lstrip().startswith("#"):
            continue
        delimiter = max(DELIMITERS, key=text.count)
        names = [name.strip() for name in next(csv.reader([text.rstrip("\r\n")], delimiter=delimiter))]
        if any(_is_number(name) for name in names):
            raise BagError(f"{path}, line {line}: expected the names of the columns, got numbers; add a header line")
        twice = next((name for name in names if names.count(name) > 1), None)
        if twice is not None:
            raise BagError(f"{path}, line {line}: two columns are named {twice!r}")
        return names, delimiter, line
    raise BagError(f"{path}: the file is empty")


def _blocks(rows: Iterator[list[str]], width: int, delimiter: str, path: Path, line: int) -> Iterator[FloatArray]:
    """The numbers, some thousand lines at a time; an empty cell is NaN."""
    while block := list(islice(rows, ROWS_AT_ONCE)):
        wrong = next((k for k, row in enumerate(block) if row and len(row) != width), None)
        if wrong is not None:
            raise BagError(f"{path}, line {line + wrong + 1}: {len(block[wrong])} cells, the header has {width}")
        kept = [row for row in block if row]
        try:
            yield np.array(kept, dtype=np.float64).reshape(-1, width)
        except ValueError:
            comma = delimiter != ","
            yield np.array(
                [[_cell(cell, comma, path, line + k + 1) for cell in row] for k, row in enumerate(block) if row]
            ).reshape(-1, width)
        line += len(block)


def _cell(text: str, comma: bool, path: Path, line: int) -> float:
    text = text.strip().replace(",", ".") if comma else text.strip()
    if not text:
        return float("nan")
    if not _is_number(text):
        raise BagError(f"{path}, line {line}: {text[:40]!r} is not a number")
    return float(text)


def _is_number(text: str) -> bool:
    try:
        float(text)
    except ValueError:
        return False
    return True


def write_csv(
    path: Path, columns: Mapping[str, FloatArray], progress: Callable[[float], None] = lambda share: None
) -> None:
    """Columns (n,) with a header line, 15 digits, an empty cell for NaN. `progress` is called with the share done."""
    count = len(next(iter(columns.values())))
    with path.open("w", encoding="utf-8", newline="") as stream:
        writer = csv.writer(stream, lineterminator="\n")
        writer.writerow(columns)
        for begin in range(0, count, ROWS_AT_ONCE):
            part = np.column_stack([values[begin : begin + ROWS_AT_ONCE] for values in columns.values()])
            writer.writerows(["" if x != x else f"{x:.15g}" for x in row] for row in part.tolist())
            progress(min(1.0, (begin + ROWS_AT_ONCE) / count))


def write_npz(path: Path, arrays: Mapping[str, Any]) -> None:
    """Arrays under their names, compressed."""
    with path.open("wb") as stream:
        np.savez_compressed(stream, **arrays)
