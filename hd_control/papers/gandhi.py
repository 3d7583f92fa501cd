"""Gandhi and Ghorbel's results beside ours: composite law (26)-(30) against the plain one (31), on the joint (8)-(10).

The plain law knows neither kinematic error nor hysteresis. `half-sample prediction` evaluates law, reference and load
half a control sample after the measurement, in the middle of the command's hold; without it the law is the paper's.
Rows first, then the figures: Figs. 4 to 6, the terms of the law, the control period.
"""

from __future__ import annotations

import math
from collections.abc import Iterable
from typing import Any

import numpy as np

from hd_control.core.arrays import FloatArray
from hd_control.lab.page.style import COLOURS, thinned
from hd_control.papers.gandhi_runs import ABLATION, PERIODS, Experiment, run
from hd_control.papers.rows import Progress, Row, load_constants, over_seeds

PAPER = "gandhi"
TARGET_DEG, TARGET_RATIO = 1e-4, 3000.0  # issue: steady-state error and ratio to (31)
ALWAYS = (
    *("stiffness_linear", "kinematic_cosine", "kinematic_sine", "perturbation_stiffness"),
    *("tracking_gain", "tracking_damping", "fast_damping_ratio", "plant_step", "duration", "steady_from"),
)
BASE = "largest joint error of 3-6 s"
MOTION = "reference 10 sin 4 pi t + 25 t deg, load 30 sin (2 pi/3) t N m known"


def _row(name: str, equation: str, ours: float, conditions: str, unit: str = "deg", **more: Any) -> Row:
    constants = load_constants(PAPER)
    names = (*ALWAYS, *more.pop("constants", ()))
    values: dict[str, Any] = {"paper_value": None, "target": None, **more}
    return Row(
        f"gandhi.{name}", PAPER, equation, unit, ours=ours, conditions=conditions, chosen=constants.chosen(*names),
        **values,
    )  # fmt: skip


def high_gain() -> tuple[tuple[str, float], ...]:
    """The second, higher set of gains."""
    c = load_constants(PAPER)
    return (("tracking_gain", c["high_tracking_gain"]), ("tracking_damping", c["high_tracking_damping"]))


def phases(seed: int, seeds: int) -> list[float]:
    """Where the wave generator stands on its shaft, rad, one for each seed; the law knows it."""
    return [float(np.random.default_rng(seed + k).uniform(0.0, 2.0 * math.pi)) for k in range(seeds)]


def wrong_parameters(seed: int) -> tuple[tuple[str, float], ...]:
    """The law's parameters, each wrong by a random share of up to `model_error`; the load stays known."""
    c, rng = load_constants(PAPER), np.random.default_rng(seed)
    square = c["gear_ratio"] ** 2
    right = {"rotor_inertia": square * c["rotor_inertia"], "rotor_damping": square * c["rotor_damping"]}
    right |= c.values("link_inertia", "link_damping", "hysteresis_stiffness", "hysteresis_rate")
    right["torsional_stiffness"] = c["stiffness_linear"]
    for kind in ("cosine", "sine"):
        right |= {f"kinematic_{kind}_{n}": -value for n, value in enumerate(c[f"kinematic_{kind}"], 1)}
    most = c["model_error"]
    return tuple((name, float(value * (1.0 + rng.uniform(-most, most)))) for name, value in right.items())


def fitted_stiffness() -> float:
    """The one stiffness that fits the polynomial spring best over the wind-up that the motion uses, N m/rad."""
    c = load_constants(PAPER)
    wind = run(Experiment()).wind_up
    torque = wind * (c["stiffness_linear"] + c["stiffness_cubic"] * wind**2 + c["stiffness_quintic"] * wind**4)
    return float(torque @ wind / (wind @ wind))


def main_rows(places: Iterable[float]) -> list[Row]:
    """Error of the composite law and its ratio to the plain one, over assembly phases of the wave generator."""
    ours, ratios, plain = [], [], []
    for phase in places:
        ours.append(run(Experiment(phase=phase)).largest_deg)
        plain.append(run(Experiment("comparison", phase=phase)).largest_deg)
        ratios.append(plain[-1] / ours[-1])
    text = f"{BASE}; {MOTION}; law every 10 us, half-sample prediction; seeds: assembly phase"
    error, error_seeds = over_seeds(ours)
    ratio, ratio_seeds = over_seeds(ratios, "more")
    other, other_seeds = over_seeds(plain)
    return [
        _row("error_deg", "(26)-(30), Fig. 5", error, f"{text}; the paper says: goes to zero", target=TARGET_DEG,
             seeds=error_seeds),
        _row("eq31.error_deg", "(31), Fig. 5", other, f"{text}; load used once", seeds=other_seeds),
        _row("ratio_to_eq31", "(26), (31), Fig. 5", ratio, f"{text}; same gains", "-", target=TARGET_RATIO,
             better="more", seeds=ratio_seeds),
    ]  # fmt: skip


