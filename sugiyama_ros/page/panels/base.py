"""What all panels share: colours that colour-blind readers can tell apart, an empty figure, a legend, a colour bar,
and the driver who is chosen.

Lines of the axes are of a grey that can be seen on white and on black. The style sheets give the colours of the text.
"""

from collections.abc import Mapping
from typing import Any

import numpy as np
from bokeh.models import (
    BasicTicker,
    BasicTickFormatter,
    ColorBar,
    ColumnDataSource,
    CustomJS,
    LinearColorMapper,
    Select,
    TapTool,
)
from bokeh.palettes import Cividis256
from bokeh.plotting import figure

from sugiyama_ros.arrays import Array, Ints
from sugiyama_ros.road import Road

# Okabe and Ito's colours.
BLUE, ORANGE, GREEN, VERMILION, GREY = "#0072B2", "#E69F00", "#009E73", "#D55E00", "#777777"
SKY = "#56B4E9"
#: Colours of the models that are compared.
COLOURS = (GREY, BLUE, VERMILION, ORANGE, GREEN, SKY, "#CC79A7", "#8C6D31", "#9A9A00", "#B5577F", "#44AA99", "#A08CC0")
#: Colour of a place without data, and of lines of a grid.
EMPTY, _GRID = "#8080802e", "#80808040"
#: Colour of the driver who is chosen.
CHOSEN = VERMILION
#: Time [s] over which the one-step error is averaged.
MOVING_S = 10.0
#: Precision of the numbers in the page.
SINGLE = np.float32
# Width of a lane [m].
_LANE_M = 3.5
#: Height of a panel [pixels].
HEIGHT = 320
# Number of characters that a row of a legend has room for above a narrow picture.
_WIDEST = 54
_TOOLS = "pan,wheel_zoom,box_zoom,reset,save"


def panel(title: str, x: str, y: str, **more: Any) -> Any:
    """An empty figure that fills the width of its place on the page."""
    plot = figure(
        **{
            "title": title,
            "x_axis_label": x,
            "y_axis_label": y,
            "height": HEIGHT,
            "sizing_mode": "stretch_width",
            "tools": _TOOLS,
            "output_backend": "canvas",
            "background_fill_color": None,
            "border_fill_color": None,
            "outline_line_color": _GRID,
            "min_border_right": 12,
            **more,
        }
    )
    plot.toolbar.autohide = True
    plot.toolbar.logo = None
    plot.title.text_color = GREY
    plot.title.text_font_size = "14px"
    plot.grid.grid_line_color = _GRID
    for name in ("axis_label_text_color", "major_label_text_color", "axis_line_color", "major_tick_line_color",
                 "minor_tick_line_color"):  # fmt: skip
        setattr(plot.axis, name, GREY)
    if isinstance(plot.yaxis.formatter, BasicTickFormatter):
        plot.yaxis.formatter.use_scientific = False
    plot.axis.axis_label_text_font_style = "normal"
    plot.axis.axis_label_text_font_size = plot.axis.major_label_text_font_size = "12px"
    return plot


def speed_colours(fastest: float) -> LinearColorMapper:
    """Colours of speeds from 0 to ``fastest`` [m/s]."""
    return LinearColorMapper(Cividis256, low=0.0, high=max(fastest, 1.0), nan_color=EMPTY)


def colour_bar(plot: Any, colours: LinearColorMapper, title: str) -> None:
    """Add a bar that explains the colours."""
    plot.add_layout(
        ColorBar(
            color_mapper=colours,
            ticker=BasicTicker(desired_num_ticks=5),
            title=title,
            width=12,
            padding=4,
            background_fill_color=None,
            title_text_color=GREY,
            title_text_font_size="12px",
            title_text_font_style="normal",
            major_label_text_color=GREY,
        ),
        "right",
    )


def colour_of(model: str, diagnosis: Mapping[str, Any]) -> str:
    """Colour of a model of a diagnosis, the same in the table of errors and in all pictures."""
    return COLOURS[list(diagnosis["errors"]).index(model) % len(COLOURS)]


