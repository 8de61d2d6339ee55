"""What recordings of the benchmark hide: mechanisms of the catalogue, forms that it lacks, and faults of a measurement.

Each is written by a formula of its own: exact delays, terms of the utility, trends.
"""

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, replace

import numpy as np

from benchmarks.away.drivers import People, Sight, worst_risk
from benchmarks.away.world import Hidden, History, Setup
from sugiyama_ros.arrays import Array

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


def _second_leader(strength: float, scene: Setup, rng: np.random.Generator) -> Built:
    """The risk of the second car ahead, as a term of the utility."""

    def weigh(moment: History, view: Sight, people: People) -> Array:
        gap = view.gap + _LENGTH_M + view.second_gap
        shifted = worst_risk(gap - _LENGTH_M - 2.0, view, view.second_speed, people, scene.period_s)
        return -10.0 * 0.35 * strength * shifted

    return Built(Hidden(weigh=weigh))


def _rear_pressure(strength: float, scene: Setup, rng: np.random.Generator) -> Built:
    """The risk of the car behind, as a term of the utility: who drives faster gets away from it."""

    def weigh(moment: History, view: Sight, people: People) -> Array:
        actions = np.arange(-24, 17) / 4.0
        near = np.exp(-((np.maximum(view.rear_gap, 0.0) / 3.0) ** 2))
        return np.asarray(0.35 * strength * near[:, None] * actions / 10.0)

    return Built(Hidden(weigh=weigh))


def _drift(strength: float, scene: Setup, rng: np.random.Generator) -> Built:
    """Each driver's desired speed wanders as a random walk that is pulled back."""
    mood = np.zeros(scene.drivers)
    keep = float(np.exp(-scene.period_s / 40.0))

    def want(moment: History, people: People) -> People:
        mood[:] = keep * mood + 0.04 * strength * np.sqrt(1.0 - keep**2) * rng.standard_normal(len(mood))
        return replace(people, desired_speed=people.desired_speed * np.exp(mood))

    return Built(Hidden(want=want))


def _switch(strength: float, scene: Setup, rng: np.random.Generator) -> Built:
    """All drivers want another speed from some moment on."""
    time = float(rng.uniform(0.35, 0.65)) * scene.duration_s
    change = 0.12 * strength

    def want(moment: History, people: People) -> People:
        factor = np.exp(-change if moment.now.time_s >= time else 0.0)
        return replace(people, desired_speed=people.desired_speed * factor)

    return Built(Hidden(want=want), {"preference_switch.v_star_change": -change, "preference_switch.time": time})


def _drag(strength: float, scene: Setup, rng: np.random.Generator) -> Built:
    """Rolling resistance and drag of the air."""
    c0, c2 = 0.3 * strength, 0.004 * strength
    push = Hidden(push=lambda moment, view: -c0 * np.tanh(4.0 * view.speed) - c2 * view.speed * np.abs(view.speed))
    return Built(push, {"drag.c0": c0, "drag.c2": c2})


def _near(view: Sight, middle: float, width: float, scene: Setup) -> Array:
    """A raised cosine around a place, 1 in its middle."""
    off = view.position - middle
    if scene.ring_m:
        off = (off + 0.5 * scene.ring_m) % scene.ring_m - 0.5 * scene.ring_m
    return np.where(np.abs(off) < 0.5 * width, 0.5 + 0.5 * np.cos(2.0 * np.pi * off / width), 0.0)


def _place(scene: Setup, rng: np.random.Generator) -> float:
    return float(rng.uniform(0.0, 1.0)) * (scene.ring_m or scene.speed_ahead * scene.duration_s)


def _grade(strength: float, scene: Setup, rng: np.random.Generator) -> Built:
    """A hill on a part of the road."""
    middle = _place(scene, rng)
    slope = 0.05 * strength
    return Built(Hidden(push=lambda moment, view: -9.81 * slope * _near(view, middle, 80.0, scene)))


def _patch(strength: float, scene: Setup, rng: np.random.Generator) -> Built:
    """Drivers want to be slower on a part of the road."""
    middle = _place(scene, rng)

    def want(moment: History, people: People) -> People:
        slower = 1.0 - 0.09 * strength * _near(moment.now, middle, 80.0, scene)
        return replace(people, desired_speed=people.desired_speed * slower)

    return Built(Hidden(want=want))


