"""What a report shows: plain data of each joint, and how it is built from comparisons, diagnosis and ladder."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from hd_control.lab.balances.channels import JointEquations
from hd_control.lab.diagnosis.verdict import JointDiagnosis
from hd_control.lab.maps.condition_maps import ChannelMaps, conditions_of, maps_of
from hd_control.lab.maps.orders import OrderLine, OrderSpectrum, lines_of, order_spectrum
from hd_control.lab.maps.zoom import Window, zoom_windows
from hd_control.lab.models.compare import ChannelComparison, JointComparison
from hd_control.lab.models.observations import Observations
from hd_control.lab.page.model_figures import HorizonCurve, Rung

FLAT = 0.5
"""Width of an interval over its value from which on the data do not fix a parameter."""


@dataclass(frozen=True)
class ChannelPage:
    """One channel of one joint: by model name its comparison, condition maps, order spectrum and lines; windows."""

    name: str
    models: Mapping[str, ChannelComparison]
    maps: Mapping[str, ChannelMaps]
    spectra: Mapping[str, tuple[OrderSpectrum, tuple[OrderLine, ...]]]
    windows: tuple[Window, ...]


@dataclass(frozen=True)
class ParameterRow:
    """One line of a parameter table; `low` and `high` are the 95 % interval, `bound` and `source` as the model states
    them, `remark` such as dead, flat, trade-off with ..., at bound."""

    effect: str
    name: str
    unit: str
    value: float
    low: float | None = None
    high: float | None = None
    bound: str = ""
    source: str = ""
    remark: str = ""


@dataclass(frozen=True)
class Ladder:
    """The rungs of one joint in one unit, and why it ended."""

    rungs: tuple[Rung, ...]
    unit: str
    stopped_because: str = ""

    @classmethod
    def of(cls, document: Mapping[str, Any], unit: str) -> Ladder:
        """From one joint's part of `hd.ladder/1`."""
        rungs = tuple(Rung.of(rung) for rung in document["rungs"])
        return cls(rungs, unit, str(document.get("stopped_because") or ""))


@dataclass(frozen=True)
class JointPage:
    """Everything on one joint. `ladders`: one, or one for each channel. `horizons`: title -> curves of one picture.
    `notes`: what was repaired or left out. `observations`: what is shown before any model is asked."""

    joint: str
    channels: tuple[ChannelPage, ...] = ()
    diagnosis: JointDiagnosis | None = None
    ladders: tuple[Ladder, ...] = ()
    parameters: tuple[ParameterRow, ...] = ()
    horizons: Mapping[str, tuple[HorizonCurve, ...]] = field(default_factory=dict)
    notes: tuple[str, ...] = ()
    observations: Observations | None = None


@dataclass(frozen=True)
class ReportPage:
    """A whole report: what was compared with what, and its joints."""

    title: str
    bag: str
    models: tuple[str, ...]
    joints: tuple[JointPage, ...]
    command: str = ""
    notes: tuple[str, ...] = ()


def joint_page(
    joint: str,
    comparisons: Mapping[str, JointComparison],
    diagnosis: JointDiagnosis | None = None,
    ladders: Sequence[Ladder] = (),
    parameters: Sequence[ParameterRow] | None = None,
    horizons: Mapping[str, tuple[HorizonCurve, ...]] | None = None,
    notes: Sequence[str] = (),
    observations: Observations | None = None,
) -> JointPage:
    """The page of one joint. comparisons: model name -> comparison on the same recording; parameters: those of the
    diagnosis if not given."""
    rows = parameter_rows(diagnosis) if parameters is None and diagnosis is not None else tuple(parameters or ())
    return JointPage(
        joint, channel_pages(comparisons), diagnosis, tuple(ladders), rows, horizons or {}, tuple(notes), observations
    )


def channel_pages(comparisons: Mapping[str, JointComparison]) -> tuple[ChannelPage, ...]:
    """The channels of a joint, each with all models that have it."""
    names = dict.fromkeys(name for item in comparisons.values() for name in item.channels)
    return tuple(_channel_page(name, {m: c for m, c in comparisons.items() if name in c.channels}) for name in names)


def _channel_page(name: str, comparisons: Mapping[str, JointComparison]) -> ChannelPage:
    models = {model: comparison.channels[name] for model, comparison in comparisons.items()}
    maps, spectra = {}, {}
    for model, comparison in comparisons.items():
        equations, channel = comparison.dictionary.equations, models[model]
        maps[model] = maps_of(conditions_of(equations, name), channel.residual, channel.used)
        ratio = equations.states.gear_ratio
        record = comparison.order_record(name)
        spectrum = order_spectrum([record], ratio) if ratio != 1.0 else order_spectrum([record], None, 20.0, 1500.0)
        spectra[model] = (spectrum, lines_of(spectrum))
    first_name = next(iter(models))
    return ChannelPage(
        name, models, maps, spectra, _windows(comparisons[first_name].dictionary.equations, models[first_name])
    )


def _windows(equations: JointEquations, channel: ChannelComparison) -> tuple[Window, ...]:
    step = equations.channels[channel.name].band.step
    velocity = np.asarray(equations.states.motor_velocity[::step])
    return zoom_windows(channel.time, channel.used, channel.residual, velocity, channel.noise_floor)


def parameter_rows(diagnosis: JointDiagnosis) -> tuple[ParameterRow, ...]:
    """The fitted parameters of the named effects."""
    rows = []
    for effect in diagnosis.effects:
        for name, interval in effect.parameters.items():
            flat = interval.high - interval.low > FLAT * abs(interval.value)
            remark = "flat: the data do not fix it" if flat else ""
            unit = effect.units.get(name, "")
            rows.append(
                ParameterRow(effect.name, name, unit, interval.value, interval.low, interval.high, "", "fitted", remark)
            )
    return tuple(rows)
