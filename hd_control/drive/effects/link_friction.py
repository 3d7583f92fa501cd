"""Friction on the link side of the gear: output bearing, seals, cables.

    torque on the link = f_c sgn(q') + f_v q'        f_c N m, f_v N m s

Source: docs/equations/link.md (L4). The sign is smoothed over `STANDSTILL`; valid outside presliding of the bearing.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import final

import numpy as np

from hd_control.core.arrays import BoolArray, FloatArray
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

STANDSTILL = 2e-3
"""rad/s: below it the direction of the link is not known from a resolver."""
TERMS = ("link_coulomb", "link_viscous")


@final
class LinkFriction(Effect):
    """Coulomb and viscous friction of the link."""

    name = "link_friction"
    title = "friction on the link side"
    evidence = "changes its sign with the direction of the joint and stands in the link balance alone"
    parameters = (
        EffectParameter("link_coulomb", "N m", "Coulomb friction of the link", low=0.0, default=0.0),
        EffectParameter("link_viscous", "N m s", "viscous friction of the link", low=0.0, default=0.0),
    )
    confusions = (
        Confusion("gauge_gain", "constant speeds in both directions: friction stays, a gain error follows the load"),
        Confusion("torsional_hysteresis", "output locked, slow torque ramps: hysteresis stays, link friction goes"),
    )
    law_error = 0.02
    references = (Reference({"terms": TERMS}, {"joint_velocity": -1.0}, {LINK: [[-1.0, -1.0]]}),)
    examples = (
        {"link_coulomb": 1.2},
        {"link_viscous": 3.0},
        {"link_coulomb": 1.2, "link_viscous": 3.0},
    )

    @classmethod
    def shapes(cls, states: DriveStates) -> Sequence[Shape]:
        return ({"terms": TERMS[:1]}, {"terms": TERMS[1:]}, {"terms": TERMS})

    @classmethod
    def coefficient_names(cls, shape: Shape) -> tuple[str, ...]:
        return tuple(shape["terms"])

    @classmethod
    def columns(cls, states: DriveStates, shape: Shape) -> Columns:
        v = states.joint_velocity
        found = [np.tanh(v / STANDSTILL) if term == "link_coulomb" else v for term in shape["terms"]]
        return {LINK: np.stack(found, axis=1)}

    @classmethod
    def blind(cls, states: DriveStates, shape: Shape) -> dict[str, BoolArray]:
        """Near standstill friction builds up over a small travel, and the direction is not known."""
        return {LINK: np.abs(states.joint_velocity) < 3.0 * STANDSTILL}

    @classmethod
    def split(cls, values: Mapping[str, float], context: Context) -> tuple[Shape, FloatArray]:
        terms = tuple(term for term in TERMS if term in values) or TERMS
        return {"terms": terms}, np.array([values.get(term, 0.0) for term in terms])

    @classmethod
    def join(cls, shape: Shape, coefficients: FloatArray, context: Context) -> dict[str, float]:
        return dict(zip(cls.coefficient_names(shape), coefficients.tolist(), strict=True))
