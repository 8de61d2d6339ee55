"""The report as one file that needs no network: what was measured, the verdict, and what it rests on, top down."""

import platform
import re
import shlex
from collections.abc import Iterable, Mapping, Sequence
from html import escape
from importlib import metadata
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from bokeh.embed import components
from bokeh.models import UIElement
from bokeh.resources import Resources

from sugiyama_ros.files import Target, writing
from sugiyama_ros.page.checks import check_title, check_values, checks_hold, failed, reasons
from sugiyama_ros.page.diagnosis import file_of, run_command
from sugiyama_ros.page.names import (
    MODELS,
    SMALL_M,
    Document,
    addition,
    chance,
    form_of,
    length,
    model_name,
    models,
    summary_of,
    title_of,
)
from sugiyama_ros.page.panels import drivers, measured
from sugiyama_ros.page.panels.base import Chosen, colour_of
from sugiyama_ros.page.panels.diagnosed import bias_maps, by_driver, candidates, growth, is_known
from sugiyama_ros.page.panels.measured import frame_mps, thumbnail
from sugiyama_ros.page.recording import Recording, preferred
from sugiyama_ros.page.style import REPAINT, STYLE
from sugiyama_ros.page.tables import steps
from sugiyama_ros.page.truth import AgainstTruth
from sugiyama_ros.page.words import (
    badge,
    beside_the_verdict,
    biased,
    capital,
    equation,
    gain_in_words,
    headline,
    how_sure,
    not_told_apart,
    on_unseen,
    sentences,
    size_of,
    what_to_do,
    worse,
    worse_in_words,
    would_have_shown,
)
from sugiyama_ros.trajectories.about import SIMULATED

_FREE_RUNS = (
    "Colours are speeds, the same in all pictures. The model starts anew from the measured state at each dotted line,"
    " and then drives all cars on its own, without noise; it was fitted without the block that it drives. The errors of"
    " free runs in tables and tiles are those of the mean of eight runs with noise, not the distance between the"
    " pictures."
)
_BIAS = (
    "Mean one-step error in predicted standard deviations: violet where cars are behind the prediction, orange where"
    " they are ahead. Black outline: more than chance makes. Grey: too few samples."
)
_CHECKS = (
    "Bias: root mean square over the bins, in predicted standard deviations. Spread: root mean square of the errors"
    " over what the model predicts. Model: what its own simulations give. A check fails if the difference is larger"
    " than its margin, and more than chance: all checks are judged together, at a false-discovery rate of 5 %."
)
_NATS = (
    "Nats: logarithm of how much more probable the model makes the data; one nat is a factor of 2.7. p: probability"
    " that chance gains as much in any candidate."
)
_GAINS = (
    "Gains are differences of log scores on unseen data, in nats, with standard errors over blocks of time and drivers;"
    " those of one car at 2, 5 and 10 s, and all of them together. CRPS: mean distance between what was forecast, with"
    " its uncertainty, and what came. Floor (dashed): the errors of the final model on a few recordings that it"
    " simulates itself, which are noise alone; smaller errors on the data mean that the model's noise is too large."
)
_RUNS = {
    "free_run": "Free runs of all cars together",
    "single_car": "Free runs of one car behind its measured leader",
}


class _Section(NamedTuple):
    """A section of the page: a text, rows of panels, a text below them, and panels that are folded."""

    name: str
    title: str
    text: str
    rows: Sequence[Sequence[UIElement]] = ()
    below: str = ""
    about_folded: str = ""
    folded: Sequence[UIElement] = ()


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
        estimates = [drivers.against_truth(against, name) for name in against.names]
        sections.append(_Section("truth", "Against the truth", _list(against.lines()), _threes(estimates)))
    sections.append(_Section("how", "How it was done", _how(r, diagnosis)))
    chosen.connect()
    panels = [panel for one in sections for row in (*one.rows, one.folded) for panel in row]
    script, divs = components([chosen.select, *panels])
    choose, shown = divs[0], iter(divs[1:])
    body = "".join(_html(one, shown) for one in sections)
    links = "".join(f'<a href="#{one.name}">{escape(one.title)}</a>' for one in sections)
    scripts = Resources(mode="inline", components=["bokeh", "bokeh-widgets"]).render()
    return (
        '<!doctype html><html lang="en"><head><meta charset="utf-8">'
        '<meta name="viewport" content="width=device-width, initial-scale=1">'
        f"<title>{escape(r.name)}</title><link rel=icon href='data:,'><style>{STYLE}</style></head><body>"
        f'{_card(r, diagnosis)}<nav>{links}<div class="choose">driver {choose}</div></nav>{body}{scripts}{script}'
        f"<script>{REPAINT}</script></body></html>"
    )


