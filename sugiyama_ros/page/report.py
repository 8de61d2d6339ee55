"""The report as one file that needs no network: what was measured, the verdict, and what it rests on, top down."""

import platform
import re
import shlex
from collections.abc import Mapping, Sequence
from html import escape
from importlib import metadata
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from bokeh.embed import components
from bokeh.models import UIElement
from bokeh.resources import Resources

from sugiyama_ros.files import Target, writing
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
from sugiyama_ros.page.recording import SHOWN, AgainstTruth, Recording, preferred
from sugiyama_ros.page.style import REPAINT, STYLE
from sugiyama_ros.page.tables import steps
from sugiyama_ros.page.words import (
    badge,
    beside_the_verdict,
    bin_in_words,
    check_title,
    check_values,
    checks_hold,
    equation,
    failed,
    gain_in_words,
    headline,
    how_sure,
    not_told_apart,
    on_unseen,
    reasons,
    sentences,
    size_of,
    what_to_do,
    worse,
    worse_in_words,
    would_have_shown,
)

_ORANGE = "<p>Orange: added (▸), and what cannot be told apart from it in these data.</p>"
_FLOOR = (
    '<p class="note">Floor: the errors of the final model on a few recordings that it simulates itself, which are noise'
    " alone. The checks say whether errors on the data are as large as this noise makes; smaller ones mean that the"
    " model's noise is larger than the drivers'. In the pictures, the floor is dashed.</p>"
)


class Section(NamedTuple):
    """A section of the page: a text, panels in ``columns``, a class of the style sheet, and panels that are folded."""

    name: str
    title: str
    text: str
    panels: Sequence[UIElement] = ()
    columns: str = ""
    folded: Sequence[UIElement] = ()
    about_folded: str = ""


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
        estimates = [drivers.against_truth(against, name) for name in SHOWN]
        sections.append(Section("truth", "Against the truth", f"<ul>{told}</ul>", estimates))
    sections.append(Section("how", "How it was done", _how(r, diagnosis)))
    chosen.connect()
    return _page(r, diagnosis, sections, chosen)


def _measured(r: Recording, d: Mapping[str, Any] | None, chosen: Chosen) -> list[Section]:
    first = measured.space_time(r, chosen)
    driven = measured.simulated(r, d, first) if d is not None else []
    about = (
        "<p>Colours are speeds, the same in all pictures. The model starts anew from the measured state at each dotted"
        " line, and then drives all cars on its own; it was fitted without the block that it drives. These pictures are"
        " without noise. The errors of free runs in tables and tiles are those of the mean of eight runs, four"
        " pairs with opposite noise, so they are not the distance between the pictures.</p>"
    )
    columns = {3: "three", 2: ""}.get(1 + len(driven), "one")
    title = f"What was {'simulated' if r.is_simulated else 'measured'}"
    found = [Section("seen", title, about if driven else "", [first, *driven], columns)]
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
    text = _failing(d) + _checks(d)
    runs = {
        "free_run": "Free runs of all cars together",
        "single_car": "Free runs of one car behind its measured leader",
    }
    worths = [growth(d, run, title) for run, title in runs.items() if is_known(d, run)]
    worths.append(by_driver(d, chosen, vehicles))
    added = _ORANGE if d["verdict"]["effects"] else ""
    return [
        Section("fails", "Where it fails", (legend if maps else "") + text, maps, "four" if len(maps) == 4 else ""),
        Section("missing", "What is missing", _additions(d) + detectable(d) + added, [candidates(d)], "one"),
        Section("worth", "What it is worth", _errors(d) + _FLOOR, worths, "three" if len(worths) == 3 else ""),
    ]


