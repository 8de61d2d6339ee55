"""Panels of the drivers: desired speed and risk premium against each other, over time and against the truth, and one
driver in detail.
"""

import math
from collections.abc import Mapping
from typing import Any

import numpy as np
from bokeh.models import ColumnDataSource, DataRange1d, HoverTool, UIElement, Whisker

from sugiyama_ros.arrays import Array
from sugiyama_ros.page.names import title_of
from sugiyama_ros.page.panels.base import (
    BLUE,
    CHOSEN,
    GREEN,
    GREY,
    MOVING_S,
    ORANGE,
    SINGLE,
    SKY,
    VERMILION,
    Chosen,
    legend_above,
    panel,
)
from sugiyama_ros.page.panels.measured import two_point_speeds
from sugiyama_ros.page.recording import SHOWN, AgainstTruth, Recording
from sugiyama_ros.trajectories.desired_speed import known_only

_NAMES = {"v_star": "desired speed v* [m/s]", "kappa_v": "risk premium κ_v [s]"}
# Time [s] between two points of the curves of all drivers.
_EVERY_S = 2.0
# A filter has settled once its standard deviation is below this multiple of its median.
_SETTLED = 5.0


def against_each_other(r: Recording, diagnosis: Mapping[str, Any] | None, chosen: Chosen) -> UIElement:
    """Desired speed and risk premium of every driver, with one standard deviation, and the truth where it is known."""
    values, where = _fitted(r, diagnosis)
    vehicles = r.trajectories.vehicle.tolist()
    x, y, dx, dy = (np.array(values[name]) for name in ("v_star", "kappa_v", "v_star_std", "kappa_v_std"))
    source = ColumnDataSource(
        {"x": x, "y": y, "left": x - dx, "right": x + dx, "low": y - dy, "high": y + dy,
         "vehicle": [str(v) for v in vehicles]}
    )  # fmt: skip
    plot = panel(f"The drivers, {where}", _NAMES["v_star"], _NAMES["kappa_v"])
    for ends in (("left", "y", "right", "y"), ("x", "low", "x", "high")):
        plot.segment(*ends, source=source, color=GREY, line_width=1, nonselection_alpha=0.6)
    dots = plot.scatter("x", "y", source=source, size=9, color=BLUE, nonselection_alpha=0.8, selection_color=CHOSEN,
                        legend_label="estimate, with one standard deviation")  # fmt: skip
    known = [r.truth[v] for v in vehicles if {"v_star", "kappa_v"} <= set(r.truth.get(v, {}))]
    if known:
        plot.scatter([k["v_star"] for k in known], [k["kappa_v"] for k in known], marker="x", size=9, color=GREEN,
                     line_width=2, legend_label="truth")  # fmt: skip
    tooltips = [("vehicle", "@vehicle"), ("v*", "@x{0.00} m/s"), ("κ_v", "@y{0.000} s")]
    plot.add_tools(HoverTool(renderers=[dots], tooltips=tooltips))
    chosen.points(plot, source, list(range(len(vehicles))))
    legend_above(plot)
    return plot


def _fitted(r: Recording, diagnosis: Mapping[str, Any] | None) -> tuple[dict[str, list[float]], str]:
    """Values of each driver, from the fit of a diagnosis if there is one, else at the end of the run."""
    names = ("v_star", "v_star_std", "kappa_v", "kappa_v_std")
    of = {int(d["vehicle"]): d for d in (diagnosis or {}).get("drivers", []) if "v_star" in d}
    if of:
        learnt_of = r.followers | ~r.followers.any()
        vehicles = zip(r.trajectories.vehicle.tolist(), learnt_of.tolist(), strict=True)
        rows = [of.get(v, {}) if is_learnt else {} for v, is_learnt in vehicles]
        return {n: [math.nan if row.get(n) is None else float(row[n]) for row in rows] for n in names}, "as fitted"
    known = [*learnt(r, "v_star"), *learnt(r, "kappa_v")]
    ends = {n: [_last(column) for column in of_all.T] for n, of_all in zip(names, known, strict=True)}
    return ends, "at the end of the run"


def _last(values: Array) -> float:
    """The last value that is known; NaN without any."""
    known = values[np.isfinite(values)]
    return float(known[-1]) if len(known) else math.nan


def learnt(r: Recording, name: str) -> tuple[Array, Array]:
    """A parameter (T, N) as it was learnt, and its standard deviation; NaN where these data do not tell it."""
    value, std = r.series[name], r.series[f"{name}_std"]
    fastest = float(np.nanmax(r.series["speed"], initial=0.0))
    return known_only(value, std, fastest) if name == "v_star" else (value, std)


def over_time(r: Recording, name: str, chosen: Chosen) -> UIElement:
    """A parameter of all drivers over time as it was learnt, and of the driver who is chosen with one deviation."""
    value, std = learnt(r, name)
    every = max(1, round(_EVERY_S / r.trajectories.period_s))
    time = r.time_s[::every].astype(SINGLE)
    plot = panel(f"Learnt while driving: {_NAMES[name].split(' [')[0]}", "time [s]", _NAMES[name])
    plot.multi_line(
        [time] * value.shape[1], [v.astype(SINGLE) for v in value[::every].T], color=GREY, line_alpha=0.45,
        legend_label="all drivers",
    )  # fmt: skip
    thick = np.broadcast_to(r.time_s[::every, None], value[::every].shape)
    shown = chosen.series(
        time=thick, value=value[::every], low=(value - std)[::every], high=(value + std)[::every],
        change=_changes(r, name)[::every], truth=_truth(r, name)[::every],
    )  # fmt: skip
    plot.varea("time", "low", "high", source=shown, color=CHOSEN, alpha=0.25)
    plot.line("time", "value", source=shown, color=CHOSEN, line_width=2.5, legend_label="the chosen driver")
    if r.changes:
        plot.scatter("time", "change", source=shown, marker="triangle", size=11, color=SKY, line_color=GREY,
                     legend_label="change of style")  # fmt: skip
    if r.truth:
        plot.line("time", "truth", source=shown, color=GREEN, line_dash="dashed", line_width=2, legend_label="truth")
    if (np.isfinite(r.series[name]) & np.isnan(value)).any():
        plot.title.text += "; gaps: these data do not tell it"
    legend_above(plot)
    return plot