def _html(one: _Section, shown: Iterable[str]) -> str:
    """A section as HTML; ``shown`` gives the elements of its panels, one after another."""
    of, rows = iter(shown), ""
    for row in one.rows:
        cells = "".join(f'<div class="panel">{next(of)}</div>' for _ in row)
        rows += f'<div class="row {one.name}">{cells}</div>'
    folded = "".join(f'<div class="panel">{next(of)}</div>' for _ in one.folded)
    more = _folded(one.about_folded, f'<div class="row">{folded}</div>') if folded else ""
    return f'<section id="{one.name}"><h2>{escape(one.title)}</h2>{one.text}{rows}{one.below}{more}</section>'


# Sections


def _measured(r: Recording, d: Mapping[str, Any] | None, chosen: Chosen) -> list[_Section]:
    first = measured.space_time(r, chosen)
    driven = measured.simulated(r, d, first) if d is not None else []
    title = f"What was {'simulated' if r.is_simulated else 'measured'}"
    road = [measured.speed_profile(r), measured.ring(r, chosen)]
    # a ring and a network need a square, a road that is straight on the whole width
    name = "ring" if r.trajectories.road.is_ring or r.above is not None else "road"
    return [
        _Section("seen", title, _text(_FREE_RUNS) if driven else "", [[first, *driven]]),
        _Section(name, "The road", "", [road]),
    ]


def _diagnosed(r: Recording, d: Mapping[str, Any], chosen: Chosen) -> list[_Section]:
    maps, drawn = bias_maps(d, r.trajectories.road.circumference_m)
    legend = _BIAS + (f" Dashed: {', '.join(drawn)}." if drawn else "")
    added = bool(d["verdict"]["effects"])
    pairs = [maps[k : k + 2] for k in range(0, len(maps), 2)] if added else [maps] if maps else []
    worths = [growth(d, run, title) for run, title in _RUNS.items() if is_known(d, run)]
    worths.append(by_driver(d, chosen, r.trajectories.vehicle.tolist()))
    orange = _text("Orange: added (▸), and what cannot be told apart from it in these data.") if added else ""
    return [
        _Section("fails", "Where it fails", _text(legend) if maps else "", pairs, _failing(d) + _checks(d)),
        _Section("missing", "What is missing", _additions(d) + orange, [[candidates(d)]], _told(d) + detectable(d)),
        _Section("worth", "What it is worth", _errors(d), [worths], _text(_GAINS, "note")),
    ]


def _drivers(r: Recording, d: Mapping[str, Any] | None, chosen: Chosen) -> _Section:
    speed, error, meant = drivers.in_detail(r, chosen)
    parameters = [drivers.over_time(r, name, chosen) for name in r.learnt]
    rows = [*_threes([*drivers.against_each_other(r, d, chosen), *parameters]), [speed, error]]
    text = _text("The estimators learn these while they listen; click a driver in any picture, or choose one above.")
    if r.types:
        classes = len(next(iter(r.types.values())))
        cells = [[str(v), *(f"{p:.2f}" for p in of)] for v, of in r.types.items()]
        text += _table(["vehicle", *(f"probability of class {k}" for k in range(classes))], cells)
    if r.changes:
        text += _text(f"Changes of style that were noticed (triangles): {len(r.changes)}.")
    if r.weights:
        rows.append([drivers.weights(r, d or {})])
        best, lead = preferred(r.weights)
        text += _text(beside_the_verdict(d, best, r.added, lead))
    about = "What the driver means to do, and the error of this run over time"
    return _Section("drivers", "The drivers", text, rows, "", about, [meant, drivers.error_over_time(r)])


def _threes(panels: list[UIElement]) -> list[list[UIElement]]:
    """Panels in rows of three."""
    return [panels[k : k + 3] for k in range(0, len(panels), 3)]


# Texts and tables


def _unbroken(text: str) -> str:
    """A text as HTML in which no line ends between a number and its unit, or within a p-value."""
    text = re.sub(r"(?<=[\d±]) (?=±|m\b|s\b|nats\b|%|std\b)|(?<=\bp) (?=[<\d])|(?<=[<±]) (?=\d)", "\u00a0", text)
    return escape(text)


