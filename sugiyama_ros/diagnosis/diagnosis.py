"""A diagnosis: what is missing from the model, where it fails, and what it is worth beside others."""

import time
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from functools import partial

from sugiyama_ros.diagnosis.discover import Discovery, discover
from sugiyama_ros.diagnosis.errors import Errors, errors_of
from sugiyama_ros.diagnosis.locate import Located, locate
from sugiyama_ros.diagnosis.rivals import by_gaps, has_parameters, in_filter
from sugiyama_ros.diagnosis.screen import Glance
from sugiyama_ros.diagnosis.search import LEVEL, Looked, Named, Search
from sugiyama_ros.driver.parameters import KAPPA_V, SIGMA_A, SIGMA_NU, V_STAR
from sugiyama_ros.fit.cross_validation import Gain, without_folds
from sugiyama_ros.fit.joint import Fit
from sugiyama_ros.fit.population import fit_base
from sugiyama_ros.fit.recording import Recorded, prepare
from sugiyama_ros.laws.registry import RIVALS
from sugiyama_ros.progress import OnStage
from sugiyama_ros.trajectories.trajectories import Trajectories

#: Each driver's own parameters.
INDIVIDUAL = (SIGMA_NU, SIGMA_A, V_STAR, KAPPA_V)


@dataclass(frozen=True, eq=False)
class Diagnosis:
    """Verdict on a recording; fits: the base model's and the last one's; looked: first round, best first."""

    data: Recorded
    base: Fit
    final: Fit
    named: tuple[Named, ...]
    looked: tuple[Looked, ...]
    heldout: dict[str, Gain]
    discovered: tuple[Discovery, ...]
    before: Errors
    after: Errors
    where_before: Located
    where_after: Located
    smallest: dict[str, float]
    rivals: dict[str, dict[str, float]]
    bootstrap_runs: int
    quick: bool
    seed: int
    wall_s: float


def diagnose(
    trajectories: Trajectories,
    *,
    seed: int = 0,
    quick: bool = False,
    most: int = 3,
    verdict_only: bool = False,
    add_forces: bool = False,
    workers: int = 4,
    on_progress: OnStage = lambda what, done, total: None,
) -> Diagnosis:
    """Find what is missing: at most ``most`` effects, one after the other.

    verdict_only: leave out the rivals and the forces without a name; add_forces: add the best of these at the end.

    Raises InputError for a recording that is too short.
    """
    began = time.monotonic()
    with ThreadPoolExecutor(workers) as work, ThreadPoolExecutor(len(RIVALS)) as aside:
        on_progress("fitting the base model", 0, 1)
        data = prepare(trajectories)
        # beside the search, which cannot always use all workers
        rival = partial(_rival, data, work, quick)
        others = aside.map(rival, [] if verdict_only else RIVALS)
        base = fit_base(data, INDIVIDUAL, work)
        search = Search(data, base, quick, seed, work, on_progress)
        before = search.errors
        forces: list[tuple[Discovery, Glance]] = []
        is_growing = True
        while is_growing:
            while len(search.named) < most and search.add_effect():
                pass
            if forces or quick or verdict_only:
                break
            on_progress("forces without a name", 0, 1)
            forces = [one for one in discover(data, search.current, work) if one[0].p_value < LEVEL]
            # with a force, something may be supported that was not
            is_growing = add_forces and search.add_force(forces)
        on_progress("rival models", 0, 1)
        rivals = {name: errors for found in others for name, errors in found.items()}
        on_progress("where it fails", 0, 1)
        compared = ((base, before), (search.current, search.errors))
        where = [locate(data, one.model, e.samples, work) for one, e in compared]
    return Diagnosis(
        data,
        base,
        search.current,
        tuple(search.named),
        tuple(search.looked),
        search.heldout,
        tuple(force for force, _ in forces),
        before,
        search.errors,
        where[0],
        where[1],
        search.smallest,
        rivals,
        search.effort.runs,
        quick,
        seed,
        time.monotonic() - began,
    )


def _rival(data: Recorded, work: ThreadPoolExecutor, quick: bool, law: str) -> dict[str, dict[str, float]]:
    """Errors of a rival calibrated in the filter, and, but for ``quick``, of the same by least squares on gaps."""
    fitted = in_filter(data, law, work)
    found = {law: errors_of(data, without_folds(data, fitted, work, searched=not quick), work).summary()}
    if not quick and has_parameters(law):
        found[f"{law}_least_squares"] = errors_of(data, by_gaps(data, law, fitted, work), work).summary()
    return found