def _changes(r: Recording, name: str) -> Array:
    """The parameter (T, N) where a change of style was published, in the sample that the page shows next; else NaN."""
    marked = np.full_like(r.series[name], np.nan)
    every = max(1, round(_EVERY_S / r.trajectories.period_s))
    column = {int(v): k for k, v in enumerate(r.trajectories.vehicle)}
    for change in r.changes:
        if change.name == name:
            step = round((change.time_s - r.trajectories.start_s) / r.trajectories.period_s)
            step = min(-(-step // every) * every, (len(marked) - 1) // every * every)
            marked[step, column[change.vehicle]] = r.series[name][step, column[change.vehicle]]
    return marked


def _truth(r: Recording, name: str) -> Array:
    """The true value (T, N) of a parameter; NaN where the bag does not say it."""
    row = [r.truth.get(int(v), {}).get(name, math.nan) for v in r.trajectories.vehicle]
    return np.broadcast_to(np.array(row), r.series[name].shape)


def in_detail(r: Recording, chosen: Chosen) -> list[UIElement]:
    """One driver: the speed, how well each next position was predicted, and what the driver means to do."""
    s = r.series
    # while a filter settles, its errors are larger than anything that the picture is about
    std = np.sqrt(s["innovation_var"])
    usual = [np.median(one[np.isfinite(one)]) if np.isfinite(one).any() else 0.0 for one in std.T]
    counts = (s["scored"] > 0.0) & (std < _SETTLED * np.array(usual))
    shown = chosen.series(
        time=np.broadcast_to(r.time_s[:, None], s["speed"].shape),
        low=s["speed"] - s["speed_std"], high=s["speed"] + s["speed_std"], speed=s["speed"],
        measured=two_point_speeds(r), meant=s["mean_action"], innovation=np.where(counts, s["innovation_m"], np.nan),
        below=np.where(counts, -2.0 * std, np.nan), above=np.where(counts, 2.0 * std, np.nan),
    )  # fmt: skip
    speed = panel("The chosen driver: speed, with one standard deviation", "time [s]", "speed [m/s]")
    speed.varea("time", "low", "high", source=shown, color=BLUE, alpha=0.3)
    speed.scatter("time", "measured", source=shown, color=GREY, size=3, legend_label="from two positions")
    speed.line("time", "speed", source=shown, color=BLUE, legend_label="filtered", line_width=2)
    legend_above(speed)
    error = panel("Error of the next position, with two deviations", "time [s]", "error [m]", x_range=speed.x_range)
    error.varea("time", "below", "above", source=shown, color=ORANGE, alpha=0.3)
    error.line("time", "innovation", source=shown, color=CHOSEN)
    meant = panel("What the driver means to do", "time [s]", "acceleration [m/s²]", x_range=speed.x_range)
    meant.line("time", "meant", source=shown, color=GREEN)
    return [speed, error, meant]


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
    plot = panel(
        f"One-step error of all drivers in this run, over {MOVING_S:g} s", "time [s]", "error [m]",
        y_range=DataRange1d(start=0.0),
    )  # fmt: skip
    plot.line(r.time_s, error.astype(SINGLE), color=CHOSEN, line_width=2)
    return plot


def weights(r: Recording, diagnosis: Mapping[str, Any]) -> UIElement:
    """Posterior probability of each model of the critic's bank, over time."""
    plot = panel("Probability of each model of the critic over time", "time [s]", "probability")
    shown = sorted(r.weights, key=lambda name: -float(np.nanmax(r.weights[name])))[:5]
    for name, colour in zip(shown, (BLUE, CHOSEN, GREEN, ORANGE, GREY), strict=False):
        plot.line(r.verdict_s, r.weights[name], color=colour, legend_label=title_of(diagnosis, name), line_width=2)
    legend_above(plot)
    return plot


def against_truth(found: AgainstTruth, name: str) -> UIElement:
    """Estimate of one parameter over its truth, with 95 % intervals; on the grey line, both are equal."""
    of = [one for one in found.parameters if one.name == name]
    source = ColumnDataSource(
        {
            "truth": [one.truth for one in of],
            "estimate": [one.estimate for one in of],
            "lower": [one.lower for one in of],
            "upper": [one.upper for one in of],
            "colour": [BLUE if one.covered else VERMILION for one in of],
        }
    )
    unit = SHOWN[name]
    plot = panel(f"{name}: estimate and truth; red: outside of the interval", f"true [{unit}]", f"estimated [{unit}]")
    ends = [f(one.truth for one in of) for f in (min, max)] if of else []
    plot.line(ends, ends, color=GREY)
    plot.scatter("truth", "estimate", source=source, size=8, color="colour")
    plot.add_layout(Whisker(base="truth", lower="lower", upper="upper", source=source, line_color=GREY))
    return plot
