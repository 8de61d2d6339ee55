"""Benchmark of the diagnosis: how often it finds the effect that is hidden in a simulated recording.

    python -m sugiyama_ros.studies.hidden_effects --seeds 10 -o docs/hidden_effects.md

`sugiyama_ros.studies.hiding` simulates the recordings. The true effect, added and fitted, gains some 100-300 nats in
its strong form and 20-50 nats in its weak form. Forces that are not in the catalogue of effects have no name: the
diagnosis is right if it finds a force without a name, or nothing.
"""

import argparse
import json
import sys
from concurrent.futures import ProcessPoolExecutor, as_completed
from dataclasses import asdict
from multiprocessing import get_context
from pathlib import Path

from sugiyama_ros.diagnosis.diagnose import diagnose
from sugiyama_ros.diagnosis.table import Entry
from sugiyama_ros.effects.discovered_force import COVARIATES
from sugiyama_ros.effects.effect import Values
from sugiyama_ros.outputs import writing
from sugiyama_ros.page.document import additions
from sugiyama_ros.studies.hiding import STRENGTHS, hide_all
from sugiyama_ros.studies.judgement import FORM, FORMS, NONE, PAIR, PAIRS, Judgement
from sugiyama_ros.studies.judgement_report import report
from sugiyama_ros.trajectories.trajectories import Trajectories

#: A recording to judge: what is hidden, its strength, and the seed.
Job = tuple[str, str, int]


def judge(hidden: str, strength: str, measured: Trajectories, seed: int) -> Judgement:
    """Diagnose one recording.

    strength: ``strong``, ``weak``, ``NONE``, ``PAIR`` or ``FORM``.
    """
    d = diagnose(measured, seed=seed, most=2 if strength in (PAIR, FORM) else 1, workers=1)
    found, begin = additions(d), d.rounds[0]
    first = found[0] if found else None
    return Judgement(
        hidden=hidden,
        strength=strength,
        seed=seed,
        first=first.name if first else NONE,
        named=tuple(one.name for one in found),
        indistinguishable=tuple(first.indistinguishable) if first else (),
        p_value=first.p_value if first else 1.0,
        gain=first.heldout_gain_nats if first else 0.0,
        oracle_gain=max((s.gain for s in begin.scores if s.candidate.mechanism == hidden), default=0.0),
        oracle_heldout=max(
            (g["all"].nats for e, g in zip(begin.entries, begin.gains, strict=True) if _is_of(e, hidden)), default=0.0
        ),
        discovered=tuple(one.covariate for one in found if one.covariate),
        wall_s=d.wall_s,
    )


def _is_of(entry: Entry, hidden: str) -> bool:
    """Whether a model has what is hidden, and nothing else."""
    return [one.mechanism for one in entry.added] == [hidden]


def _one(job: Job) -> Judgement:
    """Simulate one recording and diagnose it."""
    hidden, strength, seed = job
    effects: dict[str, Values] = {}
    if strength == FORM:
        covariate, low, high, values = FORMS[hidden]
        force = {f"force_{k}": v for k, v in enumerate(values)}
        number = float(1 + COVARIATES.index(covariate))
        effects["discovered_force"] = {"covariate": number, "first": low, "last": high, **force}
    elif hidden != NONE:
        effects = {name: STRENGTHS[name][-1 if strength == "weak" else 0] for name in hidden.split("+")}
    run, _ = hide_all(effects, seed)
    return judge(hidden, strength, run.measured, seed)


def _parsed() -> argparse.Namespace:
    """Read the arguments of the command."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--seeds", type=int, default=10, help="recordings of each effect in each strength")
    parser.add_argument("--first-seed", type=int, default=0, help="first seed")
    parser.add_argument("--free", type=int, default=40, help="recordings without an effect")
    parser.add_argument("--pairs", type=int, default=10, help="recordings of each pair of effects")
    parser.add_argument("--forms", type=int, default=2, help="recordings of each force that is not in the catalogue")
    parser.add_argument("--strength", choices=["strong", "weak", "both"], default="both", help="form of the effects")
    parser.add_argument("--effects", nargs="*", default=list(STRENGTHS), help="names of the effects")
    parser.add_argument("--workers", type=int, default=4, help="number of processes")
    parser.add_argument("-o", "--output", type=Path, help="report to write (Markdown)")
    return parser.parse_args()


def _jobs(given: argparse.Namespace) -> list[Job]:
    """List all recordings."""

    def seeds(count: int) -> range:
        return range(given.first_seed, given.first_seed + count)

    strengths = ["strong", "weak"] if given.strength == "both" else [given.strength]
    jobs = [(e, s, seed) for seed in seeds(given.seeds) for s in strengths for e in given.effects]
    jobs += [("+".join(pair), PAIR, seed) for seed in seeds(given.pairs) for pair in PAIRS]
    jobs += [(form, FORM, seed) for seed in seeds(given.forms) for form in FORMS]
    jobs += [(NONE, NONE, seed) for seed in seeds(given.free)]
    return jobs


def main() -> None:
    """Run the benchmark and write its report. Judgements are printed as JSON lines."""
    given = _parsed()
    outcomes = []
    with ProcessPoolExecutor(given.workers, mp_context=get_context("spawn")) as pool:
        for future in as_completed([pool.submit(_one, job) for job in _jobs(given)]):
            try:
                outcomes.append(future.result())
            except ValueError as error:
                print(error, file=sys.stderr)
                continue
            print(json.dumps(asdict(outcomes[-1])), flush=True)
    if given.output:
        with writing(given.output) as stream:
            stream.write(report(outcomes).encode())


if __name__ == "__main__":
    main()
