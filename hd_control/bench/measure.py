"""Timing that survives a noisy machine: interleaved runs, medians, ratios to peers of the same run."""

from __future__ import annotations

import os
import platform
import sys
import time
from collections.abc import Callable, Sequence
from dataclasses import asdict, dataclass
from typing import Any

import numpy as np

from hd_control.session.session import Children


@dataclass(frozen=True)
class Result:
    """One row of the table. A peer's row has the same `name` and its own name in `peer`."""

    name: str
    median: float
    min: float
    p99: float
    unit: str
    runs: int
    peer: str | None = None

    def as_json(self) -> dict[str, Any]:
        """The row in the schema `hd.bench/1`."""
        return asdict(self)


@dataclass(frozen=True)
class Timed:
    """A callable that does `inner` units of work per call."""

    call: Callable[[], Any]
    inner: int
    peer: str | None = None


def time_each(name: str, unit: str, cases: Sequence[Timed], runs: int, scale: float = 1e6) -> list[Result]:
    """Times the cases in turn, run after run, so that a slow moment of the machine hits all of them.

    The value is seconds of processor time per unit of work times `scale`: other programs take less part in it than in
    the time on the wall, and on a quiet machine both are the same for work in one thread.
    """
    for case in cases:
        case.call()
    samples: list[list[float]] = [[] for _ in cases]
    for _ in range(runs):
        for case, found in zip(cases, samples, strict=True):
            start = time.process_time()
            case.call()
            found.append((time.process_time() - start) / case.inner * scale)
    return [summarise(name, unit, found, case.peer) for case, found in zip(cases, samples, strict=True)]


def summarise(name: str, unit: str, samples: Sequence[float], peer: str | None = None) -> Result:
    """Median, minimum and 99th percentile of samples that are already in `unit`."""
    values = np.asarray(samples, dtype=float)
    return Result(
        name, float(np.median(values)), float(values.min()), float(np.quantile(values, 0.99)), unit, values.size, peer
    )


def keep_busy(children: Children) -> None:
    """Starts ordinary work on every processor, until the children end."""
    for number in range(os.cpu_count() or 1):
        children.start(f"busy_{number}", [sys.executable, "-c", "while True: pass"])


def machine() -> dict[str, Any]:
    """What the figures were measured on."""
    model = ""
    try:
        with open("/proc/cpuinfo", encoding="utf-8") as lines:
            model = next((line.split(":", 1)[1].strip() for line in lines if line.startswith("model name")), "")
    except OSError:
        pass
    return {
        "cpu": model or platform.processor(),
        "cores": os.cpu_count(),
        "system": platform.platform(),
        "python": platform.python_version(),
        "numpy": np.__version__,
        "load": round(os.getloadavg()[0], 2),
    }
