"""How well classes, goals and a population are found on short tracks; dated figures are in ``results``.

- ``classes``: tracks of 15 s of drivers of three classes, as a drone sees them: all cars of a ring but the first as
  followers. Adjusted Rand index, coverage of the 95 % intervals of the classes' parameters, CPU time.
- ``exits``: drivers on the way to an exit, some of whom want to leave, and are blocked before the ramp. The vehicles
  ahead count as controlled, so nobody asks what they intend. Calibration
  error of the probability of the goal, and Brier score against the share of the goal on the lane.
- ``held_out FILE``: models of a population on measured tracks, cut to 15 s, by drivers who are held out.
- ``delay``: whether a diagnosis finds a delay that all drivers have, and nothing in drivers without an effect.

    python -m benchmarks.pooling classes --seeds 7000 7100
"""

import argparse
import sys
import time
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import numpy as np

import sugiyama_ros as sg
from sugiyama_ros.arrays import Array, Ints
from sugiyama_ros.driver.parameters import KAPPA_V, SIGMA_A, V_STAR, index, population
from sugiyama_ros.effects.registry import ROW, switch_on
from sugiyama_ros.fit.driver_types import gain
from sugiyama_ros.fit.held_out_drivers import chosen, predict_held_out
from sugiyama_ros.fit.preparation import prepare
from sugiyama_ros.road import Road
from sugiyama_ros.simulation.simulator import Clock, Simulator, evenly, simulate
from sugiyama_ros.studies.driver_types import adjusted_rand
from sugiyama_ros.trajectories.about import About
from sugiyama_ros.trajectories.exchange import of_columns
from sugiyama_ros.trajectories.labels import labels_of
from sugiyama_ros.trajectories.tracks import Tracks

LENGTH_M, SEEN_S = 4.5, 15.0
#: v* [m/s], kappa_v [s] and sigma_a [m/s^2] of three classes of drivers, and their shares.
CLASSES = np.array([[8.0, 0.5, 0.15], [11.0, 0.2, 0.3], [15.0, 0.08, 0.6]])
SHARE = np.array([0.4, 0.35, 0.25])
PARAMETERS = [V_STAR, KAPPA_V, SIGMA_A]
#: The exit of ``exits``, and the share of the drivers on the right and on the left lane who want to leave.
EXIT = {"place": 500.0, "speed": 8.0, "deceleration": 1.5}
WANT = np.array([0.6, 0.2])


class Seen:
    """Collects what is seen of vehicles."""

    def __init__(self) -> None:
        self.parts: list[tuple[str, str, Array, Array, bool]] = []

    def add(
        self, lane: str, vehicle: str, first_s: float, period_s: float, position_m: Array, is_judged: bool = True
    ) -> None:
        """Add positions (T,) [m] of a vehicle from a time [s] on; ``is_judged``: whether it counts as a driver."""
        time_s: Array = np.asarray(first_s + period_s * np.arange(len(position_m)), np.float64)
        self.parts.append((lane, vehicle, time_s, position_m, is_judged))

    def tracks(self) -> Tracks:
        """All of it as tracks."""
        texts = {
            "lane": labels_of([part[0] for part in self.parts for _ in part[2]]),
            "vehicle": labels_of([part[1] for part in self.parts for _ in part[2]]),
        }
        time_s, position_m = (np.concatenate([part[k] for part in self.parts]) for k in (2, 3))
        numbers = {"time_s": time_s, "s_m": position_m, "length_m": np.full(len(time_s), LENGTH_M)}
        numbers["controlled"] = np.concatenate([np.full(len(part[2]), not part[4]) for part in self.parts])
        return of_columns({**texts, **numbers}, About(source="simulated"))


