"""Zhu, Tables I to III: single joints under the paper's law, under ours, and under laws to compare with."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from functools import lru_cache
from typing import Any

import numpy as np

from hd_control.papers.baselines import BASELINES
from hd_control.papers.rows import Row, load_constants, over_seeds
from hd_control.papers.zhu_options import (
    FAST,
    FIXED,
    IMPROVED,
    OPEN,
    PLAIN,
    STIFF,
    Case,
    combined,
    plant_of,
    setup_of,
)
from hd_control.papers.zhu_options import LADDER as LADDER_MODEL
from hd_control.papers.zhu_runs import Outcome

PAPER = "zhu"
JOINTS = (3, 4, 5, 7)
TARGET, TARGET_4KHZ = 0.2, 0.1  # issue: geometric mean of the ratios to Table III, 1 kHz and 4 kHz
KNOWN = 0.8
MAIN_BASELINES = ("pd", "pid", "computed_torque")
LADDER = {
    "error_filter": IMPROVED[:1],
    "kinematic_feedforward": IMPROVED[:2],
    "identified_friction": IMPROVED[:3],
    "slow_adaptation": IMPROVED,
    "fixed": FIXED,
}
DRIVE_SETTINGS = (
    "coulomb_torque", "friction_offset", "viscous_positive", "viscous_negative", "load_friction_linear",
    "load_friction_quadratic", "stribeck_ratio", "stribeck_velocity", "hysteresis_stiffness", "hysteresis_rate",
    "kinematic_cosine", "kinematic_sine", "gauge_noise", "current_time_constant", "torque_limit",
)  # fmt: skip
Set = dict[str, Any]
SETS: dict[str, Set] = {
    "plain": {"options": PLAIN},
    "literal": {"options": ("literal", *OPEN)},
    "": {"options": IMPROVED, "source": LADDER_MODEL},
    "truth": {"options": IMPROVED},
    "known_80": {"options": IMPROVED, "knowledge": KNOWN},
    "plain.bristle": {"options": PLAIN, "friction": "bristle"},
    "bristle": {"options": IMPROVED, "friction": "bristle"},
    "4khz": {"options": FAST, "source": LADDER_MODEL},
    "4khz.truth": {"options": FAST},
    "4khz.plain": {"options": ("fast_loop", "fine_sensor")},
    "4khz.literal": {"options": ("literal", "fast_loop", "fine_sensor", *OPEN)},
    "4khz.known_80": {"options": FAST, "knowledge": KNOWN},
    "4khz.stiff_motion": {"options": STIFF},
}
"""Suffix of the row to its settings; the row without suffix is the improved law at 1 kHz, which knows what `hd ladder`
identified from recordings of the same plant. Rows that copy the plant's truth say so in their conditions."""
VARIANTS = {
    "stiffness_only": "Remark 3.2 in place of (5): d is not used",
    "literal": "(5)-(9) to the letter",
    "filtered": "(5) with filtered differences",
}
"""Form of the wanted torsion's derivatives -> words in every condition of the paper's law."""
LOOP_OPTIONS = ("fast_loop", "fine_sensor", "open_gate")
LOAD_COPIED = ", growth of friction with load (g1, g2 of (3)) copied from the plant"
"""The paper gives no numbers for them; the law carries those of the simulated drives."""
QUICK_SETS = ("plain", "")
SEVERAL_SEEDS = ("plain", "", "known_80", "4khz", "4khz.known_80")


def experiments() -> list[tuple[int, float, float, float]]:
    """Joint, frequency Hz, amplitude rad, largest error rad of every line of Table III."""
    constants = load_constants(PAPER)
    lines = []
    for joint in JOINTS:
        numbers = constants[f"table_3_joint_{joint}"]
        lines += [(joint, *numbers[:3]), (joint, *numbers[3:])]
    return lines


def table_cases(**settings: Any) -> list[Case]:
    """The eight runs of Table III with the same settings."""
    return [Case(f"single_joint_{joint}", ("sine", f, a), **settings) for joint, f, a, _ in experiments()]


