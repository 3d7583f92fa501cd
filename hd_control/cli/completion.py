"""`hd completion`: a script that teaches the shell the commands and their options."""

from __future__ import annotations

import argparse

from hd_control.cli.options import add_output_options, say, write_json

NAME = "completion"
HELP = "print the completion script for a shell"
EXAMPLE = "hd completion bash > ~/.local/share/bash-completion/completions/hd"

BASH = """_hd() {{
    local word=${{COMP_WORDS[COMP_CWORD]}} options
    case ${{COMP_CWORD}}:${{COMP_WORDS[1]}} in
        1:*) options="{commands} --help --version" ;;
{cases}
    esac
    mapfile -t COMPREPLY < <(compgen -W "$options" -- "$word")
}}
complete -o default -F _hd hd ./hd
"""

ZSH = """#compdef hd
autoload -U +X bashcompinit && bashcompinit
"""


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Adds the options of this command."""
    parser.add_argument("shell", choices=["bash", "zsh", "fish"])
    add_output_options(parser)


def commands() -> dict[str, tuple[str, list[str]]]:
    """Command to its one-line help and its long options."""
    from hd_control.cli import main

    found = {}
    for name in main.command_names():
        module = main.load_command(name)
        actions = main.command_parser(module)._actions
        found[name] = module.HELP, [text for action in actions for text in action.option_strings if len(text) > 2]
    return found


def bash_script(known: dict[str, tuple[str, list[str]]]) -> str:
    """The script for bash."""
    cases = [f'        *:{name}) options="{" ".join(options)}" ;;' for name, (_, options) in known.items()]
    return BASH.format(commands=" ".join(known), cases="\n".join(cases))


def fish_script(known: dict[str, tuple[str, list[str]]]) -> str:
    """The script for fish."""
    lines = []
    for name, (text, options) in known.items():
        quoted = text.replace("\\", "\\\\").replace("'", "\\'")
        lines.append(f"complete -c hd -n __fish_use_subcommand -a {name} -d '{quoted}'")
        lines += [f"complete -c hd -n '__fish_seen_subcommand_from {name}' -l {option[2:]}" for option in options]
    return "\n".join(lines) + "\n"


def run(arguments: argparse.Namespace) -> int:
    """Prints the script."""
    known = commands()
    script = fish_script(known) if arguments.shell == "fish" else bash_script(known)
    if arguments.shell == "zsh":
        script = ZSH + script
    say(arguments, script.rstrip("\n"))
    write_json(arguments, {"schema": "hd.completion/1", "shell": arguments.shell, "script": script})
    return 0
