"""Do waves depend on the order of the drivers, on the period, on the circumference?"""

from collections.abc import Callable

import numpy as np

from sugiyama_ros.arrays import Array
from sugiyama_ros.studies.cases import compare
from sugiyama_ros.studies.rings import Ring, estimated, site_of
from sugiyama_ros.studies.study import Answer, Asked, Study

# Circumferences as shares of the measured one.
_SHARES = (210.0 / 230.0, 250.0 / 230.0, 280.0 / 230.0, 320.0 / 230.0)


def _answer(asked: Asked) -> Answer:
    """Simulate the estimated drivers in another order, with another period and on other rings."""
    drivers, (measured_m, length_m) = estimated(asked), site_of(asked.measured)

    def shuffled(seed: int) -> Array:
        return np.random.default_rng([seed, 1]).permutation(drivers, axis=0)

    def of_ring(ring_m: float) -> Callable[[int], Ring]:
        return lambda seed: Ring(drivers, seed, ring_m=ring_m, length_m=length_m)

    return compare(
        asked,
        {
            "as measured": of_ring(measured_m),
            "shuffled": lambda seed: Ring(shuffled(seed), seed, ring_m=measured_m, length_m=length_m),
            "period 0.2 s": lambda seed: Ring(drivers, seed, ring_m=measured_m, length_m=length_m, period_s=0.2),
            **{f"ring of {share * measured_m:g} m": of_ring(share * measured_m) for share in _SHARES},
        },
    )


STUDY = Study(
    name="robustness",
    question="Does it depend on the order of the drivers, on the period, on the circumference?",
    paper="Everything else remains more or less intact; almost independent of the period (section 5.4).",
    answer=_answer,
)
