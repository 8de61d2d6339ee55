"""Where does the slow swing of the mean speed come from?"""

from typing import Any

import numpy as np
from numpy.typing import NDArray

from sugiyama_ros.arrays import Array
from sugiyama_ros.simulation.collective import QUEUE_SPEED
from sugiyama_ros.studies.rings import Ring, estimated, mean, ring_of, run
from sugiyama_ros.studies.study import Answer, Asked, Study

# The vehicles that the paper finds in the queue when the mean speed is smallest, and the heading of their share.
_CHASING = range(2, 12)
_QUEUE = "share of vehicles 2 to 11 in the queue at least speed"
# Duration [s] of the moving average of the mean speed.
_SMOOTH_S = 10.0


def _answer(asked: Asked) -> Answer:
    """Compare the std over time of the mean speed, with the drivers in their measured order and shuffled.

    The paper explains the swing by vehicles 2 to 11: they stand in the queue when the mean speed is smallest. The table
    has their share of the queue then, and their share of all drivers.
    """
    drivers, ring, length_m = estimated(asked), ring_of(asked.measured), asked.measured.length_m
    shuffles = max(asked.runs, 2)
    rng = np.random.default_rng([asked.seed, 2])
    orders = [np.arange(len(drivers)), *(rng.permutation(len(drivers)) for _ in range(shuffles))]
    seeds = [asked.seed + k for k in range(asked.runs)]
    rings = [ring(drivers[one], seed, jammed=True, length_m=length_m[one]) for one in orders for seed in seeds]
    chasing = [np.isin(one, _CHASING) for one in orders for _ in seeds]
    found = np.array(list(asked.work.map(_swing, rings, chasing))).reshape(len(orders), len(seeds), 2)
    swings, queues = found[:, :, 0], found[:, :, 1]
    runs, by_order = np.isfinite(swings).sum(axis=1), np.array([mean(of_order) for of_order in swings])
    shuffled = by_order[1:][np.isfinite(by_order[1:])]
    rows = (
        {
            "order": "as measured",
            "swing of the mean speed [m/s]": float(by_order[0]),
            _QUEUE: mean(queues[0]),
            "share of all drivers": float(np.mean(chasing[0])),
            "runs": int(runs[0]),
        },
        {
            "order": f"shuffled, {len(shuffled)} ways",
            "swing of the mean speed [m/s]": float(shuffled.mean()) if len(shuffled) else float("nan"),
            "std over orders": float(shuffled.std(ddof=1)) if len(shuffled) > 1 else float("nan"),
            _QUEUE: mean(queues[1:]),
            "orders that swing more": int((shuffled > by_order[0]).sum()),
            "runs": int(runs[1:].sum()),
        },
    )

    def draw(figure: Any) -> None:
        axes = figure.subplots()
        for name, one in (("as measured", orders[0]), ("shuffled", orders[1])):
            shown = ring(drivers[one], asked.seed, jammed=True, length_m=length_m[one])
            average = _mean_speed(run(shown).speed, shown.period_s)
            axes.plot(np.arange(len(average)) / 3.0, average, label=name)
        axes.set(xlabel="time [s]", ylabel="mean speed of all cars [m/s]")
        axes.legend()

    return Answer(rows, draw)


def _mean_speed(speed: Array, period_s: float) -> Array:
    """Mean speed [m/s] of all cars over time, (T,), as a moving average over 10 s; speed: (T, N)."""
    width = round(_SMOOTH_S / period_s)
    return np.convolve(speed.mean(axis=1), np.full(width, 1.0 / width), mode="valid")


def _swing(ring: Ring, chasing: NDArray[np.bool_]) -> tuple[float, float]:
    """Std over time [m/s] of the mean speed in the second half of a run, and the share of some drivers in the queue.

    The queue is counted in the tenth of the time in which the mean speed is smallest. Both are NaN if the run ends in a
    collision; chasing: (N,), whether each driver is one of these drivers.
    """
    speed = run(ring).speed
    average = _mean_speed(speed, ring.period_s)
    if len(average) * ring.period_s < 0.9 * ring.duration_s:
        return float("nan"), float("nan")
    half = len(average) // 2
    slowest = half + np.argsort(average[half:])[: max(1, half // 10)]
    stands = speed[slowest + round(0.5 * _SMOOTH_S / ring.period_s)] < QUEUE_SPEED
    share = float(stands[:, chasing].sum() / stands.sum()) if stands.any() else float("nan")
    return float(np.std(average[half:])), share


STUDY = Study(
    name="order",
    question="Where does the slow swing of the mean speed come from?",
    paper=(
        "From the order of the drivers: vehicles 2 to 11 queue when the mean speed is smallest; shuffled, it disappears"
        " (section 5.3)."
    ),
    answer=_answer,
)
