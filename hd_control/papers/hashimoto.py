"""Hashimoto's results beside ours: the torque sensor on the flexspline and torque control (19) of a one-link arm.

Rows first, then the figures: sensor (Figs. 4, 12-14) and torque control (15-17).
"""

from __future__ import annotations

import math
from typing import Any

import numpy as np

from hd_control.laws.torque_feedback import static_error
from hd_control.papers import hashimoto_sensor as sensor
from hd_control.papers.gandhi import Titled, line, sheet
from hd_control.papers.hashimoto_runs import (
    Motion,
    TorqueExperiment,
    TorqueRun,
    Variant,
    half_width,
    rotor_inertia,
    run,
    step_figures,
    wave_figures,
)
from hd_control.papers.rows import Progress, Row, load_constants, over_seeds

PAPER = "hashimoto"
GAIN, GAIN_TOLERANCE = 50.74, 0.01  # issue: uV/(N m), exact formula
HALF_WIDTH, RISE, AMPLITUDE, PHASE = 0.01, 7.0, 0.95, 2.0  # issue: N m, ms (10 %), -, degrees
ARM = ("presliding_distance", "bristle_damping", "command_delay", "torque_rate_cutoff", "plant_step", "gauge_noise")
STATIC = ("static_amplitude", "static_frequency", "static_range", "static_bin", "static_cycles")
BETTER = ("feedback_integral", "feedback_integral_limit", "friction_share", "feedback_friction_rate")
LOCKED = "link locked, 0.5 ms, one sample of delay, gauge noise 0.02 N m; seeds: noise"
IMPROVED = "(19) with integral term and 90 % of the friction fed forward, the same values in all rows"


def _row(name: str, equation: str, unit: str, ours: float, conditions: str, **more: Any) -> Row:
    chosen = load_constants(PAPER).chosen(*more.pop("constants", ()))
    values: dict[str, Any] = {"paper_value": None, "target": None, **more}
    return Row(f"hashimoto.{name}", PAPER, equation, unit, ours=ours, conditions=conditions, chosen=chosen, **values)


def gain_rows() -> list[Row]:
    """The bridge from geometry and material."""
    c, own = load_constants(PAPER), sensor.bridge(rated=False)
    gain = 1e6 * sensor.gain(own)
    text = "exact Wheatstone bridge; strain of the diaphragm by quadrature of (A1)-(A6)"
    return [
        _row("gauge_gain", "(8), (14)", "uV/(N m)", gain, text, paper_value=50.0, target=GAIN, better="near",
             tolerance=GAIN_TOLERANCE),
        _row("gauge_gain.amplified", "(14)", "mV/(N m)", 1e-3 * gain * c["amplifier_gain"],
             f"{text}; behind the amplifier; the paper measured 24", paper_value=25.0),
        _row("gauge_nonlinearity", "Fig. 12", "%", 100.0 * sensor.nonlinearity(own),
             f"{text}; share of the rated output; the paper: good linearity"),
    ]  # fmt: skip


def ripple_rows() -> list[Row]:
    """What the wave generator leaves in the reading, % of the rated torque."""
    text = "amplitude over one turn without torque, exact bridge; Psi_0 100, rated strain 200 ustrain"
    found = [
        _row("modulation.one_pair", "(3)", "%", sensor.ripple_percent(sensor.bridge(), one_pair=True),
             f"{text}; one gauge pair in a half bridge"),
        _row("modulation.two_pairs", "(4), (5)", "%", sensor.ripple_percent(sensor.bridge()),
             f"{text}; two pairs at exactly 90 degrees"),
    ]  # fmt: skip
    for degrees, name in ((0.5, "0p5deg"), (1.0, "1deg"), (2.0, "2deg"), (5.0, "5deg")):
        value = sensor.ripple_percent(sensor.bridge(misalignment=math.radians(degrees)))
        paper = {"paper_value": 1.0, "target": 1.0} if degrees == 2.0 else {}
        found.append(
            _row(f"misalignment_{name}", "(13)", "%", value, f"{text}; second pair {degrees:g} deg off", **paper)
        )
    own = sensor.ripple_percent(sensor.bridge(rated=False, misalignment=math.radians(2.0)))
    left = sensor.corrected_percent(math.radians(2.0))
    return [
        *found,
        _row("misalignment_2deg.own_strain", "(7), (13)", "%", own, "the same with the strain of (7), 322 ustrain"),
        _row("misalignment_2deg.corrected", "(9)-(13)", "%", left, f"{text}; 2 deg off, known and taken off by fusion"),
    ]  # fmt: skip


