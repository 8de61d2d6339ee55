"""The road on which drivers of the benchmark drive, and what a camera sees of them."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, fields, replace
from typing import Any

import numpy as np

from benchmarks.away.drivers import People, Sight, law_action, mean_action, noises
from sugiyama_ros.arrays import Array, Mask
from sugiyama_ros.road import Road
from sugiyama_ros.trajectories.dense import DenseTracks

_LENGTH_M = 4.33
# Mean speed [m/s] of the first car on an open road, and amplitudes [m/s] and periods [s] of its waves.
_IN_TOWN = 5.5, ((3.0, 60.0), (1.5, 23.0), (0.8, 9.0))
_ON_HIGHWAY = 24.0, ((6.0, 80.0), (3.0, 31.0), (1.0, 13.0))
# Gap [m] and speed [m/s] at the start from uniform flow on an open road; in town, on a highway.
_STARTS = ((6.0, 5.0), (28.0, 19.0))


@dataclass(frozen=True)
class Setup:
    """Where, how long, and with how many drivers.

    drivers: number of drivers; ring_m: circumference; 0 for an open road, on which the first car drives as a signal of
    several periods; duration_s, period_s: duration, and time between two samples; noise: factor on all noises; spread:
    spread of desired speeds and risk premiums over the drivers; every: the camera keeps one sample of so many;
    is_moving: whether the cars start from uniform flow; otherwise from rest, with gaps of 2 m; is_highway: whether the
    open road is a highway, on which the first car drives at 14 to 34 m/s.
    """

    drivers: int = 22
    ring_m: float = 230.0
    duration_s: float = 250.0
    period_s: float = 1.0 / 3.0
    noise: float = 1.0
    spread: float = 0.1
    every: int = 1
    is_moving: bool = False
    is_highway: bool = False

    @property
    def speed_ahead(self) -> float:
        """Mean speed [m/s] of the first car on an open road."""
        return (_ON_HIGHWAY if self.is_highway else _IN_TOWN)[0]


class History:
    """What drivers see now, and what they saw before."""

    def __init__(self, scene: Setup, seen: Sequence[Sight]) -> None:
        self.scene, self._seen = scene, seen

    @property
    def now(self) -> Sight:
        """What drivers see now."""
        return self._seen[-1]

    def ago(self, seconds: float) -> Sight:
        """What drivers saw some seconds ago, between two samples by a straight line."""
        back = min(seconds / self.scene.period_s, len(self._seen) - 1.0)
        k, share = int(back), back - int(back)
        new, old = self._seen[-1 - k], self._seen[max(-2 - k, -len(self._seen))]
        if share == 0.0:
            return new
        mixed: dict[str, Any] = {
            f.name: np.where(np.isfinite(getattr(new, f.name)), getattr(new, f.name), 1e9) * (1.0 - share)
            + np.where(np.isfinite(getattr(old, f.name)), getattr(old, f.name), 1e9) * share
            for f in fields(Sight)
        }
        return Sight(**mixed)


@dataclass(frozen=True, eq=False)
class Hidden:
    """Something that the drivers, the cars or the camera do beyond the base model. All functions are optional.

    see: (moment, view) -> view: what drivers believe; want: (moment, people) -> people: what drivers want; weigh:
    (moment, view, people) -> (N, K): utility of each action, on top of the paper's; act: (moment, meant) -> (N,): what
    the cars do of the accelerations that drivers mean; push: (moment, view) -> (N,): further acceleration [m/s^2];
    steady: (view) -> (N,): factor on the acceleration noise; spoil: (positions (T, N), scene, rng) -> positions: what
    the camera makes of the measured positions; who: (N,), which drivers; all if left out.
    """

    see: Callable[[History, Sight], Sight] | None = None
    want: Callable[[History, People], People] | None = None
    weigh: Callable[[History, Sight, People], Array] | None = None
    act: Callable[[History, Array], Array] | None = None
    push: Callable[[History, Sight], Array] | None = None
    steady: Callable[[Sight], Array] | None = None
    spoil: Callable[[Array, Setup, np.random.Generator], Array] | None = None
    who: Mask | None = None


def _chosen(one: Hidden, new: Array, old: Array) -> Array:
    return new if one.who is None else np.where(one.who, new, old)


def _decide(moment: History, people: People, hidden: Sequence[Hidden]) -> Array:
    """Accelerations (N,) [m/s^2] of the cars, without noise."""
    view, wanting = moment.now, people
    more: Array | None = None
    for one in hidden:
        if one.see is not None:
            new = one.see(moment, view)
            view = replace(
                view,
                gap=_chosen(one, new.gap, view.gap),
                speed=_chosen(one, new.speed, view.speed),
                leader_speed=_chosen(one, new.leader_speed, view.leader_speed),
            )
        if one.want is not None:
            other = one.want(moment, wanting)
            wanting = replace(
                wanting,
                desired_speed=_chosen(one, other.desired_speed, wanting.desired_speed),
                risk_premium=_chosen(one, other.risk_premium, wanting.risk_premium),
            )
    for one in hidden:
        if one.weigh is not None:
            utility = one.weigh(moment, view, wanting)
            if one.who is not None:
                utility = utility * one.who[:, None]
            more = utility if more is None else more + utility
    meant = law_action(view, people) if people.law else mean_action(view, wanting, moment.scene.period_s, more)
    for one in hidden:
        if one.push is not None:
            meant = meant + _chosen(one, one.push(moment, moment.now), np.zeros_like(meant))
    for one in hidden:
        if one.act is not None:
            meant = _chosen(one, one.act(moment, meant), meant)
    return meant


def _look(time_s: float, state: tuple[Array, Array, Array, Array], ring_m: float) -> Sight:
    """What drivers see; state: positions, speeds, accelerations of the cars and of the drivers' feet, (N,) each."""
    x, v, a, held = state
    ahead = np.roll(x, -1)
    ahead[-1] = ahead[-1] + ring_m if ring_m else np.inf
    gap = ahead - x - _LENGTH_M
    return Sight(
        time_s=time_s,
        position=x,
        speed=v,
        acceleration=a,
        held=held,
        gap=gap,
        leader_speed=np.roll(v, -1),
        leader_acceleration=np.roll(a, -1),
        second_gap=np.roll(gap, -1) if ring_m else np.append(gap[1:], np.inf),
        second_speed=np.roll(v, -2),
        rear_gap=np.roll(gap, 1),
        rear_speed=np.roll(v, 1),
    )