def ablation_rows() -> list[Row]:
    """The slow terms one after the other, fast term always there."""
    text = f"{BASE}; law every 10 us, half-sample prediction; fast term and slow terms up to this one"
    return [
        _row(f"ablation.{name}", equation, run(Experiment(composition)).largest_deg, text)
        for (name, composition), equation in zip(
            ABLATION.items(), ("(50)", "(28)", "(29)", "(30)"), strict=True
        )
    ]  # fmt: skip


def variant_rows() -> list[Row]:
    """The paper's law without prediction, higher gains, a weakly damped fast mode, C-1 and C-2, motor side."""
    text = f"{BASE}; law every 10 us"
    ahead, high = f"{text}, half-sample prediction", high_gain()
    nominal, gains = run(Experiment()), ("high_tracking_gain", "high_tracking_damping")
    bare, plain = run(Experiment(prediction=0.0)).largest_deg, run(Experiment("comparison")).largest_deg
    bare_high = run(Experiment(prediction=0.0, law=high)).largest_deg
    plain_high = run(Experiment("comparison", law=high)).largest_deg
    motor = float(np.abs(nominal.motor_error_deg[nominal.time >= load_constants(PAPER)["steady_from"]]).max())
    weak = run(Experiment(law=(("fast_damping_ratio", 0.2),))).largest_deg
    return [
        _row("unpredicted.error_deg", "(26)-(30)", bare, f"{text}, no prediction: the paper's law as it stands"),
        _row("unpredicted.ratio_to_eq31", "(26), (31)", plain / bare, f"{text}, no prediction", "-"),
        _row("unpredicted.high_gain.error_deg", "(26)-(30)", bare_high, f"{text}, no prediction", constants=gains),
        _row("unpredicted.high_gain.ratio_to_eq31", "(26), (31)", plain_high / bare_high, f"{text}, no prediction",
             "-", constants=gains),
        _row("high_gain.error_deg", "(26)-(30)", run(Experiment(law=high)).largest_deg, ahead, constants=gains),
        _row("weak_fast_mode.error_deg", "(27)", weak, f"{ahead}, fast damping ratio 0.2"),
        _row("motor_error_deg", "Fig. 5", motor, f"{ahead}; motor / N minus reference: kinematic error absorbed"),
        *c2_rows(ahead),
    ]  # fmt: skip


def c2_rows(text: str) -> list[Row]:
    """Plant C-2 with the full polynomial spring; the law keeps its linear one."""
    more = ("stiffness_cubic", "stiffness_quintic")
    stiffness, c = fitted_stiffness(), load_constants(PAPER)
    knows = Experiment(nonlinear=True, law=tuple((name, c[name]) for name in more))
    fitted = Experiment(nonlinear=True, law=(("torsional_stiffness", stiffness),))
    fit_text = f"{text}; law with the one stiffness that fits the spring, {stiffness:.0f} N m/rad"
    return [
        _row("c2.error_deg", "(5), Fig. 6", run(Experiment(nonlinear=True)).largest_deg,
             f"{text}; plant C-2; the paper sees hardly a difference to C-1", constants=more),
        _row("c2.fitted_stiffness.error_deg", "(5), Fig. 6", run(fitted).largest_deg, fit_text, constants=more),
        _row("c2.polynomial_law.error_deg", "(5), Fig. 6", run(knows).largest_deg,
             f"{text}; plant C-2, the law with the spring's own tangent", constants=more),
        _row("c2.eq31.error_deg", "(5), (31)", run(Experiment("comparison", nonlinear=True)).largest_deg,
             f"{text}; plant C-2", constants=more),
    ]  # fmt: skip


