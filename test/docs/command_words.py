"""What is wrong with a command line that cannot be run here: unknown commands, options, nodes, topics, parameters."""

from __future__ import annotations

import argparse
import re
import shlex
from functools import lru_cache
from pathlib import Path

from hd_control.cli.main import UsageError, command_names, command_parser, load_command

ROOT = Path(__file__).resolve().parents[2]
TRANSITIONS = {"configure", "activate", "deactivate", "cleanup", "shutdown"}
VERBS = {"hz", "echo", "bw", "info", "pub"}


def problems(text: str, complete: bool = True) -> list[str]:
    """One sentence each; empty if nothing is. `complete`: the line has all that the command needs."""
    words = split(text)
    if not words:
        return []
    if words[0] in ("hd", "./hd"):
        return hd_problems(words[1:], complete)
    if words[0] == "ros2":
        return ros2_problems(words[1:])
    return [f"there is no {word}" for word in words if named_file(word) and not (ROOT / word).exists()]


def named_file(word: str) -> bool:
    """A word that can only be a file of this repository."""
    return word.startswith(("requirements/", "config/", "test/", "docs/", "launch/"))


def split(text: str) -> list[str]:
    """The words of a line, up to a redirection or pipe."""
    words = shlex.split(text, comments=True)
    ends = [place for place, word in enumerate(words) if word in (">", "|", "&&", "&", ";") or word.startswith(">")]
    return words[: min(ends)] if ends else words


def hd_problems(words: list[str], complete: bool) -> list[str]:
    """A command line of `hd`, by the parser of the command itself."""
    if not words or words[0] in ("--help", "--version", "help"):
        return []
    if words[0] not in command_names():
        return [f"there is no command hd {words[0]}"]
    module = load_command(words[0])
    parser = command_parser(module)
    if not complete:
        return [f"hd {words[0]} has no {word}" for word in options(words[1:]) if word not in known_options(parser)]
    try:
        _, unknown = parser.parse_known_args(words[1:])
    except UsageError as error:
        return [str(error)]
    except SystemExit:  # --help
        return []
    return [f"unknown {unknown}"] if unknown and not getattr(module, "PASS_UNKNOWN", False) else []


def options(words: list[str]) -> list[str]:
    """The options among some words."""
    return [word.partition("=")[0].rstrip(".,;") for word in words if re.match(r"--?[a-z]", word)]


def known_options(parser: argparse.ArgumentParser) -> set[str]:
    """Options of a command and of its own commands."""
    found = set(parser._option_string_actions)
    for action in parser._actions:
        if isinstance(action, argparse._SubParsersAction):
            for inner in action.choices.values():
                found |= known_options(inner)
    return found | ({"-k", "-x", "-m"} if parser.prog == "hd test" else set())


@lru_cache
def reference() -> str:
    """The generated page of the nodes, which another test keeps current."""
    return (ROOT / "docs" / "reference" / "nodes.md").read_text()


def section(node: str) -> str:
    """What the page says of one node, or of all for a common parameter."""
    parts = re.split(r"^## ", reference(), flags=re.MULTILINE)
    common = next((part for part in parts if part.startswith("Parameters of every node")), "")
    return next((part + common for part in parts if part.startswith(f"{node}\n")), "")


def ros2_problems(words: list[str]) -> list[str]:
    """A command line of the ROS 2 tools, as far as it names nodes, topics, parameters and services of this package."""
    kind, verb, *rest = [*words, "", ""]
    rest = [word for word in rest if word]
    if kind == "run":
        return [] if verb == "hd_control" and (section(rest[0]) or rest[0] == "hd") else [f"no executable {rest[:1]}"]
    if kind == "launch":
        return launch_problems(verb, rest)
    if kind == "topic":
        known = re.findall(r"`([\w/~]+)`", reference())
        return [] if verb == "list" or _last(rest, known) else [f"no topic {rest[:1]}"]
    if kind in ("param", "lifecycle"):
        return node_problems(kind, verb, rest)
    if kind == "service":
        node, _, service = rest[0].strip("/").rpartition("/")
        return [] if f"`~/{service}`" in section(node.split("/")[-1]) else [f"no service {rest[0]}"]
    if kind == "action":
        return [] if rest and rest[0].endswith("follow_joint_trajectory") else [f"no action {rest[:1]}"]
    return [] if kind in ("node", "bag", "doctor", "interface") else [f"ros2 {kind} is not checked; teach this test"]


def _last(rest: list[str], known: list[str]) -> bool:
    names = [word for word in rest if not word.startswith("-")]
    return bool(names) and any(names[0].endswith(f"/{k.removeprefix('~/').strip('/')}") for k in known)


def launch_problems(package: str, rest: list[str]) -> list[str]:
    """`ros2 launch hd_control robot.launch.py name:=value`."""
    path = ROOT / "launch" / rest[0]
    if package != "hd_control" or not path.is_file():
        return [f"no launch file {rest[0]}"]
    given = [word.partition(":=")[0] for word in rest[1:]]
    return [f"{rest[0]} has no argument {name}" for name in given if f'"{name}"' not in path.read_text()]


def node_problems(kind: str, verb: str, rest: list[str]) -> list[str]:
    """`ros2 param …` and `ros2 lifecycle …`."""
    node = rest[0].split("/")[-1] if rest else ""
    if not section(node):
        return [f"no node {rest[:1]}"]
    if kind == "lifecycle":
        return [] if verb in ("get", "list", "nodes") or rest[1] in TRANSITIONS else [f"no transition {rest[1]}"]
    if verb in ("get", "set", "describe"):
        part, _, name = rest[1].rpartition(".")
        owner = f"{part}_node" if node == "chain" and part else node
        return [] if f"| `{name}` |" in section(owner) else [f"{node} has no parameter {rest[1]}"]
    return [] if verb in ("list", "dump", "load") else [f"ros2 param has no {verb}"]
