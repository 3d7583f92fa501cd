"""Zhu's remarks and theorem: algebraic loop, delay, adaptation inside its bounds, Lyapunov function, link model."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence

from hd_control.reproduce.constants import load_constants
from hd_control.reproduce.rows import Row
from hd_control.reproduce.zhu_ideal import IdealRun, ideal_run, loop_limit, regressor_difference
from hd_control.reproduce.zhu_options import IMPROVED, OPEN, PLAIN, Case, plant_of
from hd_control.reproduce.zhu_runs import Outcome
from hd_control.reproduce.zhu_table import JOINTS, PAPER, chosen, describe, experiments, geometric_mean, table_cases

DELAYS = (0, 1, 2, 3, 4)
UNSTABLE = 2.0
"""An error of more than this times the error without delay is a limit cycle."""
LOOP_JOINT = 7
LOOP_GAINS = (0.0052, 0.02, 0.05, 0.1, 0.2, 0.35, 0.5, 0.7, 0.85, 1.0, 1.2, 1.5, 2.0, 3.0, 4.0, 5.0, 6.0, 8.0, 10.0)
"""k_f d lambda_tau; the first is Table II's for joint 7."""
REBOUND, ROUNDING = 1e-5, 1e-11
"""Share of V1(0) that discrete time may add back; difference of the link model in N m at torques up to 1 kN m."""


def _delay_cases(delay: int, seed: int) -> list[Case]:
    return [case for case in table_cases(options=OPEN, seed=seed, delay=delay) if case.motion[1] == 0.5]


def _loop_cases(delay: int, seed: int) -> list[Case]:
    joint, frequency, amplitude, _ = [line for line in experiments() if line[0] == LOOP_JOINT][1]
    drives = plant_of(Case(f"single_joint_{joint}", ("slow",))).drives
    damping = float(drives["torsional_damping"][0])
    return [
        Case(f"single_joint_{joint}", ("sine", frequency, amplitude), OPEN, seed, delay=delay, rate_gain=gain / damping)
        for gain in LOOP_GAINS
    ]


def cases(quick: bool, seeds: Sequence[int]) -> list[Case]:
    """Every run that the rows below need, besides those of the tables."""
    if quick:
        return table_cases(options=PLAIN, seed=seeds[0])
    seed = seeds[0]
    wanted = [case for delay in DELAYS for case in _delay_cases(delay, seed)]
    wanted += [case for delay in DELAYS for case in table_cases(options=(*IMPROVED, *OPEN), seed=seed, delay=delay)]
    wanted += [case for delay in DELAYS[:3] for case in _loop_cases(delay, seed)]
    return wanted + table_cases(options=PLAIN, seed=seed)


def rows(found: Mapping[Case, Outcome], quick: bool, seeds: Sequence[int]) -> list[Row]:
    """All rows of this part; the quick ones need no further runs."""
    seed = seeds[0]
    made = [*adaptation_rows(found, seed), *proof_rows(ideal_run(), ideal_run(disturbed=True)), loop_row()]
    text = "arms A, B and C, 200 random states each, torque against Pinocchio's inverse dynamics"
    difference = regressor_difference(seed)
    made.append(Row("vdc.regressor.vs_rnea", PAPER, "(33)-(39)", "N m", None, difference, ROUNDING, text))
    if quick:
        return made
    for joint in JOINTS:
        made.append(_tolerance_row(found, joint, seed))
    for delay in DELAYS:
        mean = geometric_mean(found, table_cases(options=(*IMPROVED, *OPEN), seed=seed, delay=delay))
        text = f"our error over the paper's, geometric mean of 8; {describe({'options': IMPROVED, 'delay': delay})}"
        place = f"zhu.delay.{delay}.geomean_ratio"
        made.append(Row(place, PAPER, "Table III", "-", 1.0, mean, None, text, chosen=chosen()))
    return made + [_filtered_row(found, delay, seed) for delay in DELAYS[:3]]


def loop_row() -> Row:
    """The limit of remark 3.1 in the setting of the remark."""
    text = "largest stable k_f d lambda_tau by bisection; ideal drive of joint 7, raw difference, no delay, 10 us"
    return Row(
        "zhu.algebraic_loop.limit", PAPER, "Remark 3.1", "-", 1.0, loop_limit(), 1.0, text, better="near",
        tolerance=0.02, chosen=load_constants(PAPER).chosen("loop_step"),
    )  # fmt: skip


