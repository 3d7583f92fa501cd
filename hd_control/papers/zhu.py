"""Zhu's results beside ours: rows and figures of `hd reproduce zhu`. What each means: docs/papers_zhu.md.

Figures: Figs. 3 and 4, Table III as bars, adaptation histories, the Lyapunov function.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from hd_control.lab.page.style import COLOURS
from hd_control.papers import zhu_arms, zhu_checks, zhu_table
from hd_control.papers.gandhi import Titled, line, sheet
from hd_control.papers.rows import Progress, Row, load_constants
from hd_control.papers.zhu_arms import GEOMETRIES, JOINT_3
from hd_control.papers.zhu_checks import ideal_run
from hd_control.papers.zhu_options import FAST, IMPROVED, OPEN, PLAIN, Case
from hd_control.papers.zhu_runs import ESTIMATES, MEAN_SECONDS, Outcome, history, mean_pace, play_all
from hd_control.papers.zhu_table import MAIN_BASELINES, PAPER, experiments, table_cases

# ---- Figures ---------------------------------------------------------------------------------------


UNITS = {"coulomb_torque": "N m", "friction_offset": "N m", "torsional_compliance": "rad/(N m)"}
BARS: Mapping[str, Mapping[str, Any]] = {
    **{name: {"baseline": name} for name in MAIN_BASELINES},
    "paper's law, 1 kHz": {"options": PLAIN},
    "improved, 1 kHz": {"options": IMPROVED},
    "improved, 4 kHz": {"options": FAST},
}


def figures(quick: bool, seed: int, progress: Progress) -> list[Titled]:
    """All pictures; `quick` leaves out geometry B and the 4 kHz bars."""
    geometries = list(GEOMETRIES)[: 1 if quick else 2]
    made: list[Titled] = []
    for name in geometries:
        made += [coordinated(name, seed), slow(name, seed)]
    progress(0.4, "Table III")
    made += [bars(quick, seed, progress), adaptation(seed)]
    progress(0.9, "Lyapunov function")
    return [*made, lyapunov()]


def _paper_lines(figure: Any, error: float, row: int) -> None:
    for sign in (-1.0, 1.0):
        figure.add_hline(y=sign * error, line={"color": "#888", "dash": "dot", "width": 1.2}, row=row, col=1)


def coordinated(geometry: str, seed: int) -> Titled:
    """Fig. 3: joint 3 while all joints move 10 degrees at 0.4 rad/s, with the error of all joints."""
    paper = load_constants(PAPER)["coordinated_error"]
    plain, ours = (history(Case(GEOMETRIES[geometry], ("coordinated",), o, seed)) for o in (OPEN, FAST))
    figure = sheet(
        ["joint 3: desired (dashed) and actual", "error of joint 3; dotted: the paper's largest",
         "error of all joints, improved"],
        ["rad", "mrad", "mrad"],
    )  # fmt: skip
    line(figure, ours.time, ours.true[:, JOINT_3], "actual, improved", 0)
    line(figure, ours.time, ours.desired[:, JOINT_3], "desired", 1, line={"dash": "dash"})
    for run, name, colour in ((plain, "paper's law, 1 kHz, 16 bits", 3), (ours, "improved, 4 kHz, 20 bits", 0)):
        line(figure, run.time, 1e3 * (run.desired - run.true)[:, JOINT_3], name, colour, 2)
    _paper_lines(figure, 1e3 * paper, 2)
    for joint in range(ours.true.shape[1]):
        line(figure, ours.time, 1e3 * (ours.desired - ours.true)[:, joint], f"joint {joint + 1}, improved", joint, 3)
    return f"Fig. 3, geometry {geometry[-1].upper()}: coordinated move, peak 0.4 rad/s", figure


def slow(geometry: str, seed: int) -> Titled:
    """Fig. 4: joint 3 at 0.001 rad/s with its error and its mean velocity over 0.1 s."""
    constants = load_constants(PAPER)
    plain, ours = (history(Case(GEOMETRIES[geometry], ("slow",), o, seed)) for o in (OPEN, FAST))
    figure = sheet(
        ["joint 3 from its start: desired (dashed) and actual", "error of joint 3; dotted: the paper's largest",
         "mean velocity over 0.1 s"],
        ["mrad", "mrad", "mrad/s"],
    )  # fmt: skip
    start = ours.desired[0, JOINT_3]
    for run, name, colour in ((plain, "paper's law, 1 kHz, 16 bits", 3), (ours, "improved, 4 kHz, 20 bits", 0)):
        line(figure, run.time, 1e3 * (run.true[:, JOINT_3] - start), name, colour)
        line(figure, run.time, 1e3 * (run.desired - run.true)[:, JOINT_3], name, colour, 2, showlegend=False)
    line(figure, ours.time, 1e3 * (ours.desired[:, JOINT_3] - start), "desired", 1, line={"dash": "dash"})
    _paper_lines(figure, 1e3 * constants["slow_error"], 2)
    pace = 1e3 * mean_pace(ours.true, float(ours.time[1]))[:, JOINT_3]
    line(figure, ours.time[: pace.size] + 0.5 * MEAN_SECONDS, pace, "improved", 0, 3, showlegend=False)
    return f"Fig. 4, geometry {geometry[-1].upper()}: all joints at 0.001 rad/s", figure


def bars(quick: bool, seed: int, progress: Progress) -> Titled:
    """Table III: the paper's errors, those of its law here, of ours and of the laws to compare with."""
    names = [name for name in BARS if not (quick and "4 kHz" in name)]
    wanted = {name: table_cases(**BARS[name], seed=seed) for name in names}
    found = play_all([c for own in wanted.values() for c in own], lambda share, what: progress(0.4 + 0.4 * share, what))
    places = [f"J{joint} {frequency:g} Hz" for joint, frequency, *_ in experiments()]
    figure = sheet(["largest joint error"], ["rad"], "")
    figure.add_bar(x=places, y=[error for *_, error in experiments()], name="paper", marker_color="#222")
    for i, (name, own) in enumerate(wanted.items()):
        figure.add_bar(x=places, y=_errors(found, own), name=name, marker_color=COLOURS[i])
    figure.update_yaxes(type="log", exponentformat="e", dtick=1, range=[-5.0, -1.5])
    figure.update_layout(height=480)
    return "Table III: single joints", figure