def _drivers(r: Recording, d: Mapping[str, Any] | None, chosen: Chosen) -> Section:
    speed, error, meant = drivers.in_detail(r, chosen)
    over_time = [drivers.over_time(r, name, chosen) for name in ("v_star", "kappa_v")]
    panels = [drivers.against_each_other(r, d, chosen), *over_time, speed, error]
    text = "<p>The estimators learn these while they listen; click a driver in any picture, or choose one above.</p>"
    if r.truth:
        text += "<p>The truth is drawn in green.</p>"
    if r.types:
        rows = [[str(v), *(f"{p:.2f}" for p in of)] for v, of in r.types.items()]
        classes = len(next(iter(r.types.values())))
        text += _table(["vehicle", *(f"probability of class {k}" for k in range(classes))], rows)
    if r.changes:
        text += f"<p>Changes of style that were noticed (triangles): {len(r.changes)}.</p>"
    if r.weights:
        panels.append(drivers.weights(r, d or {}))
        best, lead = preferred(r.weights)
        text += f"<p>{escape(beside_the_verdict(d, best, r.added, lead))}</p>"
    folded = [meant, drivers.error_over_time(r)]
    about = "What the driver means to do, and the error of this run over time"
    return Section("drivers", "The drivers", text, panels, "side three", folded, about)


def _page(r: Recording, d: Mapping[str, Any] | None, sections: Sequence[Section], chosen: Chosen) -> str:
    models: dict[str, UIElement] = {
        f"{one.name}-{k}": panel for one in sections for k, panel in enumerate([*one.panels, *one.folded])
    }
    script, divs = components({"choose": chosen.select, **models})
    body = "".join(_section(one, divs) for one in sections)
    links = "".join(f'<a href="#{one.name}">{escape(one.title)}</a>' for one in sections)
    scripts = Resources(mode="inline", components=["bokeh", "bokeh-widgets"]).render()
    title = escape(r.name)
    return (
        '<!doctype html><html lang="en"><head><meta charset="utf-8">'
        '<meta name="viewport" content="width=device-width, initial-scale=1">'
        f"<title>{title}</title><link rel=icon href='data:,'><style>{STYLE}</style></head><body>"
        f'{_card(r, d)}<nav>{links}<div class="choose">driver {divs["choose"]}</div></nav>{body}{scripts}{script}'
        f"<script>{REPAINT}</script></body></html>"
    )


def _section(one: Section, divs: Mapping[str, str]) -> str:
    cells = [f'<div class="panel">{divs[f"{one.name}-{k}"]}</div>' for k in range(len(one.panels) + len(one.folded))]
    shown, folded = cells[: len(one.panels)], "".join(cells[len(one.panels) :])
    grid = f'<div class="panels {one.columns}">{"".join(shown)}</div>' if shown else ""
    if folded:
        grid += f'<details><summary>{escape(one.about_folded)}</summary><div class="panels">{folded}</div></details>'
    return f'<section id="{one.name}"><h2>{escape(one.title)}</h2>{one.text}{grid}</section>'


# Number of other laws in the bars, and of sentences of one kind that the card has room for.
_LAWS = 2
_LINES = 3
# Names that are short enough for the tiles.
_NAMES = {"before": "before", "after": "after", "floor": "floor"}


def _card(r: Recording, diagnosis: Mapping[str, Any] | None) -> str:
    """The card as HTML."""
    t = r.trajectories
    road = f"a ring of {t.road.circumference_m:g} m" if t.road.is_ring else "an open road"
    followers = int(np.sum(r.followers))
    some = f" ({followers} of them followers)" if 0 < followers < len(t.vehicle) else ""
    facts = f"{len(t.vehicle)} vehicles{some}, {t.duration_s:.0f} s, a sample every {t.period_s:.3g} s, on {road}"
    facts = re.sub(r"(\d) (m|s)\b", "\\1\u00a0\\2", facts)  # no unit begins a line
    name = escape(r.name)
    moving = f"; from a car at {frame_mps(r)}\u00a0m/s" if frame_mps(r) else ""
    about = (
        f'<div class="what"><h1>{name}</h1><p>{escape(facts)}</p>'
        f'<img alt="speeds over time and place" src="{thumbnail(r)}"><p class="note">Speeds over time (to the right)'
        f" and place (upward{moving}): yellow is fast, dark blue {'slow' if moving else 'stands'}.</p></div>"
    )
    return f'<header class="card">{about}{_verdict(r, diagnosis)}{_tiles(diagnosis)}</header>'


