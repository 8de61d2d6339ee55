"""Panels of the drivers: their parameters against each other, over time and against the truth, and one driver in
detail. The report and the live page draw the chosen driver alike.
"""

import math
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from bokeh.models import ColumnDataSource, DataRange1d, FactorRange, HoverTool, UIElement

from sugiyama_ros.arrays import Array
from sugiyama_ros.page.names import parameter_title, title_of, unit_of
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
from sugiyama_ros.page.recording import Recording
from sugiyama_ros.page.truth import AgainstTruth
from sugiyama_ros.trajectories.desired_speed import known_only

# Time [s] between two points of the curves of all drivers.
_EVERY_S = 2.0
# A filter has settled once its standard deviation is below this multiple of its median.
_SETTLED = 5.0


def speed(source: ColumnDataSource) -> Any:
    """Speed of the chosen driver. Columns: time, speed, low, high, measured."""
    plot = panel("The chosen driver: speed, with one standard deviation", "time [s]", "speed [m/s]")
    plot.varea("time", "low", "high", source=source, color=BLUE, alpha=0.3)
    plot.scatter("time", "measured", source=source, color=GREY, size=3, legend_label="from two positions")
    plot.line("time", "speed", source=source, color=BLUE, legend_label="filtered", line_width=2)
    legend_above(plot)
    return plot


def error(source: ColumnDataSource, **ranges: Any) -> Any:
    """How well each next position of the chosen driver was predicted. Columns: time, innovation, below, above."""
    plot = panel("Error of the next position, with two deviations", "time [s]", "error [m]", **ranges)
    plot.varea("time", "below", "above", source=source, color=ORANGE, alpha=0.3)
    plot.line("time", "innovation", source=source, color=CHOSEN)
    return plot


def learnt(source: ColumnDataSource, name: str, **more: Any) -> Any:
    """A parameter of the chosen driver as it was learnt. Columns: time, and ``name`` with _low and _high."""
    plot = panel(f"Learnt: {parameter_title(name)}", "time [s]", parameter_title(name, with_unit=True))
    plot.varea("time", f"{name}_low", f"{name}_high", source=source, color=CHOSEN, alpha=0.25)
    plot.line("time", name, source=source, color=CHOSEN, line_width=2.5, **more)
    return plot


def each(source: ColumnDataSource, names: Sequence[str], title: str, **more: Any) -> Any:
    """Two parameters of all drivers against each other. Columns: ``names``, vehicle."""
    x, y = names
    plot = panel(title, *(parameter_title(name, with_unit=True) for name in names), **more)
    dots = plot.scatter(x, y, source=source, size=9, color=BLUE, nonselection_alpha=0.8, selection_color=CHOSEN)
    shown = [(parameter_title(name), f"@{{{name}}}{{0.000}} {unit_of(name)}") for name in names]
    plot.add_tools(HoverTool(renderers=[dots], tooltips=[("vehicle", "@vehicle"), *shown]))
    return plot


def against_each_other(r: Recording, diagnosis: Mapping[str, Any] | None, chosen: Chosen) -> list[UIElement]:
    """The first two parameters of every driver, with one standard deviation, and the truth where it is known."""
    fitted = (diagnosis or {}).get("drivers", [])
    names = [name for name in (fitted[0] if fitted else ()) if f"{name}_std" in fitted[0]][:2]
    ends = dict(zip(names, _fitted(r, names, fitted), strict=True))
    if not names:
        names = r.learnt[:2]
        ends = {name: (r.at_end(name), r.at_end(f"{name}_std")) for name in names}
    if len(names) < 2:
        return []
    vehicles = r.trajectories.vehicle.tolist()
    columns: dict[str, Any] = {"vehicle": list(map(str, vehicles))}
    for name, of in ends.items():
        value, std = _known(r, name, *of)
        columns |= {name: value, f"{name}_low": value - std, f"{name}_high": value + std}
    source, (x, y) = ColumnDataSource(columns), names
    plot = each(source, names, f"The drivers, {'as fitted' if fitted else 'at the end of the run'}, ± one deviation")
    for bar in ((f"{x}_low", y, f"{x}_high", y), (x, f"{y}_low", x, f"{y}_high")):
        plot.segment(*bar, source=source, color=GREY, line_width=1, nonselection_alpha=0.6, level="underlay")
    known = [r.truth[v] for v in vehicles if set(names) <= set(r.truth.get(v, {}))]
    if known:
        plot.scatter([k[x] for k in known], [k[y] for k in known], marker="x", size=9, color=GREEN, line_width=2,
                     legend_label="truth")  # fmt: skip
    chosen.points(plot, source, list(range(len(vehicles))))
    legend_above(plot)
    return [plot]


