"""The recording on which all parts measure."""

from functools import cache

from sugiyama_ros.studies.rings import CARS, RING_M, Ring, alike, run
from sugiyama_ros.trajectories.trajectories import Trajectories

#: Duration of the recording [s], as in the experiment.
DURATION_S = 250.0
_SEED = 4


@cache
def jam(cars: int = CARS, duration_s: float = DURATION_S) -> Trajectories:
    """Simulate a jam on a ring of as many metres for each car as in the experiment.

    duration_s: duration [s].
    """
    ring_m = RING_M * cars / CARS
    ring = Ring(alike(cars), _SEED, jammed=True, duration_s=duration_s, ring_m=ring_m)
    return run(ring).measured
