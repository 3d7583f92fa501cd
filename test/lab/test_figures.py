"""Every kind of picture is one that plotly takes. What each shows is in the tests of its file."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

import numpy as np
import plotly.graph_objects
import pytest
from report_case import PERIOD, channel_page

from hd_control.lab.maps.orders import OrderRecord, lines_of, order_spectrum
from hd_control.lab.page.model_figures import (
    Bar,
    HorizonCurve,
    Rung,
    confidence_figure,
    horizon_figure,
    ladder_figure,
    overlay_figure,
)
from hd_control.lab.page.residual_figures import heat_figure, map_figure, order_figure
from hd_control.lab.page.style import Figure

PAGE = channel_page()


def all_figures() -> Iterator[tuple[str, Figure]]:
    """Every kind of picture."""
    unit = "N m"
    yield "overlay", overlay_figure(PAGE.models)
    yield from ((w.title, overlay_figure(PAGE.models, w)) for w in PAGE.windows)
    first = PAGE.maps["nominal.yaml"]
    yield from ((name, map_figure({m: maps.maps[name] for m, maps in PAGE.maps.items()}, unit)) for name in first.maps)
    assert first.speed_load is not None
    yield "heat", heat_figure(first.speed_load, unit, "nominal.yaml")
    yield "orders", order_figure(*PAGE.spectra["nominal.yaml"], unit)
    yield "no orders", order_figure(*nothing(), unit)
    yield (
        "ladder",
        ladder_figure([Rung("as given", 7, 0.2, 0.3, 0.1), Rung("payload", 9, 0.1, 0.12, 0.1)], unit, "floor"),
    )
    yield "confidence", confidence_figure([Bar("payload", 0.9, "runner-up: gauge gain"), Bar("unknown", None)])
    curve = HorizonCurve("model", np.linspace(0.0, 5.0, 20), np.linspace(0.0, 1.0, 20), "rad")
    yield "horizon", horizon_figure([curve], "motor position")


def nothing() -> tuple[Any, Any]:
    """The spectrum of a joint that rests."""
    time = np.arange(1000) * PERIOD
    still = OrderRecord(time, np.zeros(1000), np.ones(1000), np.ones(1000, dtype=bool), 38.0)
    spectrum = order_spectrum([still], 100.0)
    return spectrum, lines_of(spectrum)


@pytest.mark.parametrize(("name", "figure"), [pytest.param(n, f, id=n) for n, f in all_figures()])
def test_plotly_takes_every_figure(name: str, figure: Figure) -> None:
    plotly.graph_objects.Figure(figure)  # raises on any key or value that plotly does not know
    assert figure["layout"]["height"] > 100
