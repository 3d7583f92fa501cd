"""`hd challenge new/check/campaign`: hidden effects to find, answers scored against the seal, blind campaigns."""

from __future__ import annotations

import argparse
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from hd_sim.puzzles.campaign import Campaign
    from hd_sim.puzzles.puzzle import Challenge, Score

NAME = "challenge"
HELP = "hide an effect, check a diagnosis against the seal, or run a blind campaign"
EXAMPLE = """hd challenge new --seed 7 -o puzzle
  hd challenge check puzzle diagnosis.json
  hd challenge campaign --n 100 --seed 200000 --jobs 2 --record campaign.jsonl"""
WORLDS = ("both", "home", "second", "real_like", "any", "library", "judge")
KINDS = ("mix", "none", "one", "two", "unknown", "poor")


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """The three actions and their options."""
    from hd_control.cli.options import add_output_options

    actions = parser.add_subparsers(dest="action", metavar="new | check | campaign", required=True)
    new = actions.add_parser("new", help="make a pair of bags with something hidden", description=_NEW)
    new.add_argument("--seed", type=int, help="what is drawn depends on it alone [a random one]")
    new.add_argument("-o", "--output", metavar="FOLDER", required=True, help="folder to make")
    new.add_argument("--kind", choices=KINDS, default="mix", help="what may be hidden [mix]")
    new.add_argument("--effect", metavar="NAME[:STRENGTH]", action="append", default=[], help="hide this; repeatable")
    new.add_argument("--motion", metavar="KIND", default="", help="kind of recording, for --effect [general]")
    new.add_argument("--world", choices=("home", "second"), default="home", help="whose physics [home]")
    new.add_argument("--arm", action="store_true", help="a seven-joint arm in place of one joint")
    check = actions.add_parser("check", help="score a diagnosis against the seal", description=_CHECK)
    check.add_argument("folder", metavar="FOLDER", help="folder of the challenge")
    check.add_argument("diagnosis", metavar="DIAGNOSIS.json", help="what hd diagnose --json wrote")
    campaign = actions.add_parser("campaign", help="diagnose many random joints blindly", description=_CAMPAIGN)
    campaign.add_argument("--n", type=int, default=100, metavar="N", help="number of joints [100]")
    campaign.add_argument("--seed", type=int, required=True, metavar="S", help="first seed; then S+1, S+2, …")
    campaign.add_argument("--kind", choices=KINDS, default="mix", help="what may be hidden [mix]")
    campaign.add_argument("--world", choices=WORLDS, default="both", help=_WORLD)
    campaign.add_argument("--jobs", type=int, default=1, help="processes [1]")
    campaign.add_argument("--record", metavar="FILE", help="JSON lines, one per joint; an existing one is continued")
    campaign.add_argument("--log", metavar="FILE", help="where a look at test seeds is written down [not at all]")
    for part in (parser, new, check, campaign):
        add_output_options(part)
    for part in (new, check, campaign):
        for action in part._actions:
            if action.dest in ("json", "force", "quiet"):
                action.default = argparse.SUPPRESS  # given before the action, it stays


_NEW = "Writes two recordings, the data sheet's model, and the truth, sealed. A chosen --effect is no riddle any more."
_CHECK = "Exit code 0: right; 1: wrong. On a poor recording a refusal is right."
_CAMPAIGN = (
    "Prints the table of right and wrong answers with exact 95 %% intervals. Seeds by purpose: docs/challenge.md."
)
_WORLD = (
    "home (any, or of it library: physics as the library's, judge: different on purpose), second: laws of its own, "
    "both, half and half, or real_like: recordings as real robots give them [both]"
)


def run(arguments: argparse.Namespace) -> int:
    """Runs one of the three."""
    return {"new": _new, "check": _check, "campaign": _campaign}[arguments.action](arguments)


def _new(arguments: argparse.Namespace) -> int:
    import secrets
    import shutil

    from hd_control.cli.options import refuse_overwrite, say, write_json
    from hd_control.core.files import whole_folder

    seed = secrets.randbelow(100_000) if arguments.seed is None else arguments.seed
    make = _maker(arguments, seed)
    folder = Path(arguments.output)
    refuse_overwrite(folder, arguments.force)
    _old_challenge(folder)
    with whole_folder(folder, lambda: shutil.rmtree(folder, ignore_errors=True)) as place:
        place.mkdir()
        made = make(place)
        _write_model(made)
    say(arguments, f"{folder}: two recordings, model.yaml, the truth sealed; {folder / 'README.txt'} says how to go on")
    write_json(arguments, {"schema": "hd.challenge_new/1", "folder": str(folder), "joints": list(made.joint_names)})
    return 0


