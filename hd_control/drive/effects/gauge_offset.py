"""Zero error of the torque gauge.

    tau_s = tau + o        o N m; seen by rotor and link balance with opposite signs

Source: docs/equations/gauge.md (S10). In the transmission it hides in the assembly zero.
"""

from __future__ import annotations

from typing import final

import numpy as np

from hd_control.drive.effect import (
    GAUGE,
    LINK,
    MOTOR,
    Columns,
    Confusion,
    DriveStates,
    Effect,
    EffectParameter,
    Reference,
    Shape,
)


@final
class GaugeOffset(Effect):
    """A constant that the bridge adds to the torque."""

    name = "gauge_offset"
    title = "zero error of the torque gauge"
    evidence = "is constant and stands in the rotor and the link balance with opposite signs"
    reads = GAUGE
    parameters = (EffectParameter("gauge_offset", "N m", "indicated minus true torque"),)
    confusions = (
        Confusion(
            "asymmetric_friction", "more than 90 degrees of joint angle, two mounting orientations, or an unloaded run"
        ),
        Confusion("payload", "more than 90 degrees of joint angle: gravity follows the angle, an offset does not"),
    )
    references = (Reference({}, {}, {MOTOR: [[-1.0]], LINK: [[1.0]]}),)
    examples = ({"gauge_offset": -0.4},)

    @classmethod
    def coefficient_names(cls, shape: Shape) -> tuple[str, ...]:
        return ("gauge_offset",)

    @classmethod
    def columns(cls, states: DriveStates, shape: Shape) -> Columns:
        one = np.ones((states.gauge_torque.size, 1))
        return {MOTOR: -one, LINK: one}