def period_rows(names: Iterable[str]) -> list[Row]:
    """Control periods as a real controller has them, with and without prediction."""
    found = []
    for name in names:
        period = PERIODS[name]
        for tag, prediction in (("", 0.5), (".unpredicted", 0.0)):
            text = f"{BASE}; law every {1e3 * period:g} ms, {'half-sample' if prediction else 'no'} prediction"
            value = run(Experiment(prediction=prediction, period=period)).largest_deg
            found.append(_row(f"period.{name}{tag}.error_deg", "(26)-(30)", value, text))
    gains = ("high_tracking_gain", "high_tracking_damping")
    value = run(Experiment(period=1e-3, law=high_gain())).largest_deg
    text = f"{BASE}; law every 1 ms, half-sample prediction, higher gains"
    return [*found, _row("period.1ms.high_gain.error_deg", "(26)-(30)", value, text, constants=gains)]


def knowledge_rows(seed: int, seeds: int) -> list[Row]:
    """The law with every parameter wrong by up to 10 %, not studied by the paper."""
    pairs = []
    for k in range(seeds):
        wrong = wrong_parameters(seed + k)
        both = (Experiment(composition, period=1e-4, law=wrong) for composition in ("all", "comparison"))
        pairs.append([run(experiment).largest_deg for experiment in both])
    text = f"{BASE}; law every 0.1 ms; each parameter of the law wrong by up to 10 %, the load known"
    error, error_seeds = over_seeds([first for first, _ in pairs])
    ratio, ratio_seeds = over_seeds([second / first for first, second in pairs], "more")
    return [
        _row("knowledge_90.error_deg", "(26)-(30)", error, text, seeds=error_seeds, constants=("model_error",)),
        _row("knowledge_90.ratio_to_eq31", "(26), (31)", ratio, text, "-", seeds=ratio_seeds, better="more",
             constants=("model_error",)),
    ]  # fmt: skip


def sensor_rows(seed: int, seeds: int) -> list[Row]:
    """The law on two quantised encoders with filtered rates, not studied by the paper."""
    pairs, period = [], load_constants(PAPER)["sensor_period"]
    for k in range(seeds):
        place = np.random.default_rng(seed + k).uniform(0.0, 1.0, 2)
        start = (float(place[0]), float(place[1]))
        both = (
            Experiment(composition, period=period, law=high_gain(), sensors=start)
            for composition in ("all", "comparison")
        )
        pairs.append([run(experiment).largest_deg for experiment in both])
    names = ("high_tracking_gain", "high_tracking_damping", "rate_cutoff", "sensor_period", "joint_sensor_bits")
    text = f"{BASE}; law every 0.25 ms on a 20 bit joint sensor and a 4000 count encoder; seeds: where the counts begin"
    error, error_seeds = over_seeds([first for first, _ in pairs])
    ratio, ratio_seeds = over_seeds([second / first for first, second in pairs], "more")
    more: dict[str, Any] = {"constants": (*names, "encoder_counts")}
    return [
        _row("sensors.error_deg", "(26)-(30)", error, text, seeds=error_seeds, **more),
        _row("sensors.ratio_to_eq31", "(26), (31)", ratio, text, "-", seeds=ratio_seeds, better="more", **more),
    ]


def rows(quick: bool, seed: int, progress: Progress, seeds: int = 3) -> list[Row]:
    """The paper's figures beside ours. `quick`: one seed of the main figures and the long control periods."""
    progress(0.0, "gandhi: composite law against (31)")
    found = main_rows(phases(seed, 1 if quick else seeds))
    progress(0.35, "gandhi: control periods")
    found += period_rows(("0p5ms", "1ms") if quick else PERIODS)
    if quick:
        return found
    progress(0.4, "gandhi: terms")
    found += ablation_rows()
    progress(0.55, "gandhi: variants")
    found += variant_rows()
    progress(0.95, "gandhi: wrong parameters, sensors")
    return [*found, *knowledge_rows(seed, seeds), *sensor_rows(seed, seeds)]


def figures(quick: bool, seed: int, progress: Progress) -> list[tuple[str, Any]]:
    """Figs. 4, 5 and 6, and the control periods."""

    progress(0.0, "gandhi: figures")
    found = [motion(), errors()]
    if quick:
        return found
    return [*found, full_model(), terms(), periods()]


# ---- Figures ---------------------------------------------------------------------------------------


Titled = tuple[str, Any]
COMPOSITE, PLAIN = "composite law (26)", "plain law (31)"


