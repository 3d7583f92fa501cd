"""All effects by name: the files of `drive/effects/` and what installed packages add by entry point.

A user's own effect is one class below `Effect` in one file, named in the entry-point group `hd_control.effects`.
"""

from __future__ import annotations

import importlib
import inspect
import pkgutil
import warnings
from collections.abc import Iterator
from functools import lru_cache
from types import ModuleType

from hd_control.core.errors import ConfigError
from hd_control.drive import effects as shipped
from hd_control.drive.effect import BASE_NUMBERS, BaseNumber, Effect

GROUP = "hd_control.effects"


@lru_cache(maxsize=1)
def library() -> dict[str, type[Effect]]:
    """Name -> effect class, shipped ones first. A broken plug-in is left out with one warning."""
    found: dict[str, type[Effect]] = {}
    for module in pkgutil.iter_modules(shipped.__path__):
        for effect in effects_in(importlib.import_module(f"{shipped.__name__}.{module.name}")):
            found[effect.name] = effect
    for source, effect in _plug_ins():
        problem = problem_of(effect) or (f"the name {effect.name!r} is taken" if effect.name in found else "")
        if problem:
            warnings.warn(f"effect {source} is left out: {problem}", stacklevel=2)
        else:
            found[effect.name] = effect
    return found


def names_in_every_model() -> tuple[str, ...]:
    """Names of the effects that every model has."""
    return tuple(name for name, effect in library().items() if effect.in_every_model)


def base_numbers() -> tuple[tuple[type[Effect], BaseNumber], ...]:
    """Effect and parameter of each of `BASE_NUMBERS`, in their order."""
    found = [(effect, one) for effect in library().values() for one in effect.base]
    return tuple(sorted(found, key=lambda item: BASE_NUMBERS.index(item[1].number)))


def names_that_may_be_missing() -> tuple[str, ...]:
    """Names of the effects that a diagnosis may find, plug-ins included."""
    return tuple(name for name, effect in library().items() if not effect.in_every_model)


def effect_named(name: str) -> type[Effect]:
    """One effect class. Raises ConfigError with the nearest name."""
    import difflib

    found = library()
    if name not in found:
        near = difflib.get_close_matches(name, found, 1)
        hint = f", did you mean {near[0]!r}?" if near else f"; there is {', '.join(found)}"
        raise ConfigError(f"unknown effect {name!r}{hint}")
    return found[name]


def effects_in(module: ModuleType) -> list[type[Effect]]:
    """The effect classes that a module defines itself."""
    classes = [value for _, value in inspect.getmembers(module, inspect.isclass)]
    return [c for c in classes if issubclass(c, Effect) and c is not Effect and c.__module__ == module.__name__]


def problem_of(effect: object) -> str:
    """What keeps a class from being an effect, one clause; empty if nothing does."""
    if not (inspect.isclass(effect) and issubclass(effect, Effect)):
        return "it is no class below hd_control.drive.effect.Effect"
    missing = [name for name in ("name", "title", "evidence", "parameters") if not hasattr(effect, name)]
    if missing:
        return f"it does not say its {', '.join(missing)}"
    if effect.__abstractmethods__:
        return f"it does not define {', '.join(sorted(effect.__abstractmethods__))}"
    if not effect.name.isidentifier():
        return f"its name {effect.name!r} is not a plain word"
    return _diagnosis_problem(effect)


def _diagnosis_problem(effect: type[Effect]) -> str:
    """What is wrong with what the class says for a diagnosis, one clause; empty if nothing is."""
    if not (isinstance(effect.law_error, (int, float)) and 0.0 <= effect.law_error < 1.0):
        return f"its law_error {effect.law_error!r} is no number from 0 to 1"
    if not inspect.ismethod(effect.needs):
        return "its needs are no class method that returns a tuple"
    if effect.base and not effect.__module__.startswith(shipped.__name__):
        return "the numbers of the base belong to the shipped effects of every model"
    test = effect.near_reversals
    named = [effect.shifts_command] if effect.shifts_command else []
    named += [test.entry, test.amplitude] if test is not None else []
    known = {parameter.name for parameter in effect.parameters}
    return next((f"it names {name!r}, which is not one of its parameters" for name in named if name not in known), "")


def _plug_ins() -> Iterator[tuple[str, type[Effect]]]:
    """Effect classes of other installed packages; a broken one gives one warning."""
    from importlib.metadata import entry_points

    for point in entry_points(group=GROUP):
        try:
            loaded = point.load()
        except Exception as error:  # a plug-in may fail in any way; it must not take the program with it
            warnings.warn(f"effect {point.value} is left out: {type(error).__name__}: {error}", stacklevel=3)
            continue
        found = effects_in(loaded) if inspect.ismodule(loaded) else [loaded]
        for effect in found:
            if problem := problem_of(effect):
                warnings.warn(f"effect {point.value} is left out: {problem}", stacklevel=3)
            else:
                yield point.value, effect
