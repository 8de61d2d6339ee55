"""The panels of the page, from arrays. Colours are told apart by the colour-blind; every axis has its unit."""

import math
import re
from collections.abc import Mapping
from typing import Any

import numpy as np
from bokeh.layouts import column, row
from bokeh.models import (
    BasicTicker,
    Button,
    ColorBar,
    ColumnDataSource,
    CustomJS,
    FactorRange,
    HoverTool,
    LinearColorMapper,
    Select,
    Slider,
    Span,
    TapTool,
    UIElement,
    Whisker,
)
from bokeh.palettes import Cividis256, PuOr11
from bokeh.plotting import figure

from sugiyama_ros.page.recording import Recording
from sugiyama_ros.road import Array, Road

# Okabe and Ito's colours.
BLUE, ORANGE, GREEN, VERMILION, GREY = "#0072B2", "#E69F00", "#009E73", "#D55E00", "#777777"
#: For as many models as are compared.
COLOURS = (GREY, BLUE, VERMILION, ORANGE, GREEN, "#56B4E9", "#CC79A7", "#000000")
#: Time [s] over which the one-step error is taken together.
MOVING_S = 10.0
_HEIGHT, _LEAST_IN_BIN, _MOST_SHOWN = 320, 8, 12
_TOOLS = "pan,wheel_zoom,box_zoom,reset,save"
_SINGLE = np.float32


def panel(title: str, x: str, y: str, **more: Any) -> Any:
    """An empty figure that is as wide as there is room."""
    return figure(
        title=title,
        x_axis_label=x,
        y_axis_label=y,
        height=_HEIGHT,
        sizing_mode="stretch_width",
        tools=_TOOLS,
        output_backend="canvas",
        **more,
    )


def from_above(road: Road, position_m: Array) -> tuple[Array, Array]:
    """Coordinates [m] of positions on a road that lies in a circle, or straight on."""
    if not road.is_ring:
        return position_m, np.zeros_like(position_m)
    radius = road.circumference_m / (2.0 * np.pi)
    return radius * np.cos(position_m / radius), radius * np.sin(position_m / radius)


def legend_above(plot: Any) -> None:
    """A legend that hides nothing, and in which a click hides a line."""
    plot.legend.click_policy = "hide"
    plot.legend.orientation = "horizontal"
    plot.legend.label_text_font_size = "11px"
    plot.add_layout(plot.legend[0], "above")


def space_time(r: Recording) -> UIElement:
    """Position over time of every vehicle, coloured by speed."""
    t = r.trajectories
    position = t.road.wrap(t.position_m) if t.road.is_ring else t.position_m
    speed = speeds(r)
    known = np.isfinite(position)
    time = np.broadcast_to(r.time_s[:, None], position.shape)
    source = ColumnDataSource(
        {
            "time": time[known].astype(_SINGLE),
            "position": position[known].astype(_SINGLE),
            "speed": speed[known].astype(_SINGLE),
        }
    )
    colours = LinearColorMapper(Cividis256, low=0.0, high=float(np.nanquantile(speed, 0.99)), nan_color=GREY)
    plot = panel("Where everybody was, and how fast", "time [s]", "position [m]")
    plot.scatter("time", "position", source=source, size=2, color={"field": "speed", "transform": colours})
    plot.add_layout(ColorBar(color_mapper=colours, ticker=BasicTicker(), title="speed [m/s]"), "right")
    return plot


def speed_profile(r: Recording) -> UIElement:
    """Mean, least and largest speed of all vehicles."""
    speed = speeds(r)
    whole = np.isfinite(speed).any(axis=1)
    plot = panel("Speeds of all vehicles", "time [s]", "speed [m/s]")
    for label, of, colour in (("largest", np.nanmax, ORANGE), ("mean", np.nanmean, BLUE), ("least", np.nanmin, GREEN)):
        plot.line(
            r.time_s[whole],
            of(speed[whole], axis=1).astype(_SINGLE),
            color=colour,
            legend_label=label,
            line_width=2,
        )
    legend_above(plot)
    return plot


