"""Panels of a diagnosis: maps of the bias, the candidates, and what the additions are worth."""

import math
import re
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from bokeh.models import (
    BoxAnnotation,
    ColumnDataSource,
    DataRange1d,
    FactorRange,
    HoverTool,
    LinearColorMapper,
    Range1d,
    Span,
    UIElement,
    Whisker,
)
from bokeh.palettes import PuOr11

from sugiyama_ros.arrays import Array
from sugiyama_ros.page.names import MODELS, UNITS, chance, form_of, model_name, models, title_of
from sugiyama_ros.page.panels.base import (
    BLUE,
    EMPTY,
    GREY,
    HEIGHT,
    VERMILION,
    Chosen,
    colour_bar,
    colour_of,
    legend_above,
    panel,
)

_AXES = {"place": "position"}
# Shares of a force between which a map shows it.
_MIDDLE = (0.1, 0.9)
# Bias [std] at the ends of the colours.
_END = 0.5


# A range of a covariate in which something acts: its name, the covariate, and both ends, which are equal for a time.
_Found = tuple[str, str, float, float]


def bias_maps(diagnosis: Mapping[str, Any], ring_m: float) -> tuple[list[UIElement], list[str]]:
    """For each pair of covariates, the map before and, if something was added, after; and what is drawn into them."""
    where = diagnosis.get("where", {})
    added = bool(diagnosis["verdict"]["effects"])
    found: list[UIElement] = []
    drawn: dict[str, None] = {}
    for k, before in enumerate(where.get("before", {}).get("maps", [])):
        if not np.size(before["bias"]):  # recordings have no places in common
            continue
        plot = _bias_map(before, "before" if added else "")
        here = _found_in(_axes(before), diagnosis, ring_m)
        drawn |= dict.fromkeys(title for title, *_ in here)
        _draw_found(plot, before, here)
        found.append(plot)
        if added:
            after = _bias_map(where["after"]["maps"][k], "after", plot)
            _draw_found(after, before, here)
            found.append(after)
    return found, list(drawn)


def _axes(one: Mapping[str, Any]) -> tuple[str, str]:
    """Covariates of the horizontal and the vertical axis; time runs to the right."""
    return (one["second"], one["first"]) if one["second"] == "time" else (one["first"], one["second"])


def _bias_map(one: Mapping[str, Any], when: str, beside: Any = None) -> Any:
    x, y = _axes(one)
    edges = {one[part]: np.array(one[f"{part}_edges"], dtype=np.float64) for part in ("first", "second")}
    across, up = edges[x], edges[y]
    ranges = {"x_range": _ends(across), "y_range": _ends(up)}
    if beside is not None:
        ranges = {"x_range": beside.x_range, "y_range": beside.y_range}
    labels = [f"{_AXES.get(name, name)} [{UNITS.get(name, '')}]" for name in (x, y)]
    title = f"Bias over {_AXES.get(x, x)} and {_AXES.get(y, y)}" + (f", {when}" if when else "")
    plot = panel(title, *labels, background_fill_color=EMPTY, **ranges)
    bias, flagged = np.array(one["bias"], dtype=np.float64), np.array(one["flagged"], dtype=np.bool_)
    if x == one["second"]:
        bias, flagged = bias.T, flagged.T
    a, b = np.nonzero(np.isfinite(bias))
    source = ColumnDataSource(
        {
            "left": across[a],
            "right": across[a + 1],
            "bottom": up[b],
            "top": up[b + 1],
            "bias": bias[a, b],
            "line": np.where(flagged[a, b], "#000000", "#00000000"),
            "says": np.where(flagged[a, b], "more than chance", "within chance"),
        }
    )
    colours = LinearColorMapper(PuOr11, low=-_END, high=_END)
    quads = plot.quad("left", "right", "bottom", "top", source=source, line_color="line", line_width=1.5,
                      fill_color={"field": "bias", "transform": colours})  # fmt: skip
    colour_bar(plot, colours, "bias [std]")
    # at the mouse: the middle of a bin that is cut off lies outside the picture
    tooltips = [("bias", "@bias{0.00} std"), ("", "@says")]
    plot.add_tools(HoverTool(renderers=[quads], tooltips=tooltips, point_policy="follow_mouse"))
    return plot


def _ends(edges: Array) -> Range1d:
    """The edges from end to end; a last bin that is far wider than the others is cut off."""
    if len(edges) < 3:
        return Range1d(float(edges[0]), float(edges[-1]))
    return Range1d(float(edges[0]), float(min(edges[-1], edges[-2] + 0.3 * (edges[-2] - edges[0]))))


def _draw_found(plot: Any, one: Mapping[str, Any], found: Sequence[_Found]) -> None:
    """Draw places, times and ranges of what was found into a map."""
    axes = _axes(one)
    for _, covariate, low, high in found:
        across = covariate == axes[0]
        if low == high:
            dimension = "height" if across else "width"
            plot.add_layout(Span(location=low, dimension=dimension, line_color=VERMILION, line_width=2.5,
                                 line_dash="dashed"))  # fmt: skip
        else:
            ends = {"left": low, "right": high} if across else {"bottom": low, "top": high}
            band = BoxAnnotation(**ends, fill_color=None, line_color=VERMILION, line_alpha=1.0, line_width=2.5,
                                 line_dash="dashed")  # fmt: skip
            plot.add_layout(band)


