"""Panels of what the model says about the drivers, and where it fails."""

import math
from typing import NamedTuple

import numpy as np
from bokeh.layouts import column
from bokeh.models import (
    ColorBar,
    ColumnDataSource,
    CustomJS,
    FactorRange,
    HoverTool,
    LinearColorMapper,
    Select,
    TapTool,
    UIElement,
)
from bokeh.palettes import PuOr11

from sugiyama_ros.arrays import Array
from sugiyama_ros.page.panels.base import (
    BLUE,
    GREEN,
    GREY,
    MOVING_S,
    ORANGE,
    SINGLE,
    VERMILION,
    legend_above,
    panel,
)
from sugiyama_ros.page.panels.measured import naive_speeds
from sugiyama_ros.page.recording import Recording

_LEAST_IN_BIN = 8


def driver(r: Recording, select: Select) -> UIElement:
    """One driver: the speed, the mean action, and how well each next position was predicted."""
    s = r.series
    std = np.sqrt(s["innovation_var"])
    arrays = {
        "low": s["speed"] - s["speed_std"],
        "high": s["speed"] + s["speed_std"],
        "speed": s["speed"],
        "measured": naive_speeds(r),
        "meant": s["mean_action"],
        "innovation": s["innovation_m"],
        "below": -2.0 * std,
        "above": 2.0 * std,
    }
    everything = ColumnDataSource({name: values.T.ravel().astype(SINGLE) for name, values in arrays.items()})
    shown = ColumnDataSource({"time": r.time_s, **{n: v[:, 0].astype(SINGLE) for n, v in arrays.items()}})
    speed = panel("One driver in the model: speed, with one sigma", "time [s]", "speed [m/s]")
    speed.varea("time", "low", "high", source=shown, color=BLUE, alpha=0.3)
    speed.line("time", "measured", source=shown, color=GREY, legend_label="from two positions, smoothed")
    speed.line("time", "speed", source=shown, color=BLUE, legend_label="filtered", line_width=2)
    legend_above(speed)
    error = panel("Error of the next position, with two sigma", "time [s]", "innovation [m]", x_range=speed.x_range)
    error.varea("time", "below", "above", source=shown, color=ORANGE, alpha=0.3)
    error.line("time", "innovation", source=shown, color=VERMILION)
    meant = panel("What the driver means to do", "time [s]", "mean action [m/s²]", x_range=speed.x_range)
    meant.line("time", "meant", source=shown, color=GREEN)
    select.js_on_change(
        "value",
        CustomJS(
            args={"all": everything, "shown": shown, "names": list(arrays), "n": len(r.time_s), "select": select},
            code="""
            const k = select.options.indexOf(select.value) * n
            for (const name of names) shown.data[name] = all.data[name].slice(k, k + n)
            shown.change.emit()
            """,
        ),
    )
    return column(select, speed, error, meant, sizing_mode="stretch_width")


def error_over_time(r: Recording) -> UIElement:
    """One-step error of all drivers: a moving root mean square."""
    y = np.where(r.series["scored"] > 0.0, r.series["innovation_m"], np.nan)
    width = max(1, round(MOVING_S / r.trajectories.period_s))
    known = np.isfinite(y)
    squares, counts = np.where(known, y, 0.0) ** 2, known.astype(float)
    kernel = np.ones(width)
    summed = np.convolve(squares.sum(axis=1), kernel)[: len(y)]
    number = np.convolve(counts.sum(axis=1), kernel)[: len(y)]
    with np.errstate(invalid="ignore", divide="ignore"):
        error = np.sqrt(summed / number)
    plot = panel(f"One-step error of all drivers, over {MOVING_S:g} s", "time [s]", "error [m]")
    plot.line(r.time_s, error.astype(SINGLE), color=VERMILION, line_width=2)
    return plot


class Quantity(NamedTuple):
    """A quantity over which a bias is shown: values (T, N), name with unit, number of bins."""

    values: Array
    label: str
    bins: int


def bias_map(r: Recording, title: str, x: Quantity, y: Quantity) -> UIElement:
    """Mean innovation, in standard deviations of the innovation, over two quantities."""
    z = r.series["innovation_m"] / np.sqrt(r.series["innovation_var"])
    known = (r.series["scored"] > 0.0) & np.isfinite(z) & np.isfinite(x.values) & np.isfinite(y.values)
    plot = panel(title, x.label, y.label)
    if known.any():
        edges = [_edges(axis.values[known], axis.bins) for axis in (x, y)]
        at = x.values[known], y.values[known]
        count = np.histogram2d(*at, bins=edges)[0]
        total = np.histogram2d(*at, bins=edges, weights=z[known])[0]
        i, j = np.nonzero(count >= _LEAST_IN_BIN)
        source = ColumnDataSource(
            {
                "left": edges[0][i],
                "right": edges[0][i + 1],
                "bottom": edges[1][j],
                "top": edges[1][j + 1],
                "bias": total[i, j] / count[i, j],
                "count": count[i, j],
            }
        )
        colours = LinearColorMapper(PuOr11, low=-1.0, high=1.0)
        plot.quad("left", "right", "bottom", "top", source=source, line_color=None,
                  color={"field": "bias", "transform": colours})  # fmt: skip
        plot.add_layout(ColorBar(color_mapper=colours, title="bias [std]"), "right")
        plot.add_tools(HoverTool(tooltips=[("bias", "@bias{0.00} std"), ("samples", "@count")]))
    return plot


def _edges(values: Array, bins: int) -> Array:
    low, high = (float(q) for q in np.quantile(values, [0.01, 0.99]))
    return np.asarray(low + (high - low) * np.arange(bins + 1) / bins, dtype=np.float64)


def by_driver(r: Recording, select: Select) -> UIElement:
    """One-step error of every driver; a click chooses the driver."""
    names = [str(v) for v in r.trajectories.vehicle]
    source = ColumnDataSource({"vehicle": names, "error": r.error_by_driver})
    plot = panel("One-step error by driver: click one", "vehicle", "error [m]", x_range=FactorRange(factors=names))
    plot.vbar("vehicle", top="error", source=source, width=0.8, color=BLUE)
    plot.add_tools(TapTool())
    plot.xaxis.major_label_orientation = math.pi / 4
    source.selected.js_on_change(
        "indices",
        CustomJS(
            args={"select": select},
            code="if (cb_obj.indices.length) select.value = select.options[cb_obj.indices[0]]",
        ),
    )
    return plot


def weights(r: Recording) -> UIElement:
    """Posterior probability of each model of the critic's bank, over time."""
    plot = panel("Probability of each model of the critic over time", "time [s]", "probability")
    shown = sorted(r.weights, key=lambda name: -float(r.weights[name].max()))[:5]
    for name, colour in zip(shown, (BLUE, VERMILION, GREEN, ORANGE, GREY), strict=False):
        plot.line(r.verdict_s, r.weights[name], color=colour, legend_label=name, line_width=2)
    legend_above(plot)
    return plot
