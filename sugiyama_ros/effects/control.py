"""What a driver does, with all effects: from what is there to see to the acceleration of his car. Compiled."""

from collections.abc import Callable
from typing import Any, TypeAlias, TypeVar

import numpy as np
from numba import njit

from sugiyama_ros.driver.parameters import KAPPA_V, V_STAR
from sugiyama_ros.driver.utility import considered_action
from sugiyama_ros.effects import actuation_lag, perception_threshold, speed_dependent_noise
from sugiyama_ros.effects.effect import ACTUATION, ENVIRONMENT, MEASUREMENT, PERCEPTION, PREFERENCE, Effect, Seen
from sugiyama_ros.effects.registry import EFFECTS, LAW, LAW_PLACES, PLACES, place
from sugiyama_ros.errors import InputError
from sugiyama_ros.laws.registry import fvdm, idm
from sugiyama_ros.road import Array, Ints

_Preferred: TypeAlias = Callable[..., tuple[float, float]]
_Function = TypeVar("_Function", bound=Callable[..., Any])
_LAG = place("actuation_lag", "time_constant")
_THRESHOLD = place("perception_threshold", "threshold")
_NOISE = place("speed_dependent_noise", "exponent")
_IDM, _FVDM = LAW_PLACES["idm"], LAW_PLACES["fvdm"]
_IDM_AT, _IDM_END, _FVDM_AT, _FVDM_END = _IDM.start, _IDM.stop, _FVDM.start, _FVDM.stop


def lean(function: _Function) -> _Function:
    """Compile a function that makes no arrays without counting references to those that it is given.

    Counting took a sixth of a filter's time.
    """
    compiled: _Function = njit(function, nogil=True, cache=True, _nrt=False)  # type: ignore[call-overload]
    return compiled


@njit(nogil=True)
def _nothing_perceived(seen: Seen, row: Array) -> Seen:
    return seen


@njit(nogil=True)
def _nothing_preferred(v_star: float, kappa_v: float, seen: Seen, row: Array) -> tuple[float, float]:
    return v_star, kappa_v


@njit(nogil=True)
def _nothing_actuated(acceleration: float, seen: Seen, row: Array) -> float:
    return acceleration


@njit(nogil=True)
def _nothing_pushes(seen: Seen, row: Array) -> float:
    return 0.0


def _function(effect: Effect) -> Callable[..., Any]:
    if effect.function is None:
        raise InputError(f"effect {effect.name}: has no function")
    return effect.function


def _places(effect: Effect) -> tuple[int, int, int, int]:
    """First and last entry in a row, and the places of the first and the last switch."""
    switches = [place(effect.name, name) for name in effect.switches]
    return PLACES[effect.name].start, PLACES[effect.name].stop, switches[0], switches[-1]


def _then_perceive(before: Callable[..., Seen], effect: Effect) -> Callable[..., Seen]:
    first, last, switch, other = _places(effect)
    perceive: Callable[..., Any] = _function(effect)

    @njit(nogil=True)
    def perceived(seen: Seen, row: Array) -> Seen:
        seen = before(seen, row)
        if row[switch] == 0.0 and row[other] == 0.0:
            return seen
        gap, speed, leader_speed = perceive(seen, row[first:last])
        return Seen(
            gap,
            speed,
            leader_speed,
            seen.position,
            seen.time,
            seen.circumference,
            seen.acceleration,
            seen.leader_acceleration,
            seen.second_gap,
            seen.second_speed,
            seen.rear_gap,
            seen.rear_speed,
        )

    return perceived


def _then_prefer(before: _Preferred, effect: Effect) -> _Preferred:
    first, last, switch, other = _places(effect)
    prefer: Callable[..., Any] = _function(effect)

    @njit(nogil=True)
    def preferred(v_star: float, kappa_v: float, seen: Seen, row: Array) -> tuple[float, float]:
        v_star, kappa_v = before(v_star, kappa_v, seen, row)
        if row[switch] == 0.0 and row[other] == 0.0:
            return v_star, kappa_v
        v_star, kappa_v = prefer(v_star, kappa_v, seen, row[first:last])
        return v_star, kappa_v

    return preferred


def _then_actuate(before: Callable[..., float], effect: Effect) -> Callable[..., float]:
    first, last, switch, other = _places(effect)
    actuate: Callable[..., Any] = _function(effect)

    @njit(nogil=True)
    def actuated(acceleration: float, seen: Seen, row: Array) -> float:
        acceleration = before(acceleration, seen, row)
        if row[switch] == 0.0 and row[other] == 0.0:
            return acceleration
        return float(actuate(acceleration, seen, row[first:last]))

    return actuated


def _then_push(before: Callable[..., float], effect: Effect) -> Callable[..., float]:
    first, last, switch, other = _places(effect)
    push: Callable[..., Any] = _function(effect)

    @njit(nogil=True)
    def pushed(seen: Seen, row: Array) -> float:
        total = before(seen, row)
        if row[switch] == 0.0 and row[other] == 0.0:
            return total
        return float(total + push(seen, row[first:last]))

    return pushed


