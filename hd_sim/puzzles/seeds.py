"""What seeds are for, and the log of looks at test seeds: nobody tunes on them, and none is looked at twice.

Ranges are in `config/challenge.yaml`; a log is a file of JSON lines, one per look.
"""

from __future__ import annotations

import json
from collections.abc import Mapping
from datetime import datetime, timezone
from pathlib import Path
from typing import Any

from hd_control.core.errors import ConfigError
from hd_sim.puzzles.draw import ranges

TEST = "test"


def purposes(seed: int, count: int) -> tuple[str, ...]:
    """What seeds `seed` to `seed + count - 1` are for, in the order of the ranges; empty beyond all of them."""
    table: Mapping[str, tuple[int, int]] = ranges()["seeds"]
    return tuple(name for name, (low, high) in table.items() if seed <= high and seed + count - 1 >= low)


def read_looks(path: Path) -> list[dict[str, Any]]:
    """The looks so far: `seed`, `count`, `world`, `kind`, `date`, `version`. Raises ConfigError for a foreign file."""
    if not path.exists():
        return []
    try:
        looks = [json.loads(line) for line in path.read_text(encoding="utf-8").splitlines() if line.strip()]
        return [look for look in looks if look["seed"] >= 0 and look["count"] >= 0 and look["world"]]
    except (OSError, ValueError, KeyError, TypeError):
        raise ConfigError(f"{path}: not a log of looks at test seeds") from None


def log_look(path: Path, seed: int, count: int, world: str, kind: str, version: str, again: bool = False) -> None:
    """Writes a look at test seeds into the log, before it happens. `again`: a record that exists goes on.

    Raises ConfigError if some of the seeds were looked at before.
    """
    looks = read_looks(path)
    same = [
        one for one in looks if (one["seed"], one["count"], one["world"], one.get("kind")) == (seed, count, world, kind)
    ]
    if again and same:
        return
    before = [one for one in looks if one["seed"] < seed + count and seed < one["seed"] + one["count"]]
    if before:
        old = before[0]
        last = old["seed"] + old["count"] - 1
        raise ConfigError(f"seeds {old['seed']} to {last} were looked at on {old.get('date', '?')}; take others")
    today = datetime.now(timezone.utc).date().isoformat()
    look = {"seed": seed, "count": count, "world": world, "kind": kind, "date": today, "version": version}
    with path.open("a", encoding="utf-8") as file:
        file.write(json.dumps(look) + "\n")
