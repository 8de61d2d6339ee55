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
from sugiyama_ros.page.names import Document, addition, chance, models, title_of
from sugiyama_ros.page.panels.base import colour_of
from sugiyama_ros.page.recording import Recording
from sugiyama_ros.page.tables import steps
from sugiyama_ros.page.words import (
    bin_in_words,
    check_title,
    check_values,
    checks_hold,
    equation,
    not_told_apart,
    on_unseen,
    sentences,
    size_of,
    worse_in_words,
    would_have_shown,
)

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


def table(headings: Sequence[str], rows: Sequence[Sequence[str]], *, left: bool = False) -> str:
    """A table; the first column is aligned to the left, or all columns."""
    head = "".join(f"<th>{escape(h)}</th>" for h in headings)
    body = "".join(f"<tr>{''.join(f'<td>{escape(cell)}</td>' for cell in row)}</tr>" for row in rows)
    kind = " left" if left else ""
    return f'<div class="scroll{kind}"><table><tr>{head}</tr>{body}</table></div>'


def errors(d: Document) -> str:
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


def additions(d: Document) -> str:
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
        text = table(headings, rows, left=True)
        if model := equation(d):
            text += f"<p>The model, with what is new in brackets: <code>{escape(model)}</code></p>"
    else:
        text = "<p>Nothing was added.</p>"
    lines = "".join(f"<li>{escape(line.strip())}</li>" for line in sentences(d))
    told = f"<details><summary>What sugiyama diagnose prints</summary><ul>{lines}</ul></details>"
    return f"{text}{_EVIDENCE}{told}"


def checks(d: Document) -> str:
    """All checks of the final model: what was measured, what its own simulations give, and whether it holds."""
    rows = [
        [check_title(d, one), *check_values(one), "fails" if one["failed"] else "holds"]
        for one in sorted(d["checks"], key=lambda one: float(one["p_value"]))
    ]
    if not rows:
        return ""
    listed = table(["check", "measured", "model", "chance", ""], rows, left=True) + _UNITS
    is_open = " open" if any(one["failed"] for one in d["checks"]) else ""
    return f"<details{is_open}><summary>Checks of the final model: {escape(checks_hold(d))}</summary>{listed}</details>"


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
        worst = "; ".join(bin_in_words(b) for b in flagged[:3])
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


def detectable(d: Document) -> str:
    """What these data would usually have shown, and what was not searched for."""
    rows = [list(row) for row in would_have_shown(d)]
    text = ""
    if rows:
        text += "<h3>What these data would usually have shown</h3>"
        text += table(["effect", "if it were this strong"], rows, left=True)
    if d["verdict"].get("asked"):
        return f"{text}<p>Nothing was searched for: effects were added by name.</p>"
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