def on_rings(
    drivers: int, seed: int, period_s: float, kinds_of: Array, share: Array, spread: float = 0.0, delay_s: float = 0.0
) -> tuple[Tracks, dict[str, int]]:
    """Tracks of drivers in the flow of rings of 230 m with 21 cars, after 40 s; and the class of each by name.

    kinds_of: (K, 3), parameters of the classes; spread: standard deviation of the logarithm of each within a class.
    """
    rng, seen, ring = np.random.default_rng(seed), Seen(), 0
    kinds: dict[str, int] = {}
    cars, road = 21, Road(230.0)
    length_m, samples = np.full(cars, LENGTH_M), round(SEEN_S / period_s) + 1
    while len(kinds) < drivers:
        kind = rng.choice(len(share), size=cars, p=share)
        rows = np.tile(ROW.with_effects(population()), (cars, 1))
        rows[:, PARAMETERS] = kinds_of[kind] * np.exp(spread * rng.standard_normal((cars, len(PARAMETERS))))
        if delay_s:
            rows = switch_on(rows, "reaction_delay", {"delay": delay_s})
        start = Simulator(
            rows, length_m, evenly(length_m, road), road, np.random.default_rng([seed, ring]), clock=Clock(period_s)
        )
        run = simulate(start, 40.0 + 3.0 * SEEN_S)
        if not run.collisions:
            way = road.unwrap(run.dense.position_m)
            first = int(rng.integers(round(40.0 / period_s), len(way) - samples))
            way = way[first : first + samples]
            way += road.circumference_m * np.maximum.accumulate(np.ceil((way[0, 0] - way[0]) / road.circumference_m))
            for car in range(cars):
                seen.add(f"{ring}", f"{ring}-{car}", period_s * first, period_s, way[:, car])
            kinds |= {f"{ring}-{car}": int(kind[car]) for car in range(cars - 1)}
        ring += 1
    return seen.tracks(), kinds


def classes(seeds: range, drivers: int, period_s: float) -> None:
    """Find three classes in short tracks."""
    inside, indices, cpu_s = [], [], []
    for seed in seeds:
        tracks, kinds = on_rings(drivers, seed, period_s, CLASSES, SHARE)
        began = time.process_time()
        found = sg.calibrate(tracks, classes=3)
        cpu_s.append(time.process_time() - began)
        assert found.classes is not None
        truth: Ints = np.array([kinds[str(driver.vehicle)] for driver in found.drivers])
        indices.append(adjusted_rand(truth, found.classes.probability.argmax(axis=1)))
        order = np.argsort(-found.classes.rows[:, KAPPA_V])
        low, high = np.moveaxis(found.classes.interval[order][:, PARAMETERS], -1, 0)
        inside.append((low <= CLASSES) & (high >= CLASSES))
        print(seed, f"index {indices[-1]:.2f}, {cpu_s[-1]:.1f} CPU s", flush=True)
    print(f"adjusted Rand index: mean {np.mean(indices):.3f}, least {min(indices):.3f}, at least 0.8 in", end=" ")
    print(f"{np.mean(np.array(indices) >= 0.8):.0%}; CPU time {np.mean(cpu_s):.1f} s")
    print(
        f"intervals hold: {np.mean(inside):.1%}; by class and v*, kappa_v, sigma_a: {np.mean(inside, axis=0).tolist()}"
    )


def approach(rng: np.random.Generator, leaves: bool, is_slow: bool, period_s: float) -> Array | None:
    """Positions (T, 3) of a driver and two vehicles ahead, until 15 s or 10 m before the exit; None of a collision."""
    rows = np.tile(ROW.with_effects(population()), (3, 1))
    rows[:, V_STAR] = (4.0 if is_slow else 15.0) * np.exp(0.1 * rng.standard_normal(3))
    rows[0, V_STAR] = 15.0 * np.exp(0.1 * rng.standard_normal())
    rows[:, KAPPA_V] = 0.4 * np.exp(0.2 * rng.standard_normal(3))
    if leaves:
        rows[:1] = switch_on(rows[:1], "goal_ahead", EXIT)
    first_m = rng.uniform(330.0, 400.0) if is_slow else rng.uniform(280.0, 340.0)
    place_m = first_m + np.append(0.0, np.cumsum(LENGTH_M + rng.uniform(15.0, 40.0, 2)))
    speed = (4.0 if is_slow else 12.0) * np.exp(0.05 * rng.standard_normal(3))
    start = Simulator(rows, np.full(3, LENGTH_M), place_m, Road(), rng, speed=speed, clock=Clock(period_s))
    run = simulate(start, SEEN_S)
    end = int(np.argmax(run.position_m[:, 0] > EXIT["place"] - 10.0)) or len(run.position_m)
    return None if run.collisions else run.dense.position_m[:end]