def _lag(strength: float, scene: Setup, rng: np.random.Generator) -> Built:
    """The car follows the foot with a time constant, solved exactly over a period."""
    time = 0.25 * strength
    keep = float(np.exp(-scene.period_s / time))

    def act(moment: History, meant: Array) -> Array:
        return keep * moment.now.held + (1.0 - keep) * meant

    return Built(Hidden(act=act), {"actuation_lag.tau": time})


def _weak_brakes(strength: float, scene: Setup, rng: np.random.Generator) -> Built:
    """Cars brake at most so hard."""
    return Built(Hidden(act=lambda moment, meant: np.maximum(meant, -1.2 / strength)))


def _weak_engine(strength: float, scene: Setup, rng: np.random.Generator) -> Built:
    """Cars accelerate at most with so much power."""
    power = 5.0 / strength

    def act(moment: History, meant: Array) -> Array:
        return np.minimum(meant, power / np.maximum(moment.now.speed, 1.0))

    return Built(Hidden(act=act))


def _outliers(strength: float, scene: Setup, rng: np.random.Generator) -> Built:
    """A few positions are off by much more than usual."""

    def spoil(x: Array, scene: Setup, rng: np.random.Generator) -> Array:
        return x + np.where(rng.random(x.shape) < 0.04 * strength, 1.2, 0.0) * rng.standard_normal(x.shape)

    return Built(Hidden(spoil=spoil))


def _push(strength: float, scene: Setup, rng: np.random.Generator) -> Built:
    """One car is once braked hard."""
    who = np.arange(scene.drivers) == rng.integers(0, scene.drivers - 1)
    time = float(rng.uniform(0.3, 0.7)) * scene.duration_s

    def force(moment: History, view: Sight) -> Array:
        off = (moment.now.time_s - time) / 1.2
        return np.full(scene.drivers, -4.0 * strength * float(np.exp(-0.5 * off * off)))

    return Built(Hidden(push=force, who=who), {"external_push.time": time})


def _held_pedal(strength: float, scene: Setup, rng: np.random.Generator) -> Built:
    """Drivers change the pedal only if they want a clearly different acceleration."""

    def act(moment: History, meant: Array) -> Array:
        return np.where(np.abs(meant - moment.now.held) > 0.5 * strength, meant, moment.now.held)

    return Built(Hidden(act=act))


#: Builders by the name of the catalogue, and the names that mean the same mechanism.
MECHANISMS: Mapping[str, tuple[Builder, tuple[str, ...]]] = {
    "delay of 0.2 s": (delay(0.2), ("reaction_delay",)),
    "delay of 0.5 s": (delay(0.5), ("reaction_delay",)),
    "second leader in the utility": (_second_leader, ("second_leader",)),
    "rear pressure in the utility": (_rear_pressure, ("rear_pressure",)),
    "drift": (_drift, ("preference_drift",)),
    "switch": (_switch, ("preference_switch",)),
    "drag": (_drag, ("drag",)),
    "grade": (_grade, ("road_grade",)),
    "slow patch": (_patch, ("slow_patch",)),
    "lag": (_lag, ("actuation_lag",)),
    "weak brakes": (_weak_brakes, ("limited_braking",)),
    "weak engine": (_weak_engine, ("limited_power",)),
    "outliers": (_outliers, ("outlier_noise",)),
    "push of one car": (_push, ("external_push",)),
    "held pedal": (_held_pedal, ("perception_threshold",)),
}


def _force(function: Callable[[History, Sight, Setup], Array]) -> Builder:
    """A force of the moment, of the view and of the scene, in proportion to the strength."""

    def build(strength: float, scene: Setup, rng: np.random.Generator) -> Built:
        return Built(Hidden(push=lambda moment, view: strength * function(moment, view, scene)))

    return build


def _brake_lights(moment: History, view: Sight, scene: Setup) -> Array:
    return np.asarray(-0.6 * np.maximum(-view.leader_acceleration - 0.5, 0.0))


def _hurry(moment: History, view: Sight, scene: Setup) -> Array:
    return np.asarray(0.8 * np.exp(-(((view.gap - 7.0) / 2.0) ** 2)))


def _reluctance(moment: History, view: Sight, scene: Setup) -> Array:
    return np.asarray(-0.7 * np.exp(-(((view.speed - 5.0) / 1.5) ** 2)))


def _overreaction(moment: History, view: Sight, scene: Setup) -> Array:
    return np.asarray(-0.7 * np.tanh((view.speed - view.leader_speed) / 0.7))