def _verdict(r: Recording, d: Mapping[str, Any] | None) -> str:
    if d is None:
        return (
            '<div class="verdict"><p class="headline">What does the model lack here?</p><p>This finds it out, and shows'
            f" it on this page:</p><p><code>{escape(_to_diagnose(r))}</code></p></div>"
        )
    sign, words = badge(d)
    outcome = {"✓": "explained", "✗": "not_explained"}.get(sign, "")
    said = headline(d).removeprefix(f"{words}: ")
    effects = d["verdict"]["effects"]
    rows: list[tuple[str, str]] = []
    if len(effects) == 1:
        if summary := summary_of(d, form_of(effects[0])):
            rows.append(("What it is", summary))
        rows.append(("How large", size_of(d, effects[0])))
    else:
        rows += _few("What was found", [gain_in_words(d, n) for n in effects])
    if sure := how_sure(d):
        rows.append(("How sure", sure))
    rows += _few("What gets worse", worse(d)) + _few("What is left", reasons(d))
    rows.append(("What to do", what_to_do(d)))
    if hidden := d.get("hidden"):
        rows.append(("What was hidden", f"{title_of(d, form_of(hidden))}; {size_of(d, hidden)}."))
    listed = "".join(f"<dt>{escape(what)}</dt><dd>{escape(text[:1].upper() + text[1:])}</dd>" for what, text in rows)
    return (
        f'<div class="verdict {escape(outcome)}"><p class="badge">{sign} {escape(words)}</p>'
        f'<p class="headline">{escape(said[:1].upper() + said[1:])}</p><dl>{listed}</dl></div>'
    )


def _few(what: str, lines: Sequence[str]) -> list[tuple[str, str]]:
    """Rows of the first lines, and the number of the others."""
    shown = list(lines[:_LINES])
    if len(lines) > _LINES:
        shown[-1] += f"; and {len(lines) - _LINES} more, below"
    return [(what if k == 0 else "", line) for k, line in enumerate(shown)]


def _tiles(d: Mapping[str, Any] | None) -> str:
    if d is None:
        return ""
    errors = d["errors"]
    tiles = [
        _tile("One step ahead", "error of the next position", "one_step_rmse_m", errors),
        _free_runs(errors),
        _tile_of_checks(d),
    ]
    return f'<div class="tiles">{"".join(tiles)}</div>'


def _tile_of_checks(d: Mapping[str, Any]) -> str:
    """How many checks of the final model hold, which ones fail, and in how many bins the model is biased."""
    every, bad = d["checks"], failed(d)
    share = 100.0 * (1.0 - len(bad) / max(len(every), 1))
    bar = f'<div class="bar"><i style="width:{share:.1f}%"></i></div>'
    names = "; ".join(check_title(d, one) for one in bad[:_LINES])
    if len(bad) > _LINES:
        names += f"; and {len(bad) - _LINES} more, below"
    note = f"fails: {names}" if bad else "the model gives what was measured, as far as chance lets one see"
    rows, effects = "", d["verdict"]["effects"]
    for when in ("before", "after") if effects else ("before",):
        if where := d.get("where", {}).get(when):
            biased = f"{len(where['flagged'])} of {len(where['bins'])}"
            rows += f'<tr class="{when}"><td>{_NAMES[when] if effects else model_name(when)}</td><td>{biased}</td></tr>'
    if rows:
        note += ". Parts of the data in which the model is biased:"
    return (
        f'<div class="tile"><h3>Checks that hold</h3><p class="number">{len(every) - len(bad)} of {len(every)}</p>{bar}'
        f'<p class="note">{escape(note)}</p><table>{rows}</table></div>'
    )


def _tile(title: str, about: str, key: str, errors: Mapping[str, Any]) -> str:
    before, after = (_value(errors, model, key) for model in ("before", "after"))
    known = [value for value in (before, after) if value is not None]
    # positions that somebody has smoothed are predicted to the millimetre
    scale, unit = (1e3, "mm") if known and max(known) < SMALL_M else (1.0, "m")
    number = "–"
    if before is not None and after is not None:
        grown = ", worse" if after > before else ""
        change = f" <span>({100.0 * (after / before - 1.0):+.0f} %{grown})</span>" if before > 0.0 else ""
        ends = list(dict.fromkeys(length(scale * end) for end in (before, after)))
        number = f"{' → '.join(ends)} {unit}{change if len(ends) > 1 else ''}"
    of = {model: value for model in errors if (value := _value(errors, model, key)) is not None}
    laws = sorted((model for model in of if model not in MODELS), key=lambda model: of[model])[:_LAWS]
    shown = [(model, of[model]) for model in ("before", "after", *laws, "floor") if model in of]
    names = _NAMES
    if before is not None and before == after:
        shown, names = [(model, value) for model, value in shown if model != "after"], {"floor": "floor"}
    # a law that goes astray may leave the picture
    full = 1.5 * max([*known, 1e-9])
    bars = "".join(
        f'<tr class="{model}"><td>{escape(names.get(model, model_name(model)))}</td><td class="bar"><i style="width:'
        f'{100.0 * min(value / full, 1.0):.1f}%"></i></td><td>{length(scale * value)} {unit}'
        f"{' ▸' if value > full else ''}</td></tr>"
        for model, value in shown
    )
    return (
        f'<div class="tile"><h3>{escape(title)}</h3><p class="number">{number}</p><p class="note">{escape(about)}</p>'
        f"<table>{bars}</table></div>"
    )


