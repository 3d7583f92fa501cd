"""Cases of Zhu's experiments and their settings: the named options of `config/reproduce/zhu_options.yaml`."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from functools import lru_cache
from typing import Any

import numpy as np

from hd_control.chain.chain import shipped_values
from hd_control.core.errors import ConfigError
from hd_control.core.resources import config_path
from hd_control.core.strict_yaml import expect_keys, load_yaml
from hd_control.drive.model_file import load_model
from hd_control.laws import torque
from hd_control.laws.from_model import apply_model
from hd_control.papers.baselines import BASELINES
from hd_control.papers.rows import load_constants
from hd_sim.plant_config import PlantConfig
from hd_sim.runner import RunSetup

NODES = ("torque_node", "motion_node")
STARTS = ("coulomb_torque", "friction_offset", "viscous_positive", "viscous_negative")
LOAD_FRICTION = ("load_friction_linear", "load_friction_quadratic")
GAINS = ("position_gain", "velocity_gain", "integral_gain")
HARMONICS = 4
TRUTH, LADDER = "truth", "ladder"
IDENTIFIED = "reproduce/identified"
"""Folder of `config` with the models that `hd ladder` made, one for each plant; how is in docs/papers_zhu.md."""

PLAIN: tuple[str, ...] = ()
IMPROVED = ("error_filter", "kinematic_feedforward", "identified_friction", "slow_adaptation")
FAST = (*IMPROVED, "fast_loop", "fine_sensor", "torque_gain")
STIFF = (*IMPROVED, "fast_loop", "fine_sensor", "stiff_motion")
OPEN = ("open_gate",)
FIXED = ("error_filter", "kinematic_feedforward", "identified_friction", "fixed")


@dataclass(frozen=True)
class Case:
    """One run. `motion`: ("sine", Hz, rad), ("coordinated",) or ("slow",). `delay`: samples from sensor to torque.

    `knowledge` is the share of the plant's friction and kinematic error that the law knows, `source` where from:
    `truth` copies the plant's own numbers, `ladder` takes what `hd ladder` identified from recordings of the plant.
    `baseline` names a motion law of `hd_control.papers.baselines`. `rate_gain` replaces lambda_tau, 1/(N m s), also
    beyond what is allowed.
    """

    plant: str
    motion: tuple[Any, ...]
    options: tuple[str, ...] = PLAIN
    seed: int = 0
    knowledge: float = 1.0
    delay: int = 1
    friction: str = "coulomb"
    baseline: str = ""
    rate_gain: float | None = None
    source: str = TRUTH


@lru_cache
def options() -> Mapping[str, Any]:
    """The option table. Raises ConfigError for unknown keys."""
    path = config_path("reproduce/zhu_options.yaml")
    table = load_yaml(path)
    for name, entry in table.items():
        expect_keys(entry, f"{path}: {name}", (), (*NODES, "loop"))
    return table  # type: ignore[no-any-return]


def combined(names: tuple[str, ...]) -> dict[str, dict[str, Any]]:
    """The changes of the paper's settings and then of each option, by node and for the loop. Raises ConfigError."""
    found: dict[str, dict[str, Any]] = {part: {} for part in (*NODES, "loop")}
    for name in ("paper", *names):
        if name not in options():
            raise ConfigError(f"no option {name!r}; there is {', '.join(options())}")
        for part, values in options()[name].items():
            found[part].update(values)
    return found


def plant_of(case: Case) -> PlantConfig:
    """The world of a case: a delay of one sample is the loop's own."""
    loop = combined(case.options)["loop"]
    config = PlantConfig.from_file(case.plant)
    config = config.with_settings(resolver_bits=loop["resolver_bits"], friction_law=case.friction)
    return replace(
        config,
        period=loop["period"],
        substeps_per_ms=loop["substeps_per_ms"],
        extra_delay_samples=max(0, case.delay - 1),
    )


def setup_of(case: Case) -> RunSetup:
    """Plant and complete settings of a case."""
    config, changes = plant_of(case), combined(case.options)
    cutoff = {"derivative_cutoff": changes["loop"]["derivative_cutoff"]}
    motion = {**changes["motion_node"], **cutoff, **_links(case, config)}
    torque = {**changes["torque_node"], **cutoff, **_known(case, config)}
    if case.baseline:
        law = next(baseline for baseline in BASELINES if baseline.name == case.baseline)
        shipped = shipped_values("motion_node")
        motion = law.values({**{name: shipped[name] for name in GAINS}, **motion})
        torque["law"] = "direct"
    values = {"torque_node": torque, "motion_node": motion, "fusion_node": cutoff}
    return RunSetup(config, case.seed, {**values, "limits": {"file": changes["loop"]["limits"]}})


def _links(case: Case, config: PlantConfig) -> dict[str, Any]:
    """Link parameters as they are believed at the start, and how fast they adapt."""
    constants = load_constants("zhu")
    gain = constants["link_adaptation"]
    if config.joints == 1:
        speed = gain / float(config.robot.inertia[0, 2, 2])
        return {
            "link_parameter_scale": [constants["start_scale_single"]],
            "link_adaptation_gain": _spread(config, [speed]),
        }
    wrong = np.random.default_rng(case.seed).uniform(-1.0, 1.0, (config.joints, 13))
    scale = (1.0 + constants["start_scale_spread"] * wrong).ravel().tolist()
    return {"link_parameter_scale": scale, "link_adaptation_gain": [gain] * config.joints}


def _known(case: Case, config: PlantConfig) -> dict[str, Any]:
    """What was identified beforehand: by `hd ladder`, or a share of the plant's own friction and kinematic error."""
    if case.source == LADDER:
        return _identified(case)
    found: dict[str, Any] = {}
    drives, share = config.drives, case.knowledge
    if "identified_friction" in case.options:
        found |= {f"{name}_initial": _spread(config, share * drives[name]) for name in STARTS}
    if "kinematic_feedforward" in case.options:
        for kind in ("cosine", "sine"):
            rows = share * drives[f"kinematic_{kind}"]
            found |= {f"kinematic_{kind}_{n + 1}": _spread(config, rows[:, n]) for n in range(HARMONICS)}
    return found


def _identified(case: Case) -> dict[str, Any]:
    """What `hd apply` makes of the model that the ladder ended with, of the parts that the options use."""
    model = load_model(config_path(f"{IDENTIFIED}/{case.plant}.yaml"))
    shipped = {name: value for name, value in shipped_values("torque_node").items() if name in torque.PARAMETERS.names}
    applied = apply_model(model, {"torque_node": shipped}).values["torque_node"]
    names: list[str] = []
    if "identified_friction" in case.options:
        names += [*(f"{name}_initial" for name in STARTS), *LOAD_FRICTION]
    if "kinematic_feedforward" in case.options:
        names += [f"kinematic_{kind}_{n + 1}" for kind in ("cosine", "sine") for n in range(HARMONICS)]
    return {name: applied[name] for name in names}


def _spread(config: PlantConfig, values: Any) -> list[float]:
    """Values (n,) of the plant's joints in a list of all joints of the shipped files; the others are 0."""
    names = list(shipped_values("torque_node")["joint_names"])
    found = np.zeros(len(names))
    found[[names.index(name) for name in config.robot.joint_names]] = values
    return [float(value) for value in found]