def fourth_rows() -> list[Row]:
    """The harmonic that two pairs at 90 degrees do not cancel, and how a second bridge does."""
    size = load_constants(PAPER)["fourth_modulation"]
    one, two = (sensor.bridge(place=place, fourth_modulation=size) for place in (0.0, 0.25 * math.pi))
    more = {"constants": ("fourth_modulation",)}
    return [
        _row("fourth_harmonic", "Figs. 3, 5", "%", sensor.ripple_percent(one), "pairs at exactly 90 degrees", **more),
        _row("fourth_harmonic.two_bridges", "-", "%", sensor.averaged_percent(one, two),
             "mean of two such bridges 45 degrees apart", **more),
    ]  # fmt: skip


def temperature_rows(seed: int, seeds: int) -> list[Row]:
    """Zero error after warming up: what the bridge compensates, and what a fitted drift takes off."""
    zeros = np.array([sensor.warm_percent(seed + k) for k in range(seeds)])
    text = "zero error in % of rated after 30 K; seeds: spread of the gauges"
    more = {"constants": ("warming", "apparent_strain", "apparent_spread")}
    names = ("one_gauge", "bridge", "corrected")
    words = ("one active gauge", "four gauges in the bridge", "and a drift fitted at 15 K, taken off by fusion")
    found = []
    for name, words_, values in zip(names, words, zeros.T, strict=True):
        ours, spread = over_seeds(values.tolist())
        found.append(_row(f"temperature.{name}", "Fig. 9", "%", ours, f"{words_}; {text}", seeds=spread, **more))
    return found


def motion_rows() -> list[Row]:
    """The sensor beside the true torque while things move."""
    rated = load_constants(PAPER)["rated_torque"]
    text = "largest difference to the true torque, % of rated; second pair 2 deg off, uncorrected"
    more = {"constants": ("joint_proportional", "joint_rate", "joint_step", *ARM[:2])}
    found = []
    for name, figure, series, what in (
        ("pulse", "Fig. 13", sensor.pulse(), "rectangular motor torque, link locked"),
        ("moving_joint", "Fig. 14", sensor.moving_joint(math.radians(2.0)), "step of the joint angle"),
    ):
        ours = 100.0 * float(np.abs(series["sensor"] - series["true"]).max()) / rated
        found.append(_row(f"{name}.sensor_error", figure, "%", ours, f"{what}; {text}", **more))
    return found


def _seeded(motion: Motion, variant: Variant, seed: int, seeds: int, locked: bool = True) -> list[Any]:
    figures: dict[str, Any] = {"static": half_width, "step": step_figures, "wave": wave_figures}
    experiments = (TorqueExperiment(motion, variant, locked, noise_seed=seed + k) for k in range(seeds))
    return [figures[motion](run(experiment)) for experiment in experiments]


