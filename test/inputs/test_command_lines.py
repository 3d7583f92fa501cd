"""Any command line ends with one line of error and a known exit code; nothing is started, nothing is written."""

from __future__ import annotations

import random

import pytest

from hd_control.cli.main import command_names, load_command, main

WORDS = [
    "",
    "-",
    "--",
    "-x",
    "--json",
    "--force",
    "--quiet",
    "--seed",
    "-1",
    "nan",
    "1e400",
    "é",
    "a b",
    "\n",
    "$(id)",
    "*",
]
WORDS += [
    "../../x",
    "/dev/null",
    "/no/such/bag",
    "--json=",
    "--output",
    "-o",
    "--joint",
    "--help=1",
    "9" * 400,
    "[1,2]",
]
READERS = ("info", "recover", "export", "import")


@pytest.mark.parametrize("name", [n for n in command_names() if not getattr(load_command(n), "PASS_UNKNOWN", False)])
def test_an_unknown_option_ends_every_command_before_it_begins(name, capsys, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    rng = random.Random(name)
    for _ in range(15):
        words = [word for word in rng.choices(WORDS, k=rng.randrange(4)) if word != "--"]
        code = main([name, *words, "--no-such-option"])
        error = capsys.readouterr().err
        assert code == 2 and error.startswith("hd: ") and error.count("\n") == 1, (words, error)
    assert not list(tmp_path.iterdir())


@pytest.mark.parametrize("name", READERS)
def test_commands_that_read_refuse_what_is_no_recording(name, capsys, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    rng = random.Random(name)
    for _ in range(60):
        words = rng.choices(WORDS, k=rng.randrange(6))
        if any(word.startswith("--h") for word in words):
            continue
        code = main([name, *words])
        error = capsys.readouterr().err
        assert code == 2 and error.startswith("hd: ") and error.count("\n") == 1, (words, code, error)
    assert not list(tmp_path.iterdir())


@pytest.mark.parametrize(
    "argv", [["infp"], ["--info"], ["-"], ["\x00"], ["é" * 500], [""], ["../info"], ["main"], ["options"]]
)
def test_words_that_are_no_command(argv, capsys):
    assert main(argv) == 2
    assert capsys.readouterr().err.count("\n") == 1
