"""The live page: it shows the topics as they arrive."""

import math
from collections.abc import Callable
from html import escape
from typing import Any

import numpy as np
from bokeh.document import Document
from bokeh.layouts import column, row
from bokeh.models import (
    Button,
    ColumnDataSource,
    CustomJS,
    DataRange1d,
    Div,
    GlobalInlineStyleSheet,
    Select,
    Span,
    TapTool,
    TextInput,
    Toggle,
)

from sugiyama_ros.arrays import Array
from sugiyama_ros.page.feed import KEPT, Feed, Log, Status
from sugiyama_ros.page.names import distances, parameter_title, spaced
from sugiyama_ros.page.panels import drivers
from sugiyama_ros.page.panels.base import (
    COLOURS,
    GREY,
    INPUT,
    MOVING_S,
    VERMILION,
    cars,
    colour_bar,
    from_above,
    legend_above,
    panel,
    speed_colours,
)
from sugiyama_ros.page.recording import name_of
from sugiyama_ros.page.style import CARD, LIVE, REPAINT
from sugiyama_ros.page.words import WHY, may_be_chance
from sugiyama_ros.trajectories.desired_speed import known_only

# Time [s] between two updates of the road, and between two updates of the curves.
_UPDATE_S, _TELL_S = 0.1, 0.5
_PARAMETERS = ("v_star", "kappa_v")
_NOT_KNOWN = "v* is not known from these data"
# Where the cars' numbers stand: radius over that of the ring, or offset [px] from a straight road.
_OUTSIDE, _ABOVE_PX = 1.14, -14
# Columns of the logs of a driver.
_COLUMNS = ("time", "speed", "std", "innovation", "spread", "place")
_LEARNT = ("time", "v_star", "v_star_std", "kappa_v", "kappa_v_std")
_ROAD = "The road from above: click a car"
# What the list of rates calls the fastest rate, which is 0.
_FASTEST = "max"
_WIDE = {"sizing_mode": "stretch_width"}
# Models of the critic that are drawn.
_MODELS = 5
# Time [s] without a sample after which the source counts as silent.
_SILENT_S = 3.0


def page(feed: Feed) -> Callable[[Document], None]:
    """Function that fills a new document of Bokeh's server."""
    return lambda document: _Page(feed).fill(document)


