"""Benchmark of the diagnosis: simulated recordings with a hidden effect, and how often it is named.

    python -m sugiyama_ros.studies.hidden_effects --seeds 10 -o docs/hidden_effects.md

22 drivers whose desired speeds and risk premiums differ by 10 %, from rest with gaps of 2 m on a ring of 230 m, 250 s
at 1/3 s. Strengths: the true effect, added and fitted, gains some 100-300 nats (strong) or 20-50 (weak). Runs
in which cars collide are drawn again; an effect with which they always do starts from uniform flow. The forms that are
not in the catalogue can be named by nobody: right is a force without a name, or nothing.
"""

import argparse
import json
import sys
from collections.abc import Mapping, Sequence
from concurrent.futures import ProcessPoolExecutor, as_completed
from dataclasses import asdict, dataclass
from multiprocessing import get_context
from pathlib import Path

import numpy as np

from sugiyama_ros.diagnosis.diagnosis import diagnose
from sugiyama_ros.effects.discovered_force import COVARIATES
from sugiyama_ros.effects.effect import Values
from sugiyama_ros.studies.hiding import DURATION_S, RING_M, STRENGTHS, hide_all
from sugiyama_ros.trajectories.trajectories import Trajectories

NONE, PAIR, FORM = "none", "pair", "form"
#: Two at once, strong forms both.
PAIRS = (
    ("slow_patch", "actuation_lag"),
    ("drag", "outlier_noise"),
    ("second_leader", "sensor_eccentricity"),
    ("limited_power", "preference_switch"),
)
#: Forces [m/s^2] that are not in the catalogue, as effects of the simulator: covariate, its range, values at knots.
FORMS: Mapping[str, tuple[str, float, float, tuple[float, ...]]] = {
    "hurry at medium gaps": ("gap", 1.0, 12.0, (0.0, 0.0, 0.6, 0.9, 0.6, 0.0, 0.0, 0.0)),
    "reluctance at medium speed": ("speed", 2.0, 10.0, (0.0, 0.0, -0.4, -0.8, -0.8, -0.4, 0.0, 0.0)),
    "overreaction to approach": ("approach_rate", -2.0, 2.0, (0.8, 0.5, 0.2, 0.0, 0.0, -0.2, -0.5, -0.8)),
    "brake lights": ("leader_acceleration", -3.0, 3.0, (-0.9, -0.6, -0.3, 0.0, 0.0, 0.0, 0.0, 0.0)),
    "two rough places": ("place", 0.0, RING_M, (0.0, -0.5, 0.0, 0.0, 0.0, -0.5, 0.0, 0.0)),
    "tiring": ("time", 0.0, DURATION_S, (0.3, 0.2, 0.1, 0.0, -0.1, -0.2, -0.3, -0.4)),
}


@dataclass(frozen=True)
class Judgement:
    """What a diagnosis said of one recording; gains in nats, of what was named first and of the true effect."""

    hidden: str
    strength: str
    seed: int
    first: str
    named: tuple[str, ...]
    indistinguishable: tuple[str, ...]
    p_value: float
    gain: float
    oracle_gain: float
    oracle_heldout: float
    discovered: tuple[str, ...]
    wall_s: float


def judge(hidden: str, strength: str, measured: Trajectories, seed: int, quick: bool) -> Judgement:
    """Diagnose one recording; of a form that is not in the catalogue, forces without a name too."""
    d = diagnose(
        measured,
        seed=seed,
        quick=quick,
        most=2 if strength in (PAIR, FORM) else 1,
        verdict_only=strength != FORM,
        workers=1,
    )
    first = d.named[0] if d.named else None
    oracle = next((one.gain for one in d.scored if one.candidate.name == hidden), 0.0)
    return Judgement(
        hidden,
        strength,
        seed,
        first.name if first else NONE,
        tuple(n.name for n in d.named),
        first.indistinguishable if first else (),
        first.p_value if first else 1.0,
        first.heldout.nats if first else 0.0,
        oracle,
        d.heldout[hidden].nats if hidden in d.heldout else 0.0,
        tuple(one.covariate for one in d.discovered),
        d.wall_s,
    )


def _one(job: tuple[str, str, int, bool]) -> Judgement:
    hidden, strength, seed, quick = job
    effects: dict[str, Values] = {}
    if strength == FORM:
        covariate, low, high, values = FORMS[hidden]
        force = {f"force_{k}": v for k, v in enumerate(values)}
        number = float(1 + COVARIATES.index(covariate))
        effects["discovered_force"] = {"covariate": number, "first": low, "last": high, **force}
    elif hidden != NONE:
        effects = {name: STRENGTHS[name][-1 if strength == "weak" else 0] for name in hidden.split("+")}
    run, _ = hide_all(effects, seed)
    return judge(hidden, strength, run.measured, seed, quick)


