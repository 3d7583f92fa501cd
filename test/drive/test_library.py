"""Effects of users: found by entry point, a broken one is left out with a warning, look-alike names are refused."""

from __future__ import annotations

import importlib.metadata
import sys
import types
from collections.abc import Iterator

import pytest

from hd_control.core.errors import ConfigError
from hd_control.drive.effect import (
    LINK,
    MOTOR,
    TORSION_FAMILY,
    BaseNumber,
    Columns,
    DriveStates,
    Effect,
    EffectParameter,
    NearReversals,
    Shape,
)
from hd_control.drive.expression import Expression
from hd_control.drive.library import effect_named, library, names_that_may_be_missing, problem_of
from hd_control.drive.needs import VARIED_LOOPS


class SealDrag(Effect):
    """A user's effect."""

    name = "seal_drag"
    title = "drag of a seal"
    evidence = "grows with the speed"
    parameters = (EffectParameter("drag", "N m s", "drag"),)

    @classmethod
    def coefficient_names(cls, shape: Shape) -> tuple[str, ...]:
        return ("drag",)

    @classmethod
    def columns(cls, states: DriveStates, shape: Shape) -> Columns:
        return {MOTOR: states.motor_velocity[:, None]}


class OwnSpring(SealDrag):
    """A user's law of the torsion."""

    name = "own_spring"
    family = TORSION_FAMILY


FORMULA = Expression("cable", {LINK: 1.0}, "pull * sin(joint_position)").effect()


class Nameless(Effect):
    """Forgets nearly everything."""


class Taken(SealDrag):
    """Takes a shipped name."""

    name = "backlash"


@pytest.fixture
def plug_in(monkeypatch: pytest.MonkeyPatch) -> Iterator[types.ModuleType]:
    """A module of another package whose entry points are set by the test."""
    module = types.ModuleType("users_effects")
    for effect in (SealDrag, Nameless, Taken):
        setattr(module, effect.__name__, effect)
    monkeypatch.setitem(sys.modules, "users_effects", module)
    library.cache_clear()
    yield module
    library.cache_clear()


def points(monkeypatch: pytest.MonkeyPatch, *values: str) -> None:
    """The entry points that the metadata of installed packages shows."""
    found = [importlib.metadata.EntryPoint("x", value, "hd_control.effects") for value in values]
    monkeypatch.setattr(
        importlib.metadata, "entry_points", lambda group: found if group == "hd_control.effects" else []
    )


def test_a_users_effect_is_a_candidate_by_existing(plug_in: object, monkeypatch: pytest.MonkeyPatch) -> None:
    points(monkeypatch, "users_effects:SealDrag")
    assert library()["seal_drag"] is SealDrag and "seal_drag" in names_that_may_be_missing()


def test_the_defaults_serve_a_users_effect() -> None:
    """Nothing but a name, words, parameters and columns is asked of a user's effect, also for the diagnosis."""
    for effect in (SealDrag, FORMULA):
        assert problem_of(effect) == ""
        assert effect.needs() == () and effect.law_error == Effect.law_error > 0.0
        assert effect.near_reversals is None and effect.shifts_command == "" and effect.base == ()
    assert OwnSpring.needs() == (VARIED_LOOPS,), "a law of the torsion needs loops, whoever writes it"


@pytest.mark.parametrize(
    ("changes", "words"),
    [
        ({"law_error": -0.1}, "law_error"),
        ({"law_error": "small"}, "law_error"),
        ({"needs": ()}, "needs"),
        ({"shifts_command": "dealy"}, "'dealy'"),
        ({"near_reversals": NearReversals("travel", (1e-4,), "drag", (0.4, 2.5), 0.6)}, "'travel'"),
        ({"base": (BaseNumber("mass", "rotor_inertia", MOTOR),)}, "every model"),
    ],
)
def test_what_the_diagnosis_asks_is_checked(changes: dict[str, object], words: str) -> None:
    """A wrong word is one clause when the effect is loaded, not a crash in the middle of a diagnosis."""
    assert words in problem_of(type("Changed", (SealDrag,), changes))


@pytest.mark.parametrize(
    ("value", "words"),
    [
        ("users_effects:Nameless", "does not say its name"),
        ("users_effects:Taken", "'backlash' is taken"),
        ("users_effects:Gone", "AttributeError"),
        ("no_such_package:X", "ModuleNotFoundError"),
        ("users_effects:__name__", "no class"),
    ],
)
def test_a_broken_one_is_left_out(value: str, words: str, plug_in: object, monkeypatch: pytest.MonkeyPatch) -> None:
    points(monkeypatch, value, "users_effects:SealDrag")
    with pytest.warns(UserWarning, match="is left out") as caught:
        found = library()
    assert len(caught) == 1 and words in str(caught[0].message)
    assert "seal_drag" in found and found["backlash"] is not Taken


def test_an_unknown_name_is_named() -> None:
    with pytest.raises(ConfigError, match="did you mean 'stribeck_friction'"):
        effect_named("stribek_friction")


def test_what_is_no_effect() -> None:
    assert problem_of(SealDrag) == ""
    assert "no class" in problem_of(3)
