"""Panel of what is missing: the candidates with their gains."""

from collections.abc import Mapping
from typing import Any

import numpy as np
from bokeh.models import ColumnDataSource, FactorRange, HoverTool, Range1d, Span, UIElement, Whisker

from sugiyama_ros.arrays import Array
from sugiyama_ros.page.names import chance, title_of
from sugiyama_ros.page.panels.base import BLUE, GREY, HEIGHT, VERMILION, panel

_MOST_SHOWN = 12


def candidates(diagnosis: Mapping[str, Any]) -> UIElement:
    """Held-out gain of every candidate, with its standard error; the set that cannot be told apart in one colour."""
    effects = diagnosis["verdict"]["effects"]
    added = {n["name"] for n in effects}
    together = added | {other for n in effects for other in n["indistinguishable"]}
    best = [c for c in diagnosis["candidates"] if c["heldout_gain_nats"] is not None]
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
        x_range=_range(gain - se, gain + se),
        y_range=FactorRange(factors=names),
        height=max(HEIGHT, 60 + 24 * len(kept), 60 + 30 * len(diagnosis["smallest_detectable"])),
    )
    bars = plot.hbar("name", right="gain", source=source, height=0.7, color="colour")
    whisker = Whisker(base="name", lower="low", upper="high", source=source, dimension="width", line_color=GREY)
    whisker.upper_head.line_color = whisker.lower_head.line_color = GREY
    plot.add_layout(whisker)
    plot.add_layout(Span(location=0.0, dimension="height", line_color=GREY))
    plot.add_tools(HoverTool(renderers=[bars], tooltips=[("", "@name"), ("gain", "@gain{0} nats"), ("", "@p")]))
    plot.min_border_right = 20
    return plot


def _range(low: Array, high: Array) -> Range1d:
    """From the end of the lowest whisker, or zero, to the end of the highest one."""
    ends = float(min(low.min(initial=0.0), 0.0)), float(max(high.max(initial=0.0), 0.0))
    margin = 0.04 * (ends[1] - ends[0]) or 1.0
    return Range1d(ends[0] - margin, ends[1] + margin)


def _label(diagnosis: Mapping[str, Any], candidate: Mapping[str, Any], added: set[str]) -> str:
    title = title_of(diagnosis, candidate["name"])
    p = chance(candidate.get("p_value"))
    return ("▸ " if candidate["name"] in added else "") + title + (f" ({p})" if p else "")
