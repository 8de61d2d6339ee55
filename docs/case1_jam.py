"""The table of the jam in docs/case1.md: what was added, fitted to the first 60 % and scored on the last 40 %.

sugiyama diagnose case1.data --add auto --json > case1.json
python docs/case1_jam.py case1.data case1.json
"""

import json
import sys
from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace
from pathlib import Path

from sugiyama_ros.diagnosis.discover import discover
from sugiyama_ros.diagnosis.errors import errors_of
from sugiyama_ros.diagnosis.screen import refine, with_candidate

from sugiyama_ros.diagnosis.candidates import candidates
from sugiyama_ros.driver.parameters import KAPPA_V, V_STAR
from sugiyama_ros.effects.discovered_force import COVARIATES
from sugiyama_ros.fit.joint import JointFit
from sugiyama_ros.fit.law import in_filter
from sugiyama_ros.fit.population import fit_base
from sugiyama_ros.fit.recording import FOLDS, Recorded, prepare
from sugiyama_ros.formats.registry import read_trajectories
from sugiyama_ros.trajectories.trajectories import Trajectories

_FITTED = 0.6


def part(t: Trajectories, first: int, last: int) -> Recorded:
    """The samples from ``first`` to ``last``."""
    return prepare(replace(t, position_m=t.position_m[first:last], start_s=first * t.period_s))


def main(source: Path, document: Path) -> None:
    """Print the table."""
    t = read_trajectories(source, 230.0)
    split = round(_FITTED * len(t.position_m))
    early, late = part(t, 0, split), part(t, split, len(t.position_m))
    with ThreadPoolExecutor(4) as work:

        def row(name: str, fitted: JointFit) -> None:
            seen, unseen = (errors_of(data, [fitted.model] * FOLDS, work).summary() for data in (early, late))
            errors = [
                ", ".join(f"{unseen[f'{run}_{h}s_m']:.2f}" for h in (2, 5, 10)) for run in ("free_run", "single_car")
            ]
            figures = (f"{seen['loglik_per_sample']:.3f}", f"{unseen['loglik_per_sample']:.3f}", *errors)
            print("| " + " | ".join((name, *figures)) + " |", flush=True)

        fitted = fit_base(early, early.even.individual(V_STAR, KAPPA_V), work)
        row("base", fitted)
        possible = {c.name: c for c in candidates(early)}
        for named in json.loads(document.read_text())["verdict"]["effects"]:
            if named["form"] in possible:
                fitted = with_candidate(early, fitted, possible[named["form"]], work)
                row(f"+ {named['form']}", fitted)
            else:
                covariate = COVARIATES[round(named["parameters"]["covariate"]) - 1]
                look = next(look for force, look in discover(early, fitted, work) if force.covariate == covariate)
                fitted = refine(early, look, work)
                row(f"+ a force over {covariate}", fitted)
        for law, name in (("idm", "IDM"), ("fvdm", "FVDM")):
            row(f"{name} in the same filter", in_filter(early, law, work))


if __name__ == "__main__":
    main(Path(sys.argv[1]), Path(sys.argv[2]))
