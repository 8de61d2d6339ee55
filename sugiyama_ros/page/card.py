"""The card at the top of the report: what was measured, the verdict, and the fall of the errors, on one screen."""

import re
from collections.abc import Mapping, Sequence
from html import escape
from typing import Any

import numpy as np

from sugiyama_ros.page.names import MODELS, SMALL_M, form_of, length, model_name, summary_of, title_of
from sugiyama_ros.page.panels.measured import frame_mps
from sugiyama_ros.page.recording import Recording
from sugiyama_ros.page.thumbnail import thumbnail
from sugiyama_ros.page.words import (
    badge,
    check_title,
    failed,
    gain_in_words,
    headline,
    how_sure,
    reasons,
    size_of,
    what_to_do,
    worse,
    would_have_shown,
)

# Number of other laws in the bars, and of sentences of one kind that the card has room for.
_LAWS = 2
_LINES = 3
# Names that are short enough for the tiles.
_NAMES = {"before": "before", "after": "after", "floor": "floor"}


def card(r: Recording, diagnosis: Mapping[str, Any] | None) -> str:
    """The card as HTML."""
    t = r.trajectories
    road = f"a ring of {t.road.circumference_m:g} m" if t.road.is_ring else "an open road"
    followers = int(np.sum(r.followers))
    some = f" ({followers} of them followers)" if 0 < followers < len(t.vehicle) else ""
    facts = f"{len(t.vehicle)} vehicles{some}, {t.duration_s:.0f} s, a sample every {t.period_s:.3g} s, on {road}"
    facts = re.sub(r"(\d) (m|s)\b", "\\1\u00a0\\2", facts)  # no unit begins a line
    name = escape(name_of(r))
    moving = f"; from a car at {frame_mps(r)}\u00a0m/s" if frame_mps(r) else ""
    about = (
        f'<div class="what"><h1>{name}</h1><p>{escape(facts)}</p>'
        f'<img alt="speeds over time and place" src="{thumbnail(r)}"><p class="note">Speeds over time (to the right)'
        f" and place (upward{moving}): yellow is fast, dark blue {'slow' if moving else 'stands'}.</p></div>"
    )
    return f'<header class="card">{about}{_verdict(diagnosis)}{_tiles(diagnosis)}</header>'


def name_of(r: Recording) -> str:
    """Name of what was measured: the file, or the model that simulated it."""
    source = r.trajectories.source or "recording"
    return source if "." in source else f"Simulated drivers ({source})" if source == "adaptiveSeek" else source


def _verdict(d: Mapping[str, Any] | None) -> str:
    if d is None:
        return (
            '<div class="verdict"><p class="headline">What the model lacks is not known yet.</p><p>To see it, run'
            " <code>sugiyama diagnose FILE --save d.json</code>, and give <code>--diagnosis d.json</code>.</p>"
            "</div>"
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
    if not effects:
        sizes = would_have_shown(d)
        shown = [size if size.startswith(f"{title}:") else f"{title}: {size}" for title, size in sizes]
        rows += _few("Would have shown", shown)
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
        _checks(d),
    ]
    return f'<div class="tiles">{"".join(tiles)}</div>'


def _checks(d: Mapping[str, Any]) -> str:
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
