"""The command line's frame: discovery, exit codes, one-line errors, outputs that are written whole or not at all."""

from __future__ import annotations

import argparse
import importlib
import io
import json
import os
import subprocess
import sys
from pathlib import Path
from types import ModuleType, SimpleNamespace

import numpy as np
import pytest

from hd_control import __version__
from hd_control.cli import main, options
from hd_control.core.errors import AnswerIsNo, HdError

HEAVY = {"numpy", "scipy", "pinocchio", "rclpy", "mcap", "rosbags", "yaml", "plotly", "pytest"}


def command(run: object, name: str = "probe") -> SimpleNamespace:
    """A command that exists only in a test."""
    return SimpleNamespace(NAME=name, HELP="a probe", EXAMPLE="hd probe", add_arguments=lambda parser: None, run=run)


@pytest.fixture
def probe(monkeypatch: pytest.MonkeyPatch) -> object:
    """Makes `hd probe` run the given function."""

    def install(run: object) -> None:
        monkeypatch.setattr(main, "load_command", lambda name: command(run))

    return install


def raises(error: BaseException) -> object:
    """A command that ends with this error."""

    def run(arguments: argparse.Namespace) -> int:
        raise error

    return run


@pytest.mark.parametrize("name", main.command_names())
def test_every_command_keeps_the_contract(name: str, capsys: pytest.CaptureFixture[str]) -> None:
    module = main.load_command(name)
    assert isinstance(module, ModuleType) and name == module.NAME
    assert module.HELP and "\n" not in module.HELP and len(module.HELP) < 100
    assert module.EXAMPLE.startswith(f"hd {name}")
    with pytest.raises(SystemExit) as end:
        main.command_parser(module).parse_args(["--help"])
    assert end.value.code == 0
    text = capsys.readouterr().out
    assert module.EXAMPLE in text and "--json" in text and "--quiet" in text


@pytest.mark.parametrize("argv", [["--help"], ["--version"]])
def test_nothing_heavy_is_imported(argv: list[str]) -> None:
    code = "import sys; from hd_control.cli.main import main; main(sys.argv[1:]); print(*sys.modules, file=sys.stderr)"
    done = subprocess.run([sys.executable, "-c", code, *argv], capture_output=True, text=True, check=True)
    loaded = {name.split(".")[0] for name in done.stderr.split()}
    assert "hd_control" in loaded and not loaded & HEAVY


@pytest.mark.parametrize(
    ("error", "code", "line"),
    [
        (HdError("the bag\nis empty"), 2, "hd: the bag is empty\n"),
        (AnswerIsNo("joint_3 differs"), 1, "hd: joint_3 differs\n"),
        (KeyboardInterrupt(), 130, "hd: interrupted\n"),
        (FileNotFoundError(2, "No such file or directory", "bag"), 2, "hd: bag: No such file or directory\n"),
    ],
)
def test_errors_become_one_line(
    error: BaseException, code: int, line: str, probe: object, capsys: pytest.CaptureFixture[str]
) -> None:
    probe(raises(error))
    assert main.main(["probe"]) == code
    seen = capsys.readouterr()
    assert seen.err == line and seen.out == ""


