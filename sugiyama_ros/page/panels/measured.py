"""Panels of what was measured: speeds, and the road from above."""

import numpy as np
from bokeh.layouts import column, row
from bokeh.models import Button, ColumnDataSource, CustomJS, DataRange1d, HoverTool, Slider, UIElement

from sugiyama_ros.arrays import Array
from sugiyama_ros.page.panels.base import (
    BLUE,
    GREEN,
    GREY,
    ORANGE,
    SINGLE,
    VERMILION,
    from_above,
    legend_above,
    panel,
    speed_colours,
)
from sugiyama_ros.page.panels.chosen import Chosen
from sugiyama_ros.page.recording import Recording

# Vehicles on a shorter part of the road than this share of it, at any time, are a platoon that drives along.
_PLATOON = 0.25


def speed_profile(r: Recording) -> UIElement:
    """Mean, least and largest speed of all vehicles."""
    speed = speeds(r)
    whole = np.isfinite(speed).any(axis=1)
    plot = panel("Speeds of all vehicles", "time [s]", "speed [m/s]", y_range=DataRange1d(start=0.0))
    for label, of, colour in (("largest", np.nanmax, ORANGE), ("mean", np.nanmean, BLUE), ("least", np.nanmin, GREEN)):
        plot.line(
            r.time_s[whole],
            of(speed[whole], axis=1).astype(SINGLE),
            color=colour,
            legend_label=label,
            line_width=2,
        )
    legend_above(plot)
    return plot


def ring(r: Recording, chosen: Chosen) -> UIElement:
    """The road from above, at a time that a slider or a button chooses."""
    t = r.trajectories
    speed = speeds(r)
    x, y = from_above(t.road, t.position_m)
    every = max(1, len(x) // 1500)
    frames = {
        "x": np.round(x[::every], 2).astype(SINGLE),
        "y": np.round(y[::every], 2).astype(SINGLE),
        "speed": np.round(speed[::every], 2).astype(SINGLE),
    }
    all_frames = ColumnDataSource({name: values.ravel() for name, values in frames.items()})
    last = len(frames["x"]) - 1
    # the first speeds are not known yet; in the middle, there is something to see
    first = last // 2
    shown = ColumnDataSource({**{n: v[first] for n, v in frames.items()}, "vehicle": [str(v) for v in t.vehicle]})
    labels = ("x [m]", "y [m]") if t.road.is_ring else ("position [m]", "")
    plot = panel("The road from above", *labels, match_aspect=t.road.is_ring)
    plot.yaxis.visible = plot.ygrid.visible = t.road.is_ring
    if t.road.is_ring:
        plot.line(
            *from_above(t.road, np.asarray(np.linspace(0.0, t.road.circumference_m, 181), dtype=np.float64)),
            color=GREY,
            line_alpha=0.5,
        )
    colour = {"field": "speed", "transform": speed_colours(fastest(r))}
    plot.scatter("x", "y", source=shown, size=12, line_color=GREY, fill_color=colour, nonselection_fill_alpha=1.0,
                 nonselection_line_alpha=1.0, selection_line_color=VERMILION, selection_line_width=3)  # fmt: skip
    chosen.points(plot, shown, list(range(len(t.vehicle))))
    plot.add_tools(HoverTool(tooltips=[("vehicle", "@vehicle"), ("speed", "@speed{0.0} m/s")]))
    step_s = t.period_s * every
    begin = float(r.time_s[0])
    slider = Slider(start=begin, end=begin + max(last, 1) * step_s, value=begin + first * step_s, step=step_s,
                    title="time [s]", format="0.0", sizing_mode="stretch_width")  # fmt: skip
    move = CustomJS(
        args={"all": all_frames, "shown": shown, "n": len(t.vehicle), "step": step_s},
        code="""
        const k = Math.round((cb_obj.value - cb_obj.start) / step) * n
        for (const name of ["x", "y", "speed"]) shown.data[name] = all.data[name].slice(k, k + n)
        shown.change.emit()
        """,
    )
    slider.js_on_change("value", move)
    play = Button(label="play", width=80)
    play.js_on_click(
        CustomJS(
            args={"slider": slider, "button": play, "ms": 1000.0 * step_s / 4.0},
            code="""
            if (button.label == "pause") { clearInterval(window.sugiyama_play); button.label = "play"; return }
            button.label = "pause"
            window.sugiyama_play = setInterval(() => {
                const next = slider.value + slider.step
                slider.value = next > slider.end + 0.5 * slider.step ? slider.start : next
            }, ms)
            """,
        )
    )
    return column(plot, row(play, slider, sizing_mode="stretch_width"), sizing_mode="stretch_width")


def places(r: Recording) -> Array:
    """Measured positions (T, N) [m], wrapped on a ring."""
    t = r.trajectories
    return t.road.wrap(t.position_m) if t.road.is_ring else t.position_m


def frame_mps(r: Recording) -> int:
    """Speed [m/s] of the observer in whose eyes a platoon is shown; 0 on a ring, and where vehicles come and go.

    A platoon that drives along a road is a thin line over time and place. An observer who drives along sees its waves.
    """
    place = r.trajectories.position_m
    known = np.isfinite(place).any(axis=1)
    if r.trajectories.road.is_ring or known.sum() < 2:
        return 0
    first, last = np.nanmin(place[known], axis=1), np.nanmax(place[known], axis=1)
    if np.median(last - first) > _PLATOON * (last.max() - first.min()):
        return 0
    return round(float(np.polyfit(r.time_s[known], 0.5 * (first + last), 1)[0]))


def fastest(r: Recording) -> float:
    """Speed [m/s] that hardly any sample exceeds: the end of the colours."""
    speed = speeds(r)
    return max(float(np.nanquantile(speed, 0.99)), 1.0) if np.isfinite(speed).any() else 1.0


def speeds(r: Recording) -> Array:
    """Speeds (T, N) [m/s]: filtered speeds if estimators have run, else speeds from positions."""
    return r.series["speed"] if r.has_estimates else naive_speeds(r)


def naive_speeds(r: Recording) -> Array:
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
