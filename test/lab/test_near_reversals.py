"""Friction that builds up over a travel, seen in the first millirad after reversals and nowhere else."""

from __future__ import annotations

from dataclasses import replace
from functools import lru_cache

import numpy as np
import pytest
from oracles.simple_joint import Changes
from plain_joint import PLAIN, equations, known, link_of, signals

from hd_control.drive.effect import COULOMB, MOTOR, Effect
from hd_control.drive.library import effect_named, library
from hd_control.lab.balances.equations import build_equations
from hd_control.lab.diagnosis.dictionary import build
from hd_control.lab.diagnosis.fit import Fit
from hd_control.lab.diagnosis.near_reversals import near_reversals
from hd_control.lab.diagnosis.scores import Scores

PRESLIDING = effect_named("presliding")


@lru_cache(maxsize=4)
def fit(changes: Changes) -> Fit:
    """The plain balances of a joint."""
    dictionary = build(equations(changes), ())
    return Fit.of(dictionary, Scores(dictionary), ())


@pytest.mark.parametrize("travel", [2e-4, 6e-4])
def test_bristles_are_found_with_their_travel_and_torque(travel: float) -> None:
    """Their law is the effect's own, so its values are right within 1 %; the interval allows for damped bristles."""
    found = near_reversals(fit(Changes(bristle=travel)), PRESLIDING)
    assert found is not None and found.gain > 1000.0 and found.t > 8.0
    distance, torque = found.parameters["presliding_distance"], found.parameters["presliding_torque"]
    assert distance.value == pytest.approx(travel, rel=0.01) and distance.low < travel < distance.high
    assert torque.value == pytest.approx(PLAIN.coulomb, rel=0.01) and torque.low < PLAIN.coulomb < torque.high
    assert found.error_after < 0.1 * found.error_before


def test_friction_that_is_whole_at_once_is_no_presliding() -> None:
    """The joint sticks at reversals instead: rows near them are wrong too, but not by that column."""
    assert near_reversals(fit(Changes()), PRESLIDING) is None


def asking(**conditions: object) -> type[Effect]:
    """Presliding that asks for other conditions."""
    assert PRESLIDING.near_reversals is not None
    test = replace(PRESLIDING.near_reversals, **conditions)  # type: ignore[arg-type] # fields of the dataclass
    return type("Asking", (PRESLIDING,), {"near_reversals": test})


@pytest.mark.parametrize(
    ("conditions", "found"),
    [
        ({"over_coulomb": (0.9, 1.1)}, True),
        ({"over_coulomb": (1.1, 2.5)}, False),
        ({"over_coulomb": (0.4, 0.9)}, False),
        ({"share": 0.98}, True),
        ({"share": 0.9999}, False),
    ],
)
def test_a_claim_asks_for_the_coulomb_torque_and_for_most_of_the_energy(
    conditions: dict[str, object], found: bool
) -> None:
    """The torque that builds up is the Coulomb torque within 1 %, and explains 99.8 % of these rows."""
    assert (near_reversals(fit(Changes(bristle=2e-4)), asking(**conditions)) is not None) == found


def test_without_rotor_balance_friction_or_rows_nothing_is_said() -> None:
    bare = replace(signals(), motor_torque=None)
    dictionary = build(build_equations(bare, known(), link_of(bare)), ())
    assert near_reversals(Fit.of(dictionary, Scores(dictionary), ()), PRESLIDING) is None
    there = fit(Changes(bristle=2e-4))
    none = there.coefficients.copy()
    none[there.dictionary.base_index(MOTOR, COULOMB)] = 0.0
    assert near_reversals(replace(there, coefficients=none), asking(share=0.0)) is None, "no Coulomb friction"
    moving = replace(there.dictionary.equations.channels[MOTOR], valid=np.ones_like(
        there.dictionary.equations.channels[MOTOR].valid))  # fmt: skip
    every = replace(there.dictionary.equations, channels={**there.dictionary.equations.channels, MOTOR: moving})
    whole = replace(there, dictionary=replace(there.dictionary, equations=every))
    assert near_reversals(whole, PRESLIDING) is None, "no rows that were left out"


def test_effects_that_act_elsewhere_are_not_tested_here() -> None:
    there = fit(Changes(bristle=2e-4))
    others = [effect for effect in library().values() if effect.near_reversals is None]
    assert others and all(near_reversals(there, effect) is None for effect in others)


def test_equal_fits_give_equal_intervals() -> None:
    there = fit(Changes(bristle=2e-4))
    assert near_reversals(there, PRESLIDING) == near_reversals(there, PRESLIDING)
