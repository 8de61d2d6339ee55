"""Forms that are not in the catalogue, with the covariates where they show and the nearest names of the catalogue."""

from collections.abc import Callable, Mapping
from dataclasses import replace

import numpy as np

from sugiyama_ros.arrays import Array
from sugiyama_ros.studies.away.catalogue import Builder, Built
from sugiyama_ros.studies.away.drivers import People, Sight
from sugiyama_ros.studies.away.world import Hidden, History, Setup

_LENGTH_M = 4.33


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
