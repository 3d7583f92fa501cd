"""How the shipped settings of the controllers differ from the paper whose gains they carry, and why.

The gains of `config/` are those of Zhu's Tables I and II, number for number; what differs is listed here and compared
with the files, so that a changed file changes the list.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from hd_control.chain.chain import shipped_values
from hd_control.papers.rows import load_constants

TABLES = ("table_1_", "table_2_")
STARTS = ("coulomb_torque_initial", "friction_offset_initial", "viscous_positive_initial", "viscous_negative_initial")
PAPER: dict[str, tuple[Any, str]] = {
    "compliance_derivative": (
        "literal",
        "(5) as printed limit-cycles at 1 kHz; Remark 3.2 is shipped, so d is not used",
    ),
    "rate_source": ("plain", "rates of the tracking error are later by less than rates of the signals"),
    "adapt_compliance": (True, "with a 16-bit joint sensor it drives joints 4 and 5 into a limit cycle"),
    "adaptation_scale": (1.0, "a tenth suits friction estimates that start at identified values"),
}
"""Switch -> what the paper has, and why the shipped file has something else."""
START_WHY = "friction estimates start at a commissioning of 90 % of the simulated drives, not at zero"
LOAD_WHY = "friction grows with load as in (3), whose numbers the paper does not give: those of the simulated drives"


def differing_numbers() -> dict[str, int]:
    """Numbers of Tables I and II that the shipped files do not carry as printed, by parameter; empty if all are."""
    found: dict[str, int] = {}
    values = {**shipped_values("motion_node"), **shipped_values("torque_node")}
    for constant in load_constants("zhu"):
        for table in TABLES:
            if constant.name.startswith(table):
                name = constant.name.removeprefix(table)
                wrong = int(np.sum(np.asarray(values[name]) != np.asarray(constant.value)))
                found |= {name: wrong} if wrong else {}
    return found


def departures() -> list[str]:
    """One sentence for each thing in which the shipped settings are not the paper's."""
    values, found = shipped_values("torque_node"), []
    numbers = differing_numbers()
    if numbers:
        found.append(f"other numbers than in Tables I and II: {', '.join(numbers)}")
    for name, (paper, why) in PAPER.items():
        if values[name] != paper:
            found.append(f"{name} {_word(values[name])}, the paper {_word(paper)}: {why}")
    if any(np.any(np.asarray(values[name]) != 0.0) for name in STARTS):
        found.append(START_WHY)
    if np.any(np.asarray(values["load_friction_linear"]) != 0.0):
        found.append(LOAD_WHY)
    return found


def _word(value: Any) -> str:
    return str(value).lower() if isinstance(value, bool) else f"{value:g}" if isinstance(value, float) else str(value)