def _text(text: str, kind: str = "") -> str:
    """A paragraph."""
    return f'<p class="{kind}">{_unbroken(text)}</p>' if kind else f"<p>{_unbroken(text)}</p>"


def _list(lines: Iterable[str]) -> str:
    return f"<ul>{''.join(f'<li>{_unbroken(line.strip())}</li>' for line in lines)}</ul>"


def _folded(title: str, content: str) -> str:
    return f"<details><summary>{escape(title)}</summary>{content}</details>"


def _table(
    headings: Sequence[str], rows: Iterable[Sequence[str]], *, left: bool = False, swatches: Sequence[str] = ()
) -> str:
    """A table; the first column is aligned to the left, or all columns; ``swatches``: a colour before each row."""
    head = "".join(f"<th>{escape(h)}</th>" for h in headings)
    body = ""
    for k, row in enumerate(rows):
        first, *others = map(_unbroken, row)
        colour = f'<i class="swatch" style="background:{swatches[k]}"></i>' if swatches else ""
        body += f"<tr><td>{colour}{first}</td>{''.join(f'<td>{cell}</td>' for cell in others)}</tr>"
    return f'<div class="scroll{" left" if left else ""}"><table><tr>{head}</tr>{body}</table></div>'


def _errors(d: Document) -> str:
    """Gains and errors of all models, each with its colour in the pictures."""
    shown = steps(d)
    swatches = [colour_of(name, d) for name in models(d)]
    return _text(f"{shown.title}.") + _table(shown.headings, shown.rows, swatches=swatches)


def _additions(d: Document) -> str:
    """What was added, one row each, and the model as an equation."""
    effects = d["verdict"]["effects"]
    if not effects:
        return _text("Nothing was added.")
    alone = "not fitted" if d["verdict"].get("asked") else "nothing"
    rows = [
        [addition(d, n), size_of(d, n), on_unseen(d, n), chance(n.get("p_value")), not_told_apart(d, n) or alone,
         worse_in_words(n) or "none"]
        for n in effects
    ]  # fmt: skip
    headings = ["added", "how large", "unseen data", "chance", "cannot be told apart from", "forecasts that get worse"]
    text = _table(headings, rows, left=True)
    if model := equation(d):
        text += f"<p>The model, with what is new in brackets: <code>{escape(model)}</code></p>"
    return text + _text(_NATS, "note")


def _told(d: Document) -> str:
    return _folded("What sugiyama diagnose prints", _list(sentences(d)))


def _checks(d: Document) -> str:
    """The checks of the final model that fail, and those that hold, to be opened."""
    rows: dict[bool, list[list[str]]] = {True: [], False: []}
    for one in sorted(d["checks"], key=lambda one: float(one["p_value"])):
        says = "fails" if one["failed"] else "holds"
        rows[bool(one["failed"])].append([check_title(d, one), *check_values(one), says])
    if not d["checks"]:
        return ""
    headings = ["check", "measured", "model", "chance", ""]
    text = _text(f"Checks of the final model: {checks_hold(d)}.")
    if rows[True]:
        text += _table(headings, rows[True], left=True)
    note = _text(_CHECKS, "note")
    return text + _folded("Checks that hold", _table(headings, rows[False], left=True) + note)


def _failing(d: Document) -> str:
    """In which regimes the model fails, and in which bins most of all, in words."""
    where = d.get("where")
    if not where:
        return ""
    says = {"before": "Before: biased", "after": "With what was added: biased"}
    if not d["verdict"]["effects"]:
        says = {"before": "Biased"}
    regimes = {when: {b["label"]: b for b in where[when]["bins"] if b["covariate"] == "regime"} for when in says}
    rows = [[f"while {label}", *(_bias(regimes[when].get(label)) for when in says)] for label in regimes["before"]]
    headings = ["regime", "before", "with what was added"] if len(says) > 1 else ["regime", "bias"]
    lines = [f"{words} in {biased(d, when)}." for when, words in says.items()]
    return "".join(map(_text, lines)) + _table(headings, rows, left=True)


# Bias [std] below which a regime is not worth a word.
_SMALLEST = 0.02


def _bias(b: Mapping[str, Any] | None) -> str:
    if b is None:
        return "too few samples"
    bias = float(b["bias"])
    if abs(bias) < _SMALLEST and not b["flagged"]:
        return "no bias"
    says = f"cars are {'ahead of' if bias > 0.0 else 'behind'} the prediction by {abs(bias):.2f} std"
    return says + (" (more than chance)" if b["flagged"] else "")