class _Page:
    def __init__(self, feed: Feed) -> None:
        self._feed = feed
        self._watched = -1
        self._own_choice: int | None = None  # the page's, until the reader chooses
        self._seen: dict[Log, int] = {}
        self._space, self._error = _source("time", "place", "speed"), _source("time", "error", "base")
        self._road = _source("x", "y", "speed", "vehicle", "number_x", "number_y", "above")
        self._yielding = _source("x", "y")
        self._lines, self._lines_drawn = _source("xs", "ys"), (math.nan,)
        self._adapted = _source("vehicle", *_PARAMETERS)
        self._driver = _source(*_COLUMNS, "low", "high", "below", "above", "measured")
        self._learnt = _source(*_LEARNT, *(f"{name}_{end}" for name in _PARAMETERS for end in ("low", "high")))
        self._last = (math.nan, math.nan)
        self._critic = _Critic(feed, self._new)
        self._colours = speed_colours(1.0)
        self._select = Select(title="driver", options=[], width=110, stylesheets=[INPUT])
        self._effect = Select(
            title="effect", options=[(name, _title(feed, name)) for name in feed.effects],
            value=next(iter(feed.effects)), width=200, stylesheets=[INPUT],
        )  # fmt: skip
        self._values = TextInput(title="strength", width=140, stylesheets=[INPUT])
        self._empty: dict[str, Any] = {}  # pictures that are not shown, because there is nothing to draw yet
        self._status = Div(text="", stylesheets=[GlobalInlineStyleSheet(css=LIVE), CARD])
        self._said, self._about = Div(text="", stylesheets=[CARD]), Div(text="")
        self._events = Div(text="", stylesheets=[CARD])
        self._plots: dict[str, Any] = {}
        self._drawn = 0

    def fill(self, document: Document) -> None:
        document.title = "sugiyama live"
        document.add_root(self._layout())
        for plot in self._empty.values():
            plot.visible = False
        document.js_on_event("document_ready", CustomJS(code=REPAINT))
        self._choose_effect()
        self._tell()
        document.add_periodic_callback(self._update, round(1000 * _UPDATE_S))
        document.add_periodic_callback(self._tell, round(1000 * _TELL_S))

    def _layout(self) -> Any:
        self._controls = self._buttons()
        space, road = self._everybody()
        self._plots["error"] = error = panel(
            f"One-step error of all drivers, over {MOVING_S:g} s",
            "time [s]",
            "error [m]",
            y_range=DataRange1d(start=0.0),
        )
        self._empty["error"] = error
        # where both are equal, both are seen
        error.line("time", "base", source=self._error, color=GREY, line_width=6, line_alpha=0.5,
                   legend_label="base model")  # fmt: skip
        error.line("time", "error", source=self._error, color=VERMILION, line_width=2, legend_label="the estimators")
        legend_above(error)
        return column(
            self._status,
            self._controls,
            self._about,
            self._said,
            row(space, error, **_WIDE),
            row(road, self._critic.plot, **_WIDE),
            self._critic.text,
            row(*self._adaptation(), **_WIDE),
            row(*self._one_driver(), **_WIDE),
            self._events,
            **_WIDE,
        )

    def _everybody(self) -> tuple[Any, Any]:
        """All vehicles: over time and place, and on the road."""
        space = panel("Where everybody is, and how fast", "time [s]", "position [m]")
        space.scatter("time", "place", source=self._space, size=2,
                      color={"field": "speed", "transform": self._colours})  # fmt: skip
        colour_bar(space, self._colours, "speed [m/s]")
        road = panel(_ROAD, "x [m]", "y [m]", match_aspect=True,
                     x_range=DataRange1d(range_padding=0.2))  # fmt: skip
        self._plots["road"] = road
        self._empty |= {"space": space, "road": road}
        road.multi_line("xs", "ys", source=self._lines, color=GREY, line_alpha=0.5)
        cars(road, self._road, self._colours)
        road.scatter("x", "y", source=self._yielding, size=24, fill_color=None, line_color=VERMILION, line_width=2)
        road.text("number_x", "number_y", text="vehicle", source=self._road, text_font_size="10px", text_color=GREY,
                  text_align="center", text_baseline="middle", y_offset="above",
                  nonselection_text_alpha=1.0)  # fmt: skip
        road.add_tools(TapTool())
        self._road.selected.on_change("indices", lambda _, __, new: self._click(self._road, new))
        return space, road

    def _adaptation(self) -> list[Any]:
        """What the estimators have learnt: of the chosen driver over time, and of all drivers now."""
        found = {name: drivers.learnt(self._learnt, name) for name in _PARAMETERS}
        spans = {"x_range": DataRange1d(default_span=1.0), "y_range": DataRange1d(default_span=0.1)}
        strip = drivers.each(self._adapted, _PARAMETERS, "All drivers now: click one", **spans)
        strip.add_tools(TapTool())
        self._adapted.selected.on_change("indices", lambda _, __, new: self._click(self._adapted, new))
        self._plots |= found
        self._empty |= {**found, "strip": strip}
        return [*found.values(), strip]

    def _one_driver(self) -> list[Any]:
        found = {"speed": drivers.speed(self._driver), "innovation": drivers.error(self._driver)}
        self._empty |= found
        return list(found.values())

    def _buttons(self) -> Any:
        rates = [*sorted({1.0, 2.0, 4.0, 8.0, self._feed.rate} - {0.0}), 0.0]
        pause = Toggle(label="pause", width=70)
        rate = Select(
            title="rate", value=f"{self._feed.rate:g}", width=70, stylesheets=[INPUT],
            options=[(f"{r:g}", f"{r:g}" if r else _FASTEST) for r in rates],
        )  # fmt: skip
        add, remove = Button(label="add", width=60), Button(label="remove", width=75)
        pause.on_change("active", lambda _, __, new: self._feed.pause(bool(new)))
        rate.on_change("value", lambda _, __, new: self._feed.set_rate(float(new)))
        self._select.on_change("value", lambda _, __, new: self._watch(int(new.split()[-1])))
        self._effect.on_change("value", lambda _, __, new: self._choose_effect())
        add.on_click(
            lambda: self._feed.add(self._effect.value, self._values.value or self._feed.values(self._effect.value))
        )
        remove.on_click(lambda: self._feed.remove(self._effect.value))
        return row(pause, rate, self._select, self._effect, self._values, add, remove)

    def _choose_effect(self) -> None:
        name = self._effect.value
        self._values.value = self._feed.values(name)
        self._about.text = escape(self._feed.effects[name])

    def _click(self, source: ColumnDataSource, chosen: list[int]) -> None:
        if chosen and chosen[0] < len(source.data["vehicle"]):
            self._select.value = f"vehicle {source.data['vehicle'][chosen[0]]}"

    def _watch(self, vehicle: int) -> None:
        self._watched = vehicle
        for logs, source in ((self._feed.driver, self._driver), (self._feed.learnt, self._learnt)):
            self._seen.pop(logs[vehicle], None)
            source.data = {name: [] for name in source.data}
        self._last = (math.nan, math.nan)

    def _new(self, log: Log) -> Array:
        """Columns (columns, rows) that the page has not shown yet; empty if there are none."""
        rows = log.since(self._seen.get(log, 0))
        self._seen[log] = log.heard
        return rows.T

    def _update(self) -> None:
        feed = self._feed
        if len(self._select.options) != len(feed.vehicles):
            self._select.options = [f"vehicle {v}" for v in feed.vehicles]
        if len(self._effect.options) != len(feed.effects):  # at the first line, or the first curve
            self._effect.options = [(name, _title(feed, name)) for name in feed.effects]
        # the lowest number of those who have a leader: the first car of a platoon follows nobody. The order in which
        # topics arrive does not matter.
        here = set(feed.led or feed.followers) & set(feed.here)
        if here and self._own_choice in (None, self._watched) and self._watched not in feed.here:
            self._own_choice = min(here)
            self._select.value = f"vehicle {self._own_choice}"
        if feed.now:
            place, speed = np.array(list(feed.now.values())).T
            lane = np.array([feed.lanes.get(v, 0) for v in feed.now], dtype=np.float64)
            x, y = from_above(feed.road, place, lane)
            self._draw_road(np.unique(lane))
            # numbers stand outside a ring, and above a road that is straight on: no car hides another one's number
            away, above = (_OUTSIDE, 0) if feed.road.is_ring else (1.0, _ABOVE_PX)
            self._road.data = {
                "x": x, "y": y, "speed": speed, "vehicle": [str(v) for v in feed.now], "number_x": away * x,
                "number_y": away * y, "above": np.full(len(x), above),
            }  # fmt: skip
            yields = np.array([v in feed.yielding for v in feed.now])
            self._yielding.data = {"x": x[yields], "y": y[yields]}
            if feed.yielding:  # from the first of them on
                self._plots["road"].title.text = f"{_ROAD} (in a circle: lets others pass)"
            if (fastest := float(np.nan_to_num(speed).max())) > self._colours.high:  # NaN: not known yet
                self._colours.high = float(2.0 * math.ceil(fastest / 2.0))  # in steps, so that it rarely changes
            self._show("road")

    def _draw_road(self, lanes: Array) -> None:
        """Draw the middle of each lane; on an open road, from the first vehicle to the last one."""
        road, places = self._feed.road, [place for place, _ in self._feed.now.values()]
        known = [place for place in places if math.isfinite(place)] or [0.0]
        ends = (0.0, road.circumference_m) if road.is_ring else (min(known), max(known))
        if (drawn := (*ends, *lanes.tolist())) == self._lines_drawn:
            return
        self._lines_drawn = drawn
        self._plots["road"].yaxis.visible = road.is_ring  # aside, there are the lanes
        lines = [from_above(road, np.asarray(np.linspace(*ends, num=121)), lane) for lane in lanes.tolist()]
        self._lines.data = {"xs": [x for x, _ in lines], "ys": [y for _, y in lines]}

    def _tell(self) -> None:
        feed, status = self._feed, self._feed.status()
        self._status.text = status_line(status, feed)
        for part in (self._controls, self._about, self._said, self._critic.text, self._events):
            part.visible = bool(feed.vehicles)  # before, there is nothing to choose
        if self._watched in feed.driver and len(new := self._new(feed.driver[self._watched])):
            self._driver.stream(self._of_driver(new), KEPT)
            self._show("speed", "innovation")
        if self._watched in feed.learnt and len(new := self._new(feed.learnt[self._watched])):
            self._learnt.stream(self._learnt_of_driver(new), KEPT)
            self._show("v_star", "kappa_v")
        if len(new := self._new(feed.space)):
            self._space.stream(dict(zip(("time", "place", "speed"), new, strict=True)), KEPT * len(feed.vehicles))
            self._show("space")
        if len(new := self._new(feed.error)):
            self._error.stream(dict(zip(("time", "error", "base"), new, strict=True)), KEPT)
            self._show("error")
        if learnt := {v: found for v, found in feed.adapted.items() if v in feed.followers and v in feed.now}:
            values = np.array(list(learnt.values()))
            v_star, _ = known_only(values[:, 0], values[:, 1], self._colours.high)
            self._adapted.data = {
                "vehicle": [str(v) for v in learnt],
                "v_star": v_star,
                "kappa_v": values[:, 2],
            }
            self._show("strip")
        self._critic.update()
        for time_s in feed.changed_s[self._drawn :]:
            self._plots["error"].add_layout(
                Span(location=time_s, dimension="height", line_color=GREY, line_dash="dashed")
            )
        self._drawn = len(feed.changed_s)
        if feed.vehicles:
            time, error, base = (self._error.data[name] for name in ("time", "error", "base"))
            shown = ""
            if len(error):
                errors = distances(error[-1], base[-1])
                shown = f"{time[-1]:.0f} s: one-step error over {MOVING_S:g} s {errors[0]}"
                shown += f", base model {errors[1]}; " if math.isfinite(base[-1]) else "; "
            added = ", ".join(_title(feed, name) for name in feed.added) or "none"
            self._said.text = f"{shown}effects added: {added}. {escape(feed.said)}"
        self._events.text = "<b>Events</b><br>" + ("<br>".join(map(escape, feed.events)) or "none yet")

    def _show(self, *names: str) -> None:
        """Show pictures that have something to draw from now on."""
        for name in names:
            if (plot := self._empty.pop(name, None)) is not None:
                plot.visible = True

    def _learnt_of_driver(self, new: Array) -> dict[str, Array]:
        """Columns of what was learnt of the chosen driver, with the ends of the bands."""
        of = dict(zip(_LEARNT, new, strict=True))
        was_known = np.isfinite(of["v_star"][-1])
        of["v_star"], of["v_star_std"] = known_only(of["v_star"], of["v_star_std"], self._colours.high)
        is_beyond = was_known and np.isnan(of["v_star"][-1])
        self._plots["v_star"].title.text = _NOT_KNOWN if is_beyond else f"Learnt: {parameter_title('v_star')}"
        for name in _PARAMETERS:
            of[f"{name}_low"], of[f"{name}_high"] = of[name] - of[f"{name}_std"], of[name] + of[f"{name}_std"]
        return of

    def _of_driver(self, new: Array) -> dict[str, Array]:
        """Columns of the chosen driver with the ends of the bands, and speeds from two positions."""
        of = dict(zip(_COLUMNS, new, strict=True))
        time = np.concatenate([[self._last[0]], of["time"]])
        place = np.concatenate([[self._last[1]], of["place"]])
        self._last = float(time[-1]), float(place[-1])
        with np.errstate(invalid="ignore", divide="ignore"):
            measured = self._feed.road.difference(place[1:], place[:-1]) / np.diff(time)
        return {
            **of,
            "low": of["speed"] - of["std"],
            "high": of["speed"] + of["std"],
            "below": -2.0 * of["spread"],
            "above": 2.0 * of["spread"],
            "measured": measured,
        }


