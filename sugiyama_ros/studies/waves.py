"""Where waves come from: variations of the ring and of its drivers, simulated with the same seeds."""

from functools import partial
from typing import Any

import numpy as np

from sugiyama_ros.arrays import Array
from sugiyama_ros.diagnosis.check import collective_of
from sugiyama_ros.driver.parameters import KAPPA_C, KAPPA_V, SIGMA_A, SIGMA_V, SIGMA_X, V_STAR, defaults
from sugiyama_ros.studies.rings import (
    CARS,
    FACTOR,
    JAM_GAP_M,
    RING_M,
    Ring,
    compare,
    estimated,
    outcome,
    ring_of,
    summed_up,
)
from sugiyama_ros.studies.study import Answer, Asked, Study

# The paper's factor of sigma_a (section 6), and the speed [m/s] from which on the noise is whole, if it grows with the
# speed (a footnote of section 6).
_PAPERS_FACTOR, _FULL_NOISE_AT = 0.5, 5.0
# Starts, and whether the cars start out of a jam.
_STARTS = {"equal gaps": False, "out of a jam": True}
# Circumferences as shares of the measured one.
_SHARES = (210.0 / 230.0, 250.0 / 230.0, 280.0 / 230.0, 320.0 / 230.0)
# Noises that are switched off, by the name of the case. The paper's simulation has no other noise than that of the
# acceleration, so without it nothing is random. Here the position and the speed are noisy, too.
_SILENT = {
    "noise of the acceleration, as in the paper": [SIGMA_X, SIGMA_V],
    "no noise, as in the paper": [SIGMA_A, SIGMA_X, SIGMA_V],
    "noise of position and speed alone": [SIGMA_A],
}
# The mean of the regularised estimates [s], and a noise [m/s^2] with which dense traffic seldom collides.
_KAPPA_V, _SIGMA_A = 0.27, 0.1
# The ring [m] on which the density varies, and numbers of cars.
_TADAKI_M, _COUNTS = 314.0, (16, 20, 24, 26, 28, 30, 32, 34, 36, 40)


def _mean_driver(drivers: Array) -> Array:
    """N drivers alike, each with the mean parameters of ``drivers``, shape (N, P)."""
    return np.tile(drivers.mean(axis=0), (len(drivers), 1))


def _simulated(asked: Asked) -> Answer:
    """Simulate the estimated drivers on the measured ring, from equal gaps and out of a jam."""
    ring, cases = ring_of(asked.measured), {}
    papers = estimated(asked, _PAPERS_FACTOR)
    papers[:, [SIGMA_X, SIGMA_V]] = 0.0
    noises = {
        f"{_PAPERS_FACTOR:g} sigma_a alone, as in the paper": papers,
        f"{_PAPERS_FACTOR:g} sigma_a": estimated(asked, _PAPERS_FACTOR),
        f"{FACTOR:g} sigma_a": estimated(asked, FACTOR),
        f"{_PAPERS_FACTOR:g} sigma_a, whole from {_FULL_NOISE_AT:g} m/s on": estimated(
            asked, _PAPERS_FACTOR, _FULL_NOISE_AT
        ),
    }
    for noise, drivers in noises.items():
        for start, jammed in _STARTS.items():
            cases[f"{start}, {noise}"] = partial(ring, drivers, jammed=jammed)
    cases["paper's mean parameters, out of a jam"] = partial(Ring, defaults(CARS), jammed=True)
    answer = compare(asked, cases)
    measured = collective_of(asked.measured)
    of_measured = {
        "mean speed [m/s]": measured.mean_speed,
        "least [m/s]": measured.least_speed,
        "largest [m/s]": measured.largest_speed,
        "wave speed [m/s]": measured.wave_speed,
        "queue [cars]": measured.queue_vehicles,
    }
    return Answer(({"case": "measured, all of it", **of_measured}, *answer.rows), answer.draw)


def _robustness(asked: Asked) -> Answer:
    """Simulate the estimated drivers in another order, with another period and on other rings."""
    drivers, ring = estimated(asked), ring_of(asked.measured)
    ring_m = ring.keywords["ring_m"]

    def shuffled(seed: int) -> Ring:
        return ring(np.random.default_rng([seed, 1]).permutation(drivers, axis=0), seed)

    return compare(
        asked,
        {
            "as measured": partial(ring, drivers),
            "shuffled": shuffled,
            "period 0.2 s": partial(ring, drivers, period_s=0.2),
            **{f"ring of {m:g} m": partial(ring, drivers, ring_m=m) for m in [share * ring_m for share in _SHARES]},
        },
    )


