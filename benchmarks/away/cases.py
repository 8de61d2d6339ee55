"""All recordings of the benchmark: scene, drivers, what is hidden, and which answers are right."""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field, replace

import numpy as np

from benchmarks.away.drivers import LAW_MEANS, People, drawn, followers
from benchmarks.away.hidden import FAULTS, FORMS, MECHANISMS, MISSING, SMOOTHED, Builder, Built, delay
from benchmarks.away.world import Setup, record
from sugiyama_ros.trajectories.dense import tracks_of
from sugiyama_ros.trajectories.tracks import Tracks

#: Strengths of whatever is hidden.
STRENGTHS = {"strong": 1.0, "weak": 0.5}
_ATTEMPTS = 60
# What only three drivers show is so many times as strong.
_OF_FEW = 2.5
_RING = Setup()
# A long delay lets cars collide where they are close together.
_WIDE = Setup(ring_m=260.0, is_moving=True)
# Desired speed [m/s], in town and on a highway.
_DESIRED = (10.26, 34.0)
#: Where nothing is hidden.
SCENES = {
    "home": _RING,
    "10 cars": Setup(drivers=10, ring_m=105.0),
    "30 cars": Setup(drivers=30, ring_m=314.0),
    "free flow": Setup(ring_m=300.0, is_moving=True, spread=0.03),
    "very free": Setup(drivers=12, ring_m=400.0, is_moving=True),
    "dense": Setup(ring_m=207.0),
    "100 s": Setup(duration_s=100.0),
    "500 s": Setup(duration_s=500.0),
    "0.1 s": Setup(drivers=10, ring_m=105.0, duration_s=100.0, period_s=0.1),
    "0.5 s": Setup(period_s=0.5),
    "1 s": Setup(every=3),
    "noise x0.3": Setup(noise=0.3),
    "noise x3": Setup(noise=3.0, ring_m=300.0, is_moving=True),
    "open platoon": Setup(drivers=8, ring_m=0.0),
    "highway": Setup(drivers=10, ring_m=0.0, duration_s=200.0, period_s=0.2, is_moving=True, is_highway=True),
    "missing samples": _RING,
    "smoothed 10 Hz": Setup(drivers=8, ring_m=0.0, duration_s=100.0, period_s=0.1),
    "0.1 s, seen every 0.3 s": Setup(period_s=0.1, every=3),
}
_CAMERAS: dict[str, tuple[Builder, ...]] = {"missing samples": (MISSING,), "smoothed 10 Hz": (SMOOTHED,)}
_TOGETHER = {
    "drag, slow patch, outliers": ("drag", "slow patch", "outliers"),
    "grade, drift, second leader": ("grade", "drift", "second leader in the utility"),
    "lag, switch, rear pressure": ("lag", "switch", "rear pressure in the utility"),
}


@dataclass(frozen=True, eq=False)
class Case:
    """A kind of recording.

    part, name: part of the benchmark, and name of the case; scene: the scene; builders: what is hidden; right: names
    that are right; covariates: covariates along which a form without a name shows; law: the drivers' law; empty for the
    paper's drivers; few: number of drivers who show what is hidden; 0 for all.
    """

    part: str
    name: str
    scene: Setup
    builders: Sequence[Builder] = ()
    right: tuple[str, ...] = ()
    covariates: tuple[str, ...] = ()
    law: str = ""
    few: int = 0


@dataclass(frozen=True, eq=False)
class Pair:
    """Two recordings of the same drivers, and what they hide.

    first, second: the recording to diagnose, and a fresh one; who: vehicles that show what is hidden; empty if all do;
    truth: values that a fit should find, by name.
    """

    first: Tracks
    second: Tracks
    who: tuple[int, ...]
    truth: dict[str, float] = field(default_factory=dict)


def cases(part: str) -> list[Case]:
    """Return the cases of a part of the benchmark."""
    if part == "conditions":
        return [Case(part, name, scene, _CAMERAS.get(name, ())) for name, scene in SCENES.items()]
    if part == "elsewhere":
        return list(_elsewhere())
    if part == "mechanisms":
        return [
            Case(part, name, _WIDE if name == "delay of 0.5 s" else _RING, (build,), right)
            for name, (build, right) in MECHANISMS.items()
        ]
    if part == "forms":
        return [Case(part, name, _RING, (build,), near, seen) for name, (build, seen, near) in FORMS.items()]
    if part == "laws":
        return [Case(part, law, _RING, law=law) for law in LAW_MEANS]
    if part == "few":
        few: dict[str, tuple[Builder, tuple[str, ...]]] = {"delay of 0.5 s": (delay(0.2), ("reaction_delay",))}
        few |= {name: MECHANISMS[name] for name in ("drag", "slow patch", "lag")}
        return [Case(part, f"3 of 22: {name}", _RING, (build,), right, few=3) for name, (build, right) in few.items()]
    if part == "three":
        return [
            Case(part, name, _RING, [MECHANISMS[m][0] for m in three], tuple(MECHANISMS[m][1][0] for m in three))
            for name, three in _TOGETHER.items()
        ]
    return [Case(part, name, _RING, (build,), right) for name, (build, right) in FAULTS.items()]


def _elsewhere() -> Iterator[Case]:
    """Each mechanism in each other scene; the first ones have all mechanisms and all scenes."""
    away = [name for name in SCENES if name != "home"]
    for shift in range(len(away)):
        for k, (name, (build, right)) in enumerate(MECHANISMS.items()):
            where = away[(k + shift) % len(away)]
            yield Case("elsewhere", f"{name}, {where}", SCENES[where], (build, *_CAMERAS.get(where, ())), right)


#: Parts of the benchmark.
PARTS = ("conditions", "mechanisms", "elsewhere", "forms", "laws", "few", "three", "faults")


def recorded(case: Case, strength: str, seed: int) -> Pair:
    """Record the drivers of a case twice. Raises ValueError."""
    for attempt in range(_ATTEMPTS):
        rng = np.random.default_rng([seed, attempt, *case.name.encode()])
        scene, built = case.scene, list[Built]()
        people: People = (
            followers(case.law, scene.drivers, rng, scene.noise)
            if case.law
            else drawn(scene.drivers, rng, scene.noise, scene.spread, _DESIRED[scene.is_highway])
        )
        who = np.sort(rng.choice(scene.drivers, case.few, replace=False)) if case.few else np.arange(0)
        for build in case.builders:
            one = build(STRENGTHS[strength] * (_OF_FEW if case.few else 1.0), scene, rng)
            if case.few:
                one = replace(one, hidden=replace(one.hidden, who=np.isin(np.arange(scene.drivers), who)))
            built.append(one)
        runs = [record(scene, people, [one.hidden for one in built], noise) for noise in rng.spawn(2)]
        first, second = runs
        if first is not None and second is not None:
            truth = {name: value for one in built for name, value in one.truth.items()}
            return Pair(tracks_of(first), tracks_of(second), tuple(who.tolist()), truth)
    raise ValueError(f"{case.name}: cars always collide")
