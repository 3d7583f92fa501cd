"""The whole demo on live nodes in lock-step, one joint, short motions: named, added, and tracked better."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from hd_control.demo import run as demo_run
from hd_control.demo.plan import StoryPlan, make_story
from hd_control.demo.run import DemoOptions, run_demo
from hd_sim.scenario import Scenario, make_plan

GOALS = ("DEMO",)

pytestmark = pytest.mark.process


def short_story(effect: str) -> StoryPlan:
    """One joint, 19 s of excitation, the goal of the demo."""
    story = make_story(2, "single_joint", effect)
    scenario = Scenario("excitation", "", "", lambda c: scenario.excitation(c.start, c.velocity_limit, c.random, 19.0))
    start, names = story.visible.start_position, story.visible.robot.joint_names
    return replace(story, excitation=make_plan(scenario, names, start, np.array([2.0]), story.visible.period, 2))


def test_the_hidden_effect_is_named_added_and_tracking_halves(tmp_path: Path, monkeypatch: Any) -> None:
    """The seal does not exist in the file system until the diagnosis is written: nothing can have read it."""
    monkeypatch.setenv("XDG_RUNTIME_DIR", str(tmp_path))
    folder, held, said = tmp_path / "demo", tmp_path / "held", list[str]()
    write, read = StoryPlan.seal, demo_run.open_seal
    monkeypatch.setattr(StoryPlan, "seal", lambda story, path: held.write_text("nothing here yet"))

    def opened(path: Path) -> Any:
        assert (folder / "diagnosis.json").stat().st_size > 0
        write(story, path)
        return read(path)

    monkeypatch.setattr(demo_run, "open_seal", opened)
    story = short_story("asymmetric_friction:3")
    outcome = run_demo(story, folder, DemoOptions(lockstep=True), said.append)
    assert outcome.right, said
    assert [(d["joint"], d["name"]) for d in outcome.diagnosed] == [("joint_5", "asymmetric_friction")]
    before, after, _, _ = outcome.errors("joint_5")
    assert after < 0.2 * before
    tracked = [outcome.rms(name)["joint_5"] for name in ("goal_before", "goal_after")]  # type: ignore[index]
    assert tracked[1] < 0.5 * tracked[0]
    assert outcome.fed_forward("joint_5")[0] == ["asymmetric_friction"]
    assert outcome.json("", "", 0.0)["missed_ticks_percent"] == 0.0
    assert not (folder / "logs").exists() and (folder / "controllers" / "torque_node.yaml").is_file()