def _rough_places(moment: History, view: Sight, scene: Setup) -> Array:
    length = scene.ring_m or 400.0
    here = (view.position % length) / length
    return np.asarray(-0.6 * ((np.abs(here - 0.2) < 0.06) | (np.abs(here - 0.7) < 0.06)))


def _tiring(moment: History, view: Sight, scene: Setup) -> Array:
    return np.full(scene.drivers, 0.3 - 0.6 * view.time_s / scene.duration_s)


def _swinging(moment: History, view: Sight, scene: Setup) -> Array:
    return np.full(scene.drivers, 0.4 * float(np.sin(2.0 * np.pi * view.time_s / 40.0)))


def _herd(moment: History, view: Sight, scene: Setup) -> Array:
    ahead = np.mean([np.roll(view.speed, -k) for k in range(2, 6)], axis=0)
    return np.asarray(0.2 * (ahead - view.speed))


def _chased(moment: History, view: Sight, scene: Setup) -> Array:
    return np.asarray(0.6 * np.maximum(view.rear_speed - view.speed, 0.0))


def _stubborn(moment: History, view: Sight, scene: Setup) -> Array:
    """Drivers keep on doing what they did two seconds ago."""
    return np.asarray(0.35 * np.clip(moment.ago(2.0).acceleration, -1.5, 1.5))


def _impatience(moment: History, view: Sight, scene: Setup) -> Array:
    """Who was slow six seconds ago drives off in a hurry."""
    return np.asarray(0.7 * (moment.ago(6.0).speed < 2.0) * (view.speed > 2.0))


def _time_gap(moment: History, view: Sight, scene: Setup) -> Array:
    """A controller of the time gap on top of the driver."""
    return np.clip(0.15 * (np.minimum(view.gap, 20.0) - 2.0 - 0.6 * view.speed), -0.8, 0.8)


def _dead_zone(strength: float, scene: Setup, rng: np.random.Generator) -> Built:
    """Wiedemann's threshold: drivers do not see slow changes of the headway."""

    def see(moment: History, view: Sight) -> Sight:
        closing = view.leader_speed - view.speed
        visible = 0.03 * strength * np.minimum(view.gap + _LENGTH_M, 30.0) ** 1.5
        return replace(view, leader_speed=np.where(np.abs(closing) > visible, view.leader_speed, view.speed))

    return Built(Hidden(see=see))


def _speed_limit(strength: float, scene: Setup, rng: np.random.Generator) -> Built:
    """A sharp limit of speed on a third of the road."""
    length = scene.ring_m or 400.0

    def want(moment: History, people: People) -> People:
        inside = (moment.now.position % length) / length < 0.33
        return replace(people, desired_speed=people.desired_speed * (1.0 - 0.15 * strength * inside))

    return Built(Hidden(want=want))


#: Builder, covariates where the form shows, and names of the catalogue that come near.
FORMS: Mapping[str, tuple[Builder, tuple[str, ...], tuple[str, ...]]] = {
    "brake lights": (_force(_brake_lights), ("leader_acceleration",), ("second_leader",)),
    "hurry at medium gaps": (_force(_hurry), ("gap", "rear_gap"), ("response_constants",)),
    "reluctance at medium speed": (_force(_reluctance), ("speed",), ("drag", "comfort_limits")),
    "overreaction to approach": (_force(_overreaction), ("approach_rate",), ("response_constants",)),
    "two rough places": (_force(_rough_places), ("place",), ("slow_patch", "road_grade")),
    "tiring": (_force(_tiring), ("time",), ("preference_switch", "preference_drift")),
    "swinging moods": (_force(_swinging), ("time",), ("preference_drift",)),
    "herd": (_force(_herd), ("second_gap", "second_approach_rate"), ("second_leader",)),
    "chased": (_force(_chased), ("rear_gap", "rear_approach_rate"), ("rear_pressure",)),
    "stubborn feet": (_force(_stubborn), ("regime", "acceleration"), ("actuation_lag", "noise_constants")),
    "impatience": (_force(_impatience), ("speed", "regime"), ("response_constants",)),
    "time-gap control": (_force(_time_gap), ("gap", "time_gap"), ("response_constants",)),
    "dead zone of approach": (_dead_zone, ("approach_rate",), ("perception_threshold", "response_constants")),
    "speed limit": (_speed_limit, ("place",), ("slow_patch", "road_grade")),
}


Spoil = Callable[[Array, Setup, np.random.Generator, float], Array]


def _spoiled(spoil: Spoil) -> Builder:
    def build(strength: float, scene: Setup, rng: np.random.Generator) -> Built:
        return Built(Hidden(spoil=lambda x, s, noise: spoil(x, s, noise, strength)))

    return build