def test_a_defect_leaves_a_crash_log(
    probe: object, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setenv("XDG_STATE_HOME", str(tmp_path))
    probe(raises(ZeroDivisionError("float division by zero")))
    assert main.main(["probe"]) == main.DEFECT
    line = capsys.readouterr().err
    assert line.count("\n") == 1 and "Traceback" not in line
    (log,) = (tmp_path / "hd_control").iterdir()
    assert str(log) in line and "Traceback" in log.read_text() and "ZeroDivisionError" in log.read_text()


@pytest.mark.parametrize(
    ("argv", "words"),
    [
        (["tset"], "did you mean hd test?"),
        (["--verbose", "test"], "unknown option '--verbose' before the command"),
        (["completion", "csh"], "completion: argument shell: invalid choice"),
        (["completion", "bash", "--colour"], "completion: unknown option or word: --colour"),
        (["completion", "bash", "--qui"], "unknown option or word: --qui"),
    ],
)
def test_bad_usage_is_one_line(argv: list[str], words: str, capsys: pytest.CaptureFixture[str]) -> None:
    assert main.main(argv) == 2
    seen = capsys.readouterr()
    assert seen.err.startswith("hd: ") and words in seen.err and seen.err.count("\n") == 1 and not seen.out


def test_version_and_help(capsys: pytest.CaptureFixture[str]) -> None:
    assert main.main(["--version"]) == 0
    assert capsys.readouterr().out == f"hd {__version__}\n"
    assert main.main(["--help"]) == 0
    assert main.main([]) == 2
    assert all(f"  {name} " in capsys.readouterr().out for name in main.command_names()[:1])


def test_a_closed_pipe_is_no_error() -> None:
    code = "import os, sys; os.close(0)\nfrom hd_control.cli.main import main; sys.exit(main(['--help']))"
    read, write = os.pipe()
    os.close(read)
    done = subprocess.run([sys.executable, "-c", code], stdout=write, stderr=subprocess.PIPE, text=True)
    os.close(write)
    assert (done.returncode, done.stderr) == (0, "")


def arguments(**given: object) -> argparse.Namespace:
    """Parsed output options."""
    return argparse.Namespace(**{"json": None, "force": False, "quiet": False, **given})


def test_json_is_plain_and_never_overwrites(tmp_path: Path) -> None:
    path = tmp_path / "result.json"
    document = {"schema": "hd.probe/1", "rms": np.float64(0.5), "nan": float("nan"), "array": np.arange(3), 7: path}
    options.write_json(arguments(json=str(path)), document)
    known = {"schema": "hd.probe/1", "rms": 0.5, "nan": None, "array": [0, 1, 2], "7": str(path)}
    assert json.loads(path.read_text()) == known
    with pytest.raises(HdError, match="exists already"):
        options.write_json(arguments(json=str(path)), {"schema": "hd.other/1"})
    with pytest.raises(HdError, match="exists already"):
        options.check_outputs(arguments(json=str(path)))
    assert json.loads(path.read_text()) == known
    options.write_json(arguments(json=str(path), force=True), {"schema": "hd.other/1"})
    assert json.loads(path.read_text()) == {"schema": "hd.other/1"}
    assert [p.name for p in tmp_path.iterdir()] == ["result.json"]


def test_json_that_cannot_be_written_leaves_nothing(tmp_path: Path) -> None:
    with pytest.raises(TypeError, match="no form in JSON"):
        options.write_json(arguments(json=str(tmp_path / "a.json")), {"schema": "hd.probe/1", "thing": object()})
    with pytest.raises(HdError, match="does not exist"):
        options.write_json(arguments(json=str(tmp_path / "missing" / "a.json")), {"schema": "hd.probe/1"})
    with pytest.raises(ValueError, match="schema"):
        options.write_json(arguments(), {})
    assert not list(tmp_path.iterdir())


def test_json_on_standard_output_stands_alone(capsys: pytest.CaptureFixture[str]) -> None:
    options.say(arguments(json="-"), "for people")
    options.write_json(arguments(json="-"), {"schema": "hd.probe/1"})
    seen = capsys.readouterr()
    assert json.loads(seen.out) == {"schema": "hd.probe/1"} and seen.err == "for people\n"
    options.say(arguments(quiet=True), "for people")
    assert capsys.readouterr().out == ""


class Terminal(io.StringIO):
    """Standard error that claims to be a terminal."""

    def isatty(self) -> bool:
        return True


@pytest.mark.parametrize(("quiet", "seconds", "seen"), [(False, 3.0, True), (False, 1.0, False), (True, 3.0, False)])
def test_progress_appears_after_two_seconds(
    quiet: bool, seconds: float, seen: bool, monkeypatch: pytest.MonkeyPatch
) -> None:
    now, terminal = [0.0], Terminal()
    monkeypatch.setattr(options.time, "monotonic", lambda: now[0])
    monkeypatch.setattr(sys, "stderr", terminal)
    for _ in options.track(arguments(quiet=quiet), range(100), 100, "reading"):
        now[0] += seconds / 100
    assert ("reading [" in terminal.getvalue()) == seen
    assert terminal.getvalue().endswith("\r\033[K") == seen


def test_progress_is_for_terminals(monkeypatch: pytest.MonkeyPatch) -> None:
    now, pipe = [0.0], io.StringIO()
    monkeypatch.setattr(options.time, "monotonic", lambda: now[0])
    monkeypatch.setattr(sys, "stderr", pipe)
    for _ in options.track(arguments(), range(10), 10, "reading"):
        now[0] += 1.0
    assert pipe.getvalue() == ""


def test_ros_defaults_yield_to_the_user(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.delenv("ROS_AUTOMATIC_DISCOVERY_RANGE", raising=False)
    main.prepare_environment()
    assert os.environ["ROS_AUTOMATIC_DISCOVERY_RANGE"] == "LOCALHOST"
    monkeypatch.setenv("ROS_AUTOMATIC_DISCOVERY_RANGE", "SUBNET")
    main.prepare_environment()
    assert os.environ["ROS_AUTOMATIC_DISCOVERY_RANGE"] == "SUBNET"


def test_test_command_selects(monkeypatch: pytest.MonkeyPatch) -> None:
    module = importlib.import_module("hd_control.cli.test")
    chosen = module.selection(arguments(unknown=["-k", "gate"], long=None, fast=True))
    assert chosen[:4] == ["-k", "gate", "-m", "not slow"] and chosen[-1].endswith("/test")
    assert module.selection(arguments(unknown=[__file__], long=None, fast=False)) == [__file__]
    monkeypatch.setattr(module, "campaigns", lambda root, goals: [])
    with pytest.raises(AnswerIsNo, match="no long campaigns"):
        module.selection(arguments(unknown=[], long=[], fast=False))


def test_what_only_calculates_runs_beside(monkeypatch: pytest.MonkeyPatch) -> None:
    """With a debugger or one processor everything runs in this process, and the run beside starts no third."""
    from hd_control.cli.test import ALONE, SecondRun

    monkeypatch.delenv(ALONE, raising=False)
    monkeypatch.setattr(os, "cpu_count", lambda: 2)
    assert SecondRun.worth_it(["-x"]) and not SecondRun.worth_it(["-x", "--pdb"])
    monkeypatch.setenv(ALONE, "1")
    assert not SecondRun.worth_it(["-x"])
    monkeypatch.delenv(ALONE)
    monkeypatch.setattr(os, "cpu_count", lambda: 1)
    assert not SecondRun.worth_it(["-x"])


def test_the_two_runs_share_all_tests_that_are_asked_for() -> None:
    from hd_control.cli.test import narrowed

    assert narrowed(["-x"], "process") == ["-x", "-m", "process"]
    assert narrowed(["-m", "not slow or gate", "test"], "not process") == [
        "-m", "(not slow or gate) and not process", "test"
    ]  # fmt: skip