def _free_runs(errors: Mapping[str, Any]) -> str:
    """The tile of free runs: of all cars, or of one car where a recording has no whole road."""
    if _value(errors, "before", "free_run_10s_m") is None:
        return _tile("Free run, 10 s", "error of one car behind its measured leader", "single_car_10s_m", errors)
    text = "error after 10 s in which all cars drive by the model"
    one_car = (_value(errors, model, "single_car_10s_m") for model in ("before", "after"))
    ends = list(dict.fromkeys(length(end) for end in one_car if end is not None))
    if ends:
        text += f"; one car behind its measured leader: {' → '.join(ends)} m"
    return _tile("Free run, 10 s", text, "free_run_10s_m", errors)


def _value(errors: Mapping[str, Any], model: str, key: str) -> float | None:
    value = errors.get(model, {}).get(key)
    return None if value is None else float(value)


_PACKAGES = ("sugiyama_ros", "numpy", "scipy", "numba", "bokeh")
_EVIDENCE = (
    '<p class="note">Nats: logarithm of how much more probable the model makes the data; one nat is a factor of 2.7.'
    " p: probability that chance gains as much in any candidate.</p>"
)
_UNITS = (
    '<p class="note">Bias: mean square over what chance makes. Spread: mean square of the errors over the variance that'
    " the model predicts. Model: what its own simulations give. All checks are judged together, at a false-discovery"
    " rate of 5 %.</p>"
)
_GUIDE = (
    '<p class="note">Gains are differences of log scores on unseen data, in nats, with standard errors over blocks of'
    " time and drivers; those of one car at 2, 5 and 10 s, and all of them together. CRPS: mean distance between what"
    " was forecast, with its uncertainty, and what came.</p>"
)
# Bias [std] below which a regime is not worth a word.
_SMALLEST = 0.02


def _table(headings: Sequence[str], rows: Sequence[Sequence[str]], *, left: bool = False) -> str:
    """A table; the first column is aligned to the left, or all columns."""
    head = "".join(f"<th>{escape(h)}</th>" for h in headings)
    body = "".join(f"<tr>{''.join(f'<td>{escape(cell)}</td>' for cell in row)}</tr>" for row in rows)
    kind = " left" if left else ""
    return f'<div class="scroll{kind}"><table><tr>{head}</tr>{body}</table></div>'


def _errors(d: Document) -> str:
    """Gains and errors of all models, each with its colour in the pictures."""
    shown = steps(d)
    rows = "".join(
        f'<tr><td><i class="swatch" style="background:{colour_of(name, d)}"></i>{escape(row[0])}</td>'
        + "".join(f"<td>{escape(cell)}</td>".replace(" ± ", "\u00a0±\u00a0") for cell in row[1:])
        + "</tr>"
        for name, row in zip(models(d), shown.rows, strict=True)
    )
    head = "".join(f"<th>{escape(h)}</th>" for h in shown.headings)
    return f'<p>{escape(shown.title)}.</p><div class="scroll"><table><tr>{head}</tr>{rows}</table></div>{_GUIDE}'


