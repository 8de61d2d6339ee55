"""The card at the top of the report: what was measured, the verdict, and the fall of the errors, on one screen."""

from collections.abc import Mapping, Sequence
from html import escape
from typing import Any

from sugiyama_ros.page.recording import Recording
from sugiyama_ros.page.thumbnail import thumbnail
from sugiyama_ros.page.words import (
    OUTCOMES,
    headline,
    how_sure,
    model_name,
    reasons,
    size_of,
    summary_of,
    title_of,
    what_to_do,
)

# Models of the bars.
_SHOWN = ("before", "after", "idm", "fvdm", "floor")


def card(r: Recording, diagnosis: Mapping[str, Any] | None) -> str:
    """The card as HTML."""
    t = r.trajectories
    road = f"a ring of {t.road.circumference_m:g} m" if t.road.is_ring else "an open road"
    facts = f"{len(t.vehicle)} vehicles, {t.duration_s:.0f} s, a sample every {t.period_s:.3g} s, on {road}"
    name = escape(name_of(r))
    about = (
        f'<div class="what"><h1>{name}</h1><p>{escape(facts)}</p>'
        f'<img alt="speeds over time and place" src="{thumbnail(r)}"><p class="note">Speeds over time (to the right)'
        " and place (upward): yellow is fast, dark blue stands.</p></div>"
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
            " <code>sugiyama diagnose FILE --json &gt; d.json</code>, and give <code>--diagnosis d.json</code>.</p>"
            "</div>"
        )
    outcome = d["verdict"].get("adequacy", {}).get("outcome", "")
    sign, words = OUTCOMES.get(outcome, ("", "Diagnosis"))
    rows = [("How large", f"{title_of(d, n['name'])}: {size_of(d, n)}") for n in d["verdict"]["effects"]]
    if len(d["verdict"]["effects"]) == 1 and (summary := summary_of(d, d["verdict"]["effects"][0]["name"])):
        rows.append(("What it is", summary))
    rows += [("How sure", line) for line in how_sure(d)]
    rows += [("What is left", "; ".join(reasons(d)) + ".")] if reasons(d) else []
    rows.append(("What to do", what_to_do(d)))
    if hidden := d.get("hidden"):
        rows.append(("The truth", f"hidden in this simulation: {title_of(d, hidden['name'])}; {size_of(d, hidden)}."))
    listed = "".join(f"<dt>{escape(what)}</dt><dd>{escape(text)}</dd>" for what, text in _merged(rows))
    return (
        f'<div class="verdict {escape(outcome)}"><p class="badge">{sign} {escape(words)}</p>'
        f'<p class="headline">{escape(headline(d))}</p><dl>{listed}</dl></div>'
    )


def _merged(rows: Sequence[tuple[str, str]]) -> list[tuple[str, str]]:
    """Rows in which a heading is not repeated."""
    return [(what if k == 0 or rows[k - 1][0] != what else "", text) for k, (what, text) in enumerate(rows)]


def _tiles(d: Mapping[str, Any] | None) -> str:
    if d is None:
        return ""
    errors = d["errors"]
    share = d["verdict"].get("adequacy", {}).get("explained_share")
    tiles = [
        _tile("One step ahead", "error of the next position", "one_step_rmse_m", errors),
        _tile("Free run, 10 s", "error after 10 s in which all cars drive by the model", "free_run_10s_m", errors),
    ]
    if share is not None:
        text = f"{100.0 * float(share):.0f} %"
        bar = f'<div class="bar"><i style="width:{100.0 * min(max(float(share), 0.0), 1.0):.1f}%"></i></div>'
        note = "of the held-out gain that anything found here can bring"
    else:
        text, bar, note = "–", "", "there is nothing to explain, or it is not known"
    tiles.append(
        f'<div class="tile"><h3>Explained</h3><p class="number">{text}</p>{bar}<p class="note">{note}</p></div>'
    )
    return f'<div class="tiles">{"".join(tiles)}</div>'


def _tile(title: str, about: str, key: str, errors: Mapping[str, Any]) -> str:
    before, after = (_value(errors, model, key) for model in ("before", "after"))
    number = "–"
    if before is not None and after is not None:
        fall = f" ({100.0 * (after / before - 1.0):+.0f} %)" if before > 0.0 and after != before else ""
        number = f"{before:.3g} → {after:.3g} m{fall}" if after != before else f"{before:.3g} m"
    shown = [(model, value) for model in _SHOWN if (value := _value(errors, model, key)) is not None]
    if before is not None and before == after:
        shown = [(model, value) for model, value in shown if model != "after"]
    # a law that goes astray may leave the picture
    full = 1.5 * max([before or 0.0, after or 0.0, 1e-9])
    bars = "".join(
        f'<tr class="{model}"><td>{escape(model_name(model))}</td><td class="bar"><i style="width:'
        f'{100.0 * min(value / full, 1.0):.1f}%"></i></td><td>{value:.3g} m{" ▸" if value > full else ""}</td></tr>'
        for model, value in shown
    )
    return (
        f'<div class="tile"><h3>{escape(title)}</h3><p class="number">{number}</p><p class="note">{escape(about)}</p>'
        f"<table>{bars}</table></div>"
    )


def _value(errors: Mapping[str, Any], model: str, key: str) -> float | None:
    value = errors.get(model, {}).get(key)
    return None if value is None else float(value)
