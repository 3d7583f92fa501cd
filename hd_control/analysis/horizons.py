"""Free runs of a model against a recording: how far off a prediction is after 0.5 s and after 5 s."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from hd_control.analysis.hunt import Task
from hd_control.analysis.link_function import LinkSide
from hd_control.analysis.signals import JointSignals
from hd_control.core.errors import ConfigError
from hd_control.drive.model import JointModel
from hd_control.drive.predict import HORIZONS, FreeRun, free_run

SIGNALS = (
    ("motor_position", "rad"),
    ("joint_position", "rad"),
    ("joint_torque", "N m"),
)


@dataclass(frozen=True)
class Horizons:
    """Free runs by length of the window, s; `why_not`: why there are none, empty if there are."""

    runs: dict[float, FreeRun]
    why_not: str = ""

    def json(self) -> dict[str, Any]:
        """RMS errors at the end of the window, beside those of holding the start values."""
        found: dict[str, Any] = {}
        for length, run in self.runs.items():
            entry: dict[str, Any] = {"windows": run.windows, "clipped_share": run.clipped_share}
            for name, unit in SIGNALS:
                error, hold = getattr(run, f"rms_{name}"), getattr(run, f"hold_{name}")
                entry[name] = {"unit": unit, "rms_error": float(error[-1]), "rms_error_hold": float(hold[-1])}
            found[f"{length:g}"] = entry
        return found


def horizons(task: Task, signals: JointSignals, joint: JointModel, side: LinkSide) -> Horizons:
    """Predictions of all windows of one joint's recording by its model."""
    equations = task.equations
    if not np.isfinite(equations.states.motor_torque).any() or signals.motor_shaft_position is None:
        return Horizons({}, "a free run needs motor torque and motor position")
    link = side.own_link(signals.joint, equations.spectral)
    if link is None:
        return Horizons({}, side.why_not(signals.joint))
    runs = {}
    for length, every in HORIZONS:
        try:
            runs[length] = free_run(
                joint, equations.states, length, every, link, equations.derived.filled["motor_torque"],
                equations.derived.usable,
            )  # fmt: skip
        except ConfigError as error:
            return Horizons(runs, str(error))
    return Horizons(runs)