def detectable(d: Document) -> str:
    """What these data would usually have shown, and what was not searched for, to be opened."""
    text = ""
    if rows := would_have_shown(d):
        shown = _table(["effect", "if it were this strong"], rows, left=True)
        text += _folded("What these data would usually have shown", shown)
    if d["verdict"].get("asked"):
        return text + _text("Nothing was searched for: effects were added by name.")
    searched = [title_of(d, name) for name in d["verdict"].get("searched", [])]
    missed = [f"{title_of(d, one['name'])} ({one['reason']})" for one in d["verdict"].get("not_searched", [])]
    tried = [f"Not searched for: {', '.join(missed)}." if missed else "", f"{', '.join(searched)}." if searched else ""]
    told = "".join(map(_text, [*filter(None, tried), "What is not in the catalogue is not searched for."]))
    return text + _folded(f"Searched for, in {len(searched)} groups", told)


# The card: what was measured, the verdict, and three tiles

# Number of other laws in the bars, and of sentences of one kind that the card has room for.
_LAWS = 2
_LINES = 3


def _card(r: Recording, d: Mapping[str, Any] | None) -> str:
    t = r.trajectories
    road = f"a ring of {t.road.circumference_m:g} m" if t.road.is_ring else "an open road"
    followers = int(np.sum(r.followers))
    some = f" ({followers} of them followers)" if 0 < followers < len(t.vehicle) else ""
    facts = f"{len(t.vehicle)} vehicles{some}, {t.duration_s:.0f} s, a sample every {t.period_s:.3g} s, on {road}"
    moving = f"; from a car at {frame_mps(r)} m/s" if frame_mps(r) else ""
    shown = (
        f"Speeds over time (to the right) and place (upward{moving}): yellow is fast, dark blue"
        f" {'slow' if moving else 'stands'}."
    )
    return (
        f'<header class="card"><div class="what"><h1>{escape(r.name)}</h1>{_text(facts)}'
        f'<img alt="speeds over time and place" src="{thumbnail(r)}">{_text(shown, "note")}</div>'
        f"{_verdict(r, d)}{_tiles(d) if d is not None else ''}</header>"
    )


def _verdict(r: Recording, d: Mapping[str, Any] | None) -> str:
    if d is None:
        return (
            '<div class="verdict"><p class="headline">What does the model lack here?</p><p>This finds it out, and shows'
            f" it on this page:</p><p><code>{escape(_to_diagnose(r))}</code></p></div>"
        )
    sign, words = badge(d)
    outcome = {"✓": "explained", "✗": "not_explained"}.get(sign, "")
    effects = d["verdict"]["effects"]
    rows: list[tuple[str, str]] = []
    if len(effects) == 1:
        rows = [("What it is", summary_of(d, form_of(effects[0]))), ("How large", size_of(d, effects[0]))]
    else:
        rows += _few("What was found", [gain_in_words(d, n) for n in effects])
    rows.append(("How sure", how_sure(d)))
    rows += _few("What gets worse", worse(d)) + _few("What is left", reasons(d))
    rows.append(("What to do", what_to_do(d)))
    if hidden := d.get("hidden"):
        rows.append(("What was hidden", f"{title_of(d, form_of(hidden))}; {size_of(d, hidden)}."))
    listed = "".join(f"<dt>{what}</dt><dd>{_unbroken(capital(text))}</dd>" for what, text in rows if text)
    said, _, more = capital(headline(d).removeprefix(f"{words}: ")).partition(". ")
    return (
        f'<div class="verdict {outcome}"><p class="badge">{sign} {escape(words)}</p>'
        f"{_text(said.rstrip('.') + '.', 'headline')}{_text(more) if more else ''}<dl>{listed}</dl></div>"
    )


def _few(what: str, lines: Sequence[str]) -> list[tuple[str, str]]:
    """Rows of the first lines, and the number of the others."""
    shown = list(lines[:_LINES])
    if len(lines) > _LINES:
        shown[-1] += f"; and {len(lines) - _LINES} more, below"
    return [(what if k == 0 else "", line) for k, line in enumerate(shown)]