def _fitted(r: Recording, names: list[str], fitted: list[Mapping[str, Any]]) -> list[tuple[Array, Array]]:
    """Fitted values (N,) and standard deviations of each parameter; NaN for a driver who follows nobody."""
    of = {int(one["vehicle"]): one for one in fitted}
    is_learnt = r.followers | ~r.followers.any()
    rows = [of.get(v, {}) if known else {} for v, known in zip(r.trajectories.vehicle.tolist(), is_learnt, strict=True)]

    def column(name: str) -> Array:
        return np.array([math.nan if row.get(name) is None else float(row[name]) for row in rows])

    return [(column(name), column(f"{name}_std")) for name in names]


def _known(r: Recording, name: str, value: Array, std: Array) -> tuple[Array, Array]:
    """A parameter and its standard deviation; NaN where these data do not tell it."""
    fastest = float(np.nanmax(r.series["speed"], initial=0.0))
    return known_only(value, std, fastest) if name == "v_star" else (value, std)


def over_time(r: Recording, name: str, chosen: Chosen) -> UIElement:
    """A parameter of all drivers over time as it was learnt, and of the driver who is chosen with one deviation."""
    value, std = _known(r, name, r.series[name], r.series[f"{name}_std"])
    every = max(1, round(_EVERY_S / r.trajectories.period_s))
    thin = value[::every]
    shown = chosen.series(
        **{"time": np.broadcast_to(r.time_s[::every, None], thin.shape), name: thin,
           f"{name}_low": (value - std)[::every], f"{name}_high": (value + std)[::every],
           "change": _changes(r, name)[::every], "truth": np.broadcast_to(_truth(r, name), thin.shape)}
    )  # fmt: skip
    plot = learnt(shown, name, legend_label="the chosen driver")
    time = r.time_s[::every].astype(SINGLE)
    plot.multi_line([time] * thin.shape[1], [v.astype(SINGLE) for v in thin.T], color=GREY, line_alpha=0.45,
                    legend_label="all drivers", level="underlay")  # fmt: skip
    if r.changes:
        plot.scatter("time", "change", source=shown, marker="triangle", size=11, color=SKY, line_color=GREY,
                     legend_label="change of style")  # fmt: skip
    if np.isfinite(_truth(r, name)).any():
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
    """The true value (N,) of a parameter; NaN where the bag does not say it."""
    return np.array([r.truth.get(int(v), {}).get(name, math.nan) for v in r.trajectories.vehicle])


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
    first = speed(shown)
    meant = panel("What the driver means to do", "time [s]", "acceleration [m/s²]", x_range=first.x_range)
    meant.line("time", "meant", source=shown, color=GREEN)
    return [first, error(shown, x_range=first.x_range), meant]


def error_over_time(r: Recording) -> UIElement:
    """One-step error of all drivers: a moving root mean square."""
    y = np.where(r.series["scored"] > 0.0, r.series["innovation_m"], np.nan)
    kernel = np.ones(max(1, round(MOVING_S / r.trajectories.period_s)))
    each_sample = (np.nansum(y**2, axis=1), np.isfinite(y).sum(axis=1))
    squares, number = (np.convolve(of, kernel)[: len(y)] for of in each_sample)
    with np.errstate(invalid="ignore", divide="ignore"):
        moving = np.sqrt(squares / number)
    title = f"One-step error of all drivers in this run, over {MOVING_S:g} s"
    plot = panel(title, "time [s]", "error [m]", y_range=DataRange1d(start=0.0))
    plot.line(r.time_s, moving.astype(SINGLE), color=CHOSEN, line_width=2)
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
    """Estimates of one parameter with 95 % intervals, and the truth, for each driver."""
    of = found.of(name)
    columns: dict[str, Any] = {"vehicle": list(map(str, of))}
    columns |= {k: [getattr(one, k) for one in of.values()] for k in ("truth", "estimate", "lower", "upper")}
    columns["colour"] = [BLUE if one.covered else VERMILION for one in of.values()]
    source = ColumnDataSource(columns)
    title = f"{parameter_title(name)}, with 95 % intervals; orange: the truth is outside"
    vehicles = FactorRange(factors=columns["vehicle"])
    plot = panel(title, "vehicle", parameter_title(name, with_unit=True), x_range=vehicles)
    plot.segment("vehicle", "lower", "vehicle", "upper", source=source, color="colour", line_width=2, line_alpha=0.6)
    plot.scatter("vehicle", "estimate", source=source, size=8, color="colour", legend_label="estimate")
    plot.scatter("vehicle", "truth", source=source, size=9, marker="x", color=GREEN, line_width=2, legend_label="truth")
    legend_above(plot)
    return plot