def static_rows(seed: int, seeds: int) -> list[Row]:
    """Fig. 15: the static loop."""
    c = load_constants(PAPER)
    text = f"half-width for |T_d| < 10 N m of a 20 N m sine at 0.05 Hz; {LOCKED}"
    names: dict[Variant, tuple[str, str, tuple[str, ...]]] = {
        "open": ("half_width.open", "motor alone", ()),
        "paper": ("half_width.eq19", "(19)", ()),
        "improved": ("half_width", IMPROVED, BETTER),
    }
    found = []
    for variant, (name, what, more) in names.items():
        ours, spread = over_seeds([width for width, _ in _seeded("static", variant, seed, seeds)])
        paper = {"paper_value": 4.0} if variant == "open" else {}
        target = {"target": HALF_WIDTH} if variant == "improved" else {}
        found.append(_row(name, "Fig. 15", "N m", ours, f"{what}; {text}", seeds=spread,
                          constants=(*ARM, *STATIC, *more), **paper, **target))  # fmt: skip
    ours, spread = over_seeds([error for _, error in _seeded("static", "improved", seed, seeds)])
    formula = static_error(c["coulomb_torque"], c["stiffness"], rotor_inertia(c), 0.0, c["feedback_proportional"])
    return [
        *found,
        _row("half_width.formula", "(20)", "N m", formula, "formula (20), link locked"),
        _row("static_error.anywhere", "Fig. 15", "N m", ours, f"{IMPROVED}; with the reversals; {LOCKED}", seeds=spread,
             constants=(*ARM, *STATIC, *BETTER)),
    ]  # fmt: skip


def step_rows(seed: int, seeds: int) -> list[Row]:
    """Fig. 16: the step."""
    figures = {variant: _seeded("step", variant, seed, seeds) for variant in ("open", "paper", "improved")}
    text = f"step of 5 N m; {LOCKED}"
    more = {"constants": (*ARM, "step_amplitude")}
    rise = over_seeds([row[0] for row in figures["paper"]], "near", RISE)
    left = over_seeds([row[1] for row in figures["paper"]], "near")
    over = over_seeds([row[2] for row in figures["paper"]])
    stays = over_seeds([row[1] for row in figures["improved"]], "near")
    better = over_seeds([row[0] for row in figures["improved"]], "near", RISE)
    found = [
        _row("rise_time", "Fig. 16", "ms", rise[0], f"(19), 10-90 %; {text}", paper_value=7.0, target=RISE,
             better="near", tolerance=0.1 * RISE, seeds=rise[1], **more),
        _row("rise_time.improved", "Fig. 16", "ms", better[0], f"{IMPROVED}, 10-90 %; {text}", paper_value=7.0,
             target=RISE, better="near", tolerance=0.1 * RISE, seeds=better[1],
             constants=(*ARM, "step_amplitude", *BETTER)),
        _row("steady_state_error", "Fig. 16", "%", left[0], f"(19); {text}; the paper: almost zero", paper_value=0.0,
             better="near", seeds=left[1], **more),
        _row("steady_state_error.improved", "Fig. 16", "%", stays[0], f"{IMPROVED}; mean of the last third; {text}",
             paper_value=0.0, better="near", seeds=stays[1], constants=(*ARM, "step_amplitude", *BETTER)),
        _row("overshoot", "Fig. 16", "%", over[0], f"(19); {text}", seeds=over[1], **more),
    ]  # fmt: skip
    open_error = figures["open"][0][1]
    return [
        *found,
        _row("steady_state_error.open", "Fig. 16", "%", open_error,
             f"motor alone; {text}; the paper's 70 % belongs to an amplitude that it does not print",
             paper_value=-70.0, **more),
    ]  # fmt: skip


def wave_rows(seed: int, seeds: int) -> list[Row]:
    """Fig. 17: 5 N m at 20 Hz."""
    text = f"5 N m at 20 Hz; {LOCKED}"
    found = []
    for tag, variant, what in (
        (".open", "open", "motor alone"),
        (".eq19", "paper", "(19)"),
        ("", "improved", IMPROVED),
    ):
        values = _seeded("wave", variant, seed, seeds)  # type: ignore[arg-type]
        more = {"constants": (*ARM, *(BETTER if variant == "improved" else ()))}
        gain = over_seeds([row[0] for row in values], "more")
        phase = over_seeds([row[1] for row in values], "near")
        gain_target = {"target": AMPLITUDE} if not tag else {}
        phase_target = {"target": 0.0, "tolerance": PHASE} if not tag else {}
        found += [
            _row(f"20hz.amplitude{tag}", "Fig. 17", "-", gain[0], f"{what}; {text}", better="more", seeds=gain[1],
                 **gain_target, **more),
            _row(f"20hz.phase_deg{tag}", "Fig. 17", "deg", phase[0], f"{what}; {text}", better="near", seeds=phase[1],
                 **phase_target, **more),
        ]  # fmt: skip
    return found


