"""Where does the slow swing of the mean speed come from?"""

from typing import Any

import numpy as np

from sugiyama_ros.arrays import Array
from sugiyama_ros.studies.rings import Ring, estimated, run
from sugiyama_ros.studies.study import Answer, Asked, Study


def _answer(asked: Asked) -> Answer:
    """Compare the std over time of the mean speed, with the drivers in their measured order and shuffled."""
    drivers = estimated(asked.measured)
    shuffles = max(asked.runs, 2)
    rng = np.random.default_rng([asked.seed, 2])
    orders = [np.arange(len(drivers)), *(rng.permutation(len(drivers)) for _ in range(shuffles))]
    seeds = [asked.seed + k for k in range(asked.runs)]
    rings = [Ring(drivers[one], seed, jammed=True) for one in orders for seed in seeds]
    swings = np.array(list(asked.work.map(_swing, rings))).reshape(len(orders), len(seeds))
    complete = np.isfinite(swings)
    runs = complete.sum(axis=1)
    by_order = np.where(complete, swings, 0.0).sum(axis=1) / np.where(runs > 0, runs, np.nan)
    shuffled = by_order[1:][np.isfinite(by_order[1:])]
    rows = (
        {"order": "as measured", "swing of the mean speed [m/s]": float(by_order[0]), "runs": int(runs[0])},
        {
            "order": f"shuffled, {len(shuffled)} ways",
            "swing of the mean speed [m/s]": float(shuffled.mean()) if len(shuffled) else float("nan"),
            "std over orders": float(shuffled.std(ddof=1)) if len(shuffled) > 1 else float("nan"),
            "orders that swing more": int((shuffled > by_order[0]).sum()),
            "runs": int(runs[1:].sum()),
        },
    )

    def draw(figure: Any) -> None:
        axes = figure.subplots()
        for name, one in (("as measured", orders[0]), ("shuffled", orders[1])):
            mean = _mean_speed(Ring(drivers[one], asked.seed, jammed=True))
            axes.plot(np.arange(len(mean)) / 3.0, mean, label=name)
        axes.set(xlabel="time [s]", ylabel="mean speed of all cars [m/s]")
        axes.legend()

    return Answer(rows, draw)


def _mean_speed(ring: Ring) -> Array:
    """Mean speed [m/s] of all cars over time, (T,), as a moving average over 10 s."""
    speed = run(ring).speed.mean(axis=1)
    width = round(10.0 / ring.period_s)
    return np.convolve(speed, np.full(width, 1.0 / width), mode="valid")


def _swing(ring: Ring) -> float:
    """Std over time [m/s] of the mean speed in the second half of a run; NaN if the run ends in a collision."""
    mean = _mean_speed(ring)
    if len(mean) * ring.period_s < 0.9 * ring.duration_s:
        return float("nan")
    return float(np.std(mean[len(mean) // 2 :]))


STUDY = Study(
    name="order",
    question="Where does the slow swing of the mean speed come from?",
    paper="From the order of the drivers: shuffled, it disappears (section 5.2).",
    answer=_answer,
)
