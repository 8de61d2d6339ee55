"""How often the diagnosis is right, as a report in Markdown."""

from collections.abc import Sequence

import numpy as np

from sugiyama_ros.studies.judgement import FORM, FORMS, NONE, PAIR, Judgement


def report(outcomes: Sequence[Judgement]) -> str:
    """Write the rates of right and wrong answers, and the first addition for every hidden effect."""
    free = [o for o in outcomes if o.hidden == NONE]
    lines = [
        *_rates(outcomes),
        *_share_of_gain(outcomes),
        *_pairs_and_forms(outcomes),
        "",
        f"Without an effect: {sum(o.first != NONE for o in free)} false alarms in {len(free)} recordings.",
        "",
        *_first_names(outcomes),
    ]
    return "\n".join(lines) + "\n"


def _rates(outcomes: Sequence[Judgement]) -> list[str]:
    """Table of the rates for strong and for weak effects."""
    lines = [
        "| strength | recordings | first name right | true effect in the set | mean set size | wrong name | none |",
        "|---|---|---|---|---|---|---|",
    ]
    for strength in ("strong", "weak"):
        of = [o for o in outcomes if o.strength == strength and o.hidden != NONE]
        if of:
            right = sum(o.first == o.hidden for o in of)
            inside = sum(o.hidden in (o.first, *o.indistinguishable) for o in of)
            sizes = [1 + len(o.indistinguishable) for o in of if o.first != NONE]
            none = sum(o.first == NONE for o in of)
            size = f"{np.mean(sizes):.2f}" if sizes else "-"
            wrong = len(of) - inside - none
            lines.append(f"| {strength} | {len(of)} | {right} | {inside} | {size} | {wrong} | {none} |")
    return lines


def _share_of_gain(outcomes: Sequence[Judgement]) -> list[str]:
    """How much of the possible held-out gain the first additions bring."""
    hidden = [o for o in outcomes if o.strength in ("strong", "weak") and o.hidden != NONE]
    possible = sum(o.oracle_heldout for o in hidden)
    if not possible:
        return []
    share = sum(o.gain for o in hidden) / possible
    return ["", f"Held-out gain of the first additions, as a share of the gain of the true effects: {share:.0%}."]


def _pairs_and_forms(outcomes: Sequence[Judgement]) -> list[str]:
    """How often both effects of a pair are found, and the right covariate of a form."""
    lines: list[str] = []
    if pairs := [o for o in outcomes if o.strength == PAIR]:
        both = sum(len(set(o.hidden.split("+")) & set(o.named)) == 2 for o in pairs)
        lines += ["", f"Two effects at once: both are found in {both} of {len(pairs)} recordings."]
    if forms := [o for o in outcomes if o.strength == FORM]:
        right = sum(bool(o.discovered) and o.discovered[0] == FORMS[o.hidden][0] for o in forms)
        lines += ["", f"Not in the catalogue: the force is found along the right covariate in {right} of {len(forms)}."]
    return lines


def _first_names(outcomes: Sequence[Judgement]) -> list[str]:
    """Table of the first additions for every hidden effect."""
    lines = ["| hidden | strength | gain of the true effect [nats] | first names |", "|---|---|---|---|"]
    for hidden, strength in sorted({(o.hidden, o.strength) for o in outcomes}):
        of = [o for o in outcomes if (o.hidden, o.strength) == (hidden, strength)]
        names = {n: sum(o.first == n for o in of) for n in sorted({o.first for o in of})}
        gains = f"{np.median([o.oracle_gain for o in of]):.0f}"
        lines.append(f"| {hidden} | {strength} | {gains} | {', '.join(f'{n} ({k})' for n, k in names.items())} |")
    return lines
