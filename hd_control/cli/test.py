"""`hd test`: the whole test suite of the source tree, style and types included."""

from __future__ import annotations

import argparse
import ast
import importlib.util
import json
import os
import subprocess
import sys
import tempfile
import time
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from hd_control.cli.options import add_output_options, say, write_json
from hd_control.core.errors import AnswerIsNo, HdError

NAME = "test"
HELP = "run the test suite, style and type checks; unknown options go to pytest"
EXAMPLE = "hd test -k gate -x"
PASS_UNKNOWN = True

ROOT = Path(__file__).resolve().parents[2]
ALONE = "HD_TEST_ALONE"
"""Set in the environment of the second run: it starts no third."""
LIVE = "process"
"""Mark of the tests that start processes or look at a wall clock; all others may run beside anything."""


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Adds the options of this command."""
    parser.add_argument("--fast", action="store_true", help="leave out the tests marked slow")
    parser.add_argument(
        "--long",
        nargs="*",
        metavar="GOAL",
        help="run the long campaigns of test/campaigns instead, all or those of the goals named (G1 G3)",
    )
    parser.add_argument("--goals", action="store_true", help="print the reliability goals with the figures reached")
    parser.add_argument("--count", type=int, metavar="N", help="cases, runs or repeats of a campaign")
    parser.add_argument("--hours", type=float, metavar="H", help="simulated hours of G3 and G10 (1)")
    add_output_options(parser)


class Counter:
    """A pytest plugin that counts outcomes."""

    def __init__(self) -> None:
        self.outcomes = {"passed": 0, "failed": 0, "skipped": 0}
        self.failures: list[str] = []

    def add(self, other: dict[str, Any]) -> None:
        """Adds the counts of another run's document."""
        for name in self.outcomes:
            self.outcomes[name] += other.get(name, 0)
        self.failures += other.get("failures", [])

    def pytest_runtest_logreport(self, report: Any) -> None:
        """Counts the call of each test, and set-up or clean-up that went wrong."""
        if report.when == "call" or report.outcome != "passed":
            self.outcomes[report.outcome] += 1
            if report.outcome == "failed":
                self.failures.append(report.nodeid)


def goals_of(path: Path) -> tuple[str, ...]:
    """The goals that a campaign measures: the line `GOALS = ("G1",)` of its file, read without running it.

    Raises HdError if the file has no such line.
    """
    for node in ast.parse(path.read_text()).body:
        if isinstance(node, ast.Assign) and [ast.unparse(target) for target in node.targets] == ["GOALS"]:
            return tuple(ast.literal_eval(node.value))
    raise HdError(f'{path}: a campaign names its goals in one line, GOALS = ("G1",)')


def campaigns(root: Path, goals: list[str] | None = None) -> list[Path]:
    """The long campaigns of test/campaigns; all, or those that measure some goals, each once, in the order asked for.

    Raises HdError for a goal without a campaign.
    """
    found = {path: goals_of(path) for path in sorted((root / "test" / "campaigns").glob("test_*.py"))}
    if not goals:
        return [*found]
    known = sorted({goal for measured in found.values() for goal in measured})
    for goal in goals:
        if goal.upper() not in known:
            raise HdError(f"there is no long campaign of {goal}; there is {', '.join(known)}")
    return [*dict.fromkeys(path for goal in goals for path, measured in found.items() if goal.upper() in measured)]


def selection(arguments: argparse.Namespace) -> list[str]:
    """What pytest is asked to run. Raises AnswerIsNo if long campaigns are wanted and there are none."""
    given: list[str] = list(arguments.unknown)
    if arguments.long is not None:
        found = campaigns(ROOT, arguments.long)
        if not found:
            raise AnswerIsNo("there are no long campaigns yet; ./hd test runs everything that exists")
        say(arguments, "campaigns: " + ", ".join(path.stem.removeprefix("test_") for path in found))
        return [*map(str, found), *given]
    if arguments.fast:
        given += ["-m", "not slow"]
    named = any(not word.startswith("-") and Path(word.partition("::")[0]).exists() for word in given)
    return given if named else [*given, str(ROOT / "test")]


def print_goals(arguments: argparse.Namespace) -> int:
    """The goals with what the last campaigns reached; the figures are those that the campaigns wrote themselves."""
    folder = ROOT / "test" / "campaigns"
    goals = json.loads((folder / "goals.json").read_text())
    rows = []
    for goal in goals:
        path = folder / "results" / f"{goal['goal']}.json"
        result = json.loads(path.read_text()) if path.exists() else {}
        reached = goal.get("not_applicable") or result.get("reached", "not measured yet")
        rows.append(
            {**goal, "reached": reached, "passed": result.get("passed"), "cpu_seconds": result.get("cpu_seconds")}
        )
    for row in rows:
        mark = {True: "ok", False: "NOT REACHED"}.get(row["passed"], "-")
        mark = "N/A YET" if "not_applicable" in row else mark
        spent = f" ({row['cpu_seconds']} s of processor time)" if row.get("cpu_seconds") else ""
        say(arguments, f"{row['goal']:<4} {mark:<12} {row['figure']}\n     {row['reached']}{spent}; see {row['test']}")
    write_json(arguments, {"schema": "hd.goals/1", "goals": rows})
    return 0


