"""The long campaigns are run rarely; a change of the quick tests that they use must not break them unseen."""

from __future__ import annotations

import ast
import json
import re
import subprocess
import sys
from pathlib import Path

import pytest

from hd_control.cli.test import campaigns, goals_of
from hd_control.core.errors import HdError

ROOT = Path(__file__).resolve().parents[1]
FOLDER = ROOT / "test" / "campaigns"
WORDS = {"STORY", "DEMO", "DOCS", "SABOTAGE", "FUZZ", "SIGNALS", "ENDS"}
"""Campaigns of the long lane that measure no numbered goal."""


def results_written(path: Path) -> set[str]:
    """Names of the result files that a campaign writes."""
    calls = (node for node in ast.walk(ast.parse(path.read_text())) if isinstance(node, ast.Call))
    return {ast.literal_eval(call.args[0]) for call in calls if ast.unparse(call.func) == "write_result"}


def test_every_campaign_can_be_collected_and_names_tests_that_exist():
    files = campaigns(ROOT)
    texts = "\n".join(path.read_text() for path in files)
    named = set(re.findall(r'"(test/[\w/]+\.py::\w+)"', texts))
    places = set(re.findall(r'"(test/[\w/.]+)', texts))
    assert len(files) >= 22 and named and places > {"test/chain"}
    assert not [place for place in places if not (ROOT / place).exists()]
    command = [sys.executable, "-m", "pytest", "--collect-only", "-q", "-p", "no:cacheprovider"]
    done = subprocess.run([*command, *map(str, files), *sorted(named)], cwd=ROOT, capture_output=True, text=True)
    assert done.returncode == 0, done.stdout[-3000:] + done.stderr[-1000:]
    for path in files:
        assert f"{path.name}::test_" in done.stdout


def test_every_goal_has_one_campaign_and_every_result_is_of_a_goal():
    measured = [goal for path in campaigns(ROOT) for goal in goals_of(path)]
    table = json.loads((FOLDER / "goals.json").read_text())
    assert sorted(measured) == sorted({row["goal"] for row in table if "not_applicable" not in row} | WORDS)
    for path in campaigns(ROOT):
        assert results_written(path) <= set(goals_of(path)), path.name


def test_a_goal_chooses_its_campaign():
    assert [path.name for path in campaigns(ROOT, ["G4"])] == ["test_gate_properties.py"]
    assert [path.name for path in campaigns(ROOT, ["g19", "STORY", "G1"])] == [
        "test_fault_injections.py",
        "test_story_effects.py",
    ]
    with pytest.raises(HdError, match="no long campaign of G16; there is DEMO"):
        campaigns(ROOT, ["G16"])


def test_a_campaign_without_its_goals_is_refused(tmp_path):
    path = tmp_path / "test_nothing.py"
    path.write_text("COUNT = 3\n")
    with pytest.raises(HdError, match="GOALS"):
        goals_of(path)


def test_no_test_file_is_named_by_a_number():
    """Files are named by their subject; goals and fault codes stand in them."""
    numbered = [path.name for path in (ROOT / "test").rglob("test_*.py") if re.match(r"test_[gfs]\d+_", path.name)]
    assert not numbered, numbered