def _maker(arguments: argparse.Namespace, seed: int) -> Callable[[Path], Challenge]:
    """What writes the challenge into a folder; everything that was asked for is checked here."""
    from hd_sim.puzzles.draw import chosen_case, draw_case
    from hd_sim.puzzles.puzzle import make_arm_challenge, make_challenge, write_challenge
    from hd_sim.puzzles.second import chosen_second, record_second, set_up_second

    if arguments.arm:
        return lambda folder: make_arm_challenge(folder, seed)
    effects, motion = _wishes(arguments)
    if arguments.world == "second":
        chosen = bool(effects or arguments.motion)
        bench = chosen_second(seed, effects, motion) if chosen else set_up_second(seed, arguments.kind)
        return lambda folder: write_challenge(folder, record_second(bench))
    case = chosen_case(seed, effects, motion) if effects or arguments.motion else draw_case(seed, arguments.kind)
    return lambda folder: make_challenge(folder, case)


def _wishes(arguments: argparse.Namespace) -> tuple[dict[str, float], str]:
    """Effects with their strengths, and the kind of motion."""
    from hd_control.core.errors import ConfigError
    from hd_sim.puzzles import random_motion
    from hd_sim.second_world import motion as second_motion

    kinds = (second_motion if arguments.world == "second" else random_motion).MOTIONS
    motion = arguments.motion or "general"
    if motion not in kinds:
        raise ConfigError(f"--motion {motion}: expected one of {', '.join(kinds)}")
    effects = {}
    for text in arguments.effect:
        name, _, strength = text.partition(":")
        try:
            effects[name] = float(strength or 1.0)
        except ValueError:
            raise ConfigError(f"--effect {text}: strength {strength!r} is not a number") from None
    return effects, motion


def _old_challenge(folder: Path) -> None:
    """Refuses to replace anything but a challenge."""
    from hd_control.core.errors import ConfigError
    from hd_sim.puzzles.puzzle import SEAL

    if folder.exists() and not (folder / SEAL).is_file():
        raise ConfigError(f"{folder}: is no challenge; --force replaces only a folder with {SEAL}")


def _write_model(made: Challenge) -> None:
    """The data sheet as a model file beside the bags."""
    from hd_control.drive.model import Model
    from hd_control.drive.model_file import save_model
    from hd_sim.puzzles.campaign import joint_model
    from hd_sim.puzzles.puzzle import MODEL, ROBOT

    joints = {name: joint_model(model) for name, model in made.models.items()}
    save_model(Model(robot=ROBOT, joints=joints), made.folder / MODEL)


def _check(arguments: argparse.Namespace) -> int:
    import json

    from hd_control.cli.options import say, write_json
    from hd_control.core.errors import ConfigError
    from hd_sim.puzzles.puzzle import check_challenge, is_right

    try:
        diagnosis = json.loads(Path(arguments.diagnosis).read_bytes())
    except ValueError:
        raise ConfigError(f"{arguments.diagnosis}: not JSON; write it with hd diagnose --json FILE") from None
    if not isinstance(diagnosis, dict):
        raise ConfigError(f"{arguments.diagnosis}: not a diagnosis")
    found = check_challenge(Path(arguments.folder), diagnosis)
    right = True
    for joint, (score, hidden) in found.items():
        good = is_right(score, hidden)
        right = right and good
        for line in _words(joint, score, hidden, good):
            say(arguments, line)
    joints = {name: {**score.to_dict(), "hidden": hidden} for name, (score, hidden) in found.items()}
    write_json(arguments, {"schema": "hd.challenge_check/1", "right": right, "joints": joints})
    return 0 if right else 1


def _words(joint: str, score: Score, hidden: Mapping[str, Any], good: bool) -> list[str]:
    """What people read of one joint."""
    names = [*hidden["names"], *hidden["unknown"]]
    poor = f" (a poor recording: {hidden['motion'].replace('_', ' ')})" if hidden["poor"] else ""
    lines = [f"{joint}: {'right' if good else 'wrong'}; hidden: {', '.join(names) or 'nothing'}{poor}"]
    for text, values in (("named rightly", score.right), ("named wrongly", score.wrong), ("missed", score.missed)):
        lines += [f"  {text}: {', '.join(values)}"] if values else []
    if score.refused:
        lines.append("  refused: the recording cannot tell")
    if score.missed and score.group:
        lines.append("  what was missed is among the named effects' confusable ones")
    if hidden["unknown"]:
        words = "right variable" if score.unknown_variable else "wrong or no variable"
        lines.append(f"  unknown effect: {f'flagged, {words}' if score.unknown_flagged else 'overlooked'}")
    for item in score.parameters:
        inside = {True: "inside", False: "outside", None: "without"}[item["covered"]]
        error = f"{100 * item['relative_error']:.2g} % off"
        lines.append(f"  {item['effect']} {item['name']}: {error}, truth {inside} its interval")
    return lines


