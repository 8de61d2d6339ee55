"""Are simulated drivers found again, and do the errors hold?"""

from typing import Any

import numpy as np

from sugiyama_ros.criticism.calibrated import each_for_himself
from sugiyama_ros.driver.parameters import index
from sugiyama_ros.estimation.calibration import ESTIMATED, Formulation
from sugiyama_ros.road import Array
from sugiyama_ros.studies.rings import Ring, alike, run
from sugiyama_ros.studies.study import Answer, Asked, Row, Study

_DURATION_S = 250.0
_FORMULATIONS: tuple[Formulation, ...] = ("paper", "causal")


def answer(asked: Asked) -> Answer:
    """Drivers at the paper's mean parameters, from gaps of 2 m; std and bias of a fit, coverage of 95 % intervals."""
    truth = alike()[0, [index(name) for name in ESTIMATED]]
    errors: dict[str, list[Array]] = {f: [] for f in _FORMULATIONS}
    stds: dict[str, list[Array]] = {f: [] for f in _FORMULATIONS}
    for k in range(asked.runs):
        simulated = run(Ring(alike(), asked.seed + k, jammed=True, duration_s=_DURATION_S))
        if simulated.collisions:
            continue
        for f in _FORMULATIONS:
            found = each_for_himself(simulated.measured, f, ESTIMATED, work=asked.work)
            errors[f].append(found.rows[:, [index(name) for name in ESTIMATED]] - truth)
            stds[f].append(np.array([[std[name] for name in ESTIMATED] for std in found.std]))
    rows: list[Row] = []
    for f in _FORMULATIONS:
        error, std = np.concatenate(errors[f]), np.concatenate(stds[f])
        # intervals of the logarithms: all four are positive
        z = np.log1p(error / truth) * (truth + error) / std
        for j, name in enumerate(ESTIMATED):
            rows.append(
                {
                    "formulation": f,
                    "parameter": name,
                    "truth": truth[j],
                    "bias": float(error[:, j].mean()),
                    "bias error": float(error[:, j].std(ddof=1) / np.sqrt(len(error))),
                    "std of a fit": float(error[:, j].std(ddof=1)),
                    "coverage of 95 %": float(np.mean(np.abs(z[:, j]) < 1.96)),
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
    "recovery",
    "Are simulated drivers found again?",
    "No systematic bias; statistical errors 0.01 m, 0.02 m/s², 0.05 m/s, 0.01 s (section 4.3).",
    answer,
)
