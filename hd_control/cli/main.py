"""The `hd` command: finds the command's module, reads its options, runs it, and turns every end into an exit code.

A command is a module of this package with `NAME, HELP, EXAMPLE, add_arguments(parser), run(arguments) -> int`; the file
is named like the command (with `_` behind it where that is a Python keyword). `PASS_UNKNOWN = True` hands options that
the command does not know to `arguments.unknown`. Adding a command edits no other file.

Exit codes: 0 done · 1 the answer is "no" or a check failed · 2 bad usage or bad input · 3 partly read ·
70 a defect of this program (the crash log is named) · 130 interrupted.
"""

from __future__ import annotations

import argparse
import difflib
import importlib
import keyword
import os
import pkgutil
import sys
from collections.abc import Sequence
from types import ModuleType
from typing import NoReturn

from hd_control import __version__
from hd_control.cli import options
from hd_control.core.errors import HdError

DEFECT, INTERRUPTED = 70, 130
_PARTS = {"main", "options"}  # modules of this package that are no commands
_PACKAGE = "hd_control.cli"


class UsageError(HdError):
    """The command line itself is wrong."""


class Parser(argparse.ArgumentParser):
    """A parser that raises UsageError, one line, instead of printing the usage and leaving the program."""

    def error(self, message: str) -> NoReturn:
        command = self.prog.partition(" ")[2]
        raise UsageError(f"{command + ': ' if command else ''}{message}; see {self.prog} --help")


def command_names() -> list[str]:
    """The commands that exist, by name, without importing them."""
    folder = list(importlib.import_module(_PACKAGE).__path__)
    names = {module.name for module in pkgutil.iter_modules(folder)}
    return sorted(name.rstrip("_") for name in names if name not in _PARTS and not name.startswith("_"))


def load_command(name: str) -> ModuleType:
    """The command's module. Raises UsageError with the nearest name if there is none."""
    known = command_names()
    if name not in known:
        near = difflib.get_close_matches(name, known, 1)
        hint = f"did you mean hd {near[0]}?" if near else f"there is {', '.join(known)}"
        raise UsageError(f"no command {name!r}; {hint}")
    return importlib.import_module(f"{_PACKAGE}.{name + '_' if keyword.iskeyword(name) else name}")


def command_parser(module: ModuleType) -> Parser:
    """The parser of one command, with the options that every command has."""
    parser = Parser(
        prog=f"hd {module.NAME}",
        description=module.HELP,
        epilog=f"example:\n  {module.EXAMPLE}",
        formatter_class=argparse.RawDescriptionHelpFormatter,
        allow_abbrev=False,
    )
    module.add_arguments(parser)
    if not any("--json" in action.option_strings for action in parser._actions):
        options.add_output_options(parser)
    return parser


def help_text() -> str:
    """The list of commands."""
    lines = ["usage: hd COMMAND [options]      hd COMMAND --help      hd --version", ""]
    lines += [f"  {name:<12}{load_command(name).HELP}" for name in command_names()]
    return "\n".join(lines)


def prepare_environment() -> None:
    """Defaults for ROS, each only where the user set nothing: traffic stays on this machine, logs have a place."""
    os.environ.setdefault("ROS_AUTOMATIC_DISCOVERY_RANGE", "LOCALHOST")
    if not os.environ.get("AMENT_PREFIX_PATH"):
        os.environ["AMENT_PREFIX_PATH"] = sys.prefix
    if not os.environ.get("HOME") and not os.environ.get("ROS_LOG_DIR"):
        os.environ["ROS_LOG_DIR"] = os.path.abspath("log")


def dispatch(argv: Sequence[str]) -> int:
    """Runs one command line and returns its exit code. Errors pass through."""
    if not argv or argv[0] in ("-h", "--help", "help"):
        print(help_text())
        return 0 if argv else 2
    if argv[0] in ("-V", "--version"):
        print(f"hd {__version__}")
        return 0
    if argv[0].startswith("-"):
        raise UsageError(f"unknown option {argv[0]!r} before the command; see hd --help")
    module = load_command(argv[0])
    parser = command_parser(module)
    arguments, unknown = parser.parse_known_args(argv[1:])
    if unknown and not getattr(module, "PASS_UNKNOWN", False):
        parser.error(f"unknown option or word: {' '.join(unknown)}")
    arguments.unknown = unknown
    options.check_outputs(arguments)
    prepare_environment()
    code: int = module.run(arguments)
    return code


def write_crash_log(argv: Sequence[str]) -> str:
    """Stores the present exception and where it happened; returns the path."""
    import platform
    import tempfile
    import traceback
    from pathlib import Path

    state = os.environ.get("XDG_STATE_HOME") or os.path.expanduser("~/.local/state")
    text = f"hd {__version__}\nPython {sys.version}\n{platform.platform()}\n{list(argv)}\n\n{traceback.format_exc()}"
    for folder in (Path(state, "hd_control"), Path(tempfile.gettempdir())):
        try:
            folder.mkdir(parents=True, exist_ok=True)
            handle, name = tempfile.mkstemp(prefix="crash-", suffix=".log", dir=folder)
            with os.fdopen(handle, "w") as stream:
                stream.write(text)
            return name
        except OSError:
            continue
    return "no crash log could be written"


def _one_line(error: BaseException) -> str:
    return " ".join(str(error).split()) or type(error).__name__


def main(argv: Sequence[str] | None = None) -> int:
    """Entry point: runs the command line, prints errors on one line, returns the exit code."""
    argv = list(sys.argv[1:] if argv is None else argv)
    try:
        code = dispatch(argv)
        sys.stdout.flush()
        return code
    except HdError as error:
        print(f"hd: {_one_line(error)}", file=sys.stderr)
        return error.exit_code
    except KeyboardInterrupt as error:
        print(f"hd: interrupted{f'; {_one_line(error)}' if str(error) else ''}", file=sys.stderr)
        return INTERRUPTED
    except BrokenPipeError:
        # The reader has seen enough. Python would complain once more when it closes the stream at exit.
        os.dup2(os.open(os.devnull, os.O_WRONLY), 1)
        return 0
    except OSError as error:
        if error.filename is None:
            return _defect(error, argv)
        print(f"hd: {error.filename}: {error.strerror}", file=sys.stderr)
        return HdError.exit_code
    except Exception as error:
        return _defect(error, argv)


def _defect(error: Exception, argv: Sequence[str]) -> int:
    log = write_crash_log(argv)
    print(f"hd: unexpected {type(error).__name__}: {_one_line(error)}; details in {log}", file=sys.stderr)
    return DEFECT


if __name__ == "__main__":
    sys.exit(main())
