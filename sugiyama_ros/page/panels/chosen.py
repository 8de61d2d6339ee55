"""The driver who is chosen: one selection that all panels of the report follow."""

from typing import Any

from bokeh.models import ColumnDataSource, CustomJS, Select, TapTool

from sugiyama_ros.arrays import Array, Ints
from sugiyama_ros.page.panels.base import SINGLE

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
