"""Mechanisms of the catalogue, by formulas of their own: exact delays, terms of the utility, trends."""

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, replace

import numpy as np

from sugiyama_ros.arrays import Array
from sugiyama_ros.studies.away.drivers import People, Sight, worst_risk
from sugiyama_ros.studies.away.world import Hidden, History, Setup

_LENGTH_M = 4.33


@dataclass(frozen=True, eq=False)
class Built:
    """Something hidden in a recording, with the values that a fit should find.

    hidden: what acts; truth: values by the name that the package gives them, where both formulas mean the same.
    """

    hidden: Hidden
    truth: Mapping[str, float] = field(default_factory=dict)


#: (strength, scene, rng) -> Built; the strength is 1 for the strong form and less for the weak form.
Builder = Callable[[float, Setup, np.random.Generator], Built]


def delay(seconds: float) -> Builder:
    """Gap and leader's speed of some time ago; drivers know their own speed."""

    def build(strength: float, scene: Setup, rng: np.random.Generator) -> Built:
        def see(moment: History, view: Sight) -> Sight:
            then = moment.ago(seconds * strength)
            return replace(view, gap=then.gap, leader_speed=then.leader_speed)

        return Built(Hidden(see=see), {"reaction_delay.delay": seconds * strength})

    return build


def second_leader(strength: float, scene: Setup, rng: np.random.Generator) -> Built:
    """The risk of the second car ahead, as a term of the utility."""

    def weigh(moment: History, view: Sight, people: People) -> Array:
        gap = view.gap + _LENGTH_M + view.second_gap
        shifted = worst_risk(gap - _LENGTH_M - 2.0, view, view.second_speed, people, scene.period_s)
        return -10.0 * 0.35 * strength * shifted

    return Built(Hidden(weigh=weigh))


def rear_pressure(strength: float, scene: Setup, rng: np.random.Generator) -> Built:
    """The risk of the car behind, as a term of the utility: who drives faster gets away from it."""

    def weigh(moment: History, view: Sight, people: People) -> Array:
        actions = np.arange(-24, 17) / 4.0
        near = np.exp(-((np.maximum(view.rear_gap, 0.0) / 3.0) ** 2))
        return np.asarray(0.35 * strength * near[:, None] * actions / 10.0)

    return Built(Hidden(weigh=weigh))


def drift(strength: float, scene: Setup, rng: np.random.Generator) -> Built:
    """Each driver's desired speed wanders as a random walk that is pulled back."""
    mood = np.zeros(scene.drivers)
    keep = float(np.exp(-scene.period_s / 40.0))

    def want(moment: History, people: People) -> People:
        mood[:] = keep * mood + 0.04 * strength * np.sqrt(1.0 - keep**2) * rng.standard_normal(len(mood))
        return replace(people, desired_speed=people.desired_speed * np.exp(mood))

    return Built(Hidden(want=want))


def switch(strength: float, scene: Setup, rng: np.random.Generator) -> Built:
    """All drivers want another speed from some moment on."""
    time = float(rng.uniform(0.35, 0.65)) * scene.duration_s
    change = 0.12 * strength

    def want(moment: History, people: People) -> People:
        factor = np.exp(-change if moment.now.time_s >= time else 0.0)
        return replace(people, desired_speed=people.desired_speed * factor)

    return Built(Hidden(want=want), {"preference_switch.v_star_change": -change, "preference_switch.time": time})


def _push(force: Callable[[History, Sight], Array]) -> Hidden:
    return Hidden(push=force)


def drag(strength: float, scene: Setup, rng: np.random.Generator) -> Built:
    """Rolling resistance and drag of the air."""
    c0, c2 = 0.3 * strength, 0.004 * strength
    push = _push(lambda moment, view: -c0 * np.tanh(4.0 * view.speed) - c2 * view.speed * np.abs(view.speed))
    return Built(push, {"drag.c0": c0, "drag.c2": c2})


def _near(view: Sight, middle: float, width: float, scene: Setup) -> Array:
    """A raised cosine around a place, 1 in its middle."""
    off = view.position - middle
    if scene.ring_m:
        off = (off + 0.5 * scene.ring_m) % scene.ring_m - 0.5 * scene.ring_m
    return np.where(np.abs(off) < 0.5 * width, 0.5 + 0.5 * np.cos(2.0 * np.pi * off / width), 0.0)


