"""Panels of what was measured: speeds, the road from above, and diagrams of space and time, one of them small."""

from base64 import b64encode
from collections.abc import Mapping
from io import BytesIO
from typing import Any

import numpy as np
from bokeh.layouts import column, row
from bokeh.models import (
    Button,
    ColumnDataSource,
    CustomJS,
    DataRange1d,
    HoverTool,
    Slider,
    Span,
    UIElement,
)
from bokeh.palettes import Cividis256
from PIL import Image

from sugiyama_ros.arrays import Array, Mask
from sugiyama_ros.page.above import Above
from sugiyama_ros.page.panels.base import (
    BLUE,
    CHOSEN,
    GREEN,
    GREY,
    ORANGE,
    SINGLE,
    Chosen,
    cars,
    colour_bar,
    from_above,
    legend_above,
    panel,
    speed_colours,
)
from sugiyama_ros.page.recording import Recording
from sugiyama_ros.road import Road

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
    in_plane = t.road.is_ring or r.above is not None
    x, y = from_above(t.road, t.position_m) if r.above is None else r.above.at(t.vehicle, t.position_m)
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
    labels = ("x [m]", "y [m]") if in_plane else ("position [m]", "")
    plot = panel("The road from above", *labels, match_aspect=in_plane)
    plot.yaxis.visible = plot.ygrid.visible = in_plane
    if r.above is not None:
        plot.multi_line(*_lanes(r.above), color=GREY, line_width=6, line_alpha=0.35, line_cap="round")
    elif t.road.is_ring:
        plot.line(
            *from_above(t.road, np.asarray(np.linspace(0.0, t.road.circumference_m, 181), dtype=np.float64)),
            color=GREY,
            line_alpha=0.5,
        )
    cars(plot, shown, speed_colours(fastest(r)))
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


def _lanes(above: Above) -> tuple[list[Array], list[Array]]:
    """Coordinates [m] of the points of each lane."""
    x, y = zip(*above.lanes, strict=True)
    return [one.astype(SINGLE) for one in x], [one.astype(SINGLE) for one in y]


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
    return r.series["speed"] if r.has_estimates else _naive_speeds(r)


def _naive_speeds(r: Recording) -> Array:
    """Speeds (T, N) [m/s] from differences of measured positions, smoothed over 5 samples."""
    padded = np.pad(two_point_speeds(r), ((2, 2), (0, 0)), constant_values=np.nan)
    around = np.lib.stride_tricks.sliding_window_view(padded, 5, axis=0)
    with np.errstate(invalid="ignore"):
        return np.asarray(np.nansum(around, axis=-1) / np.isfinite(around).sum(axis=-1))


def two_point_speeds(r: Recording) -> Array:
    """Speeds (T, N) [m/s] from each measured position and the next one."""
    t = r.trajectories
    speed = np.full_like(t.position_m, np.nan)
    speed[:-1] = t.road.difference(t.position_m[1:], t.position_m[:-1]) / t.period_s
    return speed


# Number of points of one diagram, at most.
_POINTS = 20_000