def on_the_way(seed: int, drivers: int, blocked: int, period_s: float) -> tuple[Tracks, dict[str, tuple[int, bool]]]:
    """Tracks on the way to the exit; and of each driver by name the number of the lane, and who wants to leave."""
    rng, seen = np.random.default_rng(seed), Seen()
    lane = rng.integers(0, 2, drivers)
    leaves = rng.random(drivers) < WANT[lane]
    # as many of the others are behind slow vehicles
    is_slow = np.zeros(drivers, np.bool_)
    for group, count in ((leaves, blocked), (~leaves, round(blocked * (~leaves).sum() / leaves.sum()))):
        is_slow[rng.choice(np.flatnonzero(group), count, replace=False)] = True
    for i in range(drivers):
        way = None
        while way is None or len(way) < 6.0 / period_s:
            way = approach(rng, bool(leaves[i]), bool(is_slow[i]), period_s)
        for j in range(3):
            seen.add(("right", "left")[lane[i]], f"{i}-{j}", 100.0 * i, period_s, way[:, j], j == 0)
    truth = zip(lane.tolist(), leaves.tolist(), strict=True)
    return seen.tracks(), {f"{i}-0": one for i, one in enumerate(truth)}


def exits(seeds: range, drivers: int, blocked: int, period_s: float) -> None:
    """Tell who wants to leave."""
    for seed in seeds:
        tracks, truth = on_the_way(seed, drivers, blocked, period_s)
        found = sg.calibrate(tracks, goals={"exit": EXIT})
        assert found.classes is not None
        lane, leaves = np.array([truth[str(driver.vehicle)] for driver in found.drivers]).T
        p, base = found.classes.goal_probability[:, 1], np.array([leaves[lane == k].mean() for k in (0, 1)])[lane]
        gained = np.square(base - leaves) - np.square(p - leaves)
        bins = np.minimum((10.0 * p).astype(int), 9)
        off = sum((bins == k).mean() * abs(p[bins == k].mean() - leaves[bins == k].mean()) for k in np.unique(bins))
        print(
            f"{seed} calibration error {off:.3f}; Brier score {np.mean(np.square(base - leaves)):.4f} ->"
            f" {np.mean(np.square(p - leaves)):.4f},"
            f" gain {gained.mean():.4f} ± {gained.std() / len(gained) ** 0.5:.4f}",
            flush=True,
        )


def held_out(file: Path) -> None:
    """Compare models of a population on the first 15 s of each measured driver."""
    tracks = sg.read(file)
    since_s = tracks.time_s - tracks.time_s[tracks.start[:-1]][tracks.run]
    data = prepare(tracks.select(since_s <= SEEN_S), most=None)
    with ThreadPoolExecutor(2) as work:
        found = predict_held_out(data, [index(name) for name in data.even.estimated()], 6, work, seed=0)
    for one in found:
        print(one.document(found[0]), "than alone: {:.2f} ± {:.2f}".format(*gain(one.later, found[-1].later)))
    print(data.drivers, "drivers; number of classes:", chosen(found))


def delay(seeds: range, drivers: int, period_s: float, delay_s: float) -> None:
    """Diagnose drivers with a delay of so many seconds."""
    one = np.array([[10.26, 0.215, 0.273]])
    for seed in seeds:
        tracks, _ = on_rings(drivers, seed, period_s, one, np.ones(1), 0.2, delay_s)
        found = sg.diagnose(tracks, add="auto")
        print(seed, found.summary().splitlines()[0], flush=True)


def main() -> None:
    """Run one of them."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("what", choices=("classes", "exits", "held_out", "delay"))
    parser.add_argument("file", nargs="?", type=Path)
    parser.add_argument("--seeds", nargs=2, type=int, default=(0, 1), help="first one, and one beyond the last one")
    parser.add_argument("--drivers", type=int, default=60)
    parser.add_argument("--blocked", type=int, default=100)
    parser.add_argument("--period", type=float, default=0.2)
    parser.add_argument("--delay", type=float, default=0.0)
    given = parser.parse_args()
    seeds = range(*given.seeds)
    if given.what == "classes":
        classes(seeds, given.drivers, given.period)
    elif given.what == "exits":
        exits(seeds, given.drivers, given.blocked, given.period)
    elif given.what == "delay":
        delay(seeds, given.drivers, given.period, given.delay)
    elif given.file is None:
        sys.exit("held_out: give a FILE")
    else:
        held_out(given.file)


if __name__ == "__main__":
    main()
