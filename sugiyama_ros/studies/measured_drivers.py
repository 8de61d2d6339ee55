"""What are the parameters of the measured drivers, in both formulations?"""

from typing import Any

import numpy as np

from sugiyama_ros.calibration.calibrate import each_driver
from sugiyama_ros.calibration.result import Settings
from sugiyama_ros.driver.parameters import index
from sugiyama_ros.filters import causal
from sugiyama_ros.filters.extract import chain_behind
from sugiyama_ros.filters.paper import smoothed_speed
from sugiyama_ros.fit.driver import Formulation
from sugiyama_ros.fit.smooth_positions import ESTIMATED
from sugiyama_ros.studies.study import Answer, Asked, Row, Study

_VARIANTS: tuple[tuple[str, Formulation, bool], ...] = (
    ("paper", "paper", False),
    ("paper, regularised", "paper", True),
    ("causal", "causal", False),
)


def _answer(asked: Asked) -> Answer:
    """Fit the measured drivers. The table has the mean and the std over the drivers.

    The figure shows the filtered speeds of three drivers with bands of one standard deviation.
    """
    t = asked.measured
    rows: list[Row] = []
    for name, formulation, is_regularised in _VARIANTS:
        settings = Settings(formulation, is_regularised=is_regularised)
        found = each_driver(t, settings, work=asked.work)
        row: dict[str, Any] = {"formulation": name}
        for parameter in ESTIMATED:
            known = np.array([one[parameter] for one in found.identified])
            values = found.rows[known, index(parameter)]
            # what is not known is shown as "-"
            row[parameter] = float(values.mean()) if len(values) else np.nan
            row[f"{parameter}, std"] = float(values.std(ddof=1)) if len(values) > 1 else np.nan
        row["log-likelihood"] = float(found.log_likelihood.sum())
        row["not identified"] = ", ".join(
            f"{p} of {v}" for v, one in zip(t.vehicle, found.identified, strict=True) for p in ESTIMATED if not one[p]
        )
        rows.append(row)
    speed = smoothed_speed(t.road.unwrap(t.position_m), 1, t.period_s)

    def draw(figure: Any) -> None:
        shown = np.linspace(0, len(t.vehicle) - 1, 3).astype(int)
        time = t.start_s + np.arange(len(t.position_m)) * t.period_s
        for axes, i in zip(figure.subplots(3, 1, sharex=True), shown, strict=True):
            f = causal.filter_chain(chain_behind(t, int(i)), found.rows[i])
            v, std = f.mean[:, 1], np.sqrt(f.covariance[:, 1, 1])
            axes.plot(time, speed[:, i], label="smoothed measurement")
            axes.plot(time, v, label="causal filter")
            axes.fill_between(time, v - std, v + std, alpha=0.3, color="tab:orange")
            axes.set(ylabel=f"vehicle {t.vehicle[i]}: speed [m/s]", ylim=(-1, 14))
        axes.set(xlabel="time [s]")
        figure.axes[0].legend(loc="upper right")

    return Answer(tuple(rows), draw)


STUDY = Study(
    name="measured",
    question="What are the measured drivers like?",
    paper=(
        "Means 0.263 m, 10.26 m/s, 0.215 s; sigma_a up to five times 0.273 m/s²; v* up to 14 m/s"
        " (sections 5.1 and 5.2)."
    ),
    answer=_answer,
    takes=("source",),
)
