"""Completion in the shells themselves: commands, options, and the names that options and arguments take."""

from __future__ import annotations

import shutil
import subprocess
from pathlib import Path

import pytest

from hd_control.cli import completion, main

ASK = {
    "bash": 'source {script}; COMP_WORDS=({words}) COMP_CWORD={index}; _hd; printf "%s\\n" "${{COMPREPLY[@]}}"',
    "fish": "source {script}; complete -C '{line}'",
    # zsh completes in its line editor only: the function is called as it does, and prints what it would offer.
    "zsh": 'compdef() {{}}; compadd() {{ print -l -- "$@" }}; _files() {{ print FILES }}; source {script}; '
    "words=({words}); CURRENT={number}; _hd",
}
CASES = [
    (["hd", "dia"], "diagnose", "arm_a"),
    (["hd", "diagnose", "bag", "--mo"], "--model", "--nothing"),
    (["hd", "diagnose", "bag", "--model", "arm"], "arm_b", "backlash"),
    (["hd", "add", "kine"], "kinematic_error", "coulomb_friction"),
    (["hd", "simulate", "coor"], "coordinated", "diagnose"),
    (["hd", "simulate", "coordinated", "--hide", "tooth"], "tooth_defect", "coordinated"),
    (["hd", "import", "x.csv", "--map", "ur"], "ur10", "arm_a"),
    (["hd", "challenge", "ca"], "campaign", "arm_a"),
    (["hd", "challenge", "new", "--ki"], "--kind", "campaign"),
    (["hd", "bench", "--only", "work"], "workbench", "arm_a"),
    (["hd", "up", "--robot", "arm"], "arm_c", "--robot"),
]


@pytest.fixture(scope="module")
def scripts(tmp_path_factory: pytest.TempPathFactory) -> dict[str, Path]:
    known, folder = completion.commands(), tmp_path_factory.mktemp("completion")
    found = {}
    for shell, make in completion.SCRIPTS.items():
        found[shell] = folder / shell
        found[shell].write_text(make(known))
    return found


def offered(shell: str, script: Path, words: list[str]) -> list[str]:
    """What a shell offers for the last word."""
    if shutil.which(shell) is None:
        pytest.skip(f"{shell} is not installed")
    parts = {"script": script, "words": " ".join(words), "index": len(words) - 1, "number": len(words)}
    command = ASK[shell].format(**parts, line=" ".join(words))
    plain = {"bash": ["--norc"], "zsh": ["-f"], "fish": ["--no-config"]}[shell]
    done = subprocess.run([shell, *plain, "-c", command], capture_output=True, text=True, cwd=script.parent)
    assert done.returncode == 0 and not done.stderr, done.stderr
    return [line.split("\t")[0] for line in done.stdout.splitlines()]


@pytest.mark.parametrize("shell", ["bash", "zsh", "fish"])
@pytest.mark.parametrize(("words", "wanted", "unwanted"), CASES, ids=[" ".join(words) for words, _, _ in CASES])
def test_the_shell_offers(scripts: dict[str, Path], shell: str, words: list[str], wanted: str, unwanted: str) -> None:
    found = offered(shell, scripts[shell], words)
    assert wanted in found and unwanted not in found, found


def test_bash_offers_files_too(scripts: dict[str, Path]) -> None:
    for words in (["hd", "info", "ba"], ["hd", "diagnose", "bag", "--model", "ba"]):
        assert "bash" in offered("bash", scripts["bash"], words)


def test_every_command_is_known(capsys: pytest.CaptureFixture[str]) -> None:
    for shell in completion.SCRIPTS:
        assert main.main(["completion", shell]) == 0
        script = capsys.readouterr().out
        assert all(name in script for name in main.command_names())
