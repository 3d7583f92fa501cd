"""One figure of a paper beside ours, the constants behind it, and the papers that can be asked for their figures.

A paper is a module `hd_control.papers.NAME` with

    rows(quick: bool, seed: int, progress: Progress, seeds: int = 3) -> list[Row]
    figures(quick: bool, seed: int, progress: Progress) -> list[tuple[str, plotly figure]]

`quick` is the part that runs in the test suite. `seed` is the first seed of the noise, `seeds` how many are run where
noise matters. Both are deterministic in their arguments. Nothing is said here about what a figure is compared with:
`met` is computed from `ours` and `target`, never given. Constants come from `config/reproduce`, each with its unit and
where it comes from.
"""

from __future__ import annotations

import importlib
import importlib.util
import math
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import lru_cache
from typing import Any, Literal, Protocol, cast

import numpy as np

from hd_control.core.errors import ConfigError
from hd_control.core.resources import config_path
from hd_control.core.strict_yaml import expect_keys, load_yaml

# ---- The constants of a paper's experiment ---------------------------------------------------------


CHOSEN = "chosen"


@dataclass(frozen=True)
class Constant:
    """One number (or list of numbers) of an experiment; `source` is a place in the paper, or `chosen`."""

    name: str
    value: Any
    unit: str
    symbol: str
    source: str

    @property
    def text(self) -> str:
        """`stiffness_linear K = 10000 N m/rad`."""
        numbers = self.value if isinstance(self.value, list) else [self.value]
        shown = ", ".join(f"{number:g}" for number in numbers)
        unit = "" if self.unit == "-" else f" {self.unit}"
        return f"{self.name}{' ' + self.symbol if self.symbol else ''} = {shown}{unit}"


class Constants:
    """All constants of one paper: `constants["gear_ratio"]` is a value, `chosen(...)` what has to be named."""

    def __init__(self, table: Mapping[str, Constant]) -> None:
        self._table = dict(table)

    def __getitem__(self, name: str) -> Any:
        return self._table[name].value

    def __iter__(self) -> Iterator[Constant]:
        return iter(self._table.values())

    def values(self, *names: str) -> dict[str, Any]:
        """Some of them by name."""
        return {name: self[name] for name in names}

    def chosen(self, *names: str) -> tuple[str, ...]:
        """The texts of those among `names` that the paper does not give."""
        return tuple(self._table[name].text for name in names if self._table[name].source == CHOSEN)


@lru_cache
def load_constants(paper: str) -> Constants:
    """The constants of a paper by its short name. Raises ConfigError with file and line for anything that is wrong."""
    path = config_path(f"reproduce/{paper}.yaml")
    table = {}
    for name, entry in load_yaml(path).items():
        expect_keys(entry, f"{path}: {name}", ("value", "unit", "source"), ("symbol",))
        numbers = entry["value"] if isinstance(entry["value"], list) else [entry["value"]]
        if not numbers or any(isinstance(n, bool) or not isinstance(n, (int, float)) for n in numbers):
            raise ConfigError(f"{path}: {name}: {entry['value']!r} is not a number or a list of numbers")
        table[name] = Constant(name, entry["value"], entry["unit"], entry.get("symbol", ""), entry["source"])
    return Constants(table)


# ---- Rows and papers -------------------------------------------------------------------------------


PAPERS = ("zhu", "gandhi", "hashimoto")
TITLES = {
    "zhu": "Zhu: Precision Control of Robots with Harmonic Drives",
    "gandhi": "Gandhi, Ghorbel: Control of Hysteresis and Kinematic Error Nonlinearities in Harmonic Drives",
    "hashimoto": "Hashimoto, Kiyosawa, Paul: A Torque Sensing Technique for Robots with Harmonic Drives",
}
SCHEMA = "hd.reproduce/1"
CAVEAT = (
    "Constants that a paper does not give are chosen. Agreement shows that a result is plausible; it does not "
    "identify the paper's hardware."
)

Progress = Callable[[float, str], None]
"""Called with the share that is done, 0 to 1, and what is being done."""