def _clock_offset(x: Array, scene: Setup, rng: np.random.Generator, strength: float) -> Array:
    """Each vehicle has a clock of its own, off by 0.15 s."""
    time = scene.period_s * np.arange(len(x))
    off = 0.15 * strength * rng.standard_normal(x.shape[1])
    return np.array([np.interp(time + o, time, column) for o, column in zip(off, x.T, strict=True)]).T


def _second_harmonic(x: Array, scene: Setup, rng: np.random.Generator, strength: float) -> Array:
    """The camera's picture is an ellipse: positions are off twice around the ring."""
    turn = 2.0 * np.pi * x / (scene.ring_m or 230.0)
    return np.asarray(x + 0.8 * strength * np.sin(2.0 * turn + rng.uniform(0.0, 2.0 * np.pi)))


def _off_centre(x: Array, scene: Setup, rng: np.random.Generator, strength: float) -> Array:
    """The camera is not above the centre of the ring: positions are off once around it."""
    turn = 2.0 * np.pi * x / (scene.ring_m or 230.0)
    return np.asarray(x + 1.2 * strength * np.sin(turn + rng.uniform(0.0, 2.0 * np.pi)))


def _body_offset(x: Array, scene: Setup, rng: np.random.Generator, strength: float) -> Array:
    """The camera follows another point of each car: positions are off by a length of the car's own."""
    return np.asarray(x + 0.6 * strength * rng.standard_normal(x.shape[1]))


def _held_frames(x: Array, scene: Setup, rng: np.random.Generator, strength: float) -> Array:
    """Some frames repeat the frame before."""
    found = x.copy()
    for k in np.flatnonzero(rng.random(len(x)) < 0.05 * strength):
        found[k] = found[max(k - 1, 0)]
    return found


def _rounding(x: Array, scene: Setup, rng: np.random.Generator, strength: float) -> Array:
    """Positions are rounded to a metre."""
    return np.asarray(np.round(x / strength) * strength)


def _correlated(x: Array, scene: Setup, rng: np.random.Generator, strength: float) -> Array:
    """An error that wanders, as that of a satellite receiver does: 5 s, 0.4 m."""
    keep = float(np.exp(-scene.period_s / 5.0))
    off = np.zeros_like(x)
    off[0] = rng.standard_normal(x.shape[1])
    for k in range(1, len(x)):
        off[k] = keep * off[k - 1] + np.sqrt(1.0 - keep**2) * rng.standard_normal(x.shape[1])
    return np.asarray(x + 0.4 * strength * off)


def _smoothed(x: Array, scene: Setup, rng: np.random.Generator, strength: float) -> Array:
    """Positions were smoothed over a second by whoever made the file."""
    size = max(3, round(1.0 / scene.period_s) | 1)
    edge = np.concatenate([np.repeat(x[:1], size // 2, axis=0), x, np.repeat(x[-1:], size // 2, axis=0)])
    return np.array([np.convolve(column, np.full(size, 1.0 / size), "valid") for column in edge.T]).T


def _missing(x: Array, scene: Setup, rng: np.random.Generator, strength: float) -> Array:
    """One sample in twenty is missing, and each vehicle is out of sight once for 5 s."""
    found = np.where(rng.random(x.shape) < 0.05 * strength, np.nan, x)
    for i in range(x.shape[1]):
        begin = int(rng.integers(len(x) // 10, len(x) * 8 // 10))
        found[begin : begin + round(5.0 / scene.period_s), i] = np.nan
    return found


#: Faults that a diagnosis should not take for behaviour, and the names of the catalogue that are faults as well.
FAULTS: Mapping[str, tuple[Builder, tuple[str, ...]]] = {
    "clock offset": (_spoiled(_clock_offset), ("gap_offset", "clock_offset")),
    "off centre": (_spoiled(_off_centre), ("sensor_eccentricity",)),
    "body offset": (_spoiled(_body_offset), ("gap_offset",)),
    "second harmonic": (_spoiled(_second_harmonic), ("sensor_eccentricity",)),
    "held frames": (_spoiled(_held_frames), ("outlier_noise", "noise_constants")),
    "rounding": (_spoiled(_rounding), ("noise_constants",)),
    "correlated noise": (_spoiled(_correlated), ("noise_constants", "gap_offset")),
}
#: Faults that the base model should bear.
SMOOTHED, MISSING = _spoiled(_smoothed), _spoiled(_missing)
