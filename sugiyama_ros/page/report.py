"""The report as one file that needs no network: what was measured, the verdict, and what it rests on, top down."""

from collections.abc import Mapping, Sequence
from html import escape
from typing import Any, NamedTuple

import numpy as np
from bokeh.embed import components
from bokeh.models import UIElement
from bokeh.resources import Resources

from sugiyama_ros.outputs import Target, writing
from sugiyama_ros.page import html
from sugiyama_ros.page.card import card, name_of
from sugiyama_ros.page.critic import beside_the_verdict, preferred
from sugiyama_ros.page.panels import drivers, measured, missing, space_time, truth, worth
from sugiyama_ros.page.panels.bias import bias_maps
from sugiyama_ros.page.panels.chosen import Chosen
from sugiyama_ros.page.recording import Recording
from sugiyama_ros.page.style import REPAINT, STYLE
from sugiyama_ros.page.truth import SHOWN, AgainstTruth

_ORANGE = "<p>Orange: added (▸), and what cannot be told apart from it in these data.</p>"
_FLOOR = (
    '<p class="note">Floor: the errors of the final model on a few recordings that it simulates itself, which are noise'
    " alone. The checks say whether errors on the data are as large as this noise makes; smaller ones mean that the"
    " model's noise is larger than the drivers'. In the pictures, the floor is dashed.</p>"
)


class Section(NamedTuple):
    """A section of the page.

    Panels stand in ``columns``, a class of the style sheet; ``text`` stands above them, ``beside`` is one more cell.
    """

    name: str
    title: str
    text: str
    panels: Sequence[UIElement]
    columns: str = ""
    beside: str = ""


def write_report(
    recording: Recording, diagnosis: Mapping[str, Any] | None, output: Target, against: AgainstTruth | None = None
) -> None:
    """Write the page of a recorded run. Raises OutputError."""
    page = report(recording, diagnosis, against)
    with writing(output) as stream:
        stream.write(page.encode())


def report(r: Recording, diagnosis: Mapping[str, Any] | None, against: AgainstTruth | None = None) -> str:
    """The page as HTML, with all scripts in it."""
    # the first driver of whom something was learnt: the first car of a platoon follows nobody
    chosen = Chosen(r.trajectories.vehicle, int(np.argmax(r.followers)))
    sections = _measured(r, diagnosis, chosen)
    if diagnosis is not None:
        sections += _diagnosed(r, diagnosis, chosen)
    if r.has_estimates:
        sections.append(_drivers(r, diagnosis, chosen))
    if against is not None:
        told = "".join(f"<li>{escape(line)}</li>" for line in against.lines())
        estimates = [truth.estimates(against, name) for name in SHOWN]
        sections.append(Section("truth", "Against the truth", f"<ul>{told}</ul>", estimates))
    sections.append(Section("how", "How it was done", html.how(r, diagnosis), (), ""))
    chosen.connect()
    return _page(r, diagnosis, sections, chosen)


def _measured(r: Recording, d: Mapping[str, Any] | None, chosen: Chosen) -> list[Section]:
    first = space_time.measured(r, chosen)
    driven = space_time.simulated(r, d, first) if d is not None else []
    about = (
        "<p>Colours are speeds, the same in all pictures. The model starts anew from the measured state at each dotted"
        " line, and then drives all cars on its own; it was fitted without the block that it drives. These pictures are"
        " without noise. The errors of free runs in tables and tiles are those of the mean of eight runs, four"
        " pairs with opposite noise, so they are not the distance between the pictures.</p>"
    )
    columns = {3: "three", 2: ""}.get(1 + len(driven), "one")
    found = [Section("seen", "Measured and simulated" if driven else "What was measured",
                     about if driven else "", [first, *driven], columns)]  # fmt: skip
    more = [measured.speed_profile(r), measured.ring(r, chosen)]
    # a ring needs a square, a road that is straight on the whole width
    found.append(Section("road", "The road", "", more, "road" if r.trajectories.road.is_ring else "side"))
    return found


