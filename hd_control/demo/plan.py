"""What one story is: the robot, what it hides, how it moves, and its controllers' first parameters.

Only the world and the seal know the hidden effect; the steps that look for it never see this object.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from hd_control.core.errors import ConfigError
from hd_control.core.resources import config_path
from hd_control.core.strict_yaml import load_yaml
from hd_sim import scenario
from hd_sim.hidden_effects import EFFECTS, VOCABULARY
from hd_sim.plant_config import PlantConfig
from hd_sim.runner import RunSetup
from hd_sim.scenario import Plan, Scenario, make_plan
from hd_sim.truth import HiddenEffect, apply_hidden, nominal, true_parameters, truth_of, write_seal

NODES = ("motion_node", "torque_node")


@dataclass(frozen=True)
class StoryPlan:
    """One story. `values`: parameters by node that differ from the shipped ones; `strength` of what is hidden."""

    seed: int
    plant: str
    model: str
    visible: PlantConfig
    hidden: HiddenEffect
    values: Mapping[str, Mapping[str, Any]]
    excitation: Plan
    goal: Plan

    @property
    def seconds(self) -> float:
        """Time of all recorded motion, s."""
        return (self.excitation.ticks + 2 * self.goal.ticks) * self.visible.period

    def plant_values(self) -> dict[str, Any]:
        """Parameters of the plant node: the world, with what it hides."""
        hide = f"{self.hidden.joint}:{self.hidden.name}:{self.hidden.strength:g}"
        return {"seed": self.seed, "nominal": True, "hide": [hide]}

    def seal(self, path: Path) -> None:
        """Writes the truth of every joint, sealed. Raises ConfigError if the file exists."""
        effect, names = self.hidden, self.visible.robot.joint_names
        world = apply_hidden(self.visible, [effect], self.seed)
        joints: dict[str, Any] = {name: {"names": [], "unknown": [], "parameters": {}} for name in names}
        mine = joints[str(effect.joint)]
        if effect.name in VOCABULARY:
            index = names.index(str(effect.joint))
            mine["names"].append(effect.name)
            mine["parameters"][effect.name] = true_parameters(effect.name, self.visible, world, index)
        else:
            mine["unknown"].append(effect.name)
        write_seal(path, {"joints": joints, "world": truth_of(self.visible, [effect], self.seed)})


def make_story(seed: int, robot: str = "arm", effect: str = "") -> StoryPlan:
    """The story of a seed. `effect`: `[JOINT/]NAME[:STRENGTH]`, else drawn. Raises ConfigError."""
    table = load_yaml(config_path("demo.yaml"))
    own = table[robot]
    visible = nominal(PlantConfig.from_file(own["plant"]))
    random = np.random.default_rng([seed, 0xDE3000])
    hidden = _hidden(effect, table["effects"], own["hidden_on"], visible.robot.joint_names, random)
    values = {node: own[node] for node in NODES}
    for node, given in values.items():
        given["joint_names"] = own["joint_names"]
        RunSetup(visible, seed, {node: given}).node_values(node)
    size = own["goal"]
    moves = {
        "excitation": lambda c: scenario.excitation(c.start, c.velocity_limit, c.random, own["excitation"]),
        "goal": lambda c: scenario.there_and_back(c.start, size["distance"], size["peak_velocity"]),
    }
    limit = np.array(RunSetup(visible, seed, values).node_values("motion_node")["velocity_limit"])
    plans = {
        name: make_plan(
            Scenario(name, name, own["plant"], build), visible.robot.joint_names, visible.start_position, limit,
            visible.period, seed,
        )
        for name, build in moves.items()
    }  # fmt: skip
    return StoryPlan(seed, own["plant"], own["model"], visible, hidden, values, plans["excitation"], plans["goal"])


def _hidden(
    text: str, drawn: Mapping[str, float], joints: list[str], known: tuple[str, ...], random: np.random.Generator
) -> HiddenEffect:
    """The effect that the user named, or one of the drawn ones; its joint is drawn if it is not named."""
    joint, name = str(random.choice(joints)), str(random.choice(list(drawn)))
    if not text:
        return HiddenEffect(joint, name, float(drawn[name]))
    where, _, rest = text.rpartition("/")
    name, _, strength = rest.partition(":")
    if where and where not in known:
        raise ConfigError(f"--effect {text}: unknown joint {where!r}; there is {', '.join(known)}")
    if name not in EFFECTS:
        import difflib

        near = difflib.get_close_matches(name, EFFECTS, 1)
        raise ConfigError(
            f"--effect {text}: unknown effect {name!r}"
            + (f", did you mean {near[0]!r}?" if near else "; hd simulate --list shows what there is")
        )
    try:
        value = float(strength) if strength else float(drawn.get(name, 2.0))
    except ValueError:
        value = float("nan")
    if not (np.isfinite(value) and 0.0 < value <= 20.0):
        raise ConfigError(f"--effect {text}: strength {strength!r} is not a number above 0, at most 20")
    return HiddenEffect(where or joint, name, value)