def from_above(road: Road, position_m: Array, lane: Array | float = 0.0) -> tuple[Array, Array]:
    """Coordinates [m] of positions on a road that lies in a circle, or straight on; further lanes lie outside."""
    aside = np.broadcast_to(_LANE_M * np.asarray(lane), position_m.shape)
    if not road.is_ring:
        return position_m, np.array(aside, dtype=np.float64)
    radius = road.circumference_m / (2.0 * np.pi) + aside
    return radius * np.cos(position_m / radius), radius * np.sin(position_m / radius)


def cars(plot: Any, source: ColumnDataSource, colours: LinearColorMapper) -> None:
    """Draw the cars of a road, which is seen from above. Columns: x, y, speed."""
    plot.scatter("x", "y", source=source, size=13, line_color=GREY, fill_color={"field": "speed", "transform": colours},
                 nonselection_fill_alpha=1.0, nonselection_line_alpha=1.0, selection_line_color=VERMILION,
                 selection_line_width=3)  # fmt: skip


def legend_above(plot: Any) -> None:
    """A legend that hides nothing, and in which a click hides a line."""
    if not plot.legend:  # nothing is drawn
        return
    legend = plot.legend[0]
    legend.click_policy = "hide"
    legend.orientation = "horizontal"
    longest = max(len(item.label.value) for item in legend.items)
    legend.ncols = max(1, _WIDEST // longest) if len(legend.items) > 3 else "auto"
    legend.label_text_font_size = "12px"
    legend.label_text_color = GREY
    legend.background_fill_color = legend.border_line_color = None
    legend.padding, legend.spacing, legend.margin = 2, 6 if legend.ncols == "auto" else 1, 0
    legend.glyph_height = legend.label_height = 14
    plot.add_layout(legend, "above")


#: Style of an input: dark on white, whatever the colours of the page around it.
INPUT = ".bk-input { color: #1b1b1b; background-color: #fff; }"


class Chosen:
    """Panels of one driver and points of all drivers, which follow one selection.

    vehicles: (N,), numbers of the vehicles; first: place of the driver who is chosen at the start.
    """

    def __init__(self, vehicles: Ints, first: int = 0) -> None:
        self._first = first
        self._options = [f"vehicle {v}" for v in vehicles.tolist()]
        self.select = Select(value=self._options[first], options=self._options, width=180, stylesheets=[INPUT])
        self._series: list[dict[str, Any]] = []
        self._points: list[dict[str, Any]] = []

    def series(self, **columns: Array) -> ColumnDataSource:
        """A source that holds the columns (T, N) of the driver who is chosen."""
        everything = ColumnDataSource({name: values.T.ravel().astype(SINGLE) for name, values in columns.items()})
        shown = ColumnDataSource({name: values[:, self._first].astype(SINGLE) for name, values in columns.items()})
        length = len(next(iter(columns.values())))
        self._series.append({"all": everything, "shown": shown, "names": list(columns), "n": length})
        return shown

    def points(self, plot: Any, source: ColumnDataSource, drivers: list[int]) -> None:
        """Let a click on a point of the source choose the driver; ``drivers``: place of each point's driver.

        Where each driver has one point, the point of the driver who is chosen is marked.
        """
        self._listen(plot, source, drivers)
        if len(set(drivers)) == len(drivers):
            self._points.append({"source": source, "drivers": drivers})
            source.selected.indices = [k for k, driver in enumerate(drivers) if driver == self._first]

    def _listen(self, plot: Any, source: ColumnDataSource, drivers: list[int]) -> None:
        plot.add_tools(TapTool())
        source.selected.js_on_change(
            "indices",
            CustomJS(
                args={"select": self.select, "drivers": drivers},
                code="if (cb_obj.indices.length) select.value = select.options[drivers[cb_obj.indices[0]]]",
            ),
        )

    def connect(self) -> None:
        """Connect everything, once all panels are there."""
        self.select.js_on_change(
            "value",
            CustomJS(
                args={"select": self.select, "series": self._series, "points": self._points},
                code="""
                const k = select.options.indexOf(select.value)
                for (const one of series) {
                    const data = {}
                    for (const name of one.names) data[name] = one.all.data[name].slice(k * one.n, (k + 1) * one.n)
                    one.shown.data = data
                }
                for (const {source, drivers} of points)
                    source.selected.indices = drivers.includes(k) ? [drivers.indexOf(k)] : []
                """,
            ),
        )
