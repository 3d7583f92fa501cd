"""The effect of the tutorial, as printed there, keeps the contract and is found by its entry point."""

from __future__ import annotations

import importlib.metadata
import sys
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest
from command_blocks import ROOT, Written, steps
from drive.drive_cases import moving, states_of

from hd_control.drive.library import effect_named, library, names_that_may_be_missing, problem_of

PAGE = ROOT / "docs" / "tutorials" / "write_an_effect.md"


@pytest.fixture
def written(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[dict[str, str]]:
    """The files of the page; the entry point of its package as if it were installed."""
    found = {step.name: step.text for step in steps(PAGE) if isinstance(step, Written)}
    (tmp_path / "seal_drag.py").write_text(found["seal_drag.py"])
    monkeypatch.syspath_prepend(str(tmp_path))
    point = importlib.metadata.EntryPoint("seal_drag", "seal_drag:SealDrag", "hd_control.effects")
    monkeypatch.setattr(importlib.metadata, "entry_points", lambda group: [point] if group == point.group else [])
    library.cache_clear()
    yield found
    library.cache_clear()
    sys.modules.pop("seal_drag", None)


def test_the_entry_point_is_the_printed_one(written: dict[str, str]) -> None:
    head, line = '[project.entry-points."hd_control.effects"]', 'seal_drag = "seal_drag:SealDrag"'
    assert f"{head}\n{line}\n" in written["pyproject.toml"]


def test_the_effect_is_a_candidate_with_the_right_columns(written: dict[str, str]) -> None:
    assert "seal_drag" in names_that_may_be_missing()
    effect = effect_named("seal_drag")
    assert problem_of(effect) == ""
    for case in effect.references:
        for channel, expected in case.columns.items():
            np.testing.assert_allclose(effect.columns(states_of(**case.states), case.shape)[channel], expected)
    states = moving()
    for shape in effect.shapes(states):
        low, high = effect.shape_bounds(shape, states)["knee"]
        (column,) = effect.columns(states, shape).values()
        assert low <= shape["knee"] <= high
        np.testing.assert_allclose(column[:, 0], np.tanh(states.motor_velocity / shape["knee"]))