def free_rows(seed: int, seeds: int) -> list[Row]:
    """The link free to move: the paper's model, experiments only with the link locked."""
    text = f"5 N m at 20 Hz, link free; {LOCKED.removeprefix('link locked, ')}"
    found = []
    for tag, variant, what in ((".eq19", "paper", "(19)"), ("", "improved", IMPROVED)):
        values = _seeded("wave", variant, seed, seeds, locked=False)  # type: ignore[arg-type]
        gain, phase = over_seeds([row[0] for row in values], "more"), over_seeds([row[1] for row in values], "near")
        more = {"constants": (*ARM, *(BETTER if variant == "improved" else ()))}
        found += [
            _row(f"free_link.20hz.amplitude{tag}", "(15)-(19)", "-", gain[0], f"{what}; {text}", better="more",
                 seeds=gain[1], **more),
            _row(f"free_link.20hz.phase_deg{tag}", "(15)-(19)", "deg", phase[0], f"{what}; {text}", better="near",
                 seeds=phase[1], **more),
        ]  # fmt: skip
    return found


def rows(quick: bool, seed: int, progress: Progress, seeds: int = 3) -> list[Row]:
    """The paper's figures beside ours. `quick`: one seed, without temperature, motion and free link."""
    count = 1 if quick else seeds
    progress(0.0, "hashimoto: sensor")
    found = [*gain_rows(), *ripple_rows(), *fourth_rows()]
    if not quick:
        found += [*temperature_rows(seed, count), *motion_rows()]
    progress(0.2, "hashimoto: torque control")
    found += [*static_rows(seed, count), *step_rows(seed, count)]
    progress(0.8, "hashimoto: 20 Hz")
    return [*found, *wave_rows(seed, count), *([] if quick else free_rows(seed, count))]


def figures(quick: bool, seed: int, progress: Progress) -> list[tuple[str, Any]]:
    """Figs. 4, 12 to 17 as far as the text gives their data."""

    progress(0.0, "hashimoto: figures")
    found = [modulation(), steps(seed), waves(seed)]
    return found if quick else [*found, linearity(), sensor_in_motion(), static_loops(seed)]


# ---- Figures ---------------------------------------------------------------------------------------


VARIANTS: dict[Variant, str] = {
    "open": "motor alone",
    "paper": "law (19)",
    "improved": "(19), integral, friction fed forward",
}


def _runs(motion: Motion, seed: int) -> dict[str, TorqueRun]:
    return {name: run(TorqueExperiment(motion, variant, noise_seed=seed)) for variant, name in VARIANTS.items()}


def modulation() -> Titled:
    """Fig. 4: the reading over a turn of the wave generator without torque."""
    degrees, nothing = np.rad2deg(sensor.ANGLES), np.zeros_like(sensor.ANGLES)
    titles = ["one gauge pair and two pairs", "two pairs, second one 2 degrees off; fourth harmonic"]
    figure = sheet(titles, ["% of rated torque"] * 2, "gauge angle β in deg")
    exact, off = sensor.bridge(), sensor.bridge(misalignment=math.radians(2.0))
    fourth = sensor.bridge(fourth_modulation=sensor.constants()["fourth_modulation"])
    scale = 100.0 / (sensor.gain(exact) * sensor.constants()["rated_torque"])
    line(figure, degrees, 2.0 * scale * exact.one_pair(nothing, sensor.ANGLES), "one pair", 1)
    line(figure, degrees, scale * exact.output(nothing, sensor.ANGLES), "two pairs", 0)
    line(figure, degrees, scale * off.output(nothing, sensor.ANGLES), "2° off", 3, 2)
    line(figure, degrees, scale * fourth.output(nothing, sensor.ANGLES), "fourth harmonic", 4, 2)
    return "Figs. 4, 5: modulation by the wave generator and its cancellation", figure


