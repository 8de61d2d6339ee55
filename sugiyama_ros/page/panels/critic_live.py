"""Panel of the critic on the live page: the gain of each of its models over time, and what it says in words."""

from collections.abc import Callable
from html import escape

import numpy as np
from bokeh.models import ColumnDataSource, DataRange1d, Div

from sugiyama_ros.arrays import Array
from sugiyama_ros.page.critic import WHY, may_be_chance
from sugiyama_ros.page.feed import KEPT, Feed, Log
from sugiyama_ros.page.panels.base import COLOURS, panel

# Models that are drawn.
_MODELS = 5


class CriticPanel:
    """The picture ``plot``, which appears once the critic has spoken, and the words ``text``.

    feed: what the page shows; new: log -> its columns (columns, rows) that the page has not shown yet.
    """

    def __init__(self, feed: Feed, new: Callable[[Log], Array]) -> None:
        self._feed, self._new = feed, new
        self._sources: dict[str, ColumnDataSource] = {}
        self.text = Div(text="")
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
                self._sources[name] = source = ColumnDataSource({"time": [], "gain": []})
                self.plot.line("time", "gain", source=source, color=self._colour(name), line_width=2, name=name)
            if len(new := self._new(log)):
                self._sources[name].stream(dict(zip(("time", "gain"), new, strict=True)), KEPT)
        order = sorted(feed.gains, key=lambda name: -feed.gains[name])
        for line in self.plot.renderers:
            line.visible = line.name in (*order[:_MODELS], "base")
        settled = "settled among the models that this critic knows" if feed.is_settled else "not settled yet"
        names = ", ".join(
            f'<b style="color:{self._colour(name)}">{escape(title(feed, name))}</b> {feed.gains[name]:+.0f}'
            for name in order[:_MODELS]
        )
        # the critic's own words: which model is best, and whether that has settled, is in its message
        best, lead = escape(title(feed, feed.best)), feed.gains.get(feed.best, 0.0)
        only = f" by {lead:.0f} nats only, which may be chance" if may_be_chance(feed.best, lead) else ""
        gains = f"Gains over the base model: {names} nats."
        self.text.text = f"The critic is {settled}: {best} leads{only}. {gains}{self._not_known()}"

    def _colour(self, name: str) -> str:
        """Colour of a model of the critic: the first one, grey, is that of the base model alone."""
        others = [one for one in self._sources if one != "base"]
        return COLOURS[0] if name == "base" else COLOURS[1 + others.index(name) % (len(COLOURS) - 1)]

    def _not_known(self) -> str:
        """Say why a diagnosis may find something else, and which effects the critic does not follow."""
        known = {*self._feed.gains, *self._feed.added}
        missing = [title(self._feed, name) for name in self._feed.effects if name not in known]
        names = f" It does not know {', '.join(missing)}." if missing else ""
        return f"<br>This is no verdict: {WHY} (<code>sugiyama diagnose</code>).{escape(names)}"


def title(feed: Feed, name: str) -> str:
    """Name for people of an effect, or of a model of the critic, as in the report."""
    return "the base model" if name == "base" else feed.titles.get(name, name.replace("_", " "))
