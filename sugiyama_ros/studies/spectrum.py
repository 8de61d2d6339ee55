"""How many directions of the parameter space does the likelihood determine?"""

from typing import Any

import numpy as np

from sugiyama_ros.arrays import Array
from sugiyama_ros.driver.parameters import COUNT, RATIONALITY, defaults
from sugiyama_ros.filters import paper
from sugiyama_ros.fit.driver import calibrate
from sugiyama_ros.studies.rings import CARS, Ring, run
from sugiyama_ros.studies.study import Answer, Asked, Study
from sugiyama_ros.trajectories.dense import DenseTracks

_STEP, _DURATION_S, _FREE_RING_M = 1e-4, 250.0, 460.0
_PLACES = [k for k in range(COUNT) if k != RATIONALITY]


def _eigenvalues(trajectories: DenseTracks) -> Array:
    """Find the eigenvalues of the Hessian of the log-likelihood at every driver's fit.

    Returns (N, 11), eigenvalues in ascending order; the parameters are logarithms.
    """
    found = []
    for driver, fit in enumerate(calibrate(trajectories, "paper")):
        perceived, p = paper.perceive(trajectories, driver), fit.parameters

        def slope(logarithms: Array, p: Array = p, perceived: paper.Perceived = perceived) -> Array:
            moved = p.copy()
            moved[_PLACES] *= np.exp(logarithms)
            return np.asarray(paper.log_likelihood(perceived, moved)[1][_PLACES] * moved[_PLACES])

        steps = _STEP * np.eye(len(_PLACES))
        hessian = np.array([(slope(step) - slope(-step)) / (2.0 * _STEP) for step in steps])
        found.append(np.linalg.eigvalsh(0.5 * (hessian + hessian.T)))
    return np.array(found)


def _answer(asked: Asked) -> Answer:
    """Compare a simulated jam, simulated free flow, and the measured drivers if there are any."""
    settings = {
        "jam": run(Ring(defaults(CARS), asked.seed, jammed=True, duration_s=_DURATION_S)).dense,
        "free flow": run(Ring(defaults(CARS), asked.seed, ring_m=_FREE_RING_M, duration_s=_DURATION_S)).dense,
    }
    if asked.trajectories is not None:
        settings["measured"] = asked.trajectories
    spectra = {name: _eigenvalues(t) for name, t in settings.items()}
    rows = tuple(
        {
            "data": name,
            "negative, fewest": int((e < 0.0).sum(axis=1).min()),
            "negative, median": float(np.median((e < 0.0).sum(axis=1))),
            "negative, most": int((e < 0.0).sum(axis=1).max()),
            "below -10, median": float(np.median((e < -10.0).sum(axis=1))),
            "drivers": len(e),
        }
        for name, e in spectra.items()
    )

    def draw(figure: Any) -> None:
        for axes, (name, e) in zip(np.atleast_1d(figure.subplots(1, len(spectra))), spectra.items(), strict=True):
            axes.plot(np.arange(1, e.shape[1] + 1), np.sort(e, axis=1).T, color="tab:blue", alpha=0.3)
            axes.axhline(0.0, color="black")
            axes.set(title=name, xlabel="eigenvalue", yscale="symlog")
        figure.axes[0].set(ylabel="of the Hessian of the log-likelihood")

    return Answer(rows, draw)


STUDY = Study(
    name="spectrum",
    question="How many directions of the parameter space does the likelihood determine?",
    paper="Only four largest eigenvalues are consistently negative definite (section 4.1).",
    answer=_answer,
    takes=("source", "seed"),
)