def _additions(d: Document) -> str:
    """What was added, one row each; and the sentences of the command line, to be opened."""
    if effects := d["verdict"]["effects"]:
        rows = [
            [
                addition(d, n),
                size_of(d, n),
                on_unseen(n),
                chance(n.get("p_value")).replace(" ", "\u00a0"),
                not_told_apart(d, n) or ("not fitted" if d["verdict"].get("asked") else "nothing"),
                worse_in_words(n) or "none",
            ]
            for n in effects
        ]
        headings = [
            "added",
            "how large",
            "unseen data",
            "chance",
            "cannot be told apart from",
            "forecasts that get worse",
        ]
        text = _table(headings, rows, left=True)
        if model := equation(d):
            text += f"<p>The model, with what is new in brackets: <code>{escape(model)}</code></p>"
    else:
        text = "<p>Nothing was added.</p>"
    lines = "".join(f"<li>{escape(line.strip())}</li>" for line in sentences(d))
    told = f"<details><summary>What sugiyama diagnose prints</summary><ul>{lines}</ul></details>"
    return f"{text}{_EVIDENCE}{told}"


def _checks(d: Document) -> str:
    """All checks of the final model: what was measured, what its own simulations give, and whether it holds."""
    rows = [
        [check_title(d, one), *check_values(one), "fails" if one["failed"] else "holds"]
        for one in sorted(d["checks"], key=lambda one: float(one["p_value"]))
    ]
    if not rows:
        return ""
    listed = _table(["check", "measured", "model", "chance", ""], rows, left=True) + _UNITS
    is_open = " open" if any(one["failed"] for one in d["checks"]) else ""
    return f"<details{is_open}><summary>Checks of the final model: {escape(checks_hold(d))}</summary>{listed}</details>"


def _failing(d: Document) -> str:
    """In which regimes the model fails, and in which bins most of all, in words."""
    where = d.get("where")
    if not where:
        return ""
    whens = ("before", "after") if d["verdict"]["effects"] else ("before",)
    regimes = {when: {b["label"]: b for b in where[when]["bins"] if b["covariate"] == "regime"} for when in whens}
    rows = [[f"while {label}", *(_bias(regimes[when].get(label)) for when in whens)] for label in regimes["before"]]
    says = {"before": "Before: biased" if len(whens) > 1 else "Biased", "after": "With what was added: biased"}
    lines = []
    for when in whens:
        flagged = where[when]["flagged"]
        worst = "; ".join(bin_in_words(b) for b in flagged[:3])
        text = f"{says[when]} in {len(flagged)} of {len(where[when]['bins'])} bins"
        lines.append(text + (f", most of all: {worst}." if worst else "."))
    headings = ["regime", "before", "with what was added"] if len(whens) > 1 else ["regime", "bias"]
    return "".join(f"<p>{escape(line)}</p>" for line in lines) + _table(headings, rows, left=True)


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
    if rows := [list(row) for row in would_have_shown(d)]:
        shown = _table(["effect", "if it were this strong"], rows, left=True)
        text += f"<details><summary>What these data would usually have shown</summary>{shown}</details>"
    if d["verdict"].get("asked"):
        return f"{text}<p>Nothing was searched for: effects were added by name.</p>"
    searched = [title_of(d, name) for name in d["verdict"].get("searched", [])]
    missed = [f"{title_of(d, one['name'])} ({one['reason']})" for one in d["verdict"].get("not_searched", [])]
    tried = [f"Not searched for: {', '.join(missed)}." if missed else "", f"{', '.join(searched)}." if searched else ""]
    told = "".join(f"<p>{escape(line)}</p>" for line in tried if line)
    told += "<p>What is not in the catalogue is not searched for.</p>"
    return f"{text}<details><summary>Searched for, in {len(searched)} groups</summary>{told}</details>"


def _how(r: Recording, d: Document | None) -> str:
    """Commands, versions, checksums, seeds and licences."""
    t = r.trajectories
    rows = [
        ["simulated" if r.is_simulated else "measured", r.name],
        ["checksum (SHA-256)", t.sha256 or "not known"],
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
    rows += [
        [
            "versions",
            ", ".join(f"{name} {_version(name)}" for name in _PACKAGES) + f", Python {platform.python_version()}",
        ],
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
    given = file_of(d, t.source) if d is not None else t.source
    of_bag = Path(given).name == bag.name
    source = t.source if of_bag else given
    report, run, found = ["sugiyama", "report", str(bag)], [], []
    if "." in source and source != bag.name:
        command = run_command(None if of_bag else d, source, t.road.circumference_m, bag)
        run = [f"{command} {shlex.join(['--model', r.model])}" if r.model else command]
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