def run(arguments: argparse.Namespace) -> int:
    """Runs pytest in this process. Exit code 0 if all passed, 1 if a test failed, 2 if pytest refused its options."""
    if not (ROOT / "test").is_dir():
        raise HdError("the tests belong to the source tree and are not installed; run ./hd test in a checkout")
    if arguments.goals:
        return print_goals(arguments)
    for name in ("count", "hours"):
        if getattr(arguments, name) is not None:
            os.environ[f"HD_{name.upper()}"] = str(getattr(arguments, name))
    for name in ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS"):  # before numpy is loaded: small fits lose by threads
        os.environ.setdefault(name, "1")
    try:
        import pytest
    except ImportError:
        raise HdError("pytest is not installed; run ./hd test, or install the extra: pip install '.[test]'") from None

    counter, start = Counter(), time.monotonic()
    quiet = ["-q", "--no-header"] if arguments.quiet else []
    sys.path.insert(0, str(ROOT))
    chosen = selection(arguments)
    second = None
    if chosen[-1:] == [str(ROOT / "test")] and SecondRun.worth_it(chosen):
        second = SecondRun(ROOT, [*quiet[:1], *chosen[:-1]])
        say(arguments, "the tests that only calculate run beside these; their lines come at the end")
        chosen = narrowed(chosen, LIVE)
    try:
        code = int(pytest.main(["--rootdir", str(ROOT), *quiet, *chosen], plugins=[counter]))
    finally:
        other = second.finish() if second is not None else {}
    counter.add(other)
    if pytest.ExitCode.INTERRUPTED in (code, other.get("exit_code")):
        raise KeyboardInterrupt
    nothing = int(pytest.ExitCode.NO_TESTS_COLLECTED)  # with -k one half may be empty
    codes = {code, other.get("exit_code", code)}
    code = max(codes - {nothing}, default=nothing)
    document = {"schema": "hd.test/1", **counter.outcomes, "failures": counter.failures}
    write_json(arguments, {**document, "seconds": round(time.monotonic() - start, 1), "exit_code": code})
    if second is not None:
        say(arguments, ", ".join(f"{count} {name}" for name, count in counter.outcomes.items()) + " in both halves")
    return {pytest.ExitCode.OK: 0, pytest.ExitCode.TESTS_FAILED: 1}.get(pytest.ExitCode(code), 2)


def narrowed(options: Sequence[str], expression: str) -> list[str]:
    """Options of pytest that choose, of the tests chosen by `options`, those with a mark."""
    found = list(options)
    for k, word in enumerate(found[:-1]):
        if word == "-m":
            found[k + 1] = f"({found[k + 1]}) and {expression}"
            return found
    return [*found, "-m", expression]


def _yield_to_live_nodes() -> None:
    """In the new process: runs only where nothing else wants to, and gives way at once."""
    try:
        os.sched_setscheduler(0, os.SCHED_IDLE, os.sched_param(0))
    except OSError:
        os.nice(19)


def _spread() -> list[str]:
    """Options that spread the files over all processors: the live half leaves one and a half of two unused."""
    if importlib.util.find_spec("xdist") is None:
        return []
    return ["-n", str(os.cpu_count() or 1), "--dist", "loadfile"]


class SecondRun:
    """Starts `hd test` on what only calculates; `finish` prints what it said and returns its document."""

    def __init__(self, root: Path, options: Sequence[str]) -> None:
        self._place = tempfile.TemporaryDirectory(prefix="hd_test_")
        self._document = Path(self._place.name) / "outcome.json"
        self._log = Path(self._place.name) / "log"
        command = [sys.executable, "-m", "hd_control.cli.main", "test", "--json", str(self._document)]
        with self._log.open("wb") as log:
            command += [*narrowed(options, f"not {LIVE}"), *_spread(), str(root / "test")]
            self._process = subprocess.Popen(
                command, cwd=root, stdout=log, stderr=subprocess.STDOUT, preexec_fn=_yield_to_live_nodes,
                env={**os.environ, ALONE: "1"},
            )  # fmt: skip

    @staticmethod
    def worth_it(options: Sequence[str]) -> bool:
        """True with two or more processors, unless a debugger is wanted: that needs the terminal."""
        alone = ALONE in os.environ or (os.cpu_count() or 1) == 1
        return not alone and not {"--pdb", "--trace"}.intersection(options)

    def finish(self) -> dict[str, Any]:
        """Waits, prints, and returns counts, failures and exit code. A run that died counts as exit code 3."""
        try:
            code = self._process.wait()
            sys.stdout.write(self._log.read_text(errors="replace"))
            sys.stdout.flush()
            if not self._document.exists():
                return {"passed": 0, "failed": 0, "skipped": 0, "failures": [], "exit_code": code or 3}
            found: dict[str, Any] = json.loads(self._document.read_text())
            return found
        finally:
            if self._process.poll() is None:
                self._process.terminate()
                self._process.wait()
            self._place.cleanup()
