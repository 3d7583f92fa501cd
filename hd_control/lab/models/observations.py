"""What a recording shows of one joint without asking what its model misses: sensors, delays, friction curve, spectra.

These are there also when a diagnosis refuses: people look for them first.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from hd_control.lab.balances.channels import JointEquations, shown_unit
from hd_control.lab.maps.friction_curve import FrictionCurve, FrictionPoint, friction_curves
from hd_control.lab.maps.signal_spectra import SignalSpectrum, signal_spectra
from hd_control.lab.signals.checks import SignalChecks
from hd_control.lab.signals.delays import MOTION, MeasuredDelay
from hd_control.lab.signals.joint_signals import JointSignals
from hd_control.lab.signals.sensors import SensorQuality, sensor_qualities

SHOWN_SPEEDS = 5
"""Speeds of a friction curve in its sentence; all are in the JSON form and in the picture."""
SHOWN_LINES = 6
"""Lines of a spectrum in sentences."""
OPEN_DELAY = 0.01
"""s by which a torque may be late where the motion does not show its delay; friction intervals are wider by that."""


@dataclass(frozen=True)
class Observations:
    """Of one joint: sensors by signal, delays, friction curves, spectra; and which checks of its signals spoke."""

    sensors: Mapping[str, SensorQuality]
    delays: tuple[MeasuredDelay, ...]
    friction: tuple[FrictionCurve, ...]
    spectra: tuple[SignalSpectrum, ...]
    checks: SignalChecks

    def json(self) -> dict[str, Any]:
        """What `hd.compare/1` says of it."""
        return {
            "sensors": {name: quality.json() for name, quality in self.sensors.items()},
            "delays": [delay.json() for delay in self.delays],
            "friction": {curve.signal: curve.json() for curve in self.friction},
            "spectra": {spectrum.signal: spectrum.json() for spectrum in self.spectra},
            "contradictions": list(self.checks.contradictions),
        }


def observe(signals: JointSignals, equations: JointEquations, checks: SignalChecks) -> Observations:
    """Everything that is measured on one joint; `equations` are its balances under a model that knows the gravity."""
    torques = [delay for delay in checks.delays if delay.against == MOTION]
    late = {d.signal: (d.seconds, d.error) for d in torques if d.sure}
    late = late if len(late) == 1 else {}  # of two, perhaps only one is late
    open_ = {d.signal: (0.0, OPEN_DELAY) for d in torques if not d.determined}
    curves = friction_curves(equations, {**open_, **late})
    sensors = sensor_qualities(signals)
    return Observations(sensors, checks.delays, curves, signal_spectra(equations), checks)


# ---- Words -----------------------------------------------------------------------------------------


def sensor_sentence(quality: SensorQuality) -> str:
    """`gauge_torque: noise 0.03 N m per sample, count 0.01 N m; smoothed above 5.1 Hz, ...`."""
    unit = quality.unit
    parts = [f"noise {size(quality.noise, unit)} per sample"] if np.isfinite(quality.noise) else []
    parts.append(f"count {size(quality.step, unit)}" if quality.step else "no count seen")
    if np.isfinite(quality.smoothed_above):
        parts.append(f"smoothed above {quality.smoothed_above:.2g} Hz, so its noise cannot be measured")
    if quality.stutters:
        parts.append(f"{100.0 * quality.repeated:.0f} % of the samples repeat the one before")
    return f"{quality.signal}: {', '.join(parts)}"


def delay_sentence(delay: MeasuredDelay) -> str:
    """`gauge_torque 62.4 ms late (61.2 ... 63.6) against the motion`."""
    pair = f"{delay.signal} against {delay.against}"
    if not delay.determined:
        return f"{pair}: not determined, {delay.why_not}"
    low, high = sorted((abs(1e3 * delay.low), abs(1e3 * delay.high)))
    if delay.low <= 0.0 <= delay.high:
        return f"{pair}: none within {max(low, high):.2g} ms"
    how = "late" if delay.seconds > 0.0 else "early"
    return f"{pair}: {abs(1e3 * delay.seconds):.3g} ms {how} ({low:.3g} ... {high:.3g})"


def friction_sentences(curve: FrictionCurve) -> Iterator[str]:
    """The curve at a few speeds, its differences by direction and load, and what was taken out."""
    both = curve.of(0)
    points = both or curve.of(1) or curve.of(-1)
    shown = [points[i] for i in np.unique(np.linspace(0, len(points) - 1, SHOWN_SPEEDS).round().astype(int))]
    known = [point for point in points if np.isfinite(point.low)]
    if known and all(point.low <= 0.0 <= point.high for point in known):
        yield f"{curve.signal}: none, within {size(max(abs(p.torque) for p in points), 'N m')}"
        yield "; ".join(curve.removed)
        return
    how = "both directions" if both else "forward only" if curve.of(1) else "backward only"
    yield f"{curve.signal}, {how}: {', '.join(map(_point, shown))}"
    if any(point.high < 0.0 for point in known):
        yield "negative at some speeds, which friction cannot be: a delay or the torque of other joints stays in it"
    yield from _by_direction(curve)
    for variable in dict.fromkeys(group.variable for group in curve.groups):
        yield from _by_group(curve, variable)
    yield "; ".join(curve.removed)
    widest = max((0.5 * (p.high - p.low) for p in points if np.isfinite(p.low)), default=np.inf)
    if curve.per_ms > widest:
        yield f"a delay of the torque by one ms would move it by {size(curve.per_ms, 'N m')}"


def _point(point: FrictionPoint) -> str:
    """`1.95 N m (1.93 ... 1.96) at 0.08 rad/s`."""
    interval = f" ({point.low:.3g} ... {point.high:.3g})" if np.isfinite(point.low) else " (too little for an interval)"
    return f"{point.torque:.3g} N m{interval} at {point.speed:.2g} rad/s"


def _by_direction(curve: FrictionCurve) -> Iterator[str]:
    """Forward against backward, if they surely differ at all speeds together."""
    pairs = [(f, b) for f in curve.of(1) for b in curve.of(-1) if 0.9 < f.speed / b.speed < 1.1]
    pairs = [(f, b) for f, b in pairs if np.isfinite([f.low, b.low]).all()]
    apart = [(f.torque - b.torque, max(f.low - b.high, b.low - f.high)) for f, b in pairs]
    if pairs and np.mean([gap > 0.0 for _, gap in apart]) > 0.5:
        middle = float(np.median([difference for difference, _ in apart]))
        yield f"forward is {size(abs(middle), 'N m')} {'above' if middle > 0.0 else 'below'} backward"


def _by_group(curve: FrictionCurve, variable: str) -> Iterator[str]:
    """How the curve changes from the lowest to the highest load or temperature, at the speeds that both have."""
    groups = [group for group in curve.groups if group.variable == variable]
    first, last = ([p for p in curve.groups[g] if p.direction == 0] for g in (groups[0], groups[-1]))
    pairs = [(a, b) for a in first for b in last if 0.8 < a.speed / b.speed < 1.25 and a.torque > 0.0]
    if pairs:
        a, b = pairs[len(pairs) // 2]
        low, high = groups[0], groups[-1]
        yield (
            f"by {variable}: {_point(a)} for {low.low:.3g} ... {low.high:.3g} {low.unit}, "
            f"{_point(b)} for {high.low:.3g} ... {high.high:.3g} {high.unit}"
        )


def spectrum_sentences(spectrum: SignalSpectrum, sensors: Mapping[str, SensorQuality]) -> list[str]:
    """Lines of one measured signal, those that have a name or are bound to the angle or to time; and what is hidden."""
    factor, unit = shown_unit(spectrum.unit)
    found = spectrum.sentences(unit, factor)
    more = [f"and {len(found) - SHOWN_LINES} weaker ones"] if len(found) > SHOWN_LINES else []
    quality = sensors.get(spectrum.signal)
    if found and quality is not None and np.isfinite(quality.smoothed_above):
        more.append(f"amplitudes above {quality.smoothed_above:.2g} Hz are too small, the signal was smoothed there")
    return [*found[:SHOWN_LINES], *more]


def size(value: float, unit: str) -> str:
    """A number with its unit, in thousandths or millionths where that reads better."""
    for factor, prefix in ((1.0, ""), (1e3, "m"), (1e6, "u")):
        if abs(value) * factor >= 0.1 or prefix == "u":
            return f"{value * factor:.3g} {prefix}{unit}"
    return f"{value:.3g} {unit}"


def sections(found: Observations) -> list[tuple[str, Sequence[str]]]:
    """Head and sentences of each part, those that have any."""
    parts = [
        ("sensors", [sensor_sentence(quality) for quality in found.sensors.values()]),
        ("delays", [delay_sentence(delay) for delay in found.delays]),
        ("friction", [text for curve in found.friction for text in friction_sentences(curve)]),
        (
            "lines",
            [f"{x.signal} {text}" for x in found.spectra for text in spectrum_sentences(x, found.sensors)],
        ),
    ]
    return [(head, texts) for head, texts in parts if texts]