@dataclass(frozen=True)
class Row:
    """One figure: the paper's value, ours and what was promised, all in `unit`.

    `better` says how `ours` meets `target`: `less` (<=), `more` (>=) or `near` (within `tolerance`, same unit, of it).
    `paper_value` None: the paper has no number for it. `target` None: nothing was promised. `chosen` names the
    constants that the paper does not give. `seeds` is (median, worst) over noise seeds; `ours` is the median then and
    `met` asks for the worst. `ours` NaN: the figure could not be made; it meets no target.
    """

    id: str
    paper: str
    equation: str
    unit: str
    paper_value: float | None
    ours: float
    target: float | None
    conditions: str
    better: Literal["less", "more", "near"] = "less"
    chosen: tuple[str, ...] = ()
    seeds: tuple[float, float] | None = None
    tolerance: float = 0.0

    def __post_init__(self) -> None:
        if self.better not in ("less", "more", "near"):
            raise ValueError(f"{self.id}: better {self.better!r} is not one of less, more, near")
        if self.better == "near" and self.target is not None and not self.tolerance > 0.0:
            raise ValueError(f"{self.id}: near needs a tolerance above 0")

    @property
    def worst(self) -> float:
        """The value that is held against the target: of the worst seed, or `ours`."""
        return self.ours if self.seeds is None else self.seeds[1]

    @property
    def met(self) -> bool | None:
        """Whether the target is met; None without a target."""
        if self.target is None:
            return None
        if not math.isfinite(self.worst):
            return False
        if self.better == "near":
            return abs(self.worst - self.target) <= self.tolerance
        return self.worst <= self.target if self.better == "less" else self.worst >= self.target

    def as_json(self) -> dict[str, Any]:
        """The row of schema hd.reproduce/1."""
        document: dict[str, Any] = {"id": self.id, "paper": self.paper, "equation": self.equation, "unit": self.unit}
        document |= {"paper_value": self.paper_value, "ours": self.ours, "target": self.target, "met": self.met}
        document |= {"conditions": self.conditions, "better": self.better, "tolerance": self.tolerance}
        seeds = None if self.seeds is None else {"median": self.seeds[0], "worst": self.seeds[1]}
        return {**document, "chosen": list(self.chosen), "seeds": seeds}


def over_seeds(
    values: Sequence[float], better: Literal["less", "more", "near"] = "less", target: float = 0.0
) -> tuple[float, tuple[float, float]]:
    """`ours` and `seeds` of a row from the values of several noise seeds: the median, and (median, worst).

    Worst is the largest for `less`, the smallest for `more`, the farthest from `target` for `near`. A value that is
    not a number is the worst of all and the median with it. Raises ValueError for no values.
    """
    found = np.asarray(values, dtype=float)
    if found.size == 0:
        raise ValueError("no values")
    if np.isnan(found).any():
        return math.nan, (math.nan, math.nan)
    distance = {"less": found, "more": -found, "near": np.abs(found - target)}[better]
    median = float(np.median(found))
    return median, (median, float(found[int(np.argmax(distance))]))


class Paper(Protocol):
    """What a paper's module offers."""

    def rows(self, quick: bool, seed: int, progress: Progress, seeds: int = 3) -> list[Row]: ...

    def figures(self, quick: bool, seed: int, progress: Progress) -> list[tuple[str, Any]]: ...


def available() -> list[str]:
    """The papers that have a module, without importing them."""
    return [name for name in PAPERS if importlib.util.find_spec(f"hd_control.papers.{name}") is not None]


def load_paper(name: str) -> Paper:
    """The module of a paper. Raises ValueError if there is none."""
    if name not in available():
        raise ValueError(f"no paper {name!r}; there is {', '.join(available())}")
    return cast(Paper, importlib.import_module(f"hd_control.papers.{name}"))


def document(rows: Sequence[Row], seed: int) -> dict[str, Any]:
    """The document of schema hd.reproduce/1. Raises ValueError if an id is there twice."""
    names = [row.id for row in rows]
    twice = sorted({name for name in names if names.count(name) > 1})
    if twice:
        raise ValueError(f"row {twice[0]} is there twice")
    return {"schema": SCHEMA, "seed": seed, "rows": [row.as_json() for row in rows]}


def number(value: float | None) -> str:
    """Three significant digits, `-` for nothing."""
    return "-" if value is None else f"{value:.3g}"


def target_text(row: Row) -> str:
    """`<= 0.2`, `>= 3000`, `50.7 ± 0.01` or `-`."""
    if row.target is None:
        return "-"
    if row.better == "near":
        return f"{row.target:.4g} ± {row.tolerance:.2g}"
    return f"{'<=' if row.better == 'less' else '>='} {row.target:.3g}"


def met_text(row: Row) -> str:
    """`yes`, `no`, or nothing without a target."""
    return {True: "yes", False: "NO", None: ""}[row.met]


def table(rows: Sequence[Row]) -> Iterator[str]:
    """The rows as text: one line each, under a head for each paper; its chosen constants below."""
    width = max((len(row.id) for row in rows), default=0)
    for paper in dict.fromkeys(row.paper for row in rows):
        own = [row for row in rows if row.paper == paper]
        yield TITLES.get(paper, paper)
        yield f"  {'':{width}}{'paper':>11}{'ours':>11}{'worst':>11}  {'target':>16}  met  {'unit':8}  conditions"
        for row in own:
            worst = number(row.worst) if row.seeds is not None else ""
            cells = f"{number(row.paper_value):>11}{number(row.ours):>11}{worst:>11}  {target_text(row):>16}"
            yield f"  {row.id:{width}}{cells}  {met_text(row):3}  {row.unit:8}  {row.conditions}"
        yield from chosen_lines(own)
        yield ""


def chosen_lines(rows: Sequence[Row]) -> Iterator[str]:
    """The constants that the paper does not give, each once."""
    names = list(dict.fromkeys(name for row in rows for name in row.chosen))
    if names:
        yield "  chosen:"
        yield from (f"    {name}" for name in names)
