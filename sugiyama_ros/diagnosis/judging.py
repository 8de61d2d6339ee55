"""The evidence about the final model of a search, and the judgement that rests on it."""

from collections.abc import Mapping
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, replace

from sugiyama_ros.diagnosis.adequacy import Adequacy, Evidence, judge, simulated_failures
from sugiyama_ros.diagnosis.bootstrap import widened
from sugiyama_ros.diagnosis.errors import HeldOutErrors, held_out_errors
from sugiyama_ros.diagnosis.floor import floor_of
from sugiyama_ros.diagnosis.law_check import check_laws, open_laws
from sugiyama_ros.diagnosis.locate import Located
from sugiyama_ros.diagnosis.scan import forces_left
from sugiyama_ros.diagnosis.screen import FULL
from sugiyama_ros.diagnosis.search import LEVEL, Search
from sugiyama_ros.fit.sandwich import shared_stds

# Probability below which a force that is left speaks by itself against a model; by chance it may gain 20 nats.
_SURELY = 0.001


@dataclass(frozen=True, eq=False)
class JudgedModel:
    """A judgement of the final model.

    Parameters
    ----------
    adequacy : Adequacy
        The outcome.
    evidence : Evidence
        What it rests on.
    floor : dict of str to float
        Errors of the model on recordings that it simulates.
    """

    adequacy: Adequacy
    evidence: Evidence
    floor: dict[str, float]


def judged(
    search: Search,
    located: Located,
    laws: Mapping[str, HeldOutErrors],
    work: ThreadPoolExecutor,
) -> JudgedModel:
    """Judge the final model of a search.

    A quick search simulates few recordings. Where they alone speak against the model, there are as many as in a full
    search. A scan for forces challenges the model: what is missing gets a covariate and a shape, if not a name.

    Parameters
    ----------
    search : Search
        The search at its end.
    located : Located
        Where the final model fails.
    laws : mapping of str to HeldOutErrors
        Held-out errors of other laws; without them there is no scan for forces.
    work : ThreadPoolExecutor
        Runs the filters.

    Returns
    -------
    JudgedModel
        The judgement.
    """
    stds = shared_stds(search.data, search.current, work)
    refused = [name for name, _ in search.refused]
    # what was only asked for explains nothing
    named = [one for one in search.named if one.is_supported]
    compared = (search.before, search.errors, named, located, laws)
    before = Evidence(*compared, (), (), stds, refused=refused, senseless=tuple(search.senseless.items()))
    # where samples are far apart, all evidence rests on simulations, and two of them say little
    few = search.quick and not search.data.is_sparse
    found = _judged(search, before, work, 0 if few else FULL.runs)
    is_unexplained = found.adequacy.outcome == "not_explained"
    if few and is_unexplained and judge(search.data, before).outcome != "not_explained":
        found = _judged(search, before, work, FULL.runs)
        is_unexplained = found.adequacy.outcome == "not_explained"
    # with empty samples in between, filters approximate more than two simulations tell: no force speaks there alone
    if laws and (is_unexplained or not search.data.is_sparse):
        level = LEVEL if is_unexplained else _SURELY
        left = forces_left(search.data, search.current, search.simulations(), level, work)
        evidence = replace(found.evidence, forces=left)
        found = replace(found, adequacy=judge(search.data, evidence), evidence=evidence)
    return found


def _judged(search: Search, evidence: Evidence, work: ThreadPoolExecutor, runs: int) -> JudgedModel:
    """The judgement by simulations of the final model, and by other evidence; ``runs``: number, if more than usual."""
    simulations = search.simulations(runs)
    own = [(simulated, held_out_errors(simulated, fitted, work, searched=False)) for simulated, fitted in simulations]
    open_ = open_laws(search.data, search.errors, evidence.laws)
    evidence = replace(
        evidence,
        stds=widened(evidence.stds, search.current, [fitted for _, fitted in simulations]),
        simulated=simulated_failures(simulations, work),
        checks=check_laws({name: evidence.laws[name] for name in open_}, own, work),
        own=[errors for _, errors in own],
    )
    return JudgedModel(judge(search.data, evidence), evidence, floor_of(evidence.own))
