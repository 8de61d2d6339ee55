"""At which density does free flow end?"""

from typing import Any

from sugiyama_ros.driver.parameters import KAPPA_V, SIGMA_A
from sugiyama_ros.studies.rings import Ring, alike, changed, outcomes, summed_up
from sugiyama_ros.studies.study import Answer, Asked, Study

# The mean of the regularised estimates [s], and a noise [m/s^2] with which dense traffic seldom collides.
_KAPPA_V, _SIGMA_A = 0.27, 0.1


def _answer(asked: Asked) -> Answer:
    """Simulate flow over density on 314 m, from equal gaps and out of a jam.

    Where the two curves part, the flow has two branches.
    """
    ring_m, counts = 314.0, (16, 20, 24, 26, 28, 30, 32, 34, 36, 40)
    rows: list[dict[str, Any]] = []
    for jammed, start in ((False, "equal gaps"), (True, "out of a jam")):
        for cars in counts:
            drivers = changed(changed(alike(cars), KAPPA_V, _KAPPA_V), SIGMA_A, _SIGMA_A)
            rings = [Ring(drivers, asked.seed + k, jammed=jammed, ring_m=ring_m) for k in range(asked.runs)]
            found = summed_up(outcomes(rings, asked.work))
            rows.append({"start": start, "cars": cars, "density [1/km]": 1e3 * cars / ring_m, **found})

    def draw(figure: Any) -> None:
        axes = figure.subplots()
        for start in ("equal gaps", "out of a jam"):
            of = [r for r in rows if r["start"] == start]
            axes.plot([r["density [1/km]"] for r in of], [r["flow [1/h]"] for r in of], "o-", label=start)
        axes.set(xlabel="density [1/km]", ylabel="flow [1/h]")
        axes.legend()

    return Answer(tuple(rows), draw)


STUDY = Study(
    name="tadaki",
    question="At which density does free flow end?",
    paper="The fundamental diagram and the critical region of density are reproduced (section 6.3).",
    answer=_answer,
)