def linearity() -> Titled:
    """Fig. 12: output over torque at rest, up and down."""
    most, own = sensor.constants()["rated_torque"], sensor.bridge(rated=False)
    torque = np.concatenate((np.linspace(-most, most, 100), np.linspace(most, -most, 100)))
    output = own.output(torque, np.zeros_like(torque)) * sensor.constants()["amplifier_gain"]
    figure = sheet(["sensor output behind the amplifier"], ["V"], "torque in N m")
    line(figure, torque, output, "sensor", 0)
    return "Fig. 12: linearity", figure


def sensor_in_motion() -> Titled:
    """Figs. 13 and 14: sensor beside the true torque."""
    titles = ["motor pulse on the locked link", "step of the joint angle", "sensor minus true torque"]
    figure = sheet(titles, ["N m"] * 3)
    for row, series in enumerate((sensor.pulse(), sensor.moving_joint(math.radians(2.0))), 1):
        line(figure, series["time"], series["true"], "true torque", 7, row, showlegend=row == 1)
        line(figure, series["time"], series["sensor"], "sensor, 2° off", 0, row, showlegend=row == 1,
             line={"dash": "dot"})  # fmt: skip
        name = ("pulse", "moving joint")[row - 1]
        line(figure, series["time"], series["sensor"] - series["true"], f"difference, {name}", row, 3)
    return "Figs. 13, 14: sensor in motion", figure


def static_loops(seed: int) -> Titled:
    """Fig. 15: joint torque over required torque, slow sine; below the error."""
    figure = sheet(["static loop", "joint torque minus required torque"], ["N m", "N m"], "required torque in N m")
    for colour, (name, one) in enumerate(_runs("static", seed).items()):
        last = slice(-len(one.time) // sensor.constants()["static_cycles"], None)
        thin = slice(None, None, 20)
        required, torque = one.required[last][thin], one.torque[last][thin]
        for row, values in ((1, torque), (2, torque - required)):
            style: Any = {"color": sheet_colour(colour), "width": 1.4}
            figure.add_scatter(x=required, y=values, name=name, line=style, row=row, col=1, showlegend=row == 1)
    return "Fig. 15: static characteristic", figure


def sheet_colour(number: int) -> str:
    """The colour of a series by its number."""
    from hd_control.lab.page.style import COLOURS

    return COLOURS[number % len(COLOURS)]


def steps(seed: int) -> Titled:
    """Fig. 16: the step of the required torque."""
    figure = sheet(["joint torque"], ["N m"], "time after the step in ms")
    found = _runs("step", seed)
    for colour, (name, one) in enumerate(found.items()):
        shown = (one.time >= 0.09) & (one.time < 0.25)
        line(figure, 1e3 * (one.time[shown] - 0.1), one.torque[shown], name, colour)
    line(figure, 1e3 * (one.time[shown] - 0.1), one.required[shown], "required", 7, line={"dash": "dash"})
    return "Fig. 16: step response", figure


def waves(seed: int) -> Titled:
    """Fig. 17: 5 N m at 20 Hz."""
    figure = sheet(["joint torque"], ["N m"], "time in ms")
    for colour, (name, one) in enumerate(_runs("wave", seed).items()):
        shown = (one.time >= 1.0) & (one.time < 1.15)
        line(figure, 1e3 * (one.time[shown] - 1.0), one.torque[shown], name, colour)
    line(figure, 1e3 * (one.time[shown] - 1.0), one.required[shown], "required", 7, line={"dash": "dash"})
    return "Fig. 17: 20 Hz", figure