def _place(scene: Setup, rng: np.random.Generator) -> float:
    return float(rng.uniform(0.0, 1.0)) * (scene.ring_m or scene.speed_ahead * scene.duration_s)


def grade(strength: float, scene: Setup, rng: np.random.Generator) -> Built:
    """A hill on a part of the road."""
    middle = _place(scene, rng)
    slope = 0.05 * strength
    return Built(_push(lambda moment, view: -9.81 * slope * _near(view, middle, 80.0, scene)))


def patch(strength: float, scene: Setup, rng: np.random.Generator) -> Built:
    """Drivers want to be slower on a part of the road."""
    middle = _place(scene, rng)

    def want(moment: History, people: People) -> People:
        slower = 1.0 - 0.09 * strength * _near(moment.now, middle, 80.0, scene)
        return replace(people, desired_speed=people.desired_speed * slower)

    return Built(Hidden(want=want))


def lag(strength: float, scene: Setup, rng: np.random.Generator) -> Built:
    """The car follows the foot with a time constant, solved exactly over a period."""
    time = 0.25 * strength
    keep = float(np.exp(-scene.period_s / time))

    def act(moment: History, meant: Array) -> Array:
        return keep * moment.now.held + (1.0 - keep) * meant

    return Built(Hidden(act=act), {"actuation_lag.tau": time})


def weak_brakes(strength: float, scene: Setup, rng: np.random.Generator) -> Built:
    """Cars brake at most so hard."""
    return Built(Hidden(act=lambda moment, meant: np.maximum(meant, -1.2 / strength)))


def weak_engine(strength: float, scene: Setup, rng: np.random.Generator) -> Built:
    """Cars accelerate at most with so much power."""
    power = 5.0 / strength

    def act(moment: History, meant: Array) -> Array:
        return np.minimum(meant, power / np.maximum(moment.now.speed, 1.0))

    return Built(Hidden(act=act))


def outliers(strength: float, scene: Setup, rng: np.random.Generator) -> Built:
    """A few positions are off by much more than usual."""

    def spoil(x: Array, scene: Setup, rng: np.random.Generator) -> Array:
        return x + np.where(rng.random(x.shape) < 0.04 * strength, 1.2, 0.0) * rng.standard_normal(x.shape)

    return Built(Hidden(spoil=spoil))


def push(strength: float, scene: Setup, rng: np.random.Generator) -> Built:
    """One car is pushed back for some seconds."""
    who = np.arange(scene.drivers) == rng.integers(0, scene.drivers - 1)
    time = float(rng.uniform(0.3, 0.7)) * scene.duration_s

    def force(moment: History, view: Sight) -> Array:
        off = (moment.now.time_s - time) / 2.0
        return np.full(scene.drivers, -1.5 * strength * float(np.exp(-0.5 * off * off)))

    return Built(Hidden(push=force, who=who), {"external_push.time": time})


def held_pedal(strength: float, scene: Setup, rng: np.random.Generator) -> Built:
    """Drivers change the pedal only if they want a clearly different acceleration."""

    def act(moment: History, meant: Array) -> Array:
        return np.where(np.abs(meant - moment.now.held) > 0.5 * strength, meant, moment.now.held)

    return Built(Hidden(act=act))


#: Builders by the name of the catalogue, and the names that mean the same mechanism.
MECHANISMS: Mapping[str, tuple[Builder, tuple[str, ...]]] = {
    "delay of 0.2 s": (delay(0.2), ("reaction_delay",)),
    "delay of 0.5 s": (delay(0.5), ("reaction_delay",)),
    "second leader in the utility": (second_leader, ("second_leader",)),
    "rear pressure in the utility": (rear_pressure, ("rear_pressure",)),
    "drift": (drift, ("preference_drift",)),
    "switch": (switch, ("preference_switch",)),
    "drag": (drag, ("drag",)),
    "grade": (grade, ("road_grade",)),
    "slow patch": (patch, ("slow_patch",)),
    "lag": (lag, ("actuation_lag",)),
    "weak brakes": (weak_brakes, ("limited_braking",)),
    "weak engine": (weak_engine, ("limited_power",)),
    "outliers": (outliers, ("outlier_noise",)),
    "push of one car": (push, ("external_push",)),
    "held pedal": (held_pedal, ("perception_threshold",)),
}
