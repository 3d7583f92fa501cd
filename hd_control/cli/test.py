"""`hd test`: the whole test suite of the source tree, style and types included."""

from __future__ import annotations

import argparse
import sys
import time
from pathlib import Path
from typing import Any

from hd_control.cli.options import add_output_options, say, write_json
from hd_control.core.errors import AnswerIsNo, HdError

NAME = "test"
HELP = "run the test suite, style and type checks; unknown options go to pytest"
EXAMPLE = "hd test -k gate -x"
PASS_UNKNOWN = True

ROOT = Path(__file__).resolve().parents[2]


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Adds the options of this command."""
    parser.add_argument("--fast", action="store_true", help="leave out the tests marked slow")
    parser.add_argument("--long", action="store_true", help="run the long campaigns of test/campaigns instead")
    add_output_options(parser)


class Counter:
    """A pytest plugin that counts outcomes."""

    def __init__(self) -> None:
        self.outcomes = {"passed": 0, "failed": 0, "skipped": 0}
        self.failures: list[str] = []

    def pytest_runtest_logreport(self, report: Any) -> None:
        """Counts the call of each test, and set-up or clean-up that went wrong."""
        if report.when == "call" or report.outcome != "passed":
            self.outcomes[report.outcome] += 1
            if report.outcome == "failed":
                self.failures.append(report.nodeid)


def campaigns(root: Path) -> list[Path]:
    """The long campaigns that exist."""
    return sorted((root / "test" / "campaigns").glob("test_*.py"))


def selection(arguments: argparse.Namespace) -> list[str]:
    """What pytest is asked to run. Raises AnswerIsNo if long campaigns are wanted and there are none."""
    given: list[str] = list(arguments.unknown)
    if arguments.long:
        found = campaigns(ROOT)
        if not found:
            raise AnswerIsNo("there are no long campaigns yet; ./hd test runs everything that exists")
        say(arguments, "campaigns: " + ", ".join(path.stem.removeprefix("test_") for path in found))
        return [*map(str, found), *given]
    if arguments.fast:
        given += ["-m", "not slow"]
    named = any(not word.startswith("-") and Path(word.partition("::")[0]).exists() for word in given)
    return given if named else [*given, str(ROOT / "test")]


def run(arguments: argparse.Namespace) -> int:
    """Runs pytest in this process. Exit code 0 if all passed, 1 if a test failed, 2 if pytest refused its options."""
    if not (ROOT / "test").is_dir():
        raise HdError("the tests belong to the source tree and are not installed; run ./hd test in a checkout")
    try:
        import pytest
    except ImportError:
        raise HdError("pytest is not installed; run ./hd test, or install the extra: pip install '.[test]'") from None
    counter, start = Counter(), time.monotonic()
    quiet = ["-q", "--no-header"] if arguments.quiet else []
    sys.path.insert(0, str(ROOT))
    code = pytest.main(["--rootdir", str(ROOT), *quiet, *selection(arguments)], plugins=[counter])
    document = {"schema": "hd.test/1", **counter.outcomes, "failures": counter.failures}
    write_json(arguments, {**document, "seconds": round(time.monotonic() - start, 1), "exit_code": int(code)})
    if code == pytest.ExitCode.INTERRUPTED:
        raise KeyboardInterrupt
    return {pytest.ExitCode.OK: 0, pytest.ExitCode.TESTS_FAILED: 1}.get(pytest.ExitCode(code), 2)