def _errors(found: Mapping[Case, Outcome], own: list[Case]) -> list[float]:
    return [float(found[case].error[0]) for case in own]


def adaptation(seed: int) -> Titled:
    """The five estimates of the paper's law on joint 3 at 0.5 Hz, with the plant's values dashed, bounds dotted."""
    case = table_cases(options=PLAIN, seed=seed)[0]
    run = history(case)
    figure = sheet([f"{name}; dotted: bounds" for name in ESTIMATES], [UNITS.get(name, "N m s") for name in ESTIMATES])
    for row, name in enumerate(ESTIMATES, 1):
        line(figure, run.time, run.estimates[name][:, 0], name, row - 1, row, showlegend=False)
        for bound in run.bounds[name]:
            figure.add_hline(y=float(bound[0]), line={"color": "#888", "dash": "dot"}, row=row, col=1)
    return "Adaptation of the paper's law, joint 3, 0.5 Hz", figure


def lyapunov() -> Titled:
    """V1 of the proof on the ideal drive, with and without disturbance."""
    figure = sheet(["V1"], ["J"])
    for name, colour in (("u_d = 0", 0), ("u_d in L2", 1)):
        run = ideal_run(disturbed=colour == 1)
        line(figure, run.time, run.lyapunov, name, colour)
    figure.update_yaxes(type="log", exponentformat="e", dtick=1)
    return "Lyapunov function of theorem 1 on the ideal drive", figure


# ---- Rows ------------------------------------------------------------------------------------------


PARTS = (zhu_table, zhu_arms, zhu_checks)


def rows(quick: bool, seed: int, progress: Progress, seeds: int = 3) -> list[Row]:
    """All rows; `quick` leaves out 4 kHz single joints, slow motions, delay and options, and uses one seed."""
    several = list(range(seed, seed + (1 if quick else seeds)))
    found = play_all([case for part in PARTS for case in part.cases(quick, several)], progress)
    return [row for part in PARTS for row in part.rows(found, quick, several)]
