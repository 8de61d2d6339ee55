"""Are there waves on a highway?"""

from sugiyama_ros.driver.parameters import KAPPA_C, KAPPA_V, V_STAR
from sugiyama_ros.studies.cases import compare
from sugiyama_ros.studies.rings import RING_M, Ring, alike, estimated, mean_driver
from sugiyama_ros.studies.study import Answer, Asked, Study


def _answer(asked: Asked) -> Answer:
    """Simulate three times the road and the desired speed, with kappa_v times 3 and kappa_c times 5."""
    rows = mean_driver(estimated(asked)) if asked.trajectories is not None else alike()
    rows[:, V_STAR] *= 3.0
    rows[:, KAPPA_V] *= 3.0
    rows[:, KAPPA_C] *= 5.0
    ring_m = 3.0 * RING_M
    return compare(
        asked,
        {
            "equal gaps": lambda seed: Ring(rows, seed, ring_m=ring_m),
            "out of a jam": lambda seed: Ring(rows, seed, ring_m=ring_m, jammed=True),
        },
    )


STUDY = Study(
    name="highway",
    question="Are there waves on a highway?",
    paper="Waves are clearly visible, at about -5 m/s, with some 10 cars in a cluster (section 6.4).",
    answer=_answer,
)