def report(outcomes: Sequence[Judgement]) -> str:
    """Markdown: rates, and for every hidden effect what was named first."""
    lines = [
        "| strength | recordings | first name right | true effect in the set | mean set size | wrong name | none |"
    ]
    lines.append("|---|---|---|---|---|---|---|")
    for strength in ("strong", "weak"):
        of = [o for o in outcomes if o.strength == strength and o.hidden != NONE]
        if of:
            right = sum(o.first == o.hidden for o in of)
            inside = sum(o.hidden in (o.first, *o.indistinguishable) for o in of)
            sizes = [1 + len(o.indistinguishable) for o in of if o.first != NONE]
            none = sum(o.first == NONE for o in of)
            size = f"{np.mean(sizes):.2f}" if sizes else "-"
            lines.append(
                f"| {strength} | {len(of)} | {right} | {inside} | {size} | {len(of) - inside - none} | {none} |"
            )
    hidden_ones = [o for o in outcomes if o.strength in ("strong", "weak") and o.hidden != NONE]
    if possible := sum(o.oracle_heldout for o in hidden_ones):
        share = sum(o.gain for o in hidden_ones) / possible
        lines += ["", f"Held-out gain of what was named first, over that of the true effects: {share:.0%}."]
    for strength, count in ((PAIR, 2), (FORM, 0)):
        of = [o for o in outcomes if o.strength == strength]
        both = sum(len(set(o.hidden.split("+")) & set(o.named)) == count for o in of)
        covariates = sum(bool(o.discovered) and o.discovered[0] == FORMS[o.hidden][0] for o in of if not count)
        if of and count:
            lines += ["", f"Two at once: both named in {both} of {len(of)} recordings."]
        elif of:
            lines += [
                "",
                f"Not in the catalogue: the force found along the right covariate in {covariates} of {len(of)}.",
            ]
    free = [o for o in outcomes if o.hidden == NONE]
    lines += [
        "",
        f"Without an effect: {sum(o.first != NONE for o in free)} false alarms in {len(free)} recordings.",
        "",
    ]
    lines += ["| hidden | strength | gain of the true effect [nats] | first names |", "|---|---|---|---|"]
    for hidden, strength in sorted({(o.hidden, o.strength) for o in outcomes}):
        of = [o for o in outcomes if (o.hidden, o.strength) == (hidden, strength)]
        names = {n: sum(o.first == n for o in of) for n in sorted({o.first for o in of})}
        gains = f"{np.median([o.oracle_gain for o in of]):.0f}"
        lines.append(f"| {hidden} | {strength} | {gains} | {', '.join(f'{n} ({k})' for n, k in names.items())} |")
    return "\n".join(lines) + "\n"


def main() -> None:
    """Run the benchmark and write its table; outcomes go to stdout as JSON lines."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--seeds", type=int, default=10)
    parser.add_argument("--first-seed", type=int, default=0)
    parser.add_argument("--free", type=int, default=40, help="recordings without an effect")
    parser.add_argument("--pairs", type=int, default=10, help="recordings of each pair of effects")
    parser.add_argument("--forms", type=int, default=2, help="recordings of each form that is not in the catalogue")
    parser.add_argument("--strength", choices=["strong", "weak", "both"], default="both")
    parser.add_argument("--effects", nargs="*", default=list(STRENGTHS))
    parser.add_argument("--quick", action="store_true")
    parser.add_argument("--workers", type=int, default=4)
    parser.add_argument("-o", "--output", type=Path)
    given = parser.parse_args()

    def seeds(count: int) -> range:
        return range(given.first_seed, given.first_seed + count)

    strengths = ["strong", "weak"] if given.strength == "both" else [given.strength]
    jobs = [(e, s, seed, given.quick) for seed in seeds(given.seeds) for s in strengths for e in given.effects]
    jobs += [("+".join(pair), PAIR, seed, given.quick) for seed in seeds(given.pairs) for pair in PAIRS]
    jobs += [(form, FORM, seed, False) for seed in seeds(given.forms) for form in FORMS]
    jobs += [(NONE, NONE, seed, given.quick) for seed in seeds(given.free)]
    outcomes = []
    with ProcessPoolExecutor(given.workers, mp_context=get_context("spawn")) as pool:
        for future in as_completed([pool.submit(_one, job) for job in jobs]):
            try:
                outcomes.append(future.result())
            except ValueError as error:
                print(error, file=sys.stderr)
                continue
            print(json.dumps(asdict(outcomes[-1])), flush=True)
    if given.output:
        given.output.write_text(report(outcomes))


if __name__ == "__main__":
    main()
