"""Panels of a diagnosis: what may be missing, and the errors after it was added."""

import math
import re
from collections.abc import Mapping
from typing import Any

import numpy as np
from bokeh.models import (
    ColumnDataSource,
    FactorRange,
    Span,
    UIElement,
    Whisker,
)

from sugiyama_ros.page.panels.base import (
    BLUE,
    COLOURS,
    GREY,
    VERMILION,
    legend_above,
    panel,
)

_MOST_SHOWN = 12


def candidates(diagnosis: Mapping[str, Any]) -> UIElement:
    """Held-out gain of every candidate, with its standard error."""
    best = diagnosis["candidates"][:_MOST_SHOWN][::-1]
    names = [c["name"] for c in best]
    gain, se = (np.array([float(c[key] or 0.0) for c in best]) for key in ("heldout_gain_nats", "heldout_gain_se"))
    added = {n["name"] for n in diagnosis["verdict"]["effects"]}
    source = ColumnDataSource(
        {
            "name": names,
            "gain": gain,
            "low": gain - se,
            "high": gain + se,
            "colour": [VERMILION if n in added else BLUE for n in names],
        }
    )
    plot = panel(
        "What may be missing; red: added", "held-out gain [nats]", "candidate", y_range=FactorRange(factors=names)
    )
    plot.hbar("name", right="gain", source=source, height=0.7, color="colour")
    plot.add_layout(Whisker(base="name", lower="low", upper="high", source=source, dimension="width"))
    plot.add_layout(Span(location=0.0, dimension="height", line_color=GREY))
    return plot


def before_and_after(diagnosis: Mapping[str, Any]) -> UIElement:
    """Error of every driver, before and after the effects that were found are added."""
    of = diagnosis["drivers"]
    names = [str(d["vehicle"]) for d in of]
    plot = panel(
        "Before and after: 10-s free run of one car", "vehicle", "error [m]", x_range=FactorRange(factors=names)
    )
    for label, key, colour in (
        ("before", "single_car_10s_before_m", GREY),
        ("after", "single_car_10s_after_m", BLUE),
    ):
        values = [math.nan if d[key] is None else float(d[key]) for d in of]
        plot.scatter(names, values, size=9, color=colour, legend_label=label)
    legend_above(plot)
    plot.xaxis.major_label_orientation = math.pi / 4
    return plot


def growth(diagnosis: Mapping[str, Any]) -> UIElement:
    """Error of free runs over time, for every model."""
    plot = panel("Free runs: all cars (line), one car behind its measured leader (dashed)", "after [s]", "error [m]")
    for (name, errors), colour in zip(diagnosis["errors"].items(), COLOURS, strict=False):
        for run, dash in (("free_run", "solid"), ("single_car", "dashed")):
            seconds, values = error_growth(errors, run)
            plot.line(seconds, values, color=colour, line_dash=dash, line_width=2, legend_label=name.replace("_", " "))
    legend_above(plot)
    return plot


def error_growth(errors: Mapping[str, Any], run: str) -> tuple[list[float], list[float]]:
    """Horizons [s] in ascending order, and errors [m] of free runs of one kind."""
    known = ((re.fullmatch(rf"{run}_(\d+(?:\.\d+)?)s_m", key), value) for key, value in errors.items())
    pairs = sorted((float(match[1]), float(value)) for match, value in known if match and value is not None)
    return [0.0, *(h for h, _ in pairs)], [0.0, *(value for _, value in pairs)]