def sheet(rows: list[str], units: list[str], across: str = "time in s") -> Any:
    """An empty figure: one row for each subtitle, a shared axis across."""
    from plotly.subplots import make_subplots

    figure = make_subplots(rows=len(rows), cols=1, shared_xaxes=True, vertical_spacing=0.1, subplot_titles=rows)
    for row, unit in enumerate(units, 1):
        figure.update_yaxes(title_text=unit, row=row, col=1)
    figure.update_xaxes(title_text=across, row=len(rows), col=1)
    margin = {"l": 80, "r": 20, "t": 80, "b": 50}
    figure.update_layout(template="plotly_white", height=250 * len(rows) + 100, margin=margin)
    return figure


def line(figure: Any, x: FloatArray, y: FloatArray, name: str, colour: int, row: int = 1, **more: Any) -> None:
    """One series, thinned to what a screen shows."""
    keep = thinned(np.ascontiguousarray(y))
    style = {"color": COLOURS[colour], "width": 1.4, **more.pop("line", {})}
    figure.add_scatter(x=x[keep], y=y[keep], name=name, line=style, row=row, col=1, mode="lines", **more)


def motion() -> Titled:
    """Fig. 4: the reference with the joint on it, and the load."""
    ours = run(Experiment())
    figure = sheet(["reference and joint position", "load torque"], ["deg", "N m"])
    line(figure, ours.time, np.rad2deg(ours.reference[:, 0]), "reference", 7)
    line(figure, ours.time, np.rad2deg(ours.measured[:, 0]), "joint", 0, line={"dash": "dash"})
    line(figure, ours.time, ours.reference[:, 5], "load", 3, 2)
    return "Fig. 4: trajectory and load", figure


def errors() -> Titled:
    """Fig. 5: error of joint and motor with and without compensation; below the error that remains, magnified."""
    ours, plain = run(Experiment()), run(Experiment("comparison"))
    titles = ["joint position error", "the same in the steady state, composite law", "motor position error / N"]
    figure = sheet(titles, ["deg", "1e-6 deg", "deg"])
    steady = ours.time >= 3.0
    for colour, (name, one) in enumerate(((COMPOSITE, ours), (PLAIN, plain))):
        line(figure, one.time, one.error_deg, name, colour)
        line(figure, one.time, one.motor_error_deg, name, colour, 3, showlegend=False)
    line(figure, ours.time[steady], 1e6 * ours.error_deg[steady], COMPOSITE, 0, 2, showlegend=False)
    return "Fig. 5: tracking errors", figure


def full_model() -> Titled:
    """Fig. 6: C-1, the plant the law was made for, and C-2, the plant with the polynomial spring."""
    runs = {"C-1 (linear spring)": run(Experiment()), "C-2 (polynomial spring)": run(Experiment(nonlinear=True))}
    figure = sheet(["joint position error", "the same in the steady state", "motor position error / N"], ["deg"] * 3)
    for colour, (name, one) in enumerate(runs.items()):
        steady = one.time >= 3.0
        line(figure, one.time, one.error_deg, name, colour)
        line(figure, one.time[steady], one.error_deg[steady], name, colour, 2, showlegend=False)
        line(figure, one.time, one.motor_error_deg, name, colour, 3, showlegend=False)
    return "Fig. 6: model of the law and full model", figure


def terms() -> Titled:
    """Steady-state error with the slow terms added one after the other."""
    import plotly.graph_objects as go

    values = [run(Experiment(composition)).largest_deg for composition in ("comparison", *ABLATION.values())]
    figure = go.Figure(go.Bar(x=["plain law (31)", "τ₀", "+ τ₁", "+ τ₂", "+ τ₄"], y=values, marker_color=COLOURS[0]))
    figure.update_yaxes(title_text="largest joint error, deg", type="log", exponentformat="power")
    figure.update_layout(template="plotly_white", height=380, margin={"l": 80, "r": 20, "t": 40, "b": 50})
    return "Terms of the composite law", figure


def _largest(prediction: float) -> list[float]:
    return [run(Experiment(prediction=prediction, period=period)).largest_deg for period in PERIODS.values()]


def periods() -> Titled:
    """Steady-state error over the control period, with and without half-sample prediction."""
    figure = sheet(["steady-state joint error over the control period"], ["largest error, deg"], "ms")
    across = 1e3 * np.array(list(PERIODS.values()))
    for colour, (name, prediction) in enumerate((("half-sample prediction", 0.5), ("no prediction", 0.0))):
        line(figure, across, np.array(_largest(prediction)), name, colour)
    figure.update_xaxes(type="log")
    figure.update_yaxes(type="log", exponentformat="power")
    return "Control period", figure
