"""The pieces of the story: what is drawn and sealed, what must be free before, and what it says at the end."""

from __future__ import annotations

import contextlib
import json
import shutil
import socket
import time
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from hd_control.cli.main import main
from hd_control.core.errors import ConfigError, HdError
from hd_control.demo import run as demo_run
from hd_control.demo.live import Phase
from hd_control.demo.outcome import Outcome, table
from hd_control.demo.picture import story_figure, write_page
from hd_control.demo.plan import make_story
from hd_control.lab.signals.tracking import Tracking
from hd_sim.truth import open_seal

# What is hidden ------------------------------------------------------------------------------------------------------


def test_a_seed_draws_effect_and_joint_and_other_seeds_draw_others() -> None:
    stories = [make_story(seed) for seed in range(12)]
    assert make_story(3).hidden == stories[3].hidden
    assert len({story.hidden.name for story in stories}) >= 3 and len({s.hidden.joint for s in stories}) == 2


def test_the_goal_comes_back_to_where_it_began() -> None:
    (_, goal) = make_story(0).goal.goals[0]
    np.testing.assert_array_equal(goal.positions[0], goal.positions[-1])


def test_the_seal_holds_the_joint_the_effect_and_its_values(tmp_path: Path) -> None:
    make_story(1, effect="joint_4/gauge_gain:2").seal(tmp_path / "seal")
    assert "gauge_gain" not in (tmp_path / "seal").read_text()
    truth = open_seal(tmp_path / "seal")
    assert truth["joints"]["joint_4"]["names"] == ["gauge_gain"]
    assert abs(truth["joints"]["joint_4"]["parameters"]["gauge_gain"]["gauge_gain_error"]) == pytest.approx(0.042)
    assert truth["joints"]["joint_5"] == {"names": [], "unknown": [], "parameters": {}}


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("kinematic_eror", "did you mean"),
        ("joint_9/payload", "there is joint_1"),
        ("payload:much", "not a number"),
        ("payload:0", "above 0"),
        ("payload:nan", "above 0"),
    ],
)
def test_a_wrong_effect_is_named(text: str, words: str) -> None:
    with pytest.raises(ConfigError, match=words):
        make_story(0, effect=text)


# Before it starts ----------------------------------------------------------------------------------------------------


def test_a_second_demo_waits_its_turn(tmp_path: Path, monkeypatch: Any, capsys: Any) -> None:
    monkeypatch.setenv("XDG_RUNTIME_DIR", str(tmp_path))
    with demo_run.alone("writing bags/one"):
        assert main(["demo", "-o", str(tmp_path / "two")]) == 2
        said = capsys.readouterr().err
        assert "another hd demo runs" in said and "bags/one" in said and said.count("\n") == 1
    assert not (tmp_path / "two").exists()
    with demo_run.alone("again"):
        pass


def test_a_domain_in_use_is_refused_and_a_free_one_found(tmp_path: Path, monkeypatch: Any, capsys: Any) -> None:
    monkeypatch.setenv("XDG_RUNTIME_DIR", str(tmp_path))
    domain = demo_run.free_domain(None)
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as other:
        other.bind(("0.0.0.0", 7410 + 250 * domain))
        assert demo_run.domain_in_use(domain)
        assert main(["demo", "-o", str(tmp_path / "b"), "--domain", str(domain)]) == 2
    assert f"ROS domain {domain} is in use" in capsys.readouterr().err
    assert not (tmp_path / "b").exists()
    with pytest.raises(HdError, match="outside"):
        demo_run.free_domain(4000)


def test_a_full_disk_is_seen_before_anything_starts(tmp_path: Path, monkeypatch: Any, capsys: Any) -> None:
    usage = SimpleNamespace(total=10**12, used=10**12 - 10**8, free=10**8)
    monkeypatch.setattr(shutil, "disk_usage", lambda _: usage)
    assert main(["demo", "-o", str(tmp_path / "b")]) == 2
    said = capsys.readouterr().err
    assert "100 MB are free" in said and "are needed" in said and not (tmp_path / "b").exists()


def test_a_folder_that_is_no_demo_is_never_removed(tmp_path: Path, capsys: Any) -> None:
    (tmp_path / "mine").mkdir()
    (tmp_path / "mine" / "thesis.tex").write_text("years of work")
    assert main(["demo", "-o", str(tmp_path / "mine")]) == 2
    assert main(["demo", "-o", str(tmp_path / "mine"), "--force"]) == 2
    assert "no folder of hd demo" in capsys.readouterr().err and (tmp_path / "mine" / "thesis.tex").exists()


def test_an_interruption_names_what_is_kept(tmp_path: Path, monkeypatch: Any) -> None:
    monkeypatch.setenv("XDG_RUNTIME_DIR", str(tmp_path))

    def stopped(story: Any, folder: Path, *_: Any) -> Outcome:
        (folder / "excitation").mkdir()
        raise KeyboardInterrupt

    monkeypatch.setattr(demo_run, "_with_fallback", stopped)
    with pytest.raises(KeyboardInterrupt, match=r"kept in .*demo: excitation$"):
        demo_run.run_demo(make_story(0), tmp_path / "demo", demo_run.DemoOptions(), print)


