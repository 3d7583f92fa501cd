"""The numbers of a paper's experiment from config/reproduce: each with its unit and where it comes from."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from functools import lru_cache
from typing import Any

from hd_control.core.errors import ConfigError
from hd_control.core.resources import config_path
from hd_control.core.strict_yaml import expect_keys, load_yaml

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
    """All constants of one paper: `constants["gear_ratio"]` is a value, `chosen(...)` what has to be told."""

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
