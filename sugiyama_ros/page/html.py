"""Tables and texts of the report as HTML, out of the document of a diagnosis."""

import platform
import shlex
from collections.abc import Mapping, Sequence
from html import escape
from importlib import metadata
from pathlib import Path
from typing import Any

from sugiyama_ros.page.card import name_of
from sugiyama_ros.page.diagnosis import file_of, run_command
from sugiyama_ros.page.panels.base import colour_of
from sugiyama_ros.page.recording import Recording
from sugiyama_ros.page.words import (
    SMALL_M,
    Document,
    chance,
    form_of,
    model_name,
    models,
    not_told_apart,
    on_unseen,
    size_of,
    title_of,
    worse_in_use,
    would_have_shown,
)
from sugiyama_ros.tables import figure

_COLUMNS = {
    "one_step_rmse_m": "one step [m]",
    "free_run_2s_m": "all cars 2 s [m]",
    "free_run_10s_m": "all cars 10 s [m]",
    "single_car_2s_m": "one car 2 s [m]",
    "single_car_10s_m": "one car 10 s [m]",
    "loglik_per_sample": "nats per sample",
}
_SMALL = ("one_step_rmse_m", "loglik_per_sample")
_UNITS = {"speed": "m/s", "approach_rate": "m/s", "gap": "m", "rear_gap": "m", "place": "m", "time": "s"}
_PACKAGES = ("sugiyama_ros", "numpy", "scipy", "numba", "bokeh")
_EVIDENCE = (
    '<p class="note">Nats: logarithm of how much more probable the model makes the data; one nat is a factor of 2.7.'
    " p: probability that chance gains as much on the fitted data, as in simulations where nothing is missing, with"
    " regard to how many effects were tried. A gain with a large p is no evidence.</p>"
)
_IN_USE = (
    '<p class="note">Worse in use: than the base model, where both drive into a part of the recording to which neither'
    " was fitted.</p>"
)
# Bias [std] below which a regime is not worth a word.
_SMALLEST = 0.02


def table(headings: Sequence[str], rows: Sequence[Sequence[str]], *, left: bool = False) -> str:
    """A table; the first column is aligned to the left, or all columns."""
    head = "".join(f"<th>{escape(h)}</th>" for h in headings)
    body = "".join(f"<tr>{''.join(f'<td>{escape(cell)}</td>' for cell in row)}</tr>" for row in rows)
    kind = " left" if left else ""
    return f'<div class="scroll{kind}"><table><tr>{head}</tr>{body}</table></div>'


def errors(d: Document) -> str:
    """Held-out errors of all models, each with its colour in the pictures; without columns that nothing is known of."""
    shown = models(d)
    columns = {key: title for key, title in _COLUMNS.items() if any(one.get(key) is not None for one in shown.values())}
    # positions that somebody has smoothed are predicted to the millimetre
    largest = {key: max(one.get(key) or 0.0 for one in shown.values()) for key in columns if key.endswith("_m")}
    in_mm = {key for key, value in largest.items() if value < SMALL_M}
    rows = "".join(
        f'<tr><td><i class="swatch" style="background:{colour_of(name, d)}"></i>{escape(_fitted(name, found))}</td>'
        + "".join(f"<td>{_number(found.get(key), 1e3 if key in in_mm else 1.0, key)}</td>" for key in columns)
        + "</tr>"
        for name, found in shown.items()
    )
    titles = (title.replace("[m]", "[mm]") if key in in_mm else title for key, title in columns.items())
    head = "".join(f"<th>{escape(h)}</th>" for h in ("errors on unseen data", *titles))
    return f'<div class="scroll"><table><tr>{head}</tr>{rows}</table></div>'


def _fitted(name: str, found: Mapping[str, Any]) -> str:
    """A model, with the number of drivers to whom it was fitted if there are more in the recording."""
    return f"{model_name(name)}, {found['drivers']} drivers" if "drivers" in found else model_name(name)


def _number(value: Any, scale: float, key: str) -> str:
    digits = 3 if key in _SMALL and scale == 1.0 else 2
    return "" if value is None else f"{scale * float(value):.{digits}f}"