def _campaign(arguments: argparse.Namespace) -> int:
    from hd_control.cli.options import Progress, say
    from hd_control.core.errors import ConfigError
    from hd_sim.puzzles.campaign import Campaign, ask, oracle, run_campaign

    if arguments.n < 1 or arguments.jobs < 1 or arguments.seed < 0:
        raise ConfigError("--n and --jobs must be at least 1, --seed at least 0")
    judge = {"library": False, "judge": True}.get(arguments.world)
    world = "home" if arguments.world in ("any", "library", "judge") else arguments.world
    campaign = Campaign(arguments.n, arguments.seed, arguments.kind, judge, world)
    record = Path(arguments.record) if arguments.record else None
    _log(arguments, campaign, bool(record and record.exists()))
    progress, records = Progress(arguments, arguments.n, "campaign"), []
    interrupted = False
    try:
        for entry in run_campaign(campaign, ask, arguments.jobs, record, oracle):
            records.append(entry)
            progress.update(len(records))
    except KeyboardInterrupt:
        interrupted = True
    progress.close()
    _report(arguments, records)
    if interrupted:
        say(
            arguments,
            f"interrupted after {len(records)} of {arguments.n}" + (f"; go on with --record {record}" * bool(record)),
        )
    return 130 if interrupted else 0


def _log(arguments: argparse.Namespace, campaign: Campaign, goes_on: bool) -> None:
    """Says what the seeds are for; a look at test seeds is written down before it happens."""
    from hd_control import __version__
    from hd_control.cli.options import say
    from hd_sim.puzzles.seeds import TEST, log_look, purposes

    found = purposes(campaign.seed, campaign.count)
    say(arguments, f"seeds {campaign.seed} to {campaign.seed + campaign.count - 1}: {', '.join(found) or 'free'}")
    if TEST in found and arguments.log:
        log_look(
            Path(arguments.log), campaign.seed, campaign.count, campaign.world, campaign.kind, __version__, goes_on
        )
    elif TEST in found:
        say(arguments, "test seeds: write the look down with --log FILE; who has seen them may not tune on them")


def _report(arguments: argparse.Namespace, records: list[dict[str, Any]]) -> None:
    """The tables: all worlds, then those like the library and those of the judge apart."""
    from hd_control.cli.options import say, write_json
    from hd_sim.puzzles.tables import confusion, headline, headline_text, make_table, spoilt_rows, table_text

    parts = _parts(records)
    tables = {name: make_table(part) for name, part in parts.items() if part}
    if parts["real-like recordings"]:
        tables["real-like recordings"] = spoilt_rows(parts["real-like recordings"])
    if records:
        say(arguments, f"\nworlds side by side; the worse one counts\n\n{headline_text(records)}")
    for name, rows in tables.items():
        say(arguments, f"\n{name}, {len(parts[name])} joints\n\n{table_text(rows)}")
    wrong = [entry for entry in confusion(records) if entry[0] != entry[1]]
    if wrong:
        say(arguments, "\none hidden effect, first answer another:")
    for hidden, answer, count in wrong:
        say(arguments, f"  {hidden} -> {answer}: {count}")
    document = {name: [row.to_dict() for row in rows] for name, rows in tables.items()}
    seeds = sorted(r["seed"] for r in records)
    entries = headline(records) if records else []
    tables_of_it = {"tables": document, "confusion": confusion(records), "headline": entries}
    write_json(arguments, {"schema": "hd.campaign/1", "seeds": seeds, **tables_of_it})


def _parts(records: list[dict[str, Any]]) -> dict[str, list[dict[str, Any]]]:
    """Records by world; those of the first one also by how it differs from the library."""
    home = [r for r in records if r.get("world", "home") == "home"]
    return {
        "all worlds": records,
        "worlds like the library": [r for r in home if not r["features"]],
        "worlds of the judge": [r for r in home if r["features"]],
        "second world": [r for r in records if r.get("world") == "second"],
        "real-like recordings": [r for r in records if r.get("world") == "real_like"],
    }
