"""The card at the top of the report: what was measured, the verdict, and the fall of the errors, on one screen."""

import re
from collections.abc import Mapping, Sequence
from html import escape
from typing import Any

import numpy as np

from sugiyama_ros.page.panels.measured import frame_mps
from sugiyama_ros.page.recording import Recording
from sugiyama_ros.page.thumbnail import thumbnail
from sugiyama_ros.page.words import (
    SMALL_M,
    badge,
    form_of,
    gain_in_words,
    headline,
    how_sure,
    length,
    model_name,
    reasons,
    size_of,
    summary_of,
    title_of,
    what_to_do,
    worse,
    would_have_shown,
)

# Models of the bars, and sentences of one kind that the card has room for.
_SHOWN = ("before", "after", "idm", "fvdm", "floor")
_LINES = 3
# Names that are short enough for the tiles.
_NAMES = {"before": "before", "after": "after", "floor": "floor"}
# A floor above an error by more than this factor needs a word.
_ABOVE = 1.05


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
    outcome = d["verdict"].get("adequacy", {}).get("outcome", "")
    sign, words = badge(d)
    if sign == "?":  # nothing to be green about
        outcome = ""
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
        f'<p class="headline">{escape(headline(d))}</p><dl>{listed}</dl></div>'
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
        _explained(d),
    ]
    return f'<div class="tiles">{"".join(tiles)}</div>'


def _explained(d: Mapping[str, Any]) -> str:
    """Which share of the gain the additions bring, and in how many bins the model stays biased."""
    share = d["verdict"].get("adequacy", {}).get("explained_share")
    of_chance = d["verdict"].get("adequacy", {}).get("bins_expected")
    failed = d["verdict"].get("adequacy", {}).get("outcome") == "not_explained"
    if share is not None and failed:
        # a share of what was tried is no measure of what is left
        text, bar = f"{100.0 * float(share):.0f} %", ""
        note = (
            "of what additions, other laws and forces gain on unseen data; what speaks against the model stands beside"
            " (what is left)"
        )
    elif share is not None:
        text = f"{100.0 * float(share):.0f} %"
        bar = f'<div class="bar"><i style="width:{100.0 * min(max(float(share), 0.0), 1.0):.1f}%"></i></div>'
        note = "of what additions, other laws and forces gain on unseen data"
    else:
        text, bar, note = "–", "", "nothing that was tried gains anything beyond chance"
    rows, effects = "", d["verdict"]["effects"]
    for when in ("before", "after") if effects else ("before",):
        where = d.get("where", {}).get(when)
        if where:
            biased = f"{len(where['flagged'])} of {len(where['bins'])}"
            rows += f'<tr class="{when}"><td>{_NAMES[when] if effects else model_name(when)}</td><td>{biased}</td></tr>'
    if rows and of_chance is not None:
        rows += f"<tr><td>by chance</td><td>{float(of_chance):.2g}</td></tr>"
    if rows:
        note += ". Parts of the data in which the model is biased:"
    return (
        f'<div class="tile"><h3>Share of the gain</h3><p class="number">{text}</p>{bar}<p class="note">{note}</p>'
        f"<table>{rows}</table></div>"
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
    shown = [(model, value) for model in _SHOWN if (value := _value(errors, model, key)) is not None]
    names = _NAMES
    if before is not None and before == after:
        shown, names = [(model, value) for model, value in shown if model != "after"], {"floor": "floor"}
    if known and (_value(errors, "floor", key) or 0.0) > _ABOVE * known[-1]:
        about += (
            ". ✗ A failed check: the floor lies above. In recordings that the model simulates itself, its errors are"
            " larger than in the data: its noise may be too large"
        )
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
