"""Are there waves on a highway?"""

from collections.abc import Callable

from sugiyama_ros.driver.parameters import KAPPA_C, KAPPA_V, V_STAR
from sugiyama_ros.studies.cases import compare
from sugiyama_ros.studies.rings import JAM_GAP_M, RING_M, Ring, alike, estimated, mean_driver
from sugiyama_ros.studies.study import Answer, Asked, Study


def _answer(asked: Asked) -> Answer:
    """Simulate three times the road and the desired speed, with kappa_v times 3 and kappa_c times 5."""
    rows = mean_driver(estimated(asked)) if asked.trajectories is not None else alike()
    rows[:, V_STAR] *= 3.0
    rows[:, KAPPA_V] *= 3.0
    rows[:, KAPPA_C] *= 5.0

    def start(jammed: bool) -> Callable[[int], Ring]:
        # the gaps in the jam grow like kappa_c; a car counts as queuing below a third of the desired speed
        return lambda seed: Ring(
            rows, seed, jammed=jammed, ring_m=3.0 * RING_M, jam_gap_m=5.0 * JAM_GAP_M, queue_speed=rows[0, V_STAR] / 3.0
        )

    return compare(asked, {"equal gaps": start(False), "out of a jam": start(True)})


STUDY = Study(
    name="highway",
    question="Are there waves on a highway?",
    paper="Waves are clearly visible, at about -5 m/s, with some 10 cars in a cluster (section 6.4).",
    answer=_answer,
)