def _found_in(axes: tuple[str, str], diagnosis: Mapping[str, Any], ring_m: float) -> list[_Found]:
    """Return what to draw into a map over two covariates.

    ring_m: circumference [m] of the ring, on which a place comes again; 0 for an open road.
    """
    found = []
    for effect in diagnosis["verdict"]["effects"]:
        title = title_of(diagnosis, form_of(effect))
        declared = diagnosis.get("about", {}).get(form_of(effect), {}).get("parameters", {})
        values = effect.get("parameters", {})
        for name, value in values.items():
            axis = declared.get(name, {}).get("axis")
            if axis == "time" and "time" in axes:
                found.append((title, "time", float(value), float(value)))
            elif axis == "place" and "place" in axes:
                half = 0.5 * float(values.get("width", 0.0))
                for shift in (-ring_m, 0.0, ring_m) if ring_m else (0.0,):
                    found.append((title, "place", value + shift - half, value + shift + half))
        if effect.get("covariate") in axes:
            found += _force(title, effect)
    return found


def _force(title: str, effect: Mapping[str, Any]) -> list[_Found]:
    """Where the middle 80 % of the squares of a force lies along its covariate; nothing for a force of no size."""
    values = effect["parameters"]
    size = np.abs([float(value) for name, value in values.items() if name.startswith("force_")])
    knots = np.linspace(float(values["first"]), float(values["last"]), len(size))
    if not size.any():
        return []
    low, high = knots[np.searchsorted(np.square(size).cumsum() / np.square(size).sum(), _MIDDLE)]
    return [(title, str(effect["covariate"]), float(low), float(high))]


_MOST_SHOWN = 12


def candidates(diagnosis: Mapping[str, Any]) -> UIElement:
    """Held-out gain of every candidate, with its standard error; the set that cannot be told apart in one colour."""
    effects = diagnosis["verdict"]["effects"]
    added = {n["name"] for n in effects}
    together = added | {other for n in effects for other in n["indistinguishable"]}
    # the first step may have refined what it added out of others, which alone were fitted as candidates
    first = {n["name"]: n for n in effects if n.get("step") == 0}
    every = (first.get(c["name"], c) if c["heldout_gain_nats"] is None else c for c in diagnosis["candidates"])
    best = sorted((c for c in every if c["heldout_gain_nats"] is not None), key=lambda c: -c["heldout_gain_nats"])
    kept = [c for k, c in enumerate(best) if k < _MOST_SHOWN or c["name"] in together][::-1]
    names = [_label(diagnosis, c, added) for c in kept]
    gain, se = (np.array([float(c[key] or 0.0) for c in kept]) for key in ("heldout_gain_nats", "heldout_gain_se"))
    source = ColumnDataSource(
        {
            "name": names,
            "gain": gain,
            "low": gain - se,
            "high": gain + se,
            "p": [chance(c.get("p_value")) or "not computed" for c in kept],
            "colour": [VERMILION if c["name"] in together else BLUE for c in kept],
        }
    )
    plot = panel(
        "Gain, ± one standard error",
        "gain on unseen data [nats]",
        "",
        x_range=_range_of_gains(gain - se, gain + se),
        y_range=FactorRange(factors=names),
        height=max(HEIGHT, 60 + 24 * len(kept)),
    )
    bars = plot.hbar("name", right="gain", source=source, height=0.7, color="colour")
    whisker = Whisker(base="name", lower="low", upper="high", source=source, dimension="width", line_color=GREY)
    whisker.upper_head.line_color = whisker.lower_head.line_color = GREY
    plot.add_layout(whisker)
    plot.add_layout(Span(location=0.0, dimension="height", line_color=GREY))
    plot.add_tools(HoverTool(renderers=[bars], tooltips=[("", "@name"), ("gain", "@gain{0} nats"), ("", "@p")]))
    plot.min_border_right = 20
    return plot


def _range_of_gains(low: Array, high: Array) -> Range1d:
    """From the end of the lowest whisker, or zero, to the end of the highest one."""
    ends = float(min(low.min(initial=0.0), 0.0)), float(max(high.max(initial=0.0), 0.0))
    margin = 0.04 * (ends[1] - ends[0]) or 1.0
    return Range1d(ends[0] - margin, ends[1] + margin)


def _label(diagnosis: Mapping[str, Any], candidate: Mapping[str, Any], added: set[str]) -> str:
    title = title_of(diagnosis, candidate["name"])
    p = chance(candidate.get("p_value"))
    return ("▸ " if candidate["name"] in added else "") + title + (f" ({p})" if p else "")


# Other laws in the picture of errors over time; the table has all.
_LAWS = 2


def growth(diagnosis: Mapping[str, Any], run: str, title: str) -> UIElement:
    """Error of the free runs of one kind over time: of the base and the final model, and of the best other laws."""
    plot = panel(title, "after [s]", "error [m]")
    curves = {name: _growth(errors, run) for name, errors in models(diagnosis).items()}
    laws = sorted((name for name in curves if name not in MODELS), key=lambda name: curves[name][1][-1])[:_LAWS]
    lines = []
    for name in [name for name in curves if name in (*MODELS, *laws)]:
        thick = name in ("before", "after")
        lines.append(
            plot.line(
                *curves[name],
                color=colour_of(name, diagnosis),
                line_dash="dashed" if name == "floor" else "solid",
                line_width=3.5 if thick else 1.5,
                level="overlay" if thick else "glyph",
                name=model_name(name),
                legend_label=model_name(name),
            )
        )
    plot.y_range = DataRange1d(start=0.0)
    plot.add_tools(
        HoverTool(renderers=lines, tooltips=[("", "$name"), ("after", "$x{0.0} s"), ("error", "$y{0.00} m")])
    )
    legend_above(plot)
    return plot


def is_known(diagnosis: Mapping[str, Any], run: str) -> bool:
    """Whether there are free runs of a kind: tracks have none of all cars together."""
    return len(_growth(diagnosis["errors"]["before"], run)[0]) > 1


def _growth(errors: Mapping[str, Any], run: str) -> tuple[list[float], list[float]]:
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
