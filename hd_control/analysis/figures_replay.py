"""What a replay commanded beside what was recorded: both lines of the joint that differs most, and every difference."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from hd_control.analysis.figures import COLOURS
from hd_control.analysis.figures_style import FORWARD_COLOUR, MEASURED, Figure, axis, kept, layout, line, with_gaps
from hd_control.core.arrays import FloatArray

UNITS = {"position": "rad", "velocity": "rad/s", "effort": "N m"}


def replay_figure(
    title: str, unit: str, time: FloatArray, recorded: FloatArray, made: FloatArray, joint_names: Sequence[str]
) -> Figure:
    """`time` (k,) s; `recorded` and `made` (k, n) in `unit`, NaN where there is nothing."""
    difference = made - recorded
    size = np.where(np.isfinite(difference), np.abs(difference), 0.0).max(axis=0, initial=0.0)
    worst = int(np.argmax(size))
    traces = []
    for name, values, colour in (("recorded", recorded, MEASURED), ("replayed", made, FORWARD_COLOUR)):
        own = values[:, worst]
        keep = kept(own, np.isfinite(own))
        dash = "solid" if name == "recorded" else "dot"
        traces.append(line(time[keep], own[keep], f"{joint_names[worst]} {name}", colour, dash=dash))
    for joint, name in enumerate(joint_names):
        if size[joint] > 0.0:
            there = np.isfinite(difference[:, joint])
            keep = kept(np.where(there, difference[:, joint], 0.0), there)
            shown = with_gaps(difference[:, joint], there)[keep]
            traces.append(line(time[keep], shown, name, COLOURS[joint % len(COLOURS)], yaxis="y2", width=1.0))
    result = layout(title, 460)
    result["xaxis"] = axis("time, s", anchor="y2")
    result["yaxis"] = axis(unit, domain=[0.56, 1.0])
    result["yaxis2"] = axis(f"replayed - recorded, {unit}", domain=[0.0, 0.44])
    return {"data": traces, "layout": result}
