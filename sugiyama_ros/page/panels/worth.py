"""Panels of what the additions are worth: errors over the horizon, and of each driver, before and after."""

import math
import re
from collections.abc import Mapping
from typing import Any

from bokeh.models import ColumnDataSource, FactorRange, HoverTool, Range1d, UIElement

from sugiyama_ros.page.names import model_name, models
from sugiyama_ros.page.panels.base import BLUE, GREY, VERMILION, colour_of, legend_above, panel
from sugiyama_ros.page.panels.chosen import Chosen

# Models that the vertical axis shows whole; others may leave the picture.
_WHOLE = ("before", "after", "floor", "fvdm")


def growth(diagnosis: Mapping[str, Any], run: str, title: str) -> UIElement:
    """Error of the free runs of one kind over time, for every model; the table of errors explains the colours."""
    plot = panel(title, "after [s]", "error [m]")
    largest, lines = 0.0, []
    for name, errors in models(diagnosis).items():
        seconds, values = error_growth(errors, run)
        thick = name in ("before", "after")
        lines.append(
            plot.line(
                seconds,
                values,
                color=colour_of(name, diagnosis),
                line_dash="dashed" if name == "floor" else "solid",
                line_width=3.5 if thick else 1.5,
                level="overlay" if thick else "glyph",
                name=model_name(name),
            )
        )
        if name in _WHOLE:
            largest = max(largest, *values)
    plot.y_range = Range1d(0.0, 1.1 * largest or 1.0)
    plot.add_tools(
        HoverTool(renderers=lines, tooltips=[("", "$name"), ("after", "$x{0.0} s"), ("error", "$y{0.00} m")])
    )
    return plot


def is_known(diagnosis: Mapping[str, Any], run: str) -> bool:
    """Whether there are free runs of a kind: tracks have none of all cars together."""
    return len(error_growth(diagnosis["errors"]["before"], run)[0]) > 1


def error_growth(errors: Mapping[str, Any], run: str) -> tuple[list[float], list[float]]:
    """Horizons [s] in ascending order, and errors [m] of free runs of one kind."""
    known = ((re.fullmatch(rf"{run}_(\d+(?:\.\d+)?)s_m", key), value) for key, value in errors.items())
    pairs = sorted((float(match[1]), float(value)) for match, value in known if match and value is not None)
    return [0.0, *(h for h, _ in pairs)], [0.0, *(value for _, value in pairs)]


def by_driver(diagnosis: Mapping[str, Any], chosen: Chosen, vehicles: list[int]) -> UIElement:
    """Error of every driver, before and after the effects that were found are added; who gets worse is marked."""
    of = {int(d["vehicle"]): d for d in diagnosis["drivers"]}
    # who follows nobody has no error
    shown = [v for v in vehicles if of.get(v, {}).get("single_car_10s_before_m") is not None]
    values = {
        label: [math.nan if of[v][f"single_car_10s_{label}_m"] is None else float(of[v][f"single_car_10s_{label}_m"])
                for v in shown]
        for label in ("before", "after")
    }  # fmt: skip
    worse = [b < a for b, a in zip(values["before"], values["after"], strict=True)]
    source = ColumnDataSource({"vehicle": [str(v) for v in shown], **values})
    finite = [x for column in values.values() for x in column if math.isfinite(x)]
    plot = panel(
        "Free runs of one car, 10 s: each driver",
        "vehicle",
        "error [m]",
        x_range=FactorRange(factors=[str(v) for v in shown]),
        y_range=Range1d(0.0, 1.1 * max(finite, default=1.0)),
    )
    plot.segment("vehicle", "before", "vehicle", "after", source=source, color=GREY, line_width=1.5,
                 nonselection_alpha=0.6)  # fmt: skip
    added = diagnosis["verdict"]["effects"]
    if added:
        plot.scatter("vehicle", "before", source=source, size=9, line_color=GREY, fill_color=None,
                     legend_label="before", nonselection_line_alpha=1.0, selection_line_color=VERMILION)  # fmt: skip
    after = plot.scatter("vehicle", "after", source=source, size=9, color=BLUE, nonselection_alpha=1.0,
                         legend_label="after" if added else "base model", selection_color=VERMILION)  # fmt: skip
    if any(worse):
        marked = [(str(v), a) for v, a, bad in zip(shown, values["after"], worse, strict=True) if bad]
        plot.scatter([v for v, _ in marked], [a for _, a in marked], marker="triangle", size=15, fill_color=None,
                     line_color=VERMILION, line_width=2, legend_label="worse than before")  # fmt: skip
    plot.add_tools(
        HoverTool(
            renderers=[after],
            tooltips=[("vehicle", "@vehicle"), ("before", "@before{0.00} m"), ("after", "@after{0.00} m")],
        )
    )
    chosen.points(plot, source, [vehicles.index(v) for v in shown])
    legend_above(plot)
    plot.xaxis.major_label_orientation = math.pi / 4
    return plot