def _tiles(d: Mapping[str, Any]) -> str:
    """Errors one step ahead and of free runs, of all cars or else of one car, and the checks."""
    errors = d["errors"]
    run, text = "single_car", "error of one car behind its measured leader"
    if _value(errors, "before", "free_run_10s_m") is not None:
        run, text = "free_run", "error after 10 s in which all cars drive by the model"
        one_car = (_value(errors, model, "single_car_10s_m") for model in ("before", "after"))
        if ends := list(dict.fromkeys(length(end) for end in one_car if end is not None)):
            text += f"; one car behind its measured leader: {' → '.join(ends)} m"
    tiles = (
        _tile("One step ahead", "error of the next position", "one_step_rmse_m", errors),
        _tile("Free run, 10 s", text, f"{run}_10s_m", errors, _curves(run, errors)),
        _tile_of_checks(d),
    )
    return f'<div class="tiles">{"".join(tiles)}</div>'


def _tile_of_checks(d: Mapping[str, Any]) -> str:
    """How many checks of the final model hold, which ones fail, and in how many bins the model is biased."""
    every, bad = d["checks"], failed(d)
    names = [text for _, text in _few("", [check_title(d, one) for one in bad])]
    note = f"fails: {'; '.join(names)}" if bad else "the model gives what was measured, as far as chance lets one see"
    rows, is_changed = "", bool(d["verdict"]["effects"])
    for when in ("before", "after") if is_changed else ("before",):
        if where := d.get("where", {}).get(when):
            biased_bins = f"{len(where['flagged'])} of {len(where['bins'])}"
            rows += f'<tr class="{when}"><td>{_short(when, is_changed)}</td><td>{biased_bins}</td></tr>'
    if rows:
        note += ". Parts of the data in which the model is biased:"
    share = 100.0 * (1.0 - len(bad) / max(len(every), 1))
    return (
        f'<div class="tile"><h3>Checks that hold</h3><p class="number">{len(every) - len(bad)} of {len(every)}</p>'
        f'<div class="bar"><i style="width:{share:.1f}%"></i></div>{_text(note, "note")}<table>{rows}</table></div>'
    )


def _short(model: str, is_changed: bool) -> str:
    """A name that is short enough for the tiles."""
    return model if model == "floor" or (model in MODELS and is_changed) else model_name(model)


def _curves(run: str, errors: Mapping[str, Any]) -> str:
    """Errors over the time ahead: before, after, the best law, and the floor."""
    times = {name: float(found[1]) for name in errors["before"] if (found := re.fullmatch(rf"{run}_([\d.]+)s_m", name))}
    ends = {m: _value(errors, m, f"{run}_10s_m") for m in errors}
    laws = sorted((m for m in errors if m not in MODELS and m != "floor" and ends[m]), key=lambda m: ends[m] or 0.0)
    shown = [m for m in (*laws[:1], "floor", "before", "after") if ends.get(m) is not None]
    if not shown or not times:
        return ""
    law, looks = laws[:1], {"before": "grey", "after": "blue", "floor": "dotted"}
    said = [f"{_short(m, True)} ({'dashed' if m in law else looks[m]})" for m in reversed(shown)]
    largest = max(float(_value(errors, m, name) or 0.0) for m in shown for name in times) or 1.0
    lines = ""
    for model in shown:
        values = [(second, _value(errors, model, name)) for name, second in times.items()]
        places = [(0.0, 0.0), *((second, value) for second, value in values if value is not None)]
        points = " ".join(f"{10.0 * x:.0f},{40.0 * (1.0 - y / largest):.1f}" for x, y in sorted(places))
        kind = "law" if model in laws else model
        lines += f'<polyline class="{kind}" points="{points}"><title>{escape(model_name(model))}</title></polyline>'
    return (
        f'<svg class="curves" viewBox="-1 -1 102 42" preserveAspectRatio="none" role="img" aria-label="errors over the'
        f' time ahead">{lines}</svg>' + _text(f"from 0 to {max(times.values()):g} s ahead: {', '.join(said)}", "note")
    )


