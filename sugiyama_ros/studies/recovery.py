"""Are the parameters of simulated drivers found again, and are the stated errors right?"""

from collections.abc import Sequence
from typing import Any

import numpy as np

from sugiyama_ros.arrays import Array
from sugiyama_ros.calibration.calibrate import each_driver
from sugiyama_ros.calibration.result import Settings
from sugiyama_ros.driver.parameters import defaults, index
from sugiyama_ros.filters import causal
from sugiyama_ros.filters.extract import chain_behind
from sugiyama_ros.fit.driver import Formulation
from sugiyama_ros.fit.smooth_positions import ESTIMATED
from sugiyama_ros.simulation.result import Simulation
from sugiyama_ros.studies.rings import CARS, jams
from sugiyama_ros.studies.study import Answer, Asked, Row, Study

#: Duration [s] of a simulated run.
DURATION_S = 250.0
# Places of the speed and of the acceleration in the state of the filter.
_PLACES = 1, 3
_FORMULATIONS: tuple[Formulation, ...] = ("paper", "causal")


def _answer(asked: Asked) -> Answer:
    """Simulate drivers with the paper's mean parameters from gaps of 2 m, and fit them.

    The table has the bias and the std of a fit, and the share of 95 % profile intervals that contain the truth. The
    figure has the estimates, and below them speed and acceleration of one driver, as in the paper.
    """
    places = [index(name) for name in ESTIMATED]
    truth = defaults(CARS)[0, places]
    errors: dict[str, list[Array]] = {f: [] for f in _FORMULATIONS}
    intervals: dict[str, list[Array]] = {f: [] for f in _FORMULATIONS}
    shown: tuple[Simulation, Array] | None = None
    for simulated in jams({}, asked.runs, asked.seed, DURATION_S):
        for f in _FORMULATIONS:
            found = each_driver(simulated.dense, Settings(f, profiled=True), work=asked.work)
            errors[f].append(found.rows[:, places] - truth)
            intervals[f].append(found.interval[:, places])
        shown = shown or (simulated, found.rows[0])
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
        above, below = figure.subfigures(2, 1)
        for j, (axes, name) in enumerate(zip(above.subplots(1, len(ESTIMATED)), ESTIMATED, strict=True)):
            for f in _FORMULATIONS:
                axes.hist(np.concatenate(errors[f])[:, j] + truth[j], bins=25, alpha=0.6, label=f)
            axes.axvline(truth[j], color="black")
            axes.set(xlabel=name)
        axes.legend()
        if shown is not None:
            _draw_fit(below.subplots(1, 2), *shown)

    return Answer(tuple(rows), draw)


def _draw_fit(panels: Sequence[Any], simulated: Simulation, row: Array) -> None:
    """Draw speed and acceleration of the first driver: the truth, and what the fitted filter says, with one std."""
    filtered = causal.filter_chain(chain_behind(simulated.dense, 0), row)
    time_s = simulated.dense.time_s
    for axes, place, name, truth in zip(
        panels,
        _PLACES,
        ("speed [m/s]", "acceleration [m/s²]"),
        (simulated.speed, simulated.acceleration),
        strict=True,
    ):
        value, std = filtered.mean[:, place], np.sqrt(filtered.covariance[:, place, place])
        axes.plot(time_s, truth[:, 0], color="black", linewidth=0.8, label="truth")
        axes.plot(time_s, value, color="tab:orange", linewidth=0.8, label="fitted filter")
        axes.fill_between(time_s, value - std, value + std, alpha=0.3, color="tab:orange", linewidth=0.0)
        axes.set(xlabel="time [s]", ylabel=name)
    panels[0].legend()


STUDY = Study(
    name="recovery",
    question="Are simulated drivers found again?",
    paper="No systematic bias; statistical errors 0.01 m, 0.02 m/s², 0.05 m/s, 0.01 s (section 4.3).",
    answer=_answer,
    takes=("runs", "seed"),
)
