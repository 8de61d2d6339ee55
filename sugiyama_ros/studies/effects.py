"""Are the parameters of hidden effects found again, and are their stated errors right?"""

from collections import defaultdict
from concurrent.futures import ThreadPoolExecutor
from typing import Any, NamedTuple

import numpy as np

from sugiyama_ros.diagnosis.refine import with_named
from sugiyama_ros.driver.parameters import KAPPA_V, V_STAR
from sugiyama_ros.effects.registry import ROW, index_of
from sugiyama_ros.fit.joint import fit_base
from sugiyama_ros.fit.recording import prepare
from sugiyama_ros.fit.sandwich import shared_stds
from sugiyama_ros.studies.hiding import RING_M, STRENGTHS, hide
from sugiyama_ros.studies.study import Answer, Asked, Row, Study

# A normal error is within this many standard errors in 95 of 100 cases.
_SURE = 1.96


class FoundAgain(NamedTuple):
    """A parameter of a hidden effect: its true value, its fitted value and the standard error, in its own unit."""

    name: str
    truth: float
    value: float
    std: float


def found_again(job: tuple[str, int]) -> list[FoundAgain]:
    """Hide an effect in its strong form, add it to the fitted model as a diagnosis does, and return what was found."""
    effect, seed = job
    try:
        run, truth = hide(effect, STRENGTHS[effect][0], seed)
    except ValueError:
        return []
    with ThreadPoolExecutor(1) as work:
        data = prepare(run.measured)
        base = fit_base(data, data.even.individual(V_STAR, KAPPA_V), work)
        fitted = with_named(data, base, [effect], work)
        stds = shared_stds(data, fitted, work)
    return [
        FoundAgain(
            f"{effect}.{name}", value, float(fitted.model.rows[0, index_of(effect, name)]), stds[f"{effect}.{name}"]
        )
        for name, value in truth.items()
        if f"{effect}.{name}" in stds
    ]


def _standardised(found: FoundAgain) -> float:
    """The error of a fit over its standard error; a place counts around the ring."""
    error = found.value - found.truth
    if ROW.declared[ROW.entries.index(found.name)].axis == "place":
        error -= RING_M * round(error / RING_M)
    return error / found.std


def _answer(asked: Asked) -> Answer:
    """Hide every effect in some recordings, and fit it.

    The table has, for each parameter, the medians of truth, fit and standard error, the mean and the spread of the
    errors over their standard errors, and the share of 95 % intervals that contain the truth.
    """
    jobs = [(effect, asked.seed + k) for effect in STRENGTHS for k in range(asked.runs)]
    found: dict[str, list[FoundAgain]] = defaultdict(list)
    for one in (one for several in asked.work.map(found_again, jobs) for one in several):
        found[one.name].append(one)
    z = {name: np.array([_standardised(one) for one in several]) for name, several in found.items()}
    rows: list[Row] = [
        {
            "parameter": name,
            "truth": float(np.median([one.truth for one in several])),
            "median": float(np.median([one.value for one in several])),
            "median error": float(np.median([one.std for one in several])),
            "mean z": float(z[name].mean()),
            "std of z": float(z[name].std(ddof=1)) if len(several) > 1 else np.nan,
            "coverage of 95 %": float(np.mean(np.abs(z[name]) < _SURE)),
            "fits": len(several),
        }
        for name, several in found.items()
    ]

    def draw(figure: Any) -> None:
        axes = figure.subplots()
        for k, name in enumerate(found):
            axes.plot(z[name], np.full(len(z[name]), k), "o", color="C0")
        for side in (-_SURE, _SURE):
            axes.axvline(side, color="black", linestyle=":")
        axes.set(xlabel="error / standard error", yticks=range(len(found)), yticklabels=list(found))

    return Answer(tuple(rows), draw)


STUDY = Study(
    name="effects",
    question="Are the parameters of hidden effects found again, and do their intervals hold?",
    paper="The paper has no effects besides its model; further effects are left to later work (outlook).",
    answer=_answer,
)
