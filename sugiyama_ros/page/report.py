"""The page as one file that needs no network: data, model, where the model fails, and what is missing."""

from collections.abc import Mapping, Sequence
from html import escape
from typing import Any

import numpy as np
from bokeh.embed import components
from bokeh.models import Select, UIElement
from bokeh.resources import Resources

from sugiyama_ros.outputs import Target, writing
from sugiyama_ros.page.panels import measured, missing, model, truth
from sugiyama_ros.page.panels.model import Quantity
from sugiyama_ros.page.recording import Recording
from sugiyama_ros.page.truth import SHOWN, AgainstTruth

_STYLE = """
:root { color-scheme: light dark; }
body { font: 16px/1.5 system-ui, sans-serif; margin: 0 auto; max-width: 1280px; padding: 0 1rem 3rem; }
.panels { display: grid; grid-template-columns: repeat(auto-fit, minmax(min(100%, 440px), 1fr)); gap: 1rem; }
.panel { min-width: 0; }
h1 { font-size: 1.5rem; } h2 { font-size: 1.2rem; margin: 2rem 0 .5rem; }
table { border-collapse: collapse; } tr { border-bottom: 1px solid #8884; }
td, th { padding: .2rem .8rem; text-align: right; } td:first-child, th:first-child { text-align: left; }
@media (prefers-color-scheme: dark) {
  body { background: #111; color: #ddd; }
  .panel { background: #fff; color: #111; color-scheme: light; filter: invert(.92) hue-rotate(180deg); }
}
"""


def write_report(
    recording: Recording, diagnosis: Mapping[str, Any] | None, output: Target, against: AgainstTruth | None = None
) -> None:
    """Write the page of a recorded run.

    Parameters
    ----------
    recording : Recording
        The run.
    diagnosis : mapping or None
        Document of `sugiyama diagnose --json`.
    output : Path or Output
        HTML file to write.
    against : AgainstTruth, optional
        Estimates compared with the truth, if the drivers were simulated.

    Raises
    ------
    OutputError
        Where the file cannot be written.
    """
    page = report(recording, diagnosis, against)
    with writing(output) as stream:
        stream.write(page.encode())


def report(r: Recording, diagnosis: Mapping[str, Any] | None, against: AgainstTruth | None = None) -> str:
    """The page as HTML, with all scripts in it."""
    t = r.trajectories
    select = Select(
        title="driver",
        value=f"vehicle {t.vehicle[0]}",
        options=[f"vehicle {v}" for v in t.vehicle],
        width=200,
    )
    sections: list[tuple[str, str, Sequence[UIElement]]] = [
        ("What was measured", "", [measured.space_time(r), measured.speed_profile(r), measured.ring(r)])
    ]
    if r.has_estimates:
        s = r.series
        time = np.broadcast_to(r.time_s[:, None], t.position_m.shape)
        place = t.road.wrap(t.position_m) if t.road.is_ring else t.position_m
        sections += [
            ("What the model says", "", [model.error_over_time(r), model.driver(r, select)]),
            (
                "Where it fails",
                "Where the mean of the one-step error stays away from 0, the model lacks something.",
                [
                    model.bias_map(
                        r,
                        "Bias over speed and gap",
                        Quantity(s["speed"], "speed [m/s]", 12),
                        Quantity(s["gap_m"], "gap [m]", 12),
                    ),
                    model.bias_map(
                        r,
                        "Bias over time and place",
                        Quantity(time, "time [s]", 25),
                        Quantity(place, "position [m]", 16),
                    ),
                    model.by_driver(r, select),
                ],
            ),
        ]
    if against is not None:
        told = "".join(f"<li>{escape(line)}</li>" for line in against.lines())
        sections.append(("Against the truth", f"<ul>{told}</ul>", [truth.estimates(against, name) for name in SHOWN]))
    panels: list[UIElement] = [model.weights(r)] if r.weights else []
    if diagnosis is not None:
        panels.append(missing.candidates(diagnosis))
        sections.append(("What is missing", _told(diagnosis), panels))
        sections.append(
            ("After adding it", _errors(diagnosis), [missing.growth(diagnosis), missing.before_and_after(diagnosis)])
        )
    else:
        hint = "<p>To see what is missing, add the document that <code>sugiyama diagnose --json</code> prints.</p>"
        sections.append(("What is missing", hint, panels))
    return _page(r, sections)


def _page(r: Recording, sections: Sequence[tuple[str, str, Sequence[UIElement]]]) -> str:
    t = r.trajectories
    models = {f"{i}-{k}": panel for i, (_, _, found) in enumerate(sections) for k, panel in enumerate(found)}
    script, divs = components(models)
    body = []
    for i, (title, text, found) in enumerate(sections):
        inside = "".join(f'<div class="panel">{divs[f"{i}-{k}"]}</div>' for k in range(len(found)))
        body.append(f'<section><h2>{escape(title)}</h2>{text}<div class="panels">{inside}</div></section>')
    road = f"a ring of {t.road.circumference_m:g} m" if t.road.is_ring else "an open road"
    about = f"{len(t.vehicle)} vehicles, {t.duration_s:.0f} s, a sample every {t.period_s:.3g} s, on {road}"
    scripts = Resources(mode="inline", components=["bokeh", "bokeh-widgets"]).render()
    return (
        '<!doctype html><html lang="en"><head><meta charset="utf-8">'
        '<meta name="viewport" content="width=device-width, initial-scale=1">'
        f"<title>{escape(t.source or 'recording')}</title><link rel=icon href='data:,'><style>{_STYLE}</style>{scripts}"
        f"</head><body><h1>{escape(t.source or 'recording')}</h1><p>{escape(about)}</p>{''.join(body)}{script}"
        "</body></html>"
    )


def _told(diagnosis: Mapping[str, Any]) -> str:
    """The verdict as text."""
    lines = []
    for n in diagnosis["verdict"]["effects"]:
        text = f"{n['name']}: held-out gain {n['heldout_gain_nats']:.0f} ± {n['heldout_gain_se']:.0f} nats"
        if n["indistinguishable"]:
            text += f"; cannot be told apart from {', '.join(n['indistinguishable'])}"
        lines.append(f"<li>{escape(text)}</li>")
    found = f"<ul>{''.join(lines)}</ul>" if lines else "<p>Nothing that is missing can be detected in these data.</p>"
    least = ", ".join(f"{s['name']} ({s['parameter']} {s['value']:.2g})" for s in diagnosis["smallest_detectable"])
    return found + (f"<p>What these data would usually have shown: {escape(least)}.</p>" if least else "")


def _errors(diagnosis: Mapping[str, Any]) -> str:
    """Held-out errors of all models as a table."""
    columns = {
        "one_step_rmse_m": "one step [m]",
        "free_run_10s_m": "free run 10 s [m]",
        "single_car_10s_m": "single car 10 s [m]",
        "loglik_per_sample": "nats per sample",
    }
    head = "".join(f"<th>{escape(c)}</th>" for c in ("model", *columns.values()))
    rows = []
    for name, errors in diagnosis["errors"].items():
        cells = "".join(f"<td>{_number(errors.get(key))}</td>" for key in columns)
        rows.append(f"<tr><td>{escape(str(name))}</td>{cells}</tr>")
    return f"<table><tr>{head}</tr>{''.join(rows)}</table>"


def _number(value: Any) -> str:
    return "" if value is None else f"{float(value):.3f}"
