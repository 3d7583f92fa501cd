"""Equal bit for bit: what a comparison of compiled code with its oracle asks for. HD_COUNT sets how many cases run."""

from __future__ import annotations

import os

import numpy as np


def seeds(usual: int) -> range:
    """Seeds of the random cases of a comparison; the environment variable HD_COUNT asks for another number."""
    return range(int(os.environ.get("HD_COUNT", usual)))


def same(one: object, other: object) -> bool:
    """Equal numbers with equal signs, also of zeros; one "not a number" is like another."""
    a, b = np.asarray(one, dtype=float), np.asarray(other, dtype=float)
    nowhere = np.isnan(a) if a.shape == b.shape else np.zeros(a.shape, dtype=bool)
    if a.shape != b.shape or not np.array_equal(nowhere, np.isnan(b)):
        return False
    return np.where(nowhere, 0.0, a).tobytes() == np.where(nowhere, 0.0, b).tobytes()


def rows(faults: object) -> np.ndarray:
    """Faults as rows (k, 5): code, joint, value, limit, action."""
    table = [(f.code.value, f.joint, f.value, f.limit, f.action) for f in faults]  # type: ignore[attr-defined]
    return np.array(table, dtype=float).reshape(-1, 5)


def check(where: str, **pairs: tuple[object, object]) -> None:
    """Raises AssertionError with the first pair that is not equal."""
    for name, (found, expected) in pairs.items():
        plain = isinstance(expected, str | list) or expected is None
        if not (found == expected if plain else same(found, expected)):
            raise AssertionError(f"{where}: {name} is\n{found}\ninstead of\n{expected}")
