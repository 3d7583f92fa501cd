"""Effects of users: found by entry point, a broken one is left out with a warning, look-alike names are refused."""

from __future__ import annotations

import importlib.metadata
import sys
import types
from collections.abc import Iterator

import pytest

from hd_control.core.errors import ConfigError
from hd_control.drive.effect import MOTOR, Columns, DriveStates, Effect, EffectParameter, Shape
from hd_control.drive.library import effect_named, library, names_that_may_be_missing, problem_of


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