def ring(r: Recording) -> UIElement:
    """The road from above, at a time that a slider or a button chooses."""
    t = r.trajectories
    speed = speeds(r)
    x, y = from_above(t.road, t.position_m)
    every = max(1, len(x) // 1500)
    frames = {
        "x": np.round(x[::every], 2).astype(_SINGLE),
        "y": np.round(y[::every], 2).astype(_SINGLE),
        "speed": np.round(speed[::every], 2).astype(_SINGLE),
    }
    all_frames = ColumnDataSource({name: values.ravel() for name, values in frames.items()})
    shown = ColumnDataSource({**{n: v[0] for n, v in frames.items()}, "vehicle": [str(v) for v in t.vehicle]})
    colours = LinearColorMapper(Cividis256, low=0.0, high=float(np.nanquantile(speed, 0.99)), nan_color=GREY)
    plot = panel("The road from above", "x [m]", "y [m]", match_aspect=t.road.is_ring)
    plot.scatter("x", "y", source=shown, size=12, line_color="black", color={"field": "speed", "transform": colours})
    plot.add_tools(HoverTool(tooltips=[("vehicle", "@vehicle"), ("speed", "@speed{0.0} m/s")]))
    last = len(frames["x"]) - 1
    slider = Slider(start=0, end=max(last, 1), value=0, title="sample", sizing_mode="stretch_width")
    move = CustomJS(
        args={"all": all_frames, "shown": shown, "n": len(t.vehicle)},
        code="""
        const k = cb_obj.value * n
        for (const name of ["x", "y", "speed"]) shown.data[name] = all.data[name].slice(k, k + n)
        shown.change.emit()
        """,
    )
    slider.js_on_change("value", move)
    play = Button(label="play", width=80)
    play.js_on_click(
        CustomJS(
            args={"slider": slider, "button": play, "ms": 1000.0 * t.period_s * every / 4.0},
            code="""
            if (button.label == "pause") { clearInterval(window.sugiyama_play); button.label = "play"; return }
            button.label = "pause"
            window.sugiyama_play = setInterval(() => {
                slider.value = slider.value >= slider.end ? slider.start : slider.value + 1
            }, ms)
            """,
        )
    )
    return column(plot, row(play, slider, sizing_mode="stretch_width"), sizing_mode="stretch_width")


def driver(r: Recording, select: Select) -> UIElement:
    """One driver: his speed, what he means to do, and how well his next position was predicted."""
    s = r.series
    std = np.sqrt(s["innovation_var"])
    arrays = {
        "low": s["speed"] - s["speed_std"],
        "high": s["speed"] + s["speed_std"],
        "speed": s["speed"],
        "measured": _naive_speeds(r),
        "meant": s["mean_action"],
        "innovation": s["innovation_m"],
        "below": -2.0 * std,
        "above": 2.0 * std,
    }
    everything = ColumnDataSource({name: values.T.ravel().astype(_SINGLE) for name, values in arrays.items()})
    shown = ColumnDataSource({"time": r.time_s, **{n: v[:, 0].astype(_SINGLE) for n, v in arrays.items()}})
    speed = panel("What the model says of one driver: speed, with one sigma", "time [s]", "speed [m/s]")
    speed.varea("time", "low", "high", source=shown, color=BLUE, alpha=0.3)
    speed.line("time", "measured", source=shown, color=GREY, legend_label="from two positions, smoothed")
    speed.line("time", "speed", source=shown, color=BLUE, legend_label="filtered", line_width=2)
    legend_above(speed)
    error = panel("Error of the next position, with two sigma", "time [s]", "innovation [m]", x_range=speed.x_range)
    error.varea("time", "below", "above", source=shown, color=ORANGE, alpha=0.3)
    error.line("time", "innovation", source=shown, color=VERMILION)
    meant = panel("What he means to do", "time [s]", "mean action [m/s²]", x_range=speed.x_range)
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
    """One-step error of all drivers, as a moving root mean square."""
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
    plot.line(r.time_s, error.astype(_SINGLE), color=VERMILION, line_width=2)
    return plot


def bias_map(
    r: Recording, title: str, x: Array, x_label: str, x_bins: int, y: Array, y_label: str, y_bins: int
) -> UIElement:
    """Mean innovation, in its standard deviations, over two quantities, (T, N) each."""
    z = r.series["innovation_m"] / np.sqrt(r.series["innovation_var"])
    known = (r.series["scored"] > 0.0) & np.isfinite(z) & np.isfinite(x) & np.isfinite(y)
    plot = panel(title, x_label, y_label)
    if known.any():
        edges = [_edges(a[known], bins) for a, bins in ((x, x_bins), (y, y_bins))]
        count = np.histogram2d(x[known], y[known], bins=edges)[0]
        total = np.histogram2d(x[known], y[known], bins=edges, weights=z[known])[0]
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
    """One-step error of every driver; a click chooses him."""
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
    """Probability of each model of the critic's bank over time."""
    plot = panel("What the critic believes while it listens", "time [s]", "probability")
    shown = sorted(r.weights, key=lambda name: -float(r.weights[name].max()))[:5]
    for name, colour in zip(shown, (BLUE, VERMILION, GREEN, ORANGE, GREY), strict=False):
        plot.line(r.verdict_s, r.weights[name], color=colour, legend_label=name, line_width=2)
    legend_above(plot)
    return plot


def candidates(diagnosis: Mapping[str, Any]) -> UIElement:
    """Held-out gain of every candidate, with its standard error."""
    best = diagnosis["candidates"][:_MOST_SHOWN][::-1]
    names = [c["name"] for c in best]
    gain, se = (np.array([float(c[key] or 0.0) for c in best]) for key in ("heldout_gain_nats", "heldout_gain_se"))
    named = {n["name"] for n in diagnosis["verdict"]["effects"]}
    source = ColumnDataSource(
        {
            "name": names,
            "gain": gain,
            "low": gain - se,
            "high": gain + se,
            "colour": [VERMILION if n in named else BLUE for n in names],
        }
    )
    plot = panel(
        "What may be missing; red: named", "held-out gain [nats]", "candidate", y_range=FactorRange(factors=names)
    )
    plot.hbar("name", right="gain", source=source, height=0.7, color="colour")
    plot.add_layout(Whisker(base="name", lower="low", upper="high", source=source, dimension="width"))
    plot.add_layout(Span(location=0.0, dimension="height", line_color=GREY))
    return plot


def before_and_after(diagnosis: Mapping[str, Any]) -> UIElement:
    """Error of every driver before and after what was found was added."""
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
    """How the error of free runs grows with time, of every model."""
    plot = panel("Free runs: all cars (line), one car behind his measured leader (dashed)", "after [s]", "error [m]")
    for (name, errors), colour in zip(diagnosis["errors"].items(), COLOURS, strict=False):
        for run, dash in (("free_run", "solid"), ("single_car", "dashed")):
            seconds, values = error_growth(errors, run)
            plot.line(seconds, values, color=colour, line_dash=dash, line_width=2, legend_label=name.replace("_", " "))
    legend_above(plot)
    return plot


def error_growth(errors: Mapping[str, Any], run: str) -> tuple[list[float], list[float]]:
    """Horizons [s] and errors [m] of free runs of one kind, in order."""
    known = ((re.fullmatch(rf"{run}_([\d.]+)s_m", key), value) for key, value in errors.items())
    pairs = sorted((float(match[1]), float(value)) for match, value in known if match and value is not None)
    return [0.0, *(h for h, _ in pairs)], [0.0, *(value for _, value in pairs)]


def speeds(r: Recording) -> Array:
    """Speeds (T, N) [m/s]: filtered ones where estimators have run."""
    return r.series["speed"] if r.has_estimates else _naive_speeds(r)


def _naive_speeds(r: Recording) -> Array:
    """Speeds (T, N) [m/s] from differences of measured positions, smoothed over 5 samples."""
    t = r.trajectories
    speed = np.full_like(t.position_m, np.nan)
    speed[:-1] = t.road.difference(t.position_m[1:], t.position_m[:-1]) / t.period_s
    known = np.isfinite(speed)
    number, summed = (_moving_sum(a) for a in (known.astype(np.float64), np.where(known, speed, 0.0)))
    with np.errstate(invalid="ignore", divide="ignore"):
        return np.asarray(np.where(number > 0.0, summed / number, np.nan), dtype=np.float64)


def _moving_sum(values: Array) -> Array:
    """Sum (T, N) over 5 samples."""
    return np.asarray(np.apply_along_axis(np.convolve, 0, values, np.ones(5), mode="same"), dtype=np.float64)