def _filtered_row(found: Mapping[Case, Outcome], delay: int, seed: int) -> Row:
    runs = [found[case] for case in _loop_cases(delay, seed)]
    most = float(plant_of(Case(f"single_joint_{LOOP_JOINT}", ("slow",))).drives["torque_limit"][0])
    errors = [float(run.error[0]) if run.torque_step[0] < most else math.inf for run in runs]
    stable = _first_run(errors, UNSTABLE * errors[0])
    text = f"largest k_f d lambda_tau of {LOOP_GAINS[0]:g} ... {LOOP_GAINS[-1]:g} in the search with an error below "
    text += f"{UNSTABLE:g} x that of the first and no torque step of {most:g} N m in a sample; "
    text += f"joint {LOOP_JOINT}, 5 Hz, filter 200 rad/s; {describe({'delay': delay})}"
    place = f"zhu.algebraic_loop.limit.filtered.delay_{delay}"
    ours = LOOP_GAINS[stable] if stable >= 0 else math.nan
    return Row(place, PAPER, "Remark 3.1", "-", None, ours, None, text, chosen=chosen())


def _tolerance_row(found: Mapping[Case, Outcome], joint: int, seed: int) -> Row:
    place = JOINTS.index(joint)
    errors = [float(found[_delay_cases(delay, seed)[place]].error[0]) for delay in DELAYS]
    stable = _first_run(errors, UNSTABLE * errors[0])
    text = f"most samples of delay (0 to {DELAYS[-1]}) with an error below {UNSTABLE:g} x that without; 0.5 Hz, 1 kHz; "
    return Row(
        f"zhu.delay.tolerance.joint_{joint}", PAPER, "section V", "samples", None, float(stable), None,
        text + "16 bits, paper's law", chosen=chosen(),
    )  # fmt: skip


def _first_run(values: Sequence[float], limit: float) -> int:
    """Index of the last value before the first one that is above the limit or no number; -1 for none."""
    for index, value in enumerate(values):
        if not value <= limit:
            return index - 1
    return len(values) - 1


def adaptation_rows(found: Mapping[Case, Outcome], seed: int) -> list[Row]:
    """Estimates of the paper's law stay inside their bounds, and how often they stand on one."""
    runs = [found[case] for case in table_cases(options=PLAIN, seed=seed)]
    outside, held = max(run.outside for run in runs), max(run.held for run in runs)
    text = f"5 estimates, every sample of the 8 runs of Table III; {describe({'options': PLAIN})}"
    return [
        Row("zhu.adaptation.outside_bounds", PAPER, "(11), (12)", "-", 0.0, outside, 0.0,
            f"largest excess over the distance of the bounds; {text}", chosen=chosen()),
        Row("zhu.adaptation.at_bound", PAPER, "(11), (12)", "-", None, held, None,
            f"largest share of samples in which an estimate stands on a bound; {text}", chosen=chosen()),
    ]  # fmt: skip


def proof_rows(calm: IdealRun, disturbed: IdealRun) -> list[Row]:
    """V1 falls, and the left sides of (15)-(18) stay below the right ones, with a disturbance in L2."""
    constants = load_constants(PAPER)
    told = constants.chosen("ideal_step", "ideal_duration", "ideal_disturbance", "ideal_motion", "ideal_torque")
    text = (
        f"ideal drive of joint 7, exact rates, {constants['ideal_duration']:g} s in {constants['ideal_step']:g} s steps"
    )
    made = [
        Row("zhu.lyapunov.rebound", PAPER, "Theorem 1", "-", 0.0, calm.rebound, REBOUND,
            f"how far V1 stands above its lowest value so far, over V1(0); {text}; u_d = 0", chosen=told),
        Row("zhu.lyapunov.end", PAPER, "Theorem 1", "-", None, float(calm.lyapunov[-1] / calm.lyapunov[0]), None,
            f"V1 at the end over V1(0); {text}; u_d = 0", chosen=told),
    ]  # fmt: skip
    for number, (name, ratio) in enumerate(disturbed.ratios.items(), 15):
        row = f"left over right side; {text}; u_d in L2"
        made.append(Row(f"zhu.l2.{name}", PAPER, f"({number})", "-", 1.0, ratio, 1.0, row, chosen=told))
    return made
