"""The live page: it shows the topics as they arrive."""

from collections import deque
from collections.abc import Callable, Mapping, Sequence
from html import escape
from itertools import islice
from typing import Any, Protocol

import numpy as np
from bokeh.document import Document
from bokeh.layouts import column, row
from bokeh.models import (
    BasicTicker,
    Button,
    ColorBar,
    ColumnDataSource,
    Div,
    FactorRange,
    LinearColorMapper,
    Select,
    Toggle,
)
from bokeh.palettes import Cividis256

from sugiyama_ros.arrays import Array
from sugiyama_ros.page.panels.base import BLUE, GREY, MOVING_S, ORANGE, VERMILION, from_above, panel
from sugiyama_ros.road import Road

#: Time [s] between two updates of the road, and between two updates of the curves; samples kept of each vehicle.
UPDATE_S, TELL_S, KEPT = 0.1, 0.5, 750
_FASTEST = 12.0


class Log:
    """The latest rows of numbers, for many readers. Each reader remembers how many rows it has seen."""

    def __init__(self, kept: int) -> None:
        self._rows: deque[tuple[float, ...]] = deque(maxlen=kept)
        self.heard = 0

    def add(self, *row: float) -> None:
        """Keep a row, and forget the oldest one if there are too many."""
        self._rows.append(row)
        self.heard += 1

    def since(self, seen: int) -> Array:
        """Rows after the first ``seen`` rows, as far as they are kept; array of shape (rows, columns)."""
        new = min(self.heard - seen, len(self._rows))
        return np.array(list(islice(self._rows, len(self._rows) - new, None)))


class Feed(Protocol):
    """What the page shows, and what its buttons do.

    Attributes
    ----------
    road : Road
        The road.
    rate : float
        Rate of the replay, in times real time.
    vehicles : sequence of int
        Numbers of the vehicles; empty before the first sample.
    weights : mapping
        Posterior probability of each model, by name; empty without a critic.
    now : mapping
        Position [m] and speed [m/s] of each vehicle.
    effects, added : sequence of str
        Effects that can be added, and effects that were added.
    said : str
        Last answer of a node.
    space : Log
        Time [s], position [m] and speed [m/s] of every vehicle at every sample.
    error : Log
        Time [s] and one-step error [m] of all drivers over the last ``MOVING_S`` seconds.
    driver : mapping
        For each vehicle a Log of time [s], speed and its std [m/s], innovation and its std [m].
    """

    road: Road
    rate: float
    vehicles: Sequence[int]
    weights: Mapping[str, float]
    now: Mapping[int, tuple[float, float]]
    effects: Sequence[str]
    added: Sequence[str]
    said: str
    space: Log
    error: Log
    driver: Mapping[int, Log]

    def pause(self, paused: bool) -> None:
        """Pause the replay, or resume it."""

    def set_rate(self, rate: float) -> None:
        """Set the rate of the replay, in times real time."""

    def add(self, effect: str) -> None:
        """Add an effect to all estimators."""

    def remove(self, effect: str) -> None:
        """Remove an effect from all estimators."""


def page(feed: Feed) -> Callable[[Document], None]:
    """Function that fills a new document of Bokeh's server."""
    return lambda document: _Page(feed).fill(document)