def test_ctrl_c_in_a_command_ends_its_workers_too(tmp_path: Path, monkeypatch: Any) -> None:
    script = tmp_path / "python"
    script.write_text("#!/bin/sh\nsleep 61.7301 &\ntouch started\nsleep 61.7301\n")
    script.chmod(0o755)
    monkeypatch.setattr(demo_run.sys, "executable", str(script))
    pause = time.sleep

    def interrupted(seconds: float) -> None:
        pause(seconds)
        if (tmp_path / "started").exists():
            raise KeyboardInterrupt

    monkeypatch.setattr(demo_run.time, "sleep", interrupted)
    with pytest.raises(KeyboardInterrupt):
        demo_run.Commands(tmp_path, lambda _: None).run(["ladder"], "ladder.json")
    monkeypatch.undo()
    end = time.monotonic() + 10.0
    while sleepers() and time.monotonic() < end:
        time.sleep(0.05)
    assert not sleepers()


def sleepers() -> list[str]:
    """Processes of the script that still run."""
    found = []
    for path in Path("/proc").glob("[0-9]*/cmdline"):
        with contextlib.suppress(OSError):
            text = path.read_text()
            found += [text] if "61.7301" in text else []
    return found


def test_a_command_that_fails_says_its_own_line(tmp_path: Path) -> None:
    with pytest.raises(HdError, match=r"hd info nothing: .*nothing"):
        demo_run.Commands(tmp_path, lambda _: None).run(["info", "nothing"], "info.json")


# What it says --------------------------------------------------------------------------------------------------------


def made_outcome(after: float, note: str = "", named: str = "kinematic_error") -> Outcome:
    """The outcome of a story with a tracking error of 100 µrad before."""
    time = np.arange(1000, dtype=np.int64) * 1_000_000
    wave = np.where(np.arange(1000) % 200 < 100, 1.0, -1.0)[:, None]
    tracking = {
        name: Tracking(("joint_5",), time, np.zeros((1000, 1)), size * wave)
        for name, size in (("goal_before", 1e-4), ("goal_after", after))
    }
    rung = {"parameters_count": 5, "error_train": 1e-5, "noise_floor": 1e-6, "model_sha256": ""}
    rungs = [
        {**rung, "effect": e, "error_held_out": v} for e, v in (("as given", 5e-5), ("refit", 5e-5), (named, 2e-6))
    ]
    effect = {"name": named, "confidence": 0.97, "parameters": {}}
    row = {"joint": "joint_5", "effect": named, "applied": not note, "note": note, "before": 0.0, "value": 1e-4}
    phases = {n: Phase(Path(n), (0, 1), 0.0) for n in ("excitation", "goal_before", "goal_after")}
    truth = {"names": ["kinematic_error"], "unknown": [], "parameters": {}}
    hidden = {"joint": "joint_5", "name": "kinematic_error", "strength": 4.0}
    correct = named == "kinematic_error"
    score = {
        "correct": correct,
        "missed": () if correct else ("kinematic_error",),
        "wrong": () if correct else (named,),
    }
    return Outcome(
        "demo",
        "lockstep",
        phases,
        tracking,
        diagnosis={"joints": {"joint_5": {"verdict": "missing", "effects": [effect], "unknown": None}}},
        ladder={"joints": {"joint_5": {"rungs": rungs, "unit": "rad", "stopped_because": "noise floor reached"}}},
        applied={"rows": [row], "changed": {}},
        truth={"joints": {"joint_5": truth}, "world": {"effects": [hidden]}},
        scores={"joint_5": score},
    )


def test_a_halved_error_and_a_right_answer_are_said() -> None:
    text = "\n".join(table(made_outcome(3e-5)))
    assert "the diagnosis is right" in text and "tracking error is 30 % of before" in text
    assert "50 µrad -> 2 µrad (4 %); noise 1 µrad" in text and "3.3 times smaller" in text


def test_an_effect_that_no_feed_forward_helps_is_said_with_its_reason() -> None:
    text = table(made_outcome(9.9e-5, note="belongs to the robot description"))[-1]
    assert "better on paper only" in text and "belongs to the robot description" in text and "99 %" in text


def test_less_than_half_and_a_wrong_name_are_not_glossed_over() -> None:
    assert "not halved" in table(made_outcome(7e-5))[-1]
    outcome = made_outcome(3e-5, named="backlash")
    assert "the diagnosis is WRONG: joint_5: missed kinematic_error; wrong backlash" in table(outcome)
    assert outcome.json("", "", 1.0)["right"] is False


def test_json_and_picture_hold_the_numbers(tmp_path: Path) -> None:
    outcome = made_outcome(3e-5)
    document = json.loads(json.dumps(outcome.json("demo.html", "", 12.0)))
    assert document["schema"] == "hd.demo/1" and document["hidden_effects"][0]["name"] == "kinematic_error"
    assert document["tracking_before"]["joint_5"] == pytest.approx(1e-4, rel=0.01)
    assert document["ladder"]["joint_5"][-1]["error_held_out"] == 2e-6
    figure = story_figure(outcome)
    bars = [trace for trace in figure["data"] if trace.get("xaxis") == "x3"]
    assert [bar["y"][0] for bar in bars] == pytest.approx([100.0, 30.0], rel=0.01)
    write_page(tmp_path / "demo.html", outcome, figure, table(outcome))
    page = (tmp_path / "demo.html").read_text(encoding="utf-8")
    assert 'src="http' not in page and "Hidden, opened last" in page
