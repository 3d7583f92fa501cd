"""`docs/reference/effects.md`: the effect library, from the classes and the docstrings of their files."""

from __future__ import annotations

import inspect
import sys
from collections.abc import Iterator

import numpy as np

from hd_control.drive.effect import Effect, EffectParameter
from hd_control.drive.library import library
from hd_control.reference.markdown import code, page, table


def effect_page() -> str:
    """The page; effects of other packages are left out."""
    shipped = [effect for effect in library().values() if effect.__module__.startswith("hd_control.")]
    intro = [
        "Each effect is one file in `hd_control/drive/effects`. Values belong to the joint side of the gear. Model",
        "files: [model.md](../model.md); how a diagnosis finds an effect: [diagnosis.md](../diagnosis.md); an effect",
        "of your own: [tutorial](../tutorials/write_an_effect.md).",
    ]
    rows = ([f"[`{e.name}`](#{e.name})", e.title, "yes" if e.in_every_model else ""] for e in shipped)
    overview = table(["effect", "what it is", "in every model"], rows)
    sections = (block for effect in shipped for block in _effect(effect))
    return page("Effects", "the effect library", intro, overview, *sections)


def _effect(effect: type[Effect]) -> Iterator[list[str]]:
    text = inspect.cleandoc(sys.modules[effect.__module__].__doc__ or "")
    yield [f"## {effect.name}"]
    yield ["```text", *text.splitlines(), "```"]
    yield [f"In the residual: {effect.evidence}."]
    yield table(["parameter", "unit", "range", "meaning"], map(_parameter, effect.parameters))
    yield [f"- not told from {code(one.effect)} unless: {one.experiment}" for one in effect.confusions]


def _parameter(parameter: EffectParameter) -> list[str]:
    low, high = (f"{value:g}" if np.isfinite(value) else "" for value in (parameter.low, parameter.high))
    shown = f"{low or '-inf'} to {high or 'inf'}" if low or high else ""
    return [code(parameter.name), parameter.unit, shown, parameter.meaning]