def _ablation(asked: Asked) -> Answer:
    """Switch the differences between drivers and the noise on and off.

    Waves that form from equal gaps and waves that stay after a jam are simulated separately.
    """
    drivers, ring, cases = estimated(asked), ring_of(asked.measured), {}
    for start, jammed in (("spontaneous", False), ("sustained", True)):
        for who, rows in (("different", drivers), ("alike", _mean_driver(drivers))):
            for how, silent in _SILENT.items():
                quiet = rows.copy()
                quiet[:, silent] = 0.0
                cases[f"{start}, {who}, {how}"] = partial(ring, quiet, jammed=jammed)
    return compare(asked, cases)


def _one_driver(asked: Asked) -> Answer:
    """Make one driver slower, or much more cautious, than all others."""
    drivers, ring = estimated(asked), ring_of(asked.measured)

    def with_one(place: int, value: float, jammed: bool = False) -> "partial[Ring]":
        rows = drivers.copy()
        rows[0, place] = value
        return partial(ring, rows, jammed=jammed)

    return compare(
        asked,
        {
            "as measured": partial(ring, drivers),
            "v* of one: 8 m/s": with_one(V_STAR, 8.0),
            "v* of one: 7 m/s": with_one(V_STAR, 7.0),
            "v* of one: 8 m/s, out of a jam": with_one(V_STAR, 8.0, True),
            "v* of one: 7 m/s, out of a jam": with_one(V_STAR, 7.0, True),
            "kappa_v of one: 2 s": with_one(KAPPA_V, 2.0),
        },
    )


def _tadaki(asked: Asked) -> Answer:
    """Simulate flow over density on 314 m, from equal gaps and out of a jam.

    Where the two curves part, the flow has two branches.
    """
    rows: list[dict[str, Any]] = []
    for start, jammed in _STARTS.items():
        for cars in _COUNTS:
            drivers = defaults(cars)
            drivers[:, KAPPA_V], drivers[:, SIGMA_A] = _KAPPA_V, _SIGMA_A
            rings = [Ring(drivers, asked.seed + k, jammed=jammed, ring_m=_TADAKI_M) for k in range(asked.runs)]
            found = summed_up(list(asked.work.map(outcome, rings)))
            rows.append({"start": start, "cars": cars, "density [1/km]": 1e3 * cars / _TADAKI_M, **found})

    def draw(figure: Any) -> None:
        axes = figure.subplots()
        for start in _STARTS:
            of = [r for r in rows if r["start"] == start]
            axes.plot([r["density [1/km]"] for r in of], [r["flow [1/h]"] for r in of], "o-", label=start)
        axes.set(xlabel="density [1/km]", ylabel="flow [1/h]")
        axes.legend()

    return Answer(tuple(rows), draw)


def _highway(asked: Asked) -> Answer:
    """Simulate three times the road and the desired speed, with kappa_v times 3 and kappa_c times 5."""
    rows = _mean_driver(estimated(asked)) if asked.trajectories is not None else defaults(CARS)
    rows[:, [V_STAR, KAPPA_V]] *= 3.0
    rows[:, KAPPA_C] *= 5.0
    # the gaps in the jam grow like kappa_c; a car counts as queuing below a third of the desired speed
    ring = partial(Ring, rows, ring_m=3.0 * RING_M, jam_gap_m=5.0 * JAM_GAP_M, queue_speed=rows[0, V_STAR] / 3.0)
    return compare(asked, {start: partial(ring, jammed=jammed) for start, jammed in _STARTS.items()})


SIMULATED = Study(
    name="simulated",
    question="Do the estimated drivers make the measured waves?",
    paper="Waves form by themselves; V_avg is 0.5 m/s too low, the queue a vehicle too long (section 6.1).",
    answer=_simulated,
)

ROBUSTNESS = Study(
    name="robustness",
    question="Does it depend on the order of the drivers, on the period, on the circumference?",
    paper="Everything else remains more or less intact; almost independent of the period (section 5.4).",
    answer=_robustness,
)

ABLATION = Study(
    name="ablation",
    question="Do waves need drivers who differ, or noise?",
    paper="Heterogeneity is unnecessary; noise is necessary to make waves, not to keep them (section 6.2.1).",
    answer=_ablation,
)

ONE_DRIVER = Study(
    name="one-driver",
    question="Can one driver stop the waves?",
    paper=(
        "8 m/s: not as easily; 7 m/s: much harder to form; a cautious driver changes nothing (sections 6.2.2, 6.2.3)."
    ),
    answer=_one_driver,
)

TADAKI = Study(
    name="tadaki",
    question="At which density does free flow end?",
    paper="The fundamental diagram and the critical region of density are reproduced (section 6.3).",
    answer=_tadaki,
    takes=("runs", "seed"),
)

HIGHWAY = Study(
    name="highway",
    question="Are there waves on a highway?",
    paper="Waves are clearly visible, at about -5 m/s, with some 10 cars in a cluster (section 6.4).",
    answer=_highway,
)
