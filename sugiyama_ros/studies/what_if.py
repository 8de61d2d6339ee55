"""What makes a wave: variations of the ring and of its drivers, each a study of the paper."""

from collections.abc import Callable, Mapping, Sequence
from typing import Any

import numpy as np

from sugiyama_ros.arrays import Array
from sugiyama_ros.diagnosis.compare import collective_of
from sugiyama_ros.driver.parameters import KAPPA_C, KAPPA_V, SIGMA_A, V_STAR
from sugiyama_ros.studies.rings import (
    FACTOR,
    PAPERS_FACTOR,
    RING_M,
    Ring,
    alike,
    estimated,
    outcomes,
    run,
    space_time,
    summed_up,
)
from sugiyama_ros.studies.study import Answer, Asked, Study

#: By name: what makes a ring of a seed.
Cases = Mapping[str, Callable[[int], Ring]]


def compare(asked: Asked, cases: Cases) -> Answer:
    """All cases with the same seeds; the figure shows the first run of each."""
    seeds = [asked.seed + k for k in range(asked.runs)]
    rings = [make(seed) for make in cases.values() for seed in seeds]
    found = outcomes(rings, asked.work)
    rows = tuple(
        {"case": name, **summed_up(found[k * len(seeds) : (k + 1) * len(seeds)])} for k, name in enumerate(cases)
    )

    def draw(figure: Any) -> None:
        columns = min(3, len(cases))
        lines = -(-len(cases) // columns)
        places = iter(figure.subplots(lines, columns, squeeze=False).flat)
        for (name, make), axes in zip(cases.items(), places, strict=False):
            space_time(axes, run(make(asked.seed)))
            axes.set(title=name)
        for axes in list(places):
            axes.set_visible(False)

    return Answer(rows, draw)


def _changed(drivers: Array, place: int, value: float | Array, first_only: bool = False) -> Array:
    rows = drivers.copy()
    rows[: 1 if first_only else None, place] = value
    return rows


def _mean(drivers: Array) -> Array:
    return np.tile(drivers.mean(axis=0), (len(drivers), 1))


def simulated(asked: Asked) -> Answer:
    """The estimated drivers on the measured ring, from rest at equal gaps and out of a jam."""
    ring_m = asked.measured.road.circumference_m or RING_M
    cases: dict[str, Callable[[int], Ring]] = {}
    for factor in (PAPERS_FACTOR, FACTOR):
        drivers = estimated(asked.measured, factor)
        for jammed, start in ((False, "equal gaps"), (True, "out of a jam")):

            def make(seed: int, drivers: Array = drivers, jammed: bool = jammed) -> Ring:
                return Ring(drivers, seed, jammed=jammed, ring_m=ring_m)

            cases[f"{start}, sigma_a times {factor:g}"] = make
    cases["paper's mean parameters, out of a jam"] = lambda seed: Ring(alike(), seed, jammed=True)
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


def robustness(asked: Asked) -> Answer:
    """Another order of the drivers, another period, another circumference."""
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


def ablation(asked: Asked) -> Answer:
    """Heterogeneity and acceleration noise, each on and off; waves that form and waves that stay."""
    drivers = estimated(asked.measured)
    cases: dict[str, Callable[[int], Ring]] = {}
    for jammed, start in ((False, "spontaneous"), (True, "sustained")):
        for rows, who in ((drivers, "different"), (_mean(drivers), "alike")):
            for noise, how in ((1.0, "noise"), (0.0, "no noise")):
                quiet = _changed(rows, SIGMA_A, noise * rows[:, SIGMA_A])

                def make(seed: int, quiet: Array = quiet, jammed: bool = jammed) -> Ring:
                    return Ring(quiet, seed, jammed=jammed)

                cases[f"{start}, {who}, {how}"] = make
    return compare(asked, cases)


def one_driver(asked: Asked) -> Answer:
    """One driver slower, or far more cautious, than all others."""
    drivers = estimated(asked.measured)

    def with_one(place: int, value: float, jammed: bool) -> Callable[[int], Ring]:
        return lambda seed: Ring(_changed(drivers, place, value, first_only=True), seed, jammed=jammed)

    return compare(
        asked,
        {
            "as measured": lambda seed: Ring(drivers, seed),
            "v* of one: 8 m/s": with_one(V_STAR, 8.0, False),
            "v* of one: 7 m/s": with_one(V_STAR, 7.0, False),
            "v* of one: 8 m/s, out of a jam": with_one(V_STAR, 8.0, True),
            "v* of one: 7 m/s, out of a jam": with_one(V_STAR, 7.0, True),
            "kappa_v of one: 2 s": with_one(KAPPA_V, 2.0, False),
        },
    )


def highway(asked: Asked) -> Answer:
    """Three times the road and the speed: kappa_v times 3, kappa_c times 5."""
    rows = _mean(estimated(asked.measured)) if asked.trajectories is not None else alike()
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


def tadaki(asked: Asked) -> Answer:
    """Flow over density on 314 m, from equal gaps and out of a jam: where they part, the flow has two branches."""
    ring_m, counts = 314.0, (16, 20, 24, 26, 28, 30, 32, 34, 36, 40)
    rows: list[dict[str, Any]] = []
    for jammed, start in ((False, "equal gaps"), (True, "out of a jam")):
        for cars in counts:
            drivers = _changed(_changed(alike(cars), KAPPA_V, _TADAKI_KAPPA_V), SIGMA_A, _TADAKI_SIGMA_A)
            rings = [Ring(drivers, asked.seed + k, jammed=jammed, ring_m=ring_m) for k in range(asked.runs)]
            found = summed_up(outcomes(rings, asked.work))
            rows.append({"start": start, "cars": cars, "density [1/km]": 1e3 * cars / ring_m, **found})

    def draw(figure: Any) -> None:
        axes = figure.subplots()
        for start in ("equal gaps", "out of a jam"):
            of = [r for r in rows if r["start"] == start]
            axes.plot([r["density [1/km]"] for r in of], [r["flow [1/h]"] for r in of], "o-", label=start)
        axes.set(xlabel="density [1/km]", ylabel="flow [1/h]")
        axes.legend()

    return Answer(tuple(rows), draw)


# The mean of the regularised estimates [s], and a noise [m/s^2] with which dense traffic seldom collides.
_TADAKI_KAPPA_V, _TADAKI_SIGMA_A = 0.27, 0.1


def order(asked: Asked) -> Answer:
    """The slow swing of the mean speed: its std over time with the drivers in their order, and shuffled."""
    drivers = estimated(asked.measured)
    shuffles = max(asked.runs, 2)
    rng = np.random.default_rng([asked.seed, 2])
    orders = [np.arange(len(drivers)), *(rng.permutation(len(drivers)) for _ in range(shuffles))]
    seeds = [asked.seed + k for k in range(asked.runs)]
    rings = [Ring(drivers[one], seed, jammed=True) for one in orders for seed in seeds]
    swings = np.array(list(asked.work.map(_swing, rings))).reshape(len(orders), len(seeds))
    whole = np.isfinite(swings)
    by_order = np.where(whole, swings, 0.0).sum(axis=1) / np.where(whole.any(axis=1), whole.sum(axis=1), np.nan)
    rest = by_order[1:][np.isfinite(by_order[1:])]
    rows = (
        {"order": "as measured", "swing of the mean speed [m/s]": float(by_order[0]), "runs": int(whole[0].sum())},
        {
            "order": f"shuffled, {len(rest)} ways",
            "swing of the mean speed [m/s]": float(rest.mean()) if len(rest) else float("nan"),
            "std over orders": float(rest.std(ddof=1)) if len(rest) > 1 else float("nan"),
            "orders that swing more": int((rest > by_order[0]).sum()),
            "runs": int(whole[1:].sum()),
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
    """Mean speed of all cars over time, (T,), as a moving average over 10 s."""
    speed = run(ring).speed.mean(axis=1)
    width = round(10.0 / ring.period_s)
    return np.convolve(speed, np.full(width, 1.0 / width), mode="valid")


def _swing(ring: Ring) -> float:
    """Std over time [m/s] of the mean speed in the second half of a run that does not end in a collision."""
    mean = _mean_speed(ring)
    if len(mean) * ring.period_s < 0.9 * ring.duration_s:
        return float("nan")
    return float(np.std(mean[len(mean) // 2 :]))


STUDIES: Sequence[Study] = (
    Study(
        "simulated",
        "Do the estimated drivers make the measured waves?",
        "Waves form by themselves; V_avg is 0.5 m/s too low, the queue a vehicle too long (section 6.1).",
        simulated,
    ),
    Study(
        "robustness",
        "Does it depend on the order of the drivers, on the period, on the circumference?",
        "Everything else remains more or less intact; almost independent of the period (section 5.3).",
        robustness,
    ),
    Study(
        "ablation",
        "Do waves need drivers who differ, or noise?",
        "Heterogeneity is unnecessary; noise is necessary to make waves, not to keep them (section 6.2.1).",
        ablation,
    ),
    Study(
        "one-driver",
        "Can one driver stop the waves?",
        "8 m/s: not as easily; 7 m/s: much harder to form; a cautious driver changes nothing (sections 6.2.2, 6.2.3).",
        one_driver,
    ),
    Study(
        "tadaki",
        "At which density does free flow end?",
        "The fundamental diagram and the critical region of density are reproduced (section 6.3).",
        tadaki,
    ),
    Study(
        "highway",
        "Are there waves on a highway?",
        "Waves are clearly visible, at about -5 m/s, with some 10 cars in a cluster (section 6.4).",
        highway,
    ),
    Study(
        "order",
        "Where does the slow swing of the mean speed come from?",
        "From the order of the drivers: shuffled, it disappears (section 5.2).",
        order,
    ),
)
