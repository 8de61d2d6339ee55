"""Maps of the bias, before and after the additions, with what was found drawn in."""

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from bokeh.models import BoxAnnotation, ColumnDataSource, HoverTool, LinearColorMapper, Range1d, Span, UIElement
from bokeh.palettes import PuOr11

from sugiyama_ros.arrays import Array
from sugiyama_ros.page.found import Found, found_in
from sugiyama_ros.page.panels.base import EMPTY, VERMILION, colour_bar, panel

_UNITS = {"speed": "m/s", "gap": "m", "place": "m", "time": "s"}
_NAMES = {"place": "position"}
# Bias [std] at the ends of the colours.
_END = 0.5


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
        here = found_in(_axes(before), diagnosis, ring_m)
        drawn |= dict.fromkeys(one.title for one in here)
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
    labels = [f"{_NAMES.get(name, name)} [{_UNITS.get(name, '')}]" for name in (x, y)]
    ranges = {"x_range": beside.x_range, "y_range": beside.y_range} if beside is not None else {}
    first, second = (np.array(one[f"{name}_edges"], dtype=np.float64) for name in ("first", "second"))
    if beside is None:
        across, up = (second, first) if y == one["first"] else (first, second)
        ranges = {"x_range": _range(across), "y_range": _range(up)}
    title = f"Bias over {_NAMES.get(x, x)} and {_NAMES.get(y, y)}" + (f", {when}" if when else "")
    plot = panel(title, *labels, background_fill_color=EMPTY, **ranges)
    bias = np.array(one["bias"], dtype=np.float64).reshape(len(first) - 1, -1)
    flagged = np.array(one.get("flagged", np.zeros(bias.shape)), dtype=np.bool_).reshape(bias.shape)
    i, j = np.nonzero(np.isfinite(bias))
    across, up, a, b = (second, first, j, i) if y == one["first"] else (first, second, i, j)
    source = ColumnDataSource(
        {
            "left": across[a],
            "right": across[a + 1],
            "bottom": up[b],
            "top": up[b + 1],
            "bias": bias[i, j],
            "line": np.where(flagged[i, j], "#000000", "#00000000"),
            "says": np.where(flagged[i, j], "more than chance", "within chance"),
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


def _range(edges: Array) -> Range1d:
    """The edges from end to end; a last bin that is far wider than the others is cut off."""
    if len(edges) < 3:
        return Range1d(float(edges[0]), float(edges[-1]))
    return Range1d(float(edges[0]), float(min(edges[-1], edges[-2] + 0.3 * (edges[-2] - edges[0]))))


def _draw_found(plot: Any, one: Mapping[str, Any], found: Sequence[Found]) -> None:
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