def geometric_mean(found: Mapping[Case, Outcome], cases: Sequence[Case]) -> float:
    """Geometric mean over Table III of our error over the paper's; NaN if a run was stopped."""
    paper = [error for *_, error in experiments()]
    ours = [float(found[case].error[0]) for case in cases]
    return math.exp(float(np.mean([math.log(o / p) for o, p in zip(ours, paper, strict=True)])))


def _seeds_of(name: str, seeds: Sequence[int]) -> Sequence[int]:
    return seeds if name in SEVERAL_SEEDS else seeds[:1]


def cases(quick: bool, seeds: Sequence[int]) -> list[Case]:
    """Every run that the rows below need."""
    wanted: list[Case] = []
    for name, settings in SETS.items():
        if not quick or name in QUICK_SETS:
            wanted += [case for seed in _seeds_of(name, seeds) for case in table_cases(**settings, seed=seed)]
    if not quick:
        wanted += [case for names in LADDER.values() for case in table_cases(options=names, seed=seeds[0])]
    for baseline in _baselines(quick):
        several = seeds if baseline in MAIN_BASELINES and not quick else seeds[:1]
        wanted += [case for seed in several for case in table_cases(baseline=baseline, seed=seed)]
    return wanted


def _baselines(quick: bool) -> list[str]:
    return ["pid"] if quick else [b.name for b in BASELINES if b.law in MAIN_BASELINES]


def rows(found: Mapping[Case, Outcome], quick: bool, seeds: Sequence[int]) -> list[Row]:
    """Tables I and II as run, each line of Table III, geometric means, options one after the other, baselines."""
    made = differences()
    for name in ("plain", "", "4khz"):
        if not quick or name in QUICK_SETS:
            made += _lines(found, name, seeds)
    for name in SETS if not quick else QUICK_SETS:
        made.append(_mean_row(found, name, _seeds_of(name, seeds)))
    if quick:
        return made + [_baseline_row(found, name, seeds[:1]) for name in _baselines(quick)]
    for name, names in LADDER.items():
        mean = geometric_mean(found, table_cases(options=names, seed=seeds[0]))
        made.append(_ratio(f"zhu.option.{name}.geomean_ratio", mean, describe({"options": names}), None))
    for name in _baselines(quick):
        made.append(_baseline_row(found, name, seeds if name in MAIN_BASELINES else seeds[:1]))
    return made


def differences() -> list[Row]:
    """How many numbers of Tables I and II the paper's runs do not use as printed."""
    setup = setup_of(Case("arm_a", ("coordinated",)))
    used = {**setup.node_values("motion_node"), **setup.node_values("torque_node")}
    used["adaptation_gain_compliance"] = used["adaptation_scale"] * np.asarray(used["adaptation_gain_compliance"])
    unused = ("table_2_damping_time",) if used["compliance_derivative"] == "stiffness_only" else ()
    made = []
    for table in (1, 2):
        prefix = f"table_{table}_"
        printed = [c for c in load_constants(PAPER) if c.name.startswith(prefix) and c.name not in unused]
        wrong = sum(int(np.sum(np.asarray(used[c.name[len(prefix):]]) != c.value)) for c in printed)  # fmt: skip
        text = f"{sum(len(c.value) for c in printed)} numbers of Table {'I' * table}, option paper"
        left = [c.symbol for c in load_constants(PAPER) if c.name in unused and c.name.startswith(prefix)]
        text += f"; {', '.join(left)} is not counted, Remark 3.2 does not use it" if left else ""
        made.append(
            Row(f"zhu.table{table}.differences", PAPER, f"Table {'I' * table}", "-", 0.0, float(wrong), 0.0, text)
        )
    return made


def _lines(found: Mapping[Case, Outcome], name: str, seeds: Sequence[int]) -> list[Row]:
    made = []
    for i, (joint, frequency, amplitude, paper) in enumerate(experiments()):
        runs = [found[table_cases(**SETS[name], seed=seed)[i]] for seed in _seeds_of(name, seeds)]
        ours, worst = over_seeds([float(run.error[0]) for run in runs])
        place = f"zhu.table3.joint_{joint}.{f'{frequency:g}'.replace('.', 'p')}hz"
        text = f"largest joint error, {amplitude:g} rad at {frequency:g} Hz; {describe(SETS[name])}"
        target = None if name == "plain" else paper
        made.append(
            Row(
                _suffixed(place, name),
                PAPER,
                "Table III",
                "rad",
                paper,
                ours,
                target,
                text,
                chosen=chosen(),
                seeds=worst,
            )
        )
    return made


