"""Do waves need drivers who differ, or noise?"""

from collections.abc import Callable

from sugiyama_ros.arrays import Array
from sugiyama_ros.driver.parameters import SIGMA_A, SIGMA_V, SIGMA_X
from sugiyama_ros.studies.cases import compare
from sugiyama_ros.studies.rings import Ring, estimated, mean_driver, site_of
from sugiyama_ros.studies.study import Answer, Asked, Study

# Noises that are switched off, by the name of the case.
_NOISES = (
    ([SIGMA_X, SIGMA_V], "noise of the acceleration, as in the paper"),
    ([SIGMA_A, SIGMA_X, SIGMA_V], "no noise, as in the paper"),
    ([SIGMA_A], "noise of position and speed alone"),
)


def _answer(asked: Asked) -> Answer:
    """Switch the differences between drivers and the noise on and off.

    The paper's simulation has no other noise than that of the acceleration, so without it nothing is random. Here the
    position and the speed are noisy, too; they are noisy alone in the third case. Waves that form from equal gaps and
    waves that stay after a jam are simulated separately.
    """
    drivers, site = estimated(asked), site_of(asked.measured)
    cases: dict[str, Callable[[int], Ring]] = {}
    for jammed, start in ((False, "spontaneous"), (True, "sustained")):
        for rows, who in ((drivers, "different"), (mean_driver(drivers), "alike")):
            for silent, how in _NOISES:
                quiet = rows.copy()
                quiet[:, silent] = 0.0

                def make(seed: int, quiet: Array = quiet, jammed: bool = jammed) -> Ring:
                    return Ring(quiet, seed, jammed=jammed, **site._asdict())

                cases[f"{start}, {who}, {how}"] = make
    return compare(asked, cases)


STUDY = Study(
    name="ablation",
    question="Do waves need drivers who differ, or noise?",
    paper="Heterogeneity is unnecessary; noise is necessary to make waves, not to keep them (section 6.2.1).",
    answer=_answer,
)
