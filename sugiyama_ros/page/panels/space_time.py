"""Space-time diagrams: measured, and simulated before and after, with one colour scale."""

from collections.abc import Mapping
from typing import Any, NamedTuple

import numpy as np
from bokeh.models import ColumnDataSource, LinearColorMapper, Span, UIElement

from sugiyama_ros.arrays import Array, Mask
from sugiyama_ros.page.panels.base import CHOSEN, GREY, SINGLE, colour_bar, panel, speed_colours
from sugiyama_ros.page.panels.chosen import Chosen
from sugiyama_ros.page.panels.measured import fastest, frame_mps, places, speeds
from sugiyama_ros.page.recording import Recording
from sugiyama_ros.road import Road

# Number of points of one diagram, at most.
_MOST = 20_000


def measured(r: Recording, chosen: Chosen) -> UIElement:
    """Position over time of every vehicle, coloured by speed, with the driver who is chosen as a line."""
    every = max(1, -(-r.trajectories.position_m.size // _MOST))
    place, speed = places(r)[::every], speeds(r)[::every]
    time = np.broadcast_to(r.time_s[::every, None], place.shape)
    drawn = np.isfinite(np.diff(place, axis=0)) & ~_jumps(place, r.trajectories.road)
    plot, source = _diagram("Measured", _Seen(time, place, speed, drawn, frame_mps(r)), speed_colours(fastest(r)))
    chosen.points(plot, source, np.broadcast_to(np.arange(place.shape[1]), drawn.shape)[drawn].tolist())
    line = place.copy()
    line[1:][_jumps(place, r.trajectories.road)] = np.nan
    line = chosen.series(time=time, position=_relative(line, time, frame_mps(r)))
    plot.line("time", "position", source=line, color=CHOSEN, line_width=2)
    return plot


def simulated(r: Recording, diagnosis: Mapping[str, Any], measured_plot: Any) -> list[UIElement]:
    """The same road, driven by the model before and after the additions; it starts anew in each block of time."""
    run = diagnosis.get("free_run")
    if not run or not run["time_s"]:  # tracks have no road on which all cars could drive
        return []
    colours = speed_colours(fastest(r))
    time_s, block = np.array(run["time_s"], dtype=np.float64), np.array(run["block"])
    starts = time_s[1:][np.diff(block) > 0]
    found = []
    names = [("before", "The model drives, before"), ("after", "The model drives, with what was added")]
    for name, title in names if diagnosis["verdict"]["effects"] else [("before", "The model drives")]:
        place = np.array(run[name], dtype=np.float64)
        speed = speeds_of_run(r.trajectories.road, time_s, block, place)
        time = np.broadcast_to(time_s[:, None], place.shape)
        drawn = np.isfinite(np.diff(place, axis=0)) & ~_jumps(place, r.trajectories.road)
        drawn &= (np.diff(block) == 0)[:, None]
        ranges = {"x_range": measured_plot.x_range, "y_range": measured_plot.y_range}
        plot, _ = _diagram(title, _Seen(time, place, speed, drawn, frame_mps(r)), colours, **ranges)
        for start in starts.tolist():
            plot.add_layout(Span(location=start, dimension="height", line_color=GREY, line_dash="dotted"))
        found.append(plot)
    return found


def speeds_of_run(road: Road, time_s: Array, block: Array, place: Array) -> Array:
    """Speeds (T, N) [m/s] from differences of positions inside the blocks."""
    speed = np.full_like(place, np.nan)
    speed[:-1] = road.difference(place[1:], place[:-1]) / np.diff(time_s)[:, None]
    last = np.flatnonzero(np.diff(block) > 0)
    for k in (*last.tolist(), len(place) - 1):
        speed[k] = speed[k - 1]
    return speed


def _jumps(place: Array, road: Road) -> Mask:
    """Whether (T - 1, N) a vehicle comes to the end of a ring between two samples, and begins at 0 m anew."""
    return np.asarray(np.abs(np.diff(place, axis=0)) > (0.5 * road.circumference_m if road.is_ring else np.inf))


class _Seen(NamedTuple):
    """Times, places and speeds (T, N); from which samples (T - 1, N) a line goes on; the observer's speed [m/s]."""

    time: Array
    place: Array
    speed: Array
    drawn: Mask
    frame: int


def _relative(place: Array, time: Array, frame: int) -> Array:
    """Places as an observer sees them who is at 0 m at time 0."""
    return place - frame * time


def _diagram(title: str, seen: _Seen, colours: LinearColorMapper, **ranges: Any) -> tuple[Any, ColumnDataSource]:
    """A line from each sample to the next one."""
    time, place = seen.time, _relative(seen.place, seen.time, seen.frame)
    ends = {"time": time[:-1], "position": place[:-1], "speed": seen.speed[:-1], "later": time[1:], "on": place[1:]}
    source = ColumnDataSource({name: values[seen.drawn].astype(SINGLE) for name, values in ends.items()})
    label = f"position - {seen.frame} m/s × time [m]" if seen.frame else "position [m]"
    plot = panel(title, "time [s]", label, **ranges)
    colour = {"field": "speed", "transform": colours}
    plot.segment("time", "position", "later", "on", source=source, line_width=2.5, line_color=colour,
                 nonselection_line_alpha=1.0)  # fmt: skip
    colour_bar(plot, colours, "speed [m/s]")
    return plot, source
