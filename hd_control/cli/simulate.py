"""`hd simulate SCENARIO -o BAG`: a recorded run without ROS, in lock-step, faster than real time."""

from __future__ import annotations

import argparse
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from pathlib import Path

    from hd_sim.plant_config import PlantConfig
    from hd_sim.runner import Runner, RunSetup
    from hd_sim.scenario import Plan
    from hd_sim.truth import HiddenEffect

NAME = "simulate"
HELP = "record a simulated run without ROS, faster than real time"
EXAMPLE = "hd simulate coordinated -o bags/run1 --seed 3"


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """The options of the command."""
    parser.add_argument("scenario", metavar="SCENARIO", nargs="?", help="name of the scenario; see --list")
    parser.add_argument("-o", "--output", metavar="BAG", help="folder of the new bag")
    parser.add_argument("--list", action="store_true", help="list the scenarios and hidden effects")
    parser.add_argument("--plant", metavar="FILE", help="plant file, shipped name or path [the scenario's own]")
    parser.add_argument("--seed", type=int, default=0, help="seed of noise, hidden effects and random motion [0]")
    parser.add_argument(
        "--hide", metavar="[JOINT/]EFFECT[:STRENGTH]", action="append", default=[], help="hidden effect, repeatable"
    )
    parser.add_argument("--nominal", action="store_true", help="strip the plant to the usual model before hiding")
    parser.add_argument("--seal", metavar="FILE", help="where the truth is sealed [BAG.seal if something is hidden]")
    parser.add_argument(
        "--set",
        metavar="NODE.PARAM=VALUE",
        action="append",
        default=[],
        help="change a parameter, as in torque_node.rate_source=plain; VALUE is YAML",
    )
    parser.add_argument("--delay", type=int, default=1, metavar="N", help="command delay in samples, at least 1 [1]")


def run(arguments: argparse.Namespace) -> int:
    """Runs the scenario and writes the bag."""
    from hd_control.core.errors import ConfigError

    if arguments.list:
        return _list(arguments)
    if not arguments.scenario or not arguments.output:
        raise ConfigError("give a scenario and -o BAG, as in: " + EXAMPLE + "; hd simulate --list shows what there is")
    return _simulate(arguments)


def _list(arguments: argparse.Namespace) -> int:
    from hd_control.cli.options import say, write_json
    from hd_sim.hidden_effects import OUTSIDE, VOCABULARY
    from hd_sim.scenario import SCENARIOS

    for scenario in SCENARIOS.values():
        say(arguments, f"{scenario.name:24} {scenario.meaning}; plant {scenario.plant}")
    say(arguments, "\nhidden effects: " + ", ".join(VOCABULARY))
    say(arguments, "outside the library: " + ", ".join(OUTSIDE))
    names = {"scenarios": list(SCENARIOS), "effects": list(VOCABULARY), "outside": list(OUTSIDE)}
    write_json(arguments, {"schema": "hd.simulate_list/1", **names})
    return 0


def _simulate(arguments: argparse.Namespace) -> int:
    from pathlib import Path

    from hd_control.cli.options import refuse_overwrite
    from hd_sim.runner import Runner, RunSetup
    from hd_sim.scenario import find_scenario, make_plan
    from hd_sim.truth import apply_hidden, truth_of, write_seal

    scenario = find_scenario(arguments.scenario)
    output = Path(arguments.output)
    refuse_overwrite(output, arguments.force)
    visible = _plant(arguments, scenario.plant)
    effects = hidden_effects(arguments.hide, visible.robot.joint_names)
    seal = Path(arguments.seal) if arguments.seal else output.with_name(output.name + ".seal")
    if effects:
        refuse_overwrite(seal, arguments.force)
    setup = RunSetup(apply_hidden(visible, effects, arguments.seed), arguments.seed, parameter_values(arguments.set))
    runner = Runner(setup)
    names, limit = visible.robot.joint_names, runner.goal_limits.velocity
    plan = make_plan(scenario, names, visible.start_position, limit, visible.period, arguments.seed)
    _record(arguments, setup, runner, plan, output)
    if effects:
        seal.unlink(missing_ok=True)
        write_seal(seal, truth_of(visible, effects, arguments.seed))
    return _report(arguments, output, seal if effects else None, plan, runner)


