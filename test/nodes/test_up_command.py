"""`hd up`: says when the drives obey, and stays up with a reason where they do not."""

from __future__ import annotations

from pathlib import Path

import pytest
from node_runs import random_domain

from hd_control.cli.main import main
from hd_control.session.session import Session

WORDS = ["up", "--robot", "single_joint_5", "--lockstep", "--one-process"]


@pytest.fixture(autouse=True)
def _own_domain(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("ROS_DOMAIN_ID", str(random_domain()))


def test_it_says_when_the_drives_are_armed_and_ends_after_its_ticks(capfd: pytest.CaptureFixture[str]) -> None:
    assert main([*WORDS, "--ticks", "300"]) == 0
    said = capfd.readouterr().out
    assert "armed: the drives obey, goals are taken" in said and said.rstrip().endswith("stopped")


def test_drives_that_do_not_obey_are_a_reason_and_no_end(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capfd: pytest.CaptureFixture[str]
) -> None:
    """A plant that stands still at tick 20; Ctrl-C ends the command in order."""
    paused, arming = tmp_path / "paused.yaml", Session.arming

    def interrupted(session: Session, ticks: int) -> None:
        raise KeyboardInterrupt

    paused.write_text("chain:\n  ros__parameters:\n    pause_at_tick: 20\n")
    monkeypatch.setattr(Session, "arming", lambda session: arming(session, 1.0))
    monkeypatch.setattr(Session, "stay", interrupted)
    assert main([*WORDS, "--params", "chain", str(paused)]) == 0
    said = capfd.readouterr().out
    assert "not armed within 1 s: the drives are WARMING" in said and "it goes on" in said
    assert said.rstrip().endswith("stopped")
