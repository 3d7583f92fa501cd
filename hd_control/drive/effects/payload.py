"""A mass, first moment or inertia that the nominal link dynamics does not know.

    torque on the link = Y(q, q', q'') p        p: inertial parameters of a rigid body fixed to the own or the last link
    torque on the link = g_c cos q + g_s sin q        a single joint without a robot description; N m

p = (m, m c_x, m c_y, m c_z, I_xx, I_xy, I_yy, I_xz, I_yz, I_zz), kg, kg m, kg m^2, about the joint frame's origin. Of
parameters that a joint cannot tell apart only one is kept; it stands for their combination. Valid for a rigid body.
Source: docs/equations/link.md (L2), (L3).
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from typing import final

import numpy as np

from hd_control.core.arrays import FloatArray
from hd_control.drive.effect import (
    LINK,
    Columns,
    Confusion,
    Context,
    DriveStates,
    Effect,
    EffectParameter,
    Reference,
    Shape,
)

INERTIAL = (
    ("mass", "kg"),
    *((f"moment_{axis}", "kg m") for axis in "xyz"),
    *((f"inertia_{axes}", "kg m^2") for axes in ("xx", "xy", "yy", "xz", "yz", "zz")),
)
NAMES = tuple(name for name, _ in INERTIAL)
GRAVITY = ("gravity_cosine", "gravity_sine")
TYPICAL_RADIUS = 0.2
"""m: scales mass, first moments and inertias of a payload against each other when independent ones are chosen."""
INDEPENDENT = 0.02
"""A column with less than this share of the largest, after projection on those already kept, is left out."""
ROWS = 3000


@final
class Payload(Effect):
    """An added rigid body, or a wrong gravity term of a single joint."""

    name = "payload"
    title = "unknown payload or link mass"
    evidence = "follows the joint angle as gravity does, and the acceleration"
    parameters = (
        *(
            EffectParameter(f"{body}_{name}", unit, f"{name.replace('_', ' ')} fixed to the {words} link", default=0.0)
            for body, words in (("link", "own"), ("tool", "last"))
            for name, unit in INERTIAL
        ),
        EffectParameter("gravity_cosine", "N m", "gravity torque at q = 0, single joint", default=0.0),
        EffectParameter("gravity_sine", "N m", "gravity torque at q = 90 degrees, single joint", default=0.0),
    )
    confusions = (
        Confusion("gauge_gain", "use the rotor balance as well, or record with another known mass"),
        Confusion("gauge_offset", "more than 90 degrees of joint angle: gravity follows the angle, an offset does not"),
        Confusion("structural_resonance", "chirp with at least 5 s between 8 and 40 Hz: inertia adds no peak"),
    )
    references = (
        Reference({"terms": GRAVITY}, {"joint_position": math.pi / 6.0}, {LINK: [[math.sqrt(0.75), 0.5]]}),
        Reference(
            {"terms": ("tool_mass", "tool_inertia_zz")},
            {"tool_regressor": [[1.0, 2.0, 3.0, 4.0, 5.0, 6.0, 7.0, 8.0, 9.0, 10.0]]},
            {LINK: [[1.0, 10.0]]},
        ),
    )
    examples = (
        {"gravity_cosine": 1.0, "gravity_sine": 11.0},
        {"tool_mass": 2.0, "tool_moment_x": 0.1},
        {"link_moment_y": 1.0, "link_inertia_zz": 0.3},
    )

    @classmethod
    def shapes(cls, states: DriveStates) -> Sequence[Shape]:
        own, tool = states.link_regressor, states.tool_regressor
        if own is not None and tool is not None and np.array_equal(own, tool, equal_nan=True):
            tool = None  # the last joint: both are the same body
        found: list[Shape] = []
        for body, regressor in (("link", own), ("tool", tool)):
            if regressor is None:
                continue
            for last in (4, 10):  # mass and first moments; with inertias
                terms = tuple(f"{body}_{NAMES[i]}" for i in _independent(regressor[:, :last]))
                if terms and {"terms": terms} not in found:
                    found.append({"terms": terms})
        return tuple(found) or ({"terms": GRAVITY},)

    @classmethod
    def coefficient_names(cls, shape: Shape) -> tuple[str, ...]:
        return tuple(shape["terms"])

    @classmethod
    def columns(cls, states: DriveStates, shape: Shape) -> Columns:
        return {LINK: np.stack([_column(states, term) for term in shape["terms"]], axis=1)}

    @classmethod
    def split(cls, values: Mapping[str, float], context: Context) -> tuple[Shape, FloatArray]:
        terms = tuple(p.name for p in cls.parameters if p.name in values) or GRAVITY
        return {"terms": terms}, np.array([values.get(term, 0.0) for term in terms])

    @classmethod
    def join(cls, shape: Shape, coefficients: FloatArray, context: Context) -> dict[str, float]:
        return dict(zip(cls.coefficient_names(shape), coefficients.tolist(), strict=True))


def _column(states: DriveStates, term: str) -> FloatArray:
    """Torque at the joint per unit of one parameter, (n,); zeros where the regressor is not known."""
    if term in GRAVITY:
        return np.cos(states.joint_position) if term == GRAVITY[0] else np.sin(states.joint_position)
    body, _, name = term.partition("_")
    regressor = states.link_regressor if body == "link" else states.tool_regressor
    return np.zeros_like(states.joint_position) if regressor is None else regressor[:, NAMES.index(name)]


def _independent(regressor: FloatArray) -> list[int]:
    """Columns of a regressor (n, k <= 10) that the motion separates, by pivoted orthogonalisation, in order."""
    rows = regressor[np.isfinite(regressor).all(axis=1)]
    rows = rows[:: max(1, len(rows) // ROWS)]
    scale = TYPICAL_RADIUS ** np.array([0, 1, 1, 1, 2, 2, 2, 2, 2, 2])[: regressor.shape[1]]
    rest = rows * scale
    kept: list[int] = []
    if not rows.size:
        return []
    largest = float(np.sqrt((rest**2).sum(axis=0)).max())
    while len(kept) < regressor.shape[1] and largest > 0.0:
        norm = np.sqrt((rest**2).sum(axis=0))
        best = int(np.argmax(norm))
        if norm[best] < INDEPENDENT * largest:
            break
        kept.append(best)
        direction = rest[:, best] / norm[best]
        rest = rest - direction[:, None] * (direction @ rest)
    return sorted(kept)
