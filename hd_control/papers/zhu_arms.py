"""Zhu, Figs. 3 and 4: all seven joints at once, at 0.4 and at 0.001 rad/s, on two chosen geometries."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence

from hd_control.papers.rows import Row, load_constants, over_seeds
from hd_control.papers.zhu_options import FAST, IMPROVED, OPEN, Case
from hd_control.papers.zhu_runs import Outcome
from hd_control.papers.zhu_table import KNOWN, PAPER, Set, chosen, describe

GEOMETRIES = {"geometry_a": "arm_a", "geometry_b": "arm_b"}
SPEEDS = {"0p4": "coordinated", "0p001": "slow"}
JOINT_3 = 2
TARGET_JOINT_3, TARGET_MAX, TARGET_SLOW = 1e-4, 5e-4, 3e-5  # rad; issue
SETS: dict[str, Set] = {
    "": {"options": FAST},
    "plain": {"options": OPEN},
    "plain.4khz": {"options": ("fast_loop", "fine_sensor", "open_gate")},
    "plain.4khz.filtered": {"options": ("fast_loop", "fine_sensor", "open_gate", "filtered")},
    "known_80": {"options": FAST, "knowledge": KNOWN},
    "bristle": {"options": FAST, "friction": "bristle"},
    "1khz": {"options": (*IMPROVED, *OPEN)},
    "pd": {"options": ("fast_loop", "fine_sensor"), "baseline": "pd"},
    "pid": {"options": ("fast_loop", "fine_sensor"), "baseline": "pid"},
    "computed_torque": {"options": ("fast_loop", "fine_sensor"), "baseline": "computed_torque"},
}
"""Suffix to settings; the row without suffix is the improved law at 4 kHz."""


def runs(geometry: str, speed: str, name: str, seeds: Sequence[int]) -> list[Case]:
    """One motion of one arm under one set of settings, for every seed."""
    return [Case(GEOMETRIES[geometry], (SPEEDS[speed],), **SETS[name], seed=seed) for seed in seeds]


def _wanted(quick: bool) -> list[tuple[str, str, str]]:
    """Geometry, speed and settings of every group of rows."""
    names = [""] if quick else list(SETS)
    speeds = ["0p4"] if quick else list(SPEEDS)
    return [(geometry, speed, name) for speed in speeds for geometry in GEOMETRIES for name in names]


def cases(quick: bool, seeds: Sequence[int]) -> list[Case]:
    """Every run that the rows below need."""
    return [case for group in _wanted(quick) for case in runs(*group, seeds)]


def rows(found: Mapping[Case, Outcome], quick: bool, seeds: Sequence[int]) -> list[Row]:
    """Joint 3, the worst joint and, for the slow motion, reversals; each for both geometries."""
    made: list[Row] = []
    for geometry, speed, name in _wanted(quick):
        outcomes = [found[case] for case in runs(geometry, speed, name, seeds)]
        made += _fast_rows(outcomes, geometry, name) if speed == "0p4" else _slow_rows(outcomes, geometry, name)
    return made


def _fast_rows(outcomes: Sequence[Outcome], geometry: str, name: str) -> list[Row]:
    paper = load_constants(PAPER)["coordinated_error"]
    make = _maker(outcomes, "0p4", geometry, name)
    return [
        make("joint_3", "Fig. 3", "rad", paper, TARGET_JOINT_3, lambda o: float(o.error[JOINT_3])),
        make("max", "section V", "rad", paper, TARGET_MAX, lambda o: float(o.error.max())),
    ]


def _slow_rows(outcomes: Sequence[Outcome], geometry: str, name: str) -> list[Row]:
    paper = load_constants(PAPER)["slow_error"]
    make = _maker(outcomes, "0p001", geometry, name)
    return [
        make("joint_3", "Fig. 4", "rad", paper, TARGET_SLOW, lambda o: float(o.error[JOINT_3])),
        make("reversals", "Fig. 4", "-", 0.0, 0.0, lambda o: float(o.reversals[JOINT_3])),
        make("max", "section V", "rad", None, None, lambda o: float(o.error.max())),
        make("reversals_all", "section V", "-", None, None, lambda o: float(o.reversals.sum())),
    ]


def _maker(outcomes: Sequence[Outcome], speed: str, geometry: str, name: str) -> Callable[..., Row]:
    ends = "." + name if name else ""
    motion = "+10, -10, +10 deg, peak 0.4 rad/s, third move" if speed == "0p4" else "0.001 rad/s"
    what = {
        "joint_3": "largest error of joint 3",
        "max": "largest error of the worst joint",
        "reversals": "sign changes of joint 3's mean velocity over 0.1 s",
        "reversals_all": "the same, all joints together",
    }
    law = f"{SETS[name]['baseline']} instead of " if "baseline" in SETS[name] else ""

    def make(
        figure: str, place: str, unit: str, paper: float | None, target: float | None, read: Callable[[Outcome], float]
    ) -> Row:
        ours, worst = over_seeds([read(outcome) for outcome in outcomes])
        text = f"{what[figure]}; {motion}; {law}{describe(SETS[name])}"
        named = (*chosen(), *load_constants(PAPER).chosen("slow_duration", "start_scale_spread"), *ARMS)
        return Row(
            f"zhu.coordinated.{speed}.{figure}.{geometry}{ends}", PAPER, place, unit, paper, ours,
            target if not name else None, text, chosen=named, seeds=worst,
        )  # fmt: skip

    return make


ARMS = ("arm geometry A: config/robots/arm_a.urdf", "arm geometry B: config/robots/arm_b.urdf")
