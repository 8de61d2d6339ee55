"""What all panels share: colours that colour-blind readers can tell apart, an empty figure, a legend."""

from typing import Any

import numpy as np
from bokeh.plotting import figure

from sugiyama_ros.arrays import Array
from sugiyama_ros.road import Road

# Okabe and Ito's colours.
BLUE, ORANGE, GREEN, VERMILION, GREY = "#0072B2", "#E69F00", "#009E73", "#D55E00", "#777777"
#: Colours of the models that are compared.
COLOURS = (GREY, BLUE, VERMILION, ORANGE, GREEN, "#56B4E9", "#CC79A7", "#000000")
#: Time [s] over which the one-step error is averaged.
MOVING_S = 10.0
#: Precision of the numbers in the page.
SINGLE = np.float32
_HEIGHT = 320
_TOOLS = "pan,wheel_zoom,box_zoom,reset,save"


def panel(title: str, x: str, y: str, **more: Any) -> Any:
    """An empty figure that fills the width of its place on the page."""
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
    if not plot.legend:  # nothing is drawn
        return
    plot.legend.click_policy = "hide"
    plot.legend.orientation = "horizontal"
    plot.legend.label_text_font_size = "11px"
    plot.add_layout(plot.legend[0], "above")
