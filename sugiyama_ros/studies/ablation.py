"""Do waves need drivers who differ, or noise?"""

from collections.abc import Callable

from sugiyama_ros.arrays import Array
from sugiyama_ros.driver.parameters import SIGMA_A
from sugiyama_ros.studies.cases import compare
from sugiyama_ros.studies.rings import Ring, changed, estimated, mean_driver
from sugiyama_ros.studies.study import Answer, Asked, Study


def _answer(asked: Asked) -> Answer:
    """Switch the differences between drivers and the acceleration noise on and off.

    Waves that form from equal gaps and waves that stay after a jam are simulated separately.
    """
    drivers = estimated(asked.measured)
    cases: dict[str, Callable[[int], Ring]] = {}
    for jammed, start in ((False, "spontaneous"), (True, "sustained")):
        for rows, who in ((drivers, "different"), (mean_driver(drivers), "alike")):
            for noise, how in ((1.0, "noise"), (0.0, "no noise")):
                quiet = changed(rows, SIGMA_A, noise * rows[:, SIGMA_A])

                def make(seed: int, quiet: Array = quiet, jammed: bool = jammed) -> Ring:
                    return Ring(quiet, seed, jammed=jammed)

                cases[f"{start}, {who}, {how}"] = make
    return compare(asked, cases)


STUDY = Study(
    name="ablation",
    question="Do waves need drivers who differ, or noise?",
    paper="Heterogeneity is unnecessary; noise is necessary to make waves, not to keep them (section 6.2.1).",
    answer=_answer,
)
