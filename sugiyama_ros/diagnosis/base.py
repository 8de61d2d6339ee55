"""The model that a diagnosis begins with, and the other car-following laws that its model has to be ahead of.

The paper keeps the noises of position and speed at constants that suit its recording. Where vehicles move more evenly,
the constants leave the driver model nothing to explain: the noise of the acceleration goes to 0, and the innovations
are too small. And a camera with two or three pictures a second may see drivers who decide between its pictures.
"""

from concurrent.futures import Executor, ThreadPoolExecutor
from dataclasses import replace

import numpy as np

from sugiyama_ros.diagnosis.candidates import Candidate
from sugiyama_ros.diagnosis.forecast import forecasts
from sugiyama_ros.diagnosis.refine import without_folds
from sugiyama_ros.diagnosis.score import directions, scores
from sugiyama_ros.diagnosis.table import Entry, paired
from sugiyama_ros.driver.parameters import index
from sugiyama_ros.effects.registry import ROW
from sugiyama_ros.filters.abreast import ABREAST
from sugiyama_ros.fit.joint import NEAR_STEPS, JointFit, fit, fit_nearly
from sugiyama_ros.fit.law import in_filter, start_of_drivers
from sugiyama_ros.fit.model import PointwiseDensity, unknown
from sugiyama_ros.fit.preparation import prepare
from sugiyama_ros.fit.recording import MOST_SAMPLES, Recorded, some_drivers
from sugiyama_ros.fit.smooth_positions import FREED, ROUNDING
from sugiyama_ros.laws.registry import LAWS, PAPERS, name_of
from sugiyama_ros.progress import OnStage
from sugiyama_ros.results import CLEARLY
from sugiyama_ros.statistics import sum_error
from sugiyama_ros.trajectories.tracks import Tracks

# Standard errors by which another base model must be better: a missing effect makes it a little better, too.
_CLEAR = 5.0
_NOISES = Candidate("noises", "noises", "noise", tuple(map(index, FREED)), ({},))


def base_model(data: Recorded, work: Executor, law: str = PAPERS) -> tuple[Recorded, JointFit]:
    """Fit the base model, and fit the noises of position and speed as well if that is clearly better."""
    others = law != PAPERS or bool(np.isfinite(data.lines[:, :, 0]).any())
    if others and not data.even.frees_noises:
        # the fixed noises are those of the paper's drivers in a jam; drivers of another law, and at junctions, have
        # their own
        data = replace(data, even=data.even._replace(has_other_noises=True))
    base = in_filter(data, law, work)
    if data.even.frees_noises:
        return data, base
    # each parameter of each driver gains about one nat that held-out samples do not confirm
    by_chance = len(FREED) * data.drivers
    look = scores(data, base, directions(data, base, [_NOISES], work), work)
    if max((one.gain for one in look), default=0.0) < by_chance:
        return data, base
    freed = replace(data, even=data.even._replace(has_other_noises=True))
    again = in_filter(freed, law, work)
    won = paired(data, again.samples, base.samples)
    return (freed, again) if won.nats - by_chance > _CLEAR * won.se else (data, base)


def with_more_decisions(
    recording: Tracks,
    data: Recorded,
    base: JointFit,
    work: Executor,
    on_progress: OnStage = lambda what, done, total: None,
    law: str = PAPERS,
    searched: int = MOST_SAMPLES,
) -> tuple[Recorded, JointFit] | None:
    """Return the recording at the period from which the base model predicts its samples best, and the base model there.

    None if no shorter period is clearly better, and where only some of the samples count because somebody has smoothed
    the positions. searched: drivers times samples, at most.
    """
    if data.every > data.decisions:
        return None
    found, best = None, base.samples.total
    # nobody decides more often than ten times a second
    most = int(data.apart_s / 0.1 * (1.0 + ROUNDING))
    for parts in range(data.decisions + 1, most + 1):
        on_progress("more decisions between samples", parts - data.decisions - 1, most - data.decisions)
        finer = prepare(recording, parts, searched)
        if fit(replace(finer, even=data.even), base.model, work, iterations=NEAR_STEPS).samples.total <= best:
            break
        finer, again = base_model(finer, work, law)
        if again.samples.total <= best:
            break
        found, best = (finer, again), again.samples.total
    if found is None:
        return None
    finer, again = found
    ours, theirs = (_where_measured(data, *one) for one in ((again.samples, finer.every), (base.samples, data.every)))
    won = paired(data, ours, theirs)
    return found if won.nats > _CLEAR * won.se else None


def _where_measured(data: Recorded, samples: PointwiseDensity, every: int) -> PointwiseDensity:
    """The predictions of one sample of so many, at the places of measured samples in ``data``."""
    known = unknown(data.drivers, data.samples)
    known.log_likelihood[:, :: data.every] = samples.log_likelihood[:, ::every]
    return known


def laws(data: Recorded, final: Entry, work: ThreadPoolExecutor) -> tuple[Entry, ...]:
    """Fit all other laws that are not far behind a model one step ahead."""
    own = name_of(float(final.fit.model.rows[0, ROW.law]))
    found = []
    for law in LAWS:
        if law == own or _is_far_behind(data, law, final, work):
            continue
        fitted = in_filter(data, law, work)
        models = without_folds(data, fitted, work)
        found.append(Entry(law, (), fitted, models, forecasts(data, models, work)))
    return tuple(found)


def _is_far_behind(data: Recorded, law: str, final: Entry, work: ThreadPoolExecutor) -> bool:
    """Whether a law predicts some drivers one step ahead clearly worse, although it was fitted to these samples."""
    if data.drivers <= 2 * ABREAST:
        return False
    who = [k * data.drivers // ABREAST for k in range(ABREAST)]
    some = some_drivers(data, who)
    start = start_of_drivers(some, law)
    fitted = fit_nearly(some, start.individual, work, start)
    ahead = np.nansum(final.forecasts.one_step[who], axis=1) - np.nansum(fitted.samples.log_likelihood, axis=1)
    return bool(ahead.sum() > 2.0 * CLEARLY * sum_error(ahead))