_perceive: Callable[..., Seen] = _nothing_perceived
_prefer: _Preferred = _nothing_preferred
_actuate: Callable[..., float] = _nothing_actuated
_push: Callable[..., float] = _nothing_pushes
for _effect in EFFECTS:
    if _effect.function is None:
        continue
    if _effect.stage in (PERCEPTION, MEASUREMENT):
        _perceive = _then_perceive(_perceive, _effect)
    elif _effect.stage == PREFERENCE:
        _prefer = _then_prefer(_prefer, _effect)
    elif _effect.stage == ACTUATION:
        _actuate = _then_actuate(_actuate, _effect)
    elif _effect.stage == ENVIRONMENT:
        _push = _then_push(_push, _effect)
# compiled code freezes globals, so these are the finished chains
_perceived, _preferred, _actuated, _pushed = _perceive, _prefer, _actuate, _push


def _switches(*stages: str) -> Ints:
    """Places in a row of everything that switches an effect of these stages on."""
    return np.array([place(e.name, name) for e in EFFECTS if e.stage in stages for name in e.switches], dtype=np.int64)


_PERCEIVING, _PREFERRING = _switches(PERCEPTION, MEASUREMENT), _switches(PREFERENCE)
_ACTUATING, _PUSHING = _switches(ACTUATION), _switches(ENVIRONMENT)


@lean
def _any_of(switches: Ints, row: Array) -> bool:
    """Whether an effect is on; a driver without effects need not go through all of them."""
    for k in switches:  # noqa: SIM110 (numba has no any())
        if row[k] != 0.0:
            return True
    return False


@lean
def noise_factor(speed: float, row: Array) -> float:
    """Factor of the std of the acceleration noise at a speed [m/s]."""
    if row[_NOISE] == 0.0:
        return 1.0
    return speed_dependent_noise.noise_factor(speed, row[_NOISE : _NOISE + 1])


@lean
def intend(seen: Seen, row: Array, scratch: Array, period: float, horizon: int) -> tuple[float, float]:
    """What the driver means his car to do until the next period, and what the environment adds; [m/s^2] both.

    row: (WIDTH,), at this period; changed on the way and restored. scratch: of ``scratch_for`` the driver's actions.
    """
    perceived = _perceived(seen, row) if _any_of(_PERCEIVING, row) else seen
    v_star, kappa_v = row[V_STAR], row[KAPPA_V]
    if _any_of(_PREFERRING, row):
        row[V_STAR], row[KAPPA_V] = _preferred(v_star, kappa_v, perceived, row)
    gap, speed, leader_speed = perceived.gap, perceived.speed, perceived.leader_speed
    if row[LAW] == 0.0:
        action = considered_action(gap, speed, leader_speed, row, scratch, period, horizon)
    elif row[LAW] == 1.0:
        action = idm(gap, speed, leader_speed, row[_IDM_AT:_IDM_END])
    elif row[LAW] == 3.0:
        action = 0.0
    else:
        action = fvdm(gap, speed, leader_speed, row[_FVDM_AT:_FVDM_END])
    row[V_STAR], row[KAPPA_V] = v_star, kappa_v
    if _any_of(_ACTUATING, row):
        action = _actuated(action, seen, row)
    return action, _pushed(seen, row) if _any_of(_PUSHING, row) else 0.0


@lean
def carry_out(meant: float, held: float, row: Array, period: float) -> float:
    """What he makes his car do [m/s^2], after ``held`` in the last period."""
    if row[_THRESHOLD] == 0.0 and row[_LAG] == 0.0:
        return meant
    change = meant - held
    if row[_THRESHOLD] != 0.0:
        change = perception_threshold.change(change, row[_THRESHOLD : _THRESHOLD + 1])
    if row[_LAG] != 0.0:
        change *= actuation_lag.share(period, row[_LAG : _LAG + 1])
    return held + change


@lean
def expect_change(wanted: float, variance: float, row: Array, period: float) -> tuple[float, float, float]:
    """Of a wanted change of his acceleration, known as a normal distribution, what is carried out.

    Mean [m/s^2], regression on the wanted change, and variance that it leaves.
    """
    mean, slope, left, share = wanted, 1.0, 0.0, 1.0
    if row[_THRESHOLD] != 0.0:
        mean, slope, left = perception_threshold.expected_change(wanted, variance, row[_THRESHOLD : _THRESHOLD + 1])
    if row[_LAG] != 0.0:
        share = actuation_lag.share(period, row[_LAG : _LAG + 1])
    return share * mean, share * slope, share * share * left


@lean
def remembers(row: Array) -> bool:
    """Whether what is carried out depends on what was in the last period."""
    return bool(row[_THRESHOLD] != 0.0 or row[_LAG] != 0.0)
