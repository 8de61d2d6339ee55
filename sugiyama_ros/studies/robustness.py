"""Do waves depend on the order of the drivers, on the period, on the circumference?"""

from collections.abc import Callable

import numpy as np

from sugiyama_ros.arrays import Array
from sugiyama_ros.studies.cases import compare
from sugiyama_ros.studies.rings import Ring, estimated
from sugiyama_ros.studies.study import Answer, Asked, Study


def _answer(asked: Asked) -> Answer:
    """Simulate the estimated drivers in another order, with another period and on other rings."""
    drivers = estimated(asked.measured)

    def shuffled(seed: int) -> Array:
        return np.random.default_rng([seed, 1]).permutation(drivers, axis=0)

    def of_ring(ring_m: float) -> Callable[[int], Ring]:
        return lambda seed: Ring(drivers, seed, ring_m=ring_m)

    return compare(
        asked,
        {
            "as measured": lambda seed: Ring(drivers, seed),
            "shuffled": lambda seed: Ring(shuffled(seed), seed),
            "period 0.2 s": lambda seed: Ring(drivers, seed, period_s=0.2),
            **{f"ring of {ring_m:g} m": of_ring(ring_m) for ring_m in (210.0, 250.0, 280.0, 320.0)},
        },
    )


STUDY = Study(
    name="robustness",
    question="Does it depend on the order of the drivers, on the period, on the circumference?",
    paper="Everything else remains more or less intact; almost independent of the period (section 5.3).",
    answer=_answer,
)
