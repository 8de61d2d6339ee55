"""A recorded run for the Rerun viewer, with a layout of panels: road, speeds, parameters with bands, and verdict."""

from collections.abc import Iterator, Mapping
from typing import Any

import numpy as np
import rerun
from bokeh.palettes import Cividis256
from rerun import blueprint

from sugiyama_ros.arrays import Array, Ints
from sugiyama_ros.page.panels.base import COLOURS, GREY, from_above
from sugiyama_ros.page.panels.measured import fastest, places, speeds
from sugiyama_ros.page.recording import Recording
from sugiyama_ros.page.words import sentences, what_to_do

_TIMELINE = "time"
# Width of a car and of a line of the road [m].
_CAR_M, _LINE_M = 1.2, 0.15
# Drivers of a legend, at most.
_FEW = 6
_PARAMETERS = {"v_star": "desired speed v* [m/s]", "kappa_v": "risk premium κ_v [s]"}


def log(stream: "rerun.RecordingStream", r: Recording, diagnosis: Mapping[str, Any] | None) -> None:
    """Log a recorded run and the layout of its panels.

    diagnosis: document of ``sugiyama diagnose --save``.
    """
    stream.send_blueprint(_layout(r))
    stream.send_recording_name(r.name)
    stream.log("verdict", rerun.TextDocument(_verdict(r, diagnosis), media_type="text/markdown"), static=True)
    _log_road(stream, r)
    place, speed = places(r), speeds(r)
    for k, vehicle in enumerate(r.trajectories.vehicle.tolist()):
        name = f"vehicle_{vehicle:02d}"
        _log_curve(stream, f"position/{name}", r.time_s, place[:, k], _colour(k), dots=True)
        _log_curve(stream, f"speed/{name}", r.time_s, speed[:, k], _colour(k))
        for parameter in _PARAMETERS:
            for end, values in _band(r, parameter, k):
                colour = _colour(k) if end == "estimate" else GREY
                _log_curve(stream, f"{parameter}/{name}/{end}", r.time_s, values, colour)
    for k, (model, weight) in enumerate(r.weights.items()):
        _log_curve(stream, f"critic/{model}", r.verdict_s, weight, _colour(k))


def _layout(r: Recording) -> Any:
    """The panels; a panel without data is left out."""
    curves = {"position": "Position [m]", "speed": "Speed [m/s]"}
    learnt = _PARAMETERS if r.has_estimates else {}
    critic = {"critic": "Probability of each model of the critic"} if r.weights else {}

    # the curves have the colours of their drivers; a legend of many drivers would hide them
    few = blueprint.PlotLegend(visible=len(r.trajectories.vehicle) <= _FEW)
    begin, end = (rerun.TimeRangeBoundary.absolute(seconds=float(r.time_s[k])) for k in (0, -1))
    whole = blueprint.archetypes.TimeAxis(view_range=rerun.TimeRange(begin, end))

    def of(titles: Mapping[str, str], legend: Any = few) -> list[Any]:
        return [
            blueprint.TimeSeriesView(origin=origin, name=title, axis_x=whole, plot_legend=legend)
            for origin, title in titles.items()
        ]

    first = blueprint.Vertical(
        blueprint.Spatial2DView(origin="road", name="The road from above"),
        blueprint.TextDocumentView(origin="verdict", name="Verdict"),
    )
    columns = [first, blueprint.Vertical(*of(curves))]
    if learnt:
        columns.append(blueprint.Vertical(*of(learnt), *of(critic, blueprint.PlotLegend(visible=True))))
    return blueprint.Blueprint(blueprint.Horizontal(*columns), collapse_panels=True)


def _log_road(stream: "rerun.RecordingStream", r: Recording) -> None:
    """Log the road, and the cars on it at each sample, coloured by speed and labelled with their numbers."""
    t = r.trajectories
    ends = (0.0, t.road.circumference_m)
    if not t.road.is_ring:
        ends = float(np.nanmin(t.position_m)), float(np.nanmax(t.position_m))
    line = _drawn(*from_above(t.road, np.asarray(np.linspace(*ends, num=181))))
    stream.log("road/line", rerun.LineStrips2D([line], colors=_rgb(GREY), radii=_LINE_M), static=True)
    known = np.isfinite(t.position_m)
    vehicle = np.broadcast_to(t.vehicle, known.shape)[known]
    share = np.clip(np.nan_to_num(speeds(r)[known]) / fastest(r), 0.0, 1.0)
    cars = rerun.Points2D.columns(
        positions=_drawn(*from_above(t.road, t.position_m[known])),
        colors=_rgb(*Cividis256)[(share * 255.0).astype(np.int64)],
        labels=[str(v) for v in vehicle.tolist()],
        radii=np.full(len(vehicle), _CAR_M),
    )
    here: Ints = known.sum(axis=1)
    stream.send_columns("road/cars", [_times(r.time_s)], cars.partition(here))


def _drawn(x: Array, y: Array) -> Array:
    """Coordinates of a picture, whose second axis points down."""
    return np.column_stack([x, -y])


def _log_curve(
    stream: "rerun.RecordingStream", path: str, time_s: Array, values: Array, colour: str, dots: bool = False
) -> None:
    """Log a quantity over time, without the samples at which it is not known."""
    known, rgb = np.isfinite(values), _rgb(colour)
    if known.any():
        style = rerun.SeriesPoints(colors=rgb, marker_sizes=1.5) if dots else rerun.SeriesLines(colors=rgb)
        stream.log(path, style, static=True)
        stream.send_columns(path, [_times(time_s[known])], rerun.Scalars.columns(scalars=values[known]))


def _band(r: Recording, parameter: str, k: int) -> Iterator[tuple[str, Array]]:
    """A driver's parameter as it was learnt, and one standard deviation to both sides."""
    value, std = r.series[parameter][:, k], r.series[f"{parameter}_std"][:, k]
    yield from (("estimate", value), ("low", value - std), ("high", value + std))


def _times(time_s: Array) -> Any:
    return rerun.TimeColumn(_TIMELINE, duration=time_s)


def _colour(k: int) -> str:
    return COLOURS[1 + k % (len(COLOURS) - 1)]


def _rgb(*colours: str) -> Array:
    """Colours as numbers from 0 to 255, (colours, 3)."""
    return np.array([[int(c[k : k + 2], 16) for k in (1, 3, 5)] for c in colours], dtype=np.uint8)


def _verdict(r: Recording, d: Mapping[str, Any] | None) -> str:
    """The verdict as text with headings."""
    about = f"# {r.name}\n\n{r.headline()}\n"
    if d is None:
        return f"{about}\nWhat the model lacks is not known: give `--diagnosis`.\n"
    first, *rest = sentences(d)
    return f"{about}\n**{first}**\n\n" + "".join(f"- {line.strip()}\n" for line in [*rest, what_to_do(d)])
