"""`hd completion`: a script that teaches the shell the commands, their options and the names that these take."""

from __future__ import annotations

import argparse
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field

from hd_control.cli.options import add_output_options, say, write_json

NAME = "completion"
HELP = "print the completion script for a shell"
EXAMPLE = """hd completion bash > ~/.local/share/bash-completion/completions/hd
  hd completion zsh > ~/.zfunc/_hd
  hd completion fish > ~/.config/fish/completions/hd.fish"""

BASH = """_hd() {{
    local word=${{COMP_WORDS[COMP_CWORD]}} words="" files=""
    case "${{COMP_CWORD}} ${{COMP_WORDS[1]}} ${{COMP_WORDS[COMP_CWORD-1]}}" in
        "1 "*) words="{commands} --help --version" ;;
{cases}
    esac
    mapfile -t COMPREPLY < <(compgen -W "$words" -- "$word"; [ -z "$files" ] || compgen -f -- "$word")
    [ -z "$files" ] || compopt -o filenames 2>/dev/null
}}
complete -o default -F _hd hd ./hd
"""
ZSH = """#compdef hd ./hd
_hd() {{
    local words_of_hd="" files=""
    case "$(( CURRENT - 1 )) $words[2] $words[CURRENT-1]" in
        "1 "*) words_of_hd="{commands} --help --version" ;;
{cases}
    esac
    [[ -z $words_of_hd ]] || compadd -- ${{=words_of_hd}}
    [[ -z $files ]] || _files
}}
if [[ $funcstack[1] == _hd ]]; then _hd "$@"; else compdef _hd hd ./hd; fi
"""
PLACES = {"add": "effects", "simulate": "scenarios"}
"""Commands whose first word is one of some names."""
OPTIONS = {
    "--model": "models",
    "--residuals": "models",
    "--map": "maps",
    "--plant": "plants",
    "--robot": "robots",
    "--scenario": "scenarios",
    "--hide": "hidden",
    "--effect": "hidden",
    "--nodes": "nodes",
}
"""Options whose value is one of some names, or a file."""
NO_FILE = {"scenarios", "hidden", "nodes", "effects"}


@dataclass
class Known:
    """One command: its help, long options, words in place of the first argument, and words by option. `files`: options
    that also take a file; `first_file`: so does the first argument."""

    help: str
    options: list[str] = field(default_factory=list)
    words: list[str] = field(default_factory=list)
    values: dict[str, list[str]] = field(default_factory=dict)
    files: set[str] = field(default_factory=set)
    first_file: bool = True


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Adds the options of this command."""
    parser.add_argument("shell", choices=["bash", "zsh", "fish"], help="for which shell")
    add_output_options(parser)


def names() -> dict[str, list[str]]:
    """What options and arguments take, by kind: effects, hidden effects, scenarios, shipped files, nodes."""
    from hd_control.core.resources import config_path
    from hd_control.drive.library import names_that_may_be_missing
    from hd_control.session.session import MODULES
    from hd_sim.hidden_effects import EFFECTS
    from hd_sim.scenario import SCENARIOS

    folders = {"models": "models", "maps": "maps", "plants": "plant", "robots": "robots"}
    found = {kind: sorted({path.stem for path in config_path(place).iterdir()}) for kind, place in folders.items()}
    more = {"effects": names_that_may_be_missing(), "hidden": EFFECTS, "scenarios": SCENARIOS, "nodes": MODULES}
    return found | {kind: sorted(some) for kind, some in more.items()}


def commands() -> dict[str, Known]:
    """Everything that can be completed, by command."""
    from hd_control.cli import main

    kinds, found = names(), {}
    for name in main.command_names():
        module = main.load_command(name)
        known = found[name] = Known(module.HELP, words=list(kinds.get(PLACES.get(name, ""), ())))
        known.first_file = not known.words
        _add_actions(known, main.command_parser(module), kinds)
    return found


def _add_actions(known: Known, parser: argparse.ArgumentParser, kinds: Mapping[str, list[str]]) -> None:
    """The options and choices of a parser, and of its own commands."""
    for action in parser._actions:
        long = [text for text in action.option_strings if len(text) > 2 and text not in known.options]
        known.options += long
        choices = [str(choice) for choice in action.choices] if action.choices is not None else []
        if not action.option_strings and choices:
            known.words, known.first_file = choices, False
        for text in action.option_strings:
            kind = OPTIONS.get(text, "")
            if choices or kind:
                known.values[text] = choices or kinds[kind]
                known.files |= {text} if not choices and kind not in NO_FILE else set()
        if isinstance(action, argparse._SubParsersAction):
            for inner in action.choices.values():
                _add_actions(known, inner, kinds)
                known.words, known.first_file = choices, False


def _cases(known: Mapping[str, Known], variable: str, files_anywhere: bool) -> Iterator[str]:
    """`POSITION COMMAND WORD-BEFORE) words=... ;;` for options with values, then for the commands themselves."""
    anywhere = " files=yes" if files_anywhere else ""
    for name, one in known.items():
        for option, words in one.values.items():
            files = " files=yes" if option in one.files else ""
            yield f'        *" {name} {option}") {variable}="{" ".join(words)}"{files} ;;'
        first = " ".join([*one.words, *one.options])
        yield f'        "2 {name} "*) {variable}="{first}"{" files=yes" if one.first_file else ""} ;;'
        yield f'        *" {name} "*) {variable}="{" ".join(one.options)}"{anywhere} ;;'


def bash_script(known: Mapping[str, Known]) -> str:
    """The script for bash, which offers files by itself where no word fits."""
    return BASH.format(commands=" ".join(known), cases="\n".join(_cases(known, "words", False)))


def zsh_script(known: Mapping[str, Known]) -> str:
    """The script for zsh."""
    return ZSH.format(commands=" ".join(known), cases="\n".join(_cases(known, "words_of_hd", True)))


def fish_script(known: Mapping[str, Known]) -> str:
    """The script for fish."""
    lines = []
    for name, one in known.items():
        quoted = one.help.replace("\\", "\\\\").replace("'", "\\'")
        seen = f"complete -c hd -n '__fish_seen_subcommand_from {name}'"
        lines.append(f"complete -c hd -n __fish_use_subcommand -f -a {name} -d '{quoted}'")
        if one.words:
            lines.append(f"{seen} -a '{' '.join(one.words)}'")
        for option in one.options:
            words = one.values.get(option)
            exclusive = "-r" if option in one.files else "-x"
            lines.append(f"{seen} -l {option[2:]}" + (f" {exclusive} -a '{' '.join(words)}'" if words else ""))
    return "\n".join(lines) + "\n"


SCRIPTS = {"bash": bash_script, "zsh": zsh_script, "fish": fish_script}


def run(arguments: argparse.Namespace) -> int:
    """Prints the script."""
    script = SCRIPTS[arguments.shell](commands())
    say(arguments, script.rstrip("\n"))
    write_json(arguments, {"schema": "hd.completion/1", "shell": arguments.shell, "script": script})
    return 0