def _source(*names: str) -> ColumnDataSource:
    """A source without rows."""
    return ColumnDataSource({name: [] for name in names})


class _Critic:
    """The picture ``plot``, which appears once the critic has spoken, and the words ``text``.

    feed: what the page shows; new: log -> its columns (columns, rows) that the page has not shown yet.
    """

    def __init__(self, feed: Feed, new: Callable[[Log], Array]) -> None:
        self._feed, self._new = feed, new
        self._sources: dict[str, ColumnDataSource] = {}
        self.text = Div(text="", stylesheets=[CARD])
        self.plot = panel(
            "The critic: gain over the base model", "time [s]", "gain [nats]",
            y_range=DataRange1d(only_visible=True), visible=False,
        )  # fmt: skip
        self.plot.line([0.0], [np.nan])  # Bokeh warns of a plot that has nothing to draw

    def update(self) -> None:
        """Show what the critic has said since the last time."""
        feed = self._feed
        if not feed.gains:
            self.text.text = "No critic has spoken yet. There is none where too many vehicles are in view."
            return
        self.plot.visible = True
        # what is added to the estimators is a model of the critic no longer
        for name, log in feed.critic.items():
            if name not in self._sources:
                self._sources[name] = source = _source("time", "gain")
                self.plot.line("time", "gain", source=source, color=self._colour(name), line_width=2, name=name)
            if len(new := self._new(log)):
                self._sources[name].stream(dict(zip(("time", "gain"), new, strict=True)), KEPT)
        order = sorted(feed.gains, key=lambda name: -feed.gains[name])
        for line in self.plot.renderers:
            line.visible = line.name in (*order[:_MODELS], "base")
        settled = "settled among the models that this critic knows" if feed.is_settled else "not settled yet"
        names = ", ".join(
            f'<b style="color:{self._colour(name)}">{escape(_title(feed, name))}</b> {feed.gains[name]:+.0f}'
            for name in order[:_MODELS]
        )
        # the critic's own words: which model is best, and whether that has settled, is in its message
        best, lead = escape(_title(feed, feed.best)), feed.gains.get(feed.best, 0.0)
        only = f" by {lead:.0f} nats only, which may be chance" if may_be_chance(feed.best, lead) else ""
        gains = f"Gains over the base model: {names} nats."
        self.text.text = f"The critic is {settled}: {best} leads{only}. {gains}{self._not_known()}"

    def _colour(self, name: str) -> str:
        """Colour of a model of the critic: the first one, grey, is that of the base model alone."""
        others = [one for one in self._sources if one != "base"]
        return COLOURS[0] if name == "base" else COLOURS[1 + others.index(name) % (len(COLOURS) - 1)]

    def _not_known(self) -> str:
        """Say why a diagnosis may find something else, and how many effects the critic does not follow."""
        missing = set(self._feed.effects) - {*self._feed.gains, *self._feed.added}
        number = f" It does not follow {len(missing)} of the {len(self._feed.effects)} effects." if missing else ""
        return f"<br>This is no verdict: {WHY} (<code>sugiyama diagnose</code>).{number}"