def _diagnosed(r: Recording, d: Mapping[str, Any], chosen: Chosen) -> list[Section]:
    vehicles = r.trajectories.vehicle.tolist()
    maps, drawn = bias_maps(d, r.trajectories.road.circumference_m)
    legend = (
        "<p>Mean one-step error in predicted standard deviations: violet where cars are behind the prediction, orange"
        " where they are ahead. Black outline: more than chance makes. Grey: too few samples."
        + (f" Dashed: {escape(', '.join(drawn))}." if drawn else "")
        + "</p>"
    )
    text = html.failing(d) + html.checks(d)
    runs = {
        "free_run": "Free runs of all cars together",
        "single_car": "Free runs of one car behind its measured leader",
    }
    worths = [worth.growth(d, run, title) for run, title in runs.items() if worth.is_known(d, run)]
    worths.append(worth.by_driver(d, chosen, vehicles))
    return [
        Section("fails", "Where it fails", (legend if maps else "") + text, maps, "four" if len(maps) == 4 else ""),
        Section(
            "missing", "What is missing",
            html.additions(d) + (_ORANGE if d["verdict"]["effects"] else ""),
            [missing.candidates(d)], "side", html.detectable(d),
        ),
        Section("worth", "What it is worth", "", worths, "side", html.errors(d) + _FLOOR),
    ]  # fmt: skip


def _drivers(r: Recording, d: Mapping[str, Any] | None, chosen: Chosen) -> Section:
    panels = [
        drivers.against_each_other(r, d, chosen),
        drivers.over_time(r, "v_star", chosen),
        drivers.over_time(r, "kappa_v", chosen),
        *drivers.in_detail(r, chosen),
    ]
    text = "<p>The estimators learn these while they listen; click a driver in any picture, or choose one above.</p>"
    if r.truth:
        text += "<p>The drivers are simulated: the truth is drawn in green.</p>"
    if r.types:
        rows = [[str(v), *(f"{p:.2f}" for p in of)] for v, of in r.types.items()]
        classes = len(next(iter(r.types.values())))
        text += html.table(["vehicle", *(f"probability of class {k}" for k in range(classes))], rows)
    if r.changes:
        text += f"<p>Changes of style that were noticed (triangles): {len(r.changes)}.</p>"
    if r.weights:
        panels += [drivers.error_over_time(r), drivers.weights(r, d or {})]
        best, lead = preferred(r.weights)
        text += f"<p>{escape(beside_the_verdict(d, best, r.added, lead))}</p>"
    else:
        panels.append(drivers.error_over_time(r))
    return Section("drivers", "The drivers", text, panels, "side four" if len(panels) % 4 == 0 else "side")


def _page(r: Recording, d: Mapping[str, Any] | None, sections: Sequence[Section], chosen: Chosen) -> str:
    models: dict[str, UIElement] = {f"{one.name}-{k}": panel for one in sections for k, panel in enumerate(one.panels)}
    script, divs = components({"choose": chosen.select, **models})
    body = "".join(_section(one, divs) for one in sections)
    links = "".join(f'<a href="#{one.name}">{escape(one.title)}</a>' for one in sections)
    scripts = Resources(mode="inline", components=["bokeh", "bokeh-widgets"]).render()
    title = escape(name_of(r))
    return (
        '<!doctype html><html lang="en"><head><meta charset="utf-8">'
        '<meta name="viewport" content="width=device-width, initial-scale=1">'
        f"<title>{title}</title><link rel=icon href='data:,'><style>{STYLE}</style></head><body>"
        f'{card(r, d)}<nav>{links}<div class="choose">driver {divs["choose"]}</div></nav>{body}{scripts}{script}'
        f"<script>{REPAINT}</script></body></html>"
    )


def _section(one: Section, divs: Mapping[str, str]) -> str:
    inside = "".join(f'<div class="panel">{divs[f"{one.name}-{k}"]}</div>' for k in range(len(one.panels)))
    if one.beside:
        inside += f'<div class="text">{one.beside}</div>'
    grid = f'<div class="panels {one.columns}">{inside}</div>' if inside else ""
    return f'<section id="{one.name}"><h2>{escape(one.title)}</h2>{one.text}{grid}</section>'
