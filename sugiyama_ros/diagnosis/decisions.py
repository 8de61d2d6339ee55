"""How often drivers decide: a recording does not say it, and the model takes its samples for their decisions.

A camera with two or three pictures a second may see drivers who go on deciding between its pictures. A model that
decides only once for each picture lags behind them, and a drag or other effects that pull the other way then seem to be
missing.
"""

from collections.abc import Callable, Sized
from concurrent.futures import Executor, Future

import numpy as np

from sugiyama_ros.diagnosis.law_check import CLEARLY
from sugiyama_ros.diagnosis.noises import base_model, is_clear
from sugiyama_ros.diagnosis.rival_fits import RivalErrors
from sugiyama_ros.diagnosis.search import Search
from sugiyama_ros.fit.cross_validation import Gain, gain
from sugiyama_ros.fit.joint import JointFit
from sugiyama_ros.fit.recording import Recorded
from sugiyama_ros.fit.sampling import ROUNDING
from sugiyama_ros.fit.score import PointwiseDensity, unknown
from sugiyama_ros.fit.stretched import prepared
from sugiyama_ros.progress import OnStage
from sugiyama_ros.trajectories.tracks import Tracks
from sugiyama_ros.trajectories.trajectories import Trajectories

#: A search at its end, and the fits of other laws that run beside it.
Searched = tuple[Search, list[Future[dict[str, RivalErrors]]]]
# Shortest time [s] between two decisions that is tried.
_SHORTEST_S = 0.1


def searched_with_decisions(
    searched: Callable[[Recorded, JointFit], Searched],
    recording: Trajectories | Tracks,
    work: Executor,
    on_progress: OnStage,
) -> Searched:
    """Search for what is missing, and again with more decisions if they may explain what was named.

    Parameters
    ----------
    searched : callable
        Carries out a search from a base model to its end, and returns it with the fits of other laws that run beside
        it.
    recording : Trajectories or Tracks
        The recording.
    work : Executor
        Runs the filters.
    on_progress : callable
        Called with the name of the stage, the number of steps done, and the number of all steps.

    Returns
    -------
    Searched
        The search whose model predicts held-out samples better; the other's laws are given up. A search that names more
        must be better by two standard errors.
    """
    data, base = base_model(prepared(recording), work)
    usual = searched(data, base)
    finer = with_more_decisions(recording, data, base, work, on_progress) if usual[0].named else None
    if finer is None:
        return usual
    again = searched(*finer)
    new, old = again[0], usual[0]
    won = _gain((new.data, new.errors.samples), (old.data, old.errors.samples))
    better, other = (again, usual) if won.nats > lead_needed(won, new.named, old.named) else (usual, again)
    for one in other[1]:
        one.cancel()
    return better


def lead_needed(won: Gain, new: Sized, old: Sized) -> float:
    """Return the held-out gain [nats] from which a search is better than another one, by what both have named.

    Parameters
    ----------
    won : Gain
        Held-out gain of the new search over the old one.
    new, old : sequence
        The additions of both.

    Returns
    -------
    float
        0 if they name as much; otherwise the one that names more must lead by two standard errors.
    """
    return CLEARLY * won.se * float(np.sign(len(new) - len(old)))


def with_more_decisions(
    recording: Trajectories | Tracks,
    data: Recorded,
    base: JointFit,
    work: Executor,
    on_progress: OnStage = lambda what, done, total: None,
) -> tuple[Recorded, JointFit] | None:
    """Return the recording at the period from which the base model predicts its samples best, if that is clear.

    Parameters
    ----------
    recording : Trajectories or Tracks
        The recording.
    data : Recorded
        The same, prepared.
    base : JointFit
        The fitted model without effects.
    work : Executor
        Runs the filters.
    on_progress : callable
        Called with the name of the stage, the number of steps done, and the number of all steps.

    Returns
    -------
    (Recorded, JointFit) or None
        The recording with (more) empty samples in between, and the base model there; None if no shorter period is
        clearly better, and where only some of the samples count because somebody has smoothed the positions.
    """
    if data.every > data.decisions:
        return None
    found, best = None, base.samples.total
    most = int(data.apart_s / _SHORTEST_S * (1.0 + ROUNDING))
    for parts in range(data.decisions + 1, most + 1):
        on_progress("more decisions between samples", parts - data.decisions - 1, most - data.decisions)
        finer, again = base_model(prepared(recording, parts), work)
        if again.samples.total <= best:
            break
        found, best = (finer, again), again.samples.total
    if found is None:
        return None
    finer, again = found
    won = _gain((finer, again.samples), (data, base.samples))
    return found if is_clear(won) else None


def _gain(finer: tuple[Recorded, PointwiseDensity], usual: tuple[Recorded, PointwiseDensity]) -> Gain:
    """Gain of the predictions of a recording with more decisions, on the samples in which vehicles are measured."""
    data = usual[0]
    return gain(data, *(_where_measured(data, samples, one.every) for one, samples in (finer, usual)))


def _where_measured(data: Recorded, samples: PointwiseDensity, every: int) -> PointwiseDensity:
    """The predictions of one sample of so many, at the places of measured samples in ``data``."""
    known = unknown(data.drivers, data.samples)
    known.log_likelihood[:, :: data.every] = samples.log_likelihood[:, ::every]
    return known