def additions(d: Document) -> str:
    """What was added, one row each; and the sentences of the command line, to be opened."""
    if effects := d["verdict"]["effects"]:
        rows = [
            [
                f"{title_of(d, form_of(n))} ({form_of(n)})",
                size_of(d, n) or "a value of each driver",
                on_unseen(n),
                chance(n.get("p_value")).replace(" ", "\u00a0"),
                not_told_apart(d, n) or ("not searched for" if d["verdict"].get("asked") else "nothing"),
                "; ".join(worse_in_use(n)) or "nowhere",
            ]
            for n in effects
        ]
        headings = ["added", "how large", "unseen data", "fitted data", "cannot be told apart from", "worse in use"]
        text = table(headings, rows, left=True) + (_IN_USE if any(map(worse_in_use, effects)) else "")
    else:
        text = "<p>Nothing was added.</p>"
    lines = "".join(f"<li>{escape(line.strip())}</li>" for line in d["verdict"].get("told", []))
    return f"{text}{_EVIDENCE}" + (
        f"<details><summary>What sugiyama diagnose prints</summary><ul>{lines}</ul></details>" if lines else ""
    )


def failing(d: Document) -> str:
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
        worst = "; ".join(_bin(b) for b in flagged[:3])
        text = f"{says[when]} in {len(flagged)} of {len(where[when]['bins'])} bins"
        lines.append(text + (f", most of all: {worst}." if worst else "."))
    headings = ["regime", "before", "with what was added"] if len(whens) > 1 else ["regime", "bias"]
    return "".join(f"<p>{escape(line)}</p>" for line in lines) + table(headings, rows, left=True)


def _bias(b: Mapping[str, Any] | None) -> str:
    if b is None:
        return "too few samples"
    bias = float(b["bias"])
    if abs(bias) < _SMALLEST and not b["flagged"]:
        return "no bias"
    says = f"cars are {'ahead of' if bias > 0.0 else 'behind'} the prediction by {abs(bias):.2f} std"
    return says + (" (more than chance)" if b["flagged"] else "")


def _bin(b: Mapping[str, Any]) -> str:
    name = "while" if b["covariate"] == "regime" else str(b["covariate"]).replace("_", " ")
    value = b["label"] or f"{figure(b['low'])} to {figure(b['high'])} {_UNITS.get(b['covariate'], '')}".strip()
    return f"{name} {value} ({b['bias']:+.2f} std)"


def detectable(d: Document) -> str:
    """What these data would usually have shown, and what was not searched for."""
    rows = [list(row) for row in would_have_shown(d)]
    text = ""
    if rows:
        text += "<h3>What these data would usually have shown</h3>"
        text += table(["effect", "if it were this strong"], rows, left=True)
    missed = [f"{title_of(d, one['name'])} ({one['reason']})" for one in d["verdict"].get("not_searched", [])]
    text += f"<p>Not searched for: {escape(', '.join(missed))}.</p>" if missed else ""
    if searched := [title_of(d, name) for name in d["verdict"].get("searched", [])]:
        names = escape(", ".join(searched))
        text += f"<details><summary>Searched for, in {len(searched)} groups</summary>{names}.</details>"
    return text + "<p>What is not in the catalogue is not searched for.</p>"


def how(r: Recording, d: Document | None) -> str:
    """Commands, versions, checksums, seeds and licences."""
    t = r.trajectories
    rows = [
        ["measured", name_of(r)],
        ["checksum (SHA-256)", t.sha256 or "not known"],
        ["commands", " && ".join(_commands(r, d))],
    ]
    if d is not None:
        runs = d.get("bootstrap_runs", "?")
        chance = f"the gains in {runs} recordings that the model simulates without it" if runs else "what chance gives"
        rows += [
            [
                "p-values",
                f"Student's t of the gain over {chance} (seed {d.get('seed', '?')}), corrected for the number of"
                " candidates",
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
    return table(["what", "how"], rows, left=True)


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
        file, quick = str(d.get("file") or "diagnosis.json"), ["--quick"] if d.get("quick") else []
        own = ["sugiyama", "diagnose", given or str(bag), *quick, "--seed", str(d.get("seed", 0)), "--save", file]
        found = [str(d.get("command") or shlex.join(own))]
        report += ["--diagnosis", file]
    # the run may start from the model that the diagnosis writes
    return [*(run + found if of_bag else found + run), shlex.join(report)]


def _version(name: str) -> str:
    try:
        return metadata.version(name)
    except metadata.PackageNotFoundError:
        return "not installed"
