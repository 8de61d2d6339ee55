"""Who goes at a line, and when they wait: the attention of this package beside a logistic regression on the time gap.

    python -m benchmarks.junctions make roundabout DIR_1 --seed 1    (and DIR_2, DIR_3)
    python -m benchmarks.gaps DIR_1 DIR_2 --judge DIR_3

A gap is offered whenever a driver is near a line, with nobody before it, and somebody who goes first comes. They accept
it if they pass the line before the other one arrives. Both models are logistic with two numbers, fitted to the first
folders: on the time until the other one arrives, and on the time that the driver would have left after being through.
Losses are of the folder to judge, their difference with a standard error over drivers.
"""

import argparse
from collections.abc import Sequence
from pathlib import Path
from typing import NamedTuple

import numpy as np
from scipy.optimize import minimize

import sugiyama_ros as sg
from sugiyama_ros.arrays import Array, Ints, Mask
from sugiyama_ros.driver.line import time_through
from sugiyama_ros.trajectories.tracks import Tracks

# Gap [m] to a line within which a driver decides.
_NEAR_M = 12.0
# Samples without a line, and growth [s] of the time to arrival, that end an offer.
_APART, _LATER_S = 3, 0.5


class Offers(NamedTuple):
    """Gaps that drivers are offered, (n,) each: time [s] until who goes first arrives, time [s] until the driver would
    be through, whether they went, and the number of the driver.
    """

    arrive_s: Array
    through_s: Array
    went: Mask
    driver: Ints


def main() -> None:
    """Print both losses."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("fit", type=Path, nargs="+", help="folders of traffic to fit to")
    parser.add_argument("--judge", type=Path, required=True, help="folder of traffic to judge by")
    asked = parser.parse_args()
    known = [offers(read(folder)) for folder in asked.fit]
    learnt = Offers(*(np.concatenate(parts) for parts in zip(*known, strict=True)))
    judged = offers(read(asked.judge))
    losses = []
    for name, of in (("time gap", 0.0), ("attention", 1.0)):
        fitted = fit(learnt.arrive_s - of * learnt.through_s, learnt.went)
        losses.append(loss(fitted, judged.arrive_s - of * judged.through_s, judged.went))
        print(f"{name}: log-loss {losses[-1].mean():.4f}, half go at {-fitted[0] / fitted[1]:.2f} s")
    difference = losses[0] - losses[1]
    number = np.unique(judged.driver, return_inverse=True)[1]
    left = np.bincount(number, difference - difference.mean())
    std = float(np.sqrt(np.square(left).sum())) / len(difference)
    print(
        f"{len(difference)} offers, {judged.went.mean():.2f} accepted; difference {difference.mean():.4f} +- {std:.4f}"
    )


def read(folder: Path) -> Tracks:
    """Traffic of SUMO on its road."""
    return sg.read(folder / "fcd.xml", road=folder / "road.csv")


def offers(tracks: Tracks) -> Offers:
    """All gaps that drivers are offered."""
    found = [one for run in range(tracks.runs) for one in _offers_of(tracks, run)]
    arrive, through, went, driver = (np.array(column) for column in zip(*found, strict=True))
    return Offers(arrive, through, went, driver)


def _offers_of(tracks: Tracks, run: int) -> list[tuple[float, float, bool, int]]:
    rows = slice(int(tracks.start[run]), int(tracks.start[run + 1]))
    line, arrive, shift = tracks.line_m, tracks.arrive_s, tracks.leader_shift_m
    if line is None or arrive is None or shift is None or rows.stop - rows.start < 3:
        return []
    time, front = tracks.time_s[rows], tracks.s_m[rows] + 0.5 * tracks.length_m[rows]
    speed, gap = np.gradient(front, time), line[rows] - front
    leader = tracks.leader_row[rows]
    ahead = np.where(leader >= 0, tracks.s_m[leader] + shift[rows] - 0.5 * tracks.length_m[leader], np.inf)
    is_first = ahead > line[rows]
    near = is_first & (gap > 0.0) & (gap < _NEAR_M) & (arrive[rows] > 0.0) & np.isfinite(arrive[rows])
    found: list[tuple[float, float, bool, int]] = []
    last = (-_APART - 1, 0.0)
    for k in np.flatnonzero(near).tolist():
        now = float(arrive[rows][k])
        is_new = k - last[0] > _APART or now > last[1] + _LATER_S
        last = (k, now)
        there_s = time[k] + now
        if is_new and (there_s <= time[-1] or front[-1] > line[rows][k]):
            went = bool(np.interp(there_s, time, front) > line[rows][k])
            found.append((now, time_through(float(gap[k]), float(speed[k])), went, run))
    return found


def fit(x: Array, went: Mask) -> Array:
    """The two numbers of the logistic model that suits best."""
    return np.asarray(minimize(lambda p: loss(p, x, went).sum(), [0.0, 1.0], method="Nelder-Mead").x)


def loss(fitted: Sequence[float] | Array, x: Array, went: Mask) -> Array:
    """Minus the logarithm of the probability of what happened, of each offer."""
    return np.asarray(np.logaddexp(0.0, -np.where(went, 1.0, -1.0) * (fitted[0] + fitted[1] * x)))


if __name__ == "__main__":
    main()