def space_time(r: Recording, chosen: Chosen) -> UIElement:
    """Position over time of every vehicle, coloured by speed, with the driver who is chosen as a line."""
    every = max(1, -(-r.trajectories.position_m.size // _POINTS))
    place, speed = places(r)[::every], speeds(r)[::every]
    time = np.broadcast_to(r.time_s[::every, None], place.shape)
    plot, source, drawn = _diagram(r, "Simulated" if r.is_simulated else "Measured", (time, place, speed))
    chosen.points(plot, source, np.broadcast_to(np.arange(place.shape[1]), drawn.shape)[drawn].tolist())
    line = place.copy()
    line[1:][_jumps(place, r.trajectories.road)] = np.nan
    shown = chosen.series(time=time, position=line - frame_mps(r) * time)
    plot.line("time", "position", source=shown, color=CHOSEN, line_width=2)
    return plot


def simulated(r: Recording, diagnosis: Mapping[str, Any], beside: Any) -> list[UIElement]:
    """The same road, driven by the model before and after the additions; it starts anew in each block of time."""
    run = diagnosis.get("free_run")
    if not run or not run["time_s"]:  # tracks have no road on which all cars could drive
        return []
    time_s, begins = np.array(run["time_s"], dtype=np.float64), np.diff(run["block"]) > 0
    found = []
    names = {"before": "The model drives, before", "after": "The model drives, with what was added"}
    for name, title in names.items() if diagnosis["verdict"]["effects"] else [("before", "The model drives")]:
        place = np.array(run[name], dtype=np.float64)
        speed = np.full_like(place, np.nan)
        speed[:-1] = r.trajectories.road.difference(place[1:], place[:-1]) / np.diff(time_s)[:, None]
        time = np.broadcast_to(time_s[:, None], place.shape)
        ranges = {"x_range": beside.x_range, "y_range": beside.y_range}
        plot, *_ = _diagram(r, title, (time, place, speed), begins, **ranges)
        for start in time_s[1:][begins].tolist():
            plot.add_layout(Span(location=start, dimension="height", line_color=GREY, line_dash="dotted"))
        found.append(plot)
    return found


def _jumps(place: Array, road: Road) -> Mask:
    """Whether (T - 1, N) a vehicle comes to the end of a ring between two samples, and begins at 0 m anew."""
    return np.asarray(np.abs(np.diff(place, axis=0)) > (0.5 * road.circumference_m if road.is_ring else np.inf))


def _diagram(
    r: Recording, title: str, seen: tuple[Array, Array, Array], begins: Mask | bool = False, **ranges: Any
) -> tuple[Any, ColumnDataSource, Mask]:
    """A line from each sample to the next one, as an observer sees them who drives along with a platoon.

    seen: times [s], places [m] and speeds [m/s] (T, N); begins: (T - 1,), whether a line ends before the next sample.
    Returns the plot, the source, and which lines (T - 1, N) are drawn.
    """
    time, place, speed = seen
    drawn = np.isfinite(np.diff(place, axis=0)) & ~_jumps(place, r.trajectories.road) & ~np.atleast_1d(begins)[:, None]
    frame, colours = frame_mps(r), speed_colours(fastest(r))
    place = place - frame * time
    ends = {"time": time[:-1], "position": place[:-1], "speed": speed[:-1], "later": time[1:], "on": place[1:]}
    source = ColumnDataSource({name: values[drawn].astype(SINGLE) for name, values in ends.items()})
    plot = panel(title, "time [s]", f"position - {frame} m/s × time [m]" if frame else "position [m]", **ranges)
    colour = {"field": "speed", "transform": colours}
    plot.segment("time", "position", "later", "on", source=source, line_width=2.5, line_color=colour,
                 nonselection_line_alpha=1.0)  # fmt: skip
    colour_bar(plot, colours, "speed [m/s]")
    return plot, source, drawn


# Columns and rows of the small picture, and samples that a cell holds on average, at least.
_COLUMNS, _ROWS, _IN_CELL = 150, 50, 4


def thumbnail(r: Recording) -> str:
    """A small picture of speeds as an address for HTML; time runs to the right, the road upward, fast is yellow."""
    place, speed = places(r), speeds(r)
    time = np.broadcast_to(r.time_s[:, None], place.shape)
    place = place - frame_mps(r) * time
    known = np.isfinite(place) & np.isfinite(speed)
    fill = min(1.0, float(np.sqrt(known.sum() / (_IN_CELL * _COLUMNS * _ROWS))))
    bins = (max(1, round(_COLUMNS * fill)), max(1, round(_ROWS * fill)))
    count, *edges = np.histogram2d(time[known], place[known], bins=bins)
    total = np.histogram2d(time[known], place[known], bins=edges, weights=speed[known])[0]
    share = np.clip(total / np.maximum(count, 1) / fastest(r), 0.0, 1.0)
    colours = np.array([[int(c[k : k + 2], 16) for k in (1, 3, 5)] for c in Cividis256], dtype=np.uint8)
    pixels = np.zeros((*bins, 4), dtype=np.uint8)
    pixels[..., :3] = colours[(share * 255).astype(int)]
    pixels[..., 3] = np.where(count > 0, 255, 40)
    stream = BytesIO()
    Image.fromarray(np.ascontiguousarray(pixels.transpose(1, 0, 2)[::-1])).save(stream, "PNG")
    return "data:image/png;base64," + b64encode(stream.getvalue()).decode()