def _plant(arguments: argparse.Namespace, default: str) -> PlantConfig:
    """The plant before anything is hidden."""
    from dataclasses import replace

    from hd_control.core.errors import ConfigError
    from hd_sim.plant_config import PlantConfig
    from hd_sim.truth import nominal

    config = PlantConfig.from_file(arguments.plant or default)
    if not 1 <= arguments.delay <= 17:
        raise ConfigError(f"--delay: {arguments.delay} is outside [1, 17] samples")
    config = replace(config, extra_delay_samples=config.extra_delay_samples + arguments.delay - 1)
    return nominal(config) if arguments.nominal else config


def _record(arguments: argparse.Namespace, setup: RunSetup, runner: Runner, plan: Plan, output: Path) -> None:
    """Runs the plan and writes the bag."""
    from hd_control.cli.options import Progress
    from hd_sim.recording import RunRecording

    notes = {"scenario": arguments.scenario, "plant": arguments.plant or "", "seed": str(arguments.seed)}
    notes |= {"clock": "lockstep", "period": repr(runner.period), "command_delay_samples": str(arguments.delay)}
    progress = Progress(arguments, plan.ticks, f"simulate {arguments.scenario}")
    with RunRecording(output, runner.robot, runner.period, notes, arguments.force) as recording:
        for node, values in setup.all_values().items():
            recording.writer.attach(f"{node}.yaml", _params_text(values), "application/yaml")
        for tick, goal in plan.goals:
            recording.goal(tick, goal)

        def observe(tick: int, bus: Any) -> None:
            recording.observe(tick, bus)
            if tick % 500 == 0:
                progress.update(tick)

        runner.run(plan, observe)
    progress.close()


def _report(arguments: argparse.Namespace, output: Path, seal: Path | None, plan: Plan, runner: Runner) -> int:
    from hd_control.cli.options import say, write_json

    stopped, values = runner.world.report()
    say(arguments, f"{output}: {plan.ticks} ticks of {runner.period * 1e3:g} ms")
    if seal is not None:
        say(arguments, f"{seal}: the truth, sealed")
    if stopped:
        say(arguments, f"the safety gate stopped the robot: {stopped}")
    document: dict[str, Any] = {
        "schema": "hd.simulate/1",
        "bag": str(output),
        "seal": None if seal is None else str(seal),
    }
    document |= {"ticks": plan.ticks, "window": plan.window, "stopped": stopped or None, "gate": values}
    write_json(arguments, document)
    return 1 if stopped else 0


def hidden_effects(texts: list[str], joint_names: tuple[str, ...]) -> list[HiddenEffect]:
    """`[JOINT/]EFFECT[:STRENGTH]` as values; without a joint the effect is on every joint. Raises ConfigError."""
    from hd_control.core.errors import ConfigError
    from hd_sim.truth import HiddenEffect

    found = []
    for text in texts:
        joint, _, rest = text.rpartition("/")
        name, _, strength = rest.partition(":")
        try:
            value = float(strength) if strength else 1.0
        except ValueError:
            raise ConfigError(f"--hide {text}: strength {strength!r} is not a number") from None
        if joint and joint not in joint_names:
            raise ConfigError(f"--hide {text}: unknown joint {joint!r}; there is {', '.join(joint_names)}")
        found += [HiddenEffect(one, name, value) for one in ([joint] if joint else joint_names)]
    return found


def parameter_values(texts: list[str]) -> dict[str, dict[str, Any]]:
    """`NODE.PARAM=VALUE` as values by node. Raises ConfigError."""
    from hd_control.chain.chain import LAWS
    from hd_control.core.errors import ConfigError
    from hd_control.core.strict_yaml import parse_yaml

    found: dict[str, dict[str, Any]] = {}
    for text in texts:
        name, equals, value = text.partition("=")
        node, dot, parameter = name.partition(".")
        if not (equals and dot and node in LAWS):
            raise ConfigError(f"--set {text}: expected NODE.PARAM=VALUE with NODE one of {', '.join(LAWS)}")
        found.setdefault(node, {})[parameter] = parse_yaml(value, f"--set {name}")
    return found


def _params_text(values: dict[str, Any]) -> str:
    """A params file with these values; JSON notation is YAML."""
    import json

    lines = [f"    {name}: {json.dumps(value)}" for name, value in values.items()]
    return "/**:\n  ros__parameters:\n" + "\n".join(lines) + "\n"