def _mean_row(found: Mapping[Case, Outcome], name: str, seeds: Sequence[int]) -> Row:
    means = [geometric_mean(found, table_cases(**SETS[name], seed=seed)) for seed in seeds]
    target = {"": TARGET, "4khz": TARGET_4KHZ}.get(name)
    place = "zhu.table3.geomean_ratio"
    return _ratio(_suffixed(place, name), means, describe(SETS[name]), target)


def _baseline_row(found: Mapping[Case, Outcome], name: str, seeds: Sequence[int]) -> Row:
    means = [geometric_mean(found, table_cases(baseline=name, seed=seed)) for seed in seeds]
    law = next(b for b in BASELINES if b.name == name)
    gains = f"lambda x {law.position:g}, k_p x {law.velocity:g}, k_I x {law.integral:g} of Table II"
    instead = describe({"options": PLAIN, "baseline": name})
    return _ratio(f"zhu.baseline.{name}.geomean_ratio", means, f"{law.law}, {gains}; instead of {instead}", None)


def _ratio(place: str, means: float | Sequence[float], conditions: str, target: float | None) -> Row:
    values = [means] if isinstance(means, float) else list(means)
    ours, worst = over_seeds(values)
    text = f"our error over the paper's, geometric mean of 8; {conditions}"
    return Row(place, PAPER, "Table III", "-", 1.0, ours, target, text, chosen=chosen(), seeds=worst)


def _suffixed(place: str, name: str) -> str:
    return f"{place}.{name}" if name else place


def describe(settings: Mapping[str, Any]) -> str:
    """Rate, sensor, delay, friction law, knowledge and options in words."""
    case = Case("single_joint_3", ("slow",), **settings)
    config = plant_of(case)
    setting = f"{1e-3 / config.period:g} kHz, {config.drives['resolver_bits'][0]:g} bits, delay {case.delay}"
    extra = " + ".join(name for name in case.options if name not in (*LOOP_OPTIONS, *VARIANTS))
    variant = "" if case.baseline else f" ({VARIANTS[variant_of(case)]})"
    law = f"paper's law{variant}{' + ' + extra if extra else ''}"
    return f"{setting}, {case.friction} friction, set S{_knowledge(case)}; {law}"


def variant_of(case: Case) -> str:
    """Which form of (5) a case runs with."""
    return str(combined(case.options)["torque_node"]["compliance_derivative"])


def _knowledge(case: Case) -> str:
    """Where the law's friction and kinematic error come from, as a part of the conditions; nothing if it has none."""
    known = {"identified_friction": "friction", "kinematic_feedforward": "KE"}
    names = " and ".join(word for option, word in known.items() if option in case.options)
    if not names:
        return LOAD_COPIED if not case.baseline else ""
    if case.source == LADDER_MODEL:
        return f", {names} as hd ladder identified them from recordings of the plant"
    return f", {names} copied from the plant's truth ({100 * case.knowledge:g} %){LOAD_COPIED}"


@lru_cache
def chosen() -> tuple[str, ...]:
    """What the paper does not give for these runs: drives of parameter set S, loads, beliefs; reasons in config/."""
    plants = [plant_of(Case(f"single_joint_{joint}", ("slow",))) for joint in JOINTS]
    joints = ", ".join(str(joint) for joint in JOINTS)
    made = []
    for name in DRIVE_SETTINGS:
        shown = [" ".join(f"{x:.4g}" for x in np.ravel(plant.drives[name][0])) for plant in plants]
        text = shown[0] if len(set(shown)) == 1 else f"{', '.join(shown)} (joints {joints})"
        made.append(f"plant {name} = {text}")
    inertia = [p.robot.inertia[0, 2, 2] + p.robot.mass[0] * (p.robot.center_of_mass[0] ** 2).sum() for p in plants]
    made.append(f"plant load = {', '.join(f'{x:g}' for x in inertia)} kg m^2 (joints {joints}), axis horizontal")
    return (*made, *load_constants(PAPER).chosen("start_scale_single", "link_adaptation"))
