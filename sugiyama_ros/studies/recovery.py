"""Are the parameters of simulated drivers found again, and are the stated errors right?"""

from typing import Any

import numpy as np

from sugiyama_ros.arrays import Array
from sugiyama_ros.calibration.calibrate import each_driver
from sugiyama_ros.calibration.result import Settings
from sugiyama_ros.driver.parameters import defaults, index
from sugiyama_ros.fit.driver import Formulation
from sugiyama_ros.fit.smooth_positions import ESTIMATED
from sugiyama_ros.studies.rings import CARS, jams
from sugiyama_ros.studies.study import Answer, Asked, Row, Study

#: Duration [s] of a simulated run.
DURATION_S = 250.0
_FORMULATIONS: tuple[Formulation, ...] = ("paper", "causal")


def _answer(asked: Asked) -> Answer:
    """Simulate drivers with the paper's mean parameters from gaps of 2 m, and fit them.

    The table has the bias and the std of a fit, and the share of 95 % profile intervals that contain the truth.
    """
    places = [index(name) for name in ESTIMATED]
    truth = defaults(CARS)[0, places]
    errors: dict[str, list[Array]] = {f: [] for f in _FORMULATIONS}
    intervals: dict[str, list[Array]] = {f: [] for f in _FORMULATIONS}
    for _, measured in jams({}, asked.runs, asked.seed, DURATION_S):
        for f in _FORMULATIONS:
            found = each_driver(measured, Settings(f, profiled=True), work=asked.work)
            errors[f].append(found.rows[:, places] - truth)
            intervals[f].append(found.interval[:, places])
    rows: list[Row] = []
    for f in _FORMULATIONS:
        error, interval = np.concatenate(errors[f]), np.concatenate(intervals[f])
        for j, name in enumerate(ESTIMATED):
            rows.append(
                {
                    "formulation": f,
                    "parameter": name,
                    "truth": truth[j],
                    "bias": float(error[:, j].mean()),
                    "bias error": float(error[:, j].std(ddof=1) / np.sqrt(len(error))),
                    "std of a fit": float(error[:, j].std(ddof=1)),
                    "coverage of 95 %": float(np.mean((interval[:, j, 0] < truth[j]) & (truth[j] < interval[:, j, 1]))),
                    "fits": len(error),
                }
            )

    def draw(figure: Any) -> None:
        for j, (axes, name) in enumerate(zip(figure.subplots(1, len(ESTIMATED)), ESTIMATED, strict=True)):
            for f in _FORMULATIONS:
                axes.hist(np.concatenate(errors[f])[:, j] + truth[j], bins=25, alpha=0.6, label=f)
            axes.axvline(truth[j], color="black")
            axes.set(xlabel=name)
        axes.legend()

    return Answer(tuple(rows), draw)


STUDY = Study(
    name="recovery",
    question="Are simulated drivers found again?",
    paper="No systematic bias; statistical errors 0.01 m, 0.02 m/s², 0.05 m/s, 0.01 s (section 4.3).",
    answer=_answer,
)