def _title(feed: Feed, name: str) -> str:
    """Name for people of an effect, or of a model of the critic, as in the report."""
    return "the base model" if name == "base" else feed.titles.get(name, spaced(name))


def status_line(status: Status, feed: Feed) -> str:
    """The status line as HTML."""
    if not feed.vehicles:
        waiting = "the first positions on /measured" if status.source else "a road on /road and positions on /measured"
        return (
            f"Waiting for {waiting}, in ROS domain {escape(status.domain)}. To feed this page, replay a file with"
            " <code>sugiyama live FILE</code>, or start <code>sugiyama run FILE -o run.mcap --rate 1</code> or nodes"
            f" with <code>ROS_DOMAIN_ID={escape(status.domain)}</code>."
        )
    total = f" of {status.total_s:.0f}" if status.total_s > 0.0 else ""
    if status.ended:
        state = "ended"
    elif status.silent_s > _SILENT_S:
        state = f"silent for {status.silent_s:.0f} s"
    else:
        state = "running"
    rate = "" if math.isnan(status.real_rate) or state != "running" else f", {status.real_rate:.1f} times real time"
    end = ""
    if status.ended:
        end = " Ctrl-C in the terminal ends the page."
        if status.recording:
            command = f"sugiyama report {status.recording} --open"
            end = f" Ctrl-C in the terminal closes the recording; <code>{escape(command)}</code> makes a report of it."
    return (
        f"<b>{escape(name_of(status.source) or 'live source')}</b>: {status.time_s:.0f}{total} s, {state}{rate};"
        f" {len(feed.now)} vehicles on the road; ROS domain {escape(status.domain)}.{end}"
    )
