"""`docs/reference/commands.md`: every command of `hd` with its options, read from the parsers themselves."""

from __future__ import annotations

import argparse
from collections.abc import Iterator

from hd_control.cli import main
from hd_control.reference.markdown import code, page, table


def command_page() -> str:
    """The page."""
    intro = [
        'Exit codes: 0 done; 1 the answer is "no" or a check failed; 2 bad usage or bad input; 3 partly read; 70 a',
        "defect of this program; 130 interrupted. Every command has `--help`, `--json FILE`, `--force` and",
        "`--quiet`; they are not repeated below.",
    ]
    names = main.command_names()
    rows = ([f"[`hd {name}`](#hd-{name})", main.load_command(name).HELP] for name in names)
    overview = table(["command", "does"], rows)
    sections = [section for name in names for section in _command(name)]
    return page("Commands", "the parsers of `hd`", intro, overview, *sections)


def _command(name: str) -> Iterator[list[str]]:
    module = main.load_command(name)
    parser = main.command_parser(module)
    yield [f"## hd {name}"]
    yield [_sentence(module.HELP)]
    yield ["```sh parse", *(line.strip() for line in module.EXAMPLE.splitlines()), "```"]
    yield from _options(parser)
    if getattr(module, "PASS_UNKNOWN", False):
        yield ["Options that it does not know are handed on."]


def _options(parser: argparse.ArgumentParser) -> Iterator[list[str]]:
    rows = [_row(action) for action in _shown(parser)]
    yield table(["argument", "meaning"], rows)
    for action in parser._actions:
        if isinstance(action, argparse._SubParsersAction):
            for word, inner in action.choices.items():
                yield [f"### {parser.prog} {word}"]
                yield from _options(inner)


def _shown(parser: argparse.ArgumentParser) -> Iterator[argparse.Action]:
    """What is not the same everywhere."""
    common = {"--help", "--json", "--force", "--quiet"}
    for action in parser._actions:
        words = isinstance(action, argparse._SubParsersAction)
        if not common & set(action.option_strings) and action.help is not argparse.SUPPRESS and not words:
            yield action


def _row(action: argparse.Action) -> tuple[str, str]:
    value = "" if action.nargs == 0 else _value(action)
    names = action.option_strings or [""]
    shown = ", ".join(code(f"{name} {value}".strip()) for name in names)
    required = " **required**" if action.option_strings and action.required else ""
    repeatable = isinstance(action, argparse._AppendAction) and "repeatable" not in (action.help or "")
    return shown, (action.help or "") + ("; repeatable" if repeatable else "") + required


def _value(action: argparse.Action) -> str:
    if action.metavar is not None:
        name = action.metavar if isinstance(action.metavar, str) else " ".join(action.metavar)
    elif action.choices is not None:
        name = "{" + ",".join(str(choice) for choice in action.choices) + "}"
    else:
        name = action.dest.upper()
    return {"+": f"{name} ...", "*": f"[{name} ...]", "?": f"[{name}]"}.get(str(action.nargs), name)


def _sentence(text: str) -> str:
    return f"{text[0].upper()}{text[1:]}."