class _Page:
    def __init__(self, feed: Feed) -> None:
        self._feed = feed
        self._watched = -1
        self._seen: dict[Log, int] = {}
        self._space = ColumnDataSource({"time": [], "place": [], "speed": []})
        self._error = ColumnDataSource({"time": [], "error": []})
        self._road = ColumnDataSource({"x": [], "y": [], "speed": []})
        names = ("time", "speed", "low", "high", "innovation", "below", "above")
        self._driver = ColumnDataSource({name: [] for name in names})
        self._weights = ColumnDataSource({"name": [], "weight": []})
        self._select = Select(title="driver", options=[], width=160)
        self._effect = Select(title="effect", options=list(feed.effects), value=feed.effects[0], width=220)
        self._said = Div(text="waiting for the road")

    def fill(self, document: Document) -> None:
        document.title = "sugiyama live"
        document.add_root(self._layout())
        document.add_periodic_callback(self._update, round(1000 * UPDATE_S))
        document.add_periodic_callback(self._tell, round(1000 * TELL_S))

    def _layout(self) -> Any:
        colours = LinearColorMapper(Cividis256, low=0.0, high=_FASTEST, nan_color=GREY)
        colour = {"field": "speed", "transform": colours}
        space = panel("Where everybody is, and how fast", "time [s]", "position [m]")
        space.scatter("time", "place", source=self._space, size=2, color=colour)
        space.add_layout(ColorBar(color_mapper=colours, ticker=BasicTicker(), title="speed [m/s]"), "right")
        ring = panel("The road from above", "x [m]", "y [m]", match_aspect=True)
        ring.scatter("x", "y", source=self._road, size=12, line_color="black", color=colour)
        error = panel(f"One-step error of all drivers, over {MOVING_S:g} s", "time [s]", "error [m]")
        error.line("time", "error", source=self._error, color=VERMILION, line_width=2)
        speed = panel("The driver: speed, with one sigma", "time [s]", "speed [m/s]")
        speed.varea("time", "low", "high", source=self._driver, color=BLUE, alpha=0.3)
        speed.line("time", "speed", source=self._driver, color=BLUE, line_width=2)
        innovation = panel("Error of the next position, with two sigma", "time [s]", "innovation [m]")
        innovation.varea("time", "below", "above", source=self._driver, color=ORANGE, alpha=0.3)
        innovation.line("time", "innovation", source=self._driver, color=VERMILION)
        self._models = FactorRange(factors=[])
        critic = panel(
            "Probability of each model of the critic", "probability", "model", y_range=self._models, x_range=(0.0, 1.0)
        )
        critic.hbar("name", right="weight", source=self._weights, height=0.7, color=BLUE)
        rates = sorted({1.0, 2.0, 4.0, 8.0, self._feed.rate})
        pause = Toggle(label="pause", width=90)
        rate = Select(title="rate", value=f"{self._feed.rate:g}", options=[f"{r:g}" for r in rates], width=80)
        add, remove = Button(label="add", width=70), Button(label="remove", width=70)
        pause.on_change("active", lambda _, __, new: self._feed.pause(bool(new)))
        rate.on_change("value", lambda _, __, new: self._feed.set_rate(float(new)))
        self._select.on_change("value", lambda _, __, new: self._watch(int(new.split()[-1])))
        add.on_click(lambda: self._feed.add(self._effect.value))
        remove.on_click(lambda: self._feed.remove(self._effect.value))
        wide = {"sizing_mode": "stretch_width"}
        return column(
            row(pause, rate, self._select, self._effect, add, remove),
            self._said,
            row(space, error, **wide),
            row(ring, critic, **wide),
            row(speed, innovation, **wide),
            **wide,
        )

    def _watch(self, vehicle: int) -> None:
        self._watched = vehicle
        self._seen.pop(self._feed.driver[vehicle], None)
        self._driver.data = {name: [] for name in self._driver.data}

    def _new(self, log: Log) -> Array:
        """Columns (columns, rows) that the page has not shown yet; empty if there are none."""
        rows = log.since(self._seen.get(log, 0))
        self._seen[log] = log.heard
        return rows.T

    def _update(self) -> None:
        feed = self._feed
        if not feed.vehicles:
            return
        if not self._select.options:
            self._select.options = [f"vehicle {v}" for v in feed.vehicles]
            self._select.value = self._select.options[0]
        if feed.now:
            place, speed = np.array(list(feed.now.values())).T
            x, y = from_above(feed.road, place)
            self._road.data = {"x": x, "y": y, "speed": speed}

    def _tell(self) -> None:
        feed = self._feed
        if self._watched in feed.driver and len(new := self._new(feed.driver[self._watched])):
            time, speed, std, innovation, spread = new
            self._driver.stream(
                {
                    "time": time,
                    "speed": speed,
                    "low": speed - std,
                    "high": speed + std,
                    "innovation": innovation,
                    "below": -2.0 * spread,
                    "above": 2.0 * spread,
                },
                KEPT,
            )
        if len(new := self._new(feed.space)):
            self._space.stream(dict(zip(("time", "place", "speed"), new, strict=True)), KEPT * len(feed.vehicles))
        if len(new := self._new(feed.error)):
            self._error.stream(dict(zip(("time", "error"), new, strict=True)), KEPT)
        if feed.weights:
            best = sorted(feed.weights, key=lambda name: feed.weights[name])[-6:]
            self._models.factors = best
            self._weights.data = {"name": best, "weight": [feed.weights[name] for name in best]}
        added = ", ".join(feed.added) or "none"
        time, error = (self._error.data[name] for name in ("time", "error"))
        shown = f"{time[-1]:.0f} s: one-step error over {MOVING_S:g} s {error[-1]:.3f} m; " if len(error) else ""
        if feed.vehicles:
            silent = "" if feed.weights else "No critic has spoken yet (sugiyama run --critic). "
            self._said.text = f"{shown}effects added: {added}. {silent}{escape(feed.said)}"