def _tile(title: str, about: str, key: str, errors: Mapping[str, Any], below: str = "") -> str:
    of = {model: value for model in errors if (value := _value(errors, model, key)) is not None}
    known = [of[model] for model in ("before", "after") if model in of]
    # positions that somebody has smoothed are predicted to the millimetre
    scale, unit = (1e3, "mm") if known and max(known) < SMALL_M else (1.0, "m")
    number = "–"
    is_changed = len(known) == 2 and known[0] != known[1]
    if len(known) == 2:
        before, after = known
        grown = ", worse" if after > before else ""
        change = f" <span>({100.0 * (after / before - 1.0):+.0f} %{grown})</span>" if before > 0.0 else ""
        ends = list(dict.fromkeys(length(scale * end) for end in known))
        number = f"{' → '.join(ends)} {unit}{change if len(ends) > 1 else ''}"
    laws = sorted((model for model in of if model not in MODELS), key=lambda model: of[model])[:_LAWS]
    own = ("before", "after") if is_changed else ("before",)
    if ahead := [model_name(law) for law in laws if own[-1] in of and of[law] < of[own[-1]]]:
        about += f"; smaller with another law: {', '.join(ahead)}"
    # a law that goes astray may leave the picture
    full, bars = 1.5 * max([*known, 1e-9]), ""
    for model in (model for model in (*own, *laws, "floor") if model in of):
        width, beyond = 100.0 * min(of[model] / full, 1.0), " ▸" if of[model] > full else ""
        bars += (
            f'<tr class="{model}"><td>{escape(_short(model, is_changed))}</td><td class="bar">'
            f'<i style="width:{width:.1f}%"></i></td><td>{length(scale * of[model])} {unit}{beyond}</td></tr>'
        )
    return (
        f'<div class="tile"><h3>{escape(title)}</h3><p class="number">{number}</p>{_text(about, "note")}'
        f"<table>{bars}</table>{below}</div>"
    )


def _value(errors: Mapping[str, Any], model: str, key: str) -> float | None:
    value = errors.get(model, {}).get(key)
    return None if value is None else float(value)


# How it was done

_PACKAGES = ("sugiyama_ros", "numpy", "scipy", "numba", "bokeh")


def _how(r: Recording, d: Document | None) -> str:
    """Commands, versions, checksums, seeds and licences."""
    rows = [
        ["simulated" if r.is_simulated else "measured", r.name],
        ["checksum (SHA-256)", r.trajectories.sha256 or "not known"],
        ["commands", " && ".join(_commands(r, d))],
    ]
    if d is not None:
        rows += [
            [
                "p-values",
                f"bootstrap of the scores over blocks of drivers and time, recentred by {d.get('simulations', '?')}"
                f" recordings that the model simulates (seed {d.get('seed', '?')}); all candidates are judged together",
            ],
            ["held out", "five interleaved folds of 25-s blocks; no sample is predicted by a model that has seen it"],
        ]
    versions = [f"{name} {_version(name)}" for name in _PACKAGES]
    rows += [
        ["versions", ", ".join([*versions, f"Python {platform.python_version()}"])],
        ["licences", "sugiyama_ros: MIT; Bokeh, in this page: BSD-3-Clause; the data: as their source says"],
    ]
    return _table(["what", "how"], rows, left=True)


def _to_diagnose(r: Recording) -> str:
    """The command that finds what the model lacks in a recording, and shows it on its page."""
    bag = r.path or Path("run.mcap")
    saved = str(bag.with_name(f"{bag.stem}_diagnosis.json"))
    found = shlex.join(["sugiyama", "diagnose", str(bag), "--save", saved])
    return f"{found} && {shlex.join(['sugiyama', 'report', str(bag), '--diagnosis', saved, '--overwrite', '--open'])}"


def _commands(r: Recording, d: Document | None) -> list[str]:
    """The commands that made the page, with the names of the files as far as they are known."""
    t, bag = r.trajectories, r.path or Path("run.mcap")
    # what was simulated for a demonstration is in no file that is left
    named = "" if SIMULATED in t.source else t.source
    given = file_of(d, named) if d is not None else named
    of_bag = Path(given).name == bag.name
    source = named if of_bag else given
    report, run, found = ["sugiyama", "report", str(bag)], [], []
    if "." in source and source != bag.name:
        run = [run_command(None if of_bag else d, source, t.road.circumference_m, bag, r.model)]
    if d is not None:
        file = str(d.get("file") or "diagnosis.json")
        own = ["sugiyama", "diagnose", given or str(bag), "--seed", str(d.get("seed", 0)), "--save", file]
        found = [str(d.get("command") or shlex.join(own))]
        report += ["--diagnosis", file]
    # the run may start from the model that the diagnosis writes
    return [*(run + found if of_bag else found + run), shlex.join(report)]


def _version(name: str) -> str:
    try:
        return metadata.version(name)
    except metadata.PackageNotFoundError:
        return "not installed"