def _start(scene: Setup, is_moving: bool) -> tuple[Array, Array]:
    """Positions [m] and speeds [m/s] at the start."""
    gap, speed = _STARTS[scene.is_highway] if is_moving else (2.0, 0.0)
    apart = scene.ring_m / scene.drivers if scene.ring_m and is_moving else _LENGTH_M + gap
    return apart * np.arange(scene.drivers, dtype=np.float64), np.full(scene.drivers, speed)


def _speed_ahead(time_s: float, scene: Setup) -> float:
    """Speed [m/s] of the first car on an open road."""
    mean, waves = _ON_HIGHWAY if scene.is_highway else _IN_TOWN
    return mean + sum(size * float(np.sin(2.0 * np.pi * time_s / period - 1.0)) for size, period in waves)


def drive(scene: Setup, people: People, hidden: Sequence[Hidden], rng: np.random.Generator, is_moving: bool) -> Array:
    """Return the positions (T, N) [m] along the road; fewer samples if cars collide."""
    samples = round(scene.duration_s / scene.period_s) + 1
    rho, std, std_x, std_v = noises(people, scene.period_s)
    x, v = _start(scene, is_moving)
    a, held, noise = (x * 0.0 for _ in range(3))
    seen: list[Sight] = []
    for k in range(samples):
        view = _look(k * scene.period_s, (x, v, a, held), scene.ring_m)
        if (view.gap <= 0.0).any() or not np.isfinite(v).all():
            break
        seen.append(view)
        held = _decide(History(scene, seen), people, hidden)
        factor = np.prod([_chosen(one, one.steady(view), x * 0.0 + 1.0) for one in hidden if one.steady], axis=0)
        noise = rho * noise + factor * std * rng.standard_normal(len(x)) if k else noise
        a = held + noise
        x = x + scene.period_s * v + std_x * rng.standard_normal(len(x))
        v = v + scene.period_s * a + std_v * rng.standard_normal(len(x))
        if not scene.ring_m:
            x[-1] = view.position[-1] + scene.period_s * view.speed[-1]
            v[-1] = max(_speed_ahead((k + 1) * scene.period_s, scene), 0.0)
    return np.array([view.position for view in seen])


def record(scene: Setup, people: People, hidden: Sequence[Hidden], rng: np.random.Generator) -> DenseTracks | None:
    """Return what a camera sees of a run; None if cars collide from rest and from uniform flow."""
    for is_moving in (scene.is_moving, True):
        x = drive(scene, people, hidden, rng, is_moving)
        if len(x) < round(scene.duration_s / scene.period_s):
            continue
        measured = x + people.measurement_std * rng.standard_normal(x.shape)
        for one in hidden:
            if one.spoil is not None:
                measured = _chosen(one, one.spoil(measured, scene, rng), measured)
        measured = measured[:: scene.every]
        return DenseTracks(
            position_m=measured % scene.ring_m if scene.ring_m else measured,
            length_m=np.full(scene.drivers, _LENGTH_M),
            vehicle=np.arange(scene.drivers),
            road=Road(scene.ring_m),
            period_s=scene.every * scene.period_s,
            source="a simulation away from home",
        )
    return None
