"""Tables of the benchmark away from home."""

from collections.abc import Sequence

import numpy as np
from scipy.stats import kstest

from sugiyama_ros.studies.away.judged import Judged

_HEAD = "| part | recordings | right | first name right | in the set | named | not explained | misleading |"


def _share(known: Sequence[bool]) -> str:
    return f"{sum(known)} of {len(known)}" if known else "-"


def _row(label: str, rows: Sequence[Judged]) -> str:
    cells = (
        label,
        str(len(rows)),
        _share([r.is_right for r in rows]),
        _share([r.is_named for r in rows]) if any(r.right for r in rows) else "-",
        _share([r.is_in_set for r in rows]) if any(r.right for r in rows) else "-",
        _share([bool(r.named) for r in rows]),
        _share([r.is_warned for r in rows]),
        _share([r.is_misleading for r in rows]),
    )
    return f"| {' | '.join(cells)} |"


def _told(r: Judged) -> str:
    laws = f", near {' and '.join(r.laws)}" if r.laws and r.is_warned else ""
    who = f" of {', '.join(map(str, r.who))}" if r.who else ""
    return f"{', '.join(r.named) or 'nothing'}{who}: {r.outcome.replace('_', ' ')}{laws}"


def _calibration(rows: Sequence[Judged]) -> list[str]:
    """How gains and errors hold, and how p-values spread where nothing is hidden."""
    lines = []
    gains = [r for r in rows if r.named]
    if gains:
        off = [abs(r.fresh - r.heldout) <= 2.0 * np.hypot(r.fresh_se, r.heldout_se) for r in gains]
        lines.append(f"Held-out gains that reproduce on fresh data within two standard errors: {_share(off)}.")
    errors = [abs(e) for r in rows for e in r.errors.values()]
    if errors:
        lines.append(
            f"Parameters within 1.96 standard errors of the truth: {_share([e < 1.96 for e in errors])};"
            f" the largest error is {max(errors):.1f} standard errors."
        )
    p = [r.p_value for r in rows if r.part == "conditions"]
    if p:
        lines.append(
            f"Smallest p-value of the first round where nothing is hidden:"
            f" {_share([x <= 0.05 for x in p])} below 0.05; Kolmogorov-Smirnov against uniform"
            f" p = {kstest(p, 'uniform').pvalue:.2g}."
        )
    return lines


def report(rows: Sequence[Judged]) -> str:
    """Return the tables as Markdown: one row for each part, and one for each kind of recording."""
    head = [_HEAD, "|" + "---|" * (_HEAD.count("|") - 1)]
    by_part = [_row(part, [r for r in rows if r.part == part]) for part in dict.fromkeys(r.part for r in rows)]
    cases = ["| part | recording | right | verdict |", "|---|---|---|---|"]
    for r in rows:
        cases.append(f"| {r.part} | {r.name}, {r.strength} ({r.seed}) | {'yes' if r.is_right else 'no'} | {_told(r)} |")
    return "\n".join([*head, *by_part, "", *_calibration(rows), "", *cases, ""])
