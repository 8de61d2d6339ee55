"""What a driver does, with all effects: from what is there to see to the acceleration of the car. Compiled."""

import math

from sugiyama_ros.arrays import Array
from sugiyama_ros.driver.parameters import KAPPA_V, V_STAR
from sugiyama_ros.driver.utility import GRID_ROW, UTILITY_ROW, boltzmann_mean, preferences, utilities
from sugiyama_ros.effects import chains
from sugiyama_ros.effects.chains import Hook, any_of, chain, having, switches
from sugiyama_ros.effects.effect import ACTUATION, ENVIRONMENT, MEASUREMENT, PERCEPTION, PREFERENCE, UTILITY, Seen
from sugiyama_ros.effects.registry import ROW
from sugiyama_ros.jit import kernel
from sugiyama_ros.laws.law import LawFunction
from sugiyama_ros.laws.registry import ADAPTIVE_SEEK, LAWS

_LAW = ROW.law
_PERCEIVE, _PREFER = having("function", PERCEPTION, MEASUREMENT), having("function", PREFERENCE)
_VALUE, _ACTUATE, _PUSH = (having("function", stage) for stage in (UTILITY, ACTUATION, ENVIRONMENT))
_REMEMBER, _NOISE = having("memory"), having("noise_factor")
# compiled code freezes globals: these are the finished chains
_perceived = chain(chains.nothing_perceived, chains.then_perceive, _PERCEIVE)
_preferred = chain(chains.nothing_preferred, chains.then_prefer, _PREFER)
_valued = chain(chains.nothing_valued, chains.then_value, _VALUE)
_actuated = chain(chains.nothing_actuated, chains.then_actuate, _ACTUATE)
_pushed = chain(chains.nothing_pushes, chains.then_push, _PUSH)
_changed = chain(chains.all_changed, chains.then_change, _REMEMBER)
_expected = chain(chains.all_expected, chains.then_expect, _REMEMBER)
_factor = chain(chains.no_factor, chains.then_factor, _NOISE)
_PERCEIVING, _PREFERRING, _VALUING = switches(_PERCEIVE), switches(_PREFER), switches(_VALUE)
_ACTUATING, _PUSHING, _REMEMBERING, _NOISY = (switches(e) for e in (_ACTUATE, _PUSH, _REMEMBER, _NOISE))
_FEELING = switches(e for e in _PERCEIVE if e.sees_accelerations)


@kernel(cached=False)
def _no_law(gap: float, speed: float, leader_speed: float, row: Array) -> float:
    return math.nan


def _then_law(before: Hook, number: float, name: str, law: LawFunction) -> Hook:
    first, last = ROW.law_places[name].start, ROW.law_places[name].stop

    @kernel(cached=False)
    def by_law(gap: float, speed: float, leader_speed: float, row: Array) -> float:
        if row[_LAW] == number:
            return float(law(gap, speed, leader_speed, row[first:last]))
        return float(before(gap, speed, leader_speed, row))

    return by_law


_by_law: Hook = _no_law
for _number, _name in reversed(list(enumerate(LAWS))):
    if _number != ADAPTIVE_SEEK:
        _by_law = _then_law(_by_law, float(_number), _name, LAWS[_name].function)
_acceleration = _by_law


@kernel(allocates=False)
def law_acceleration(gap: float, speed: float, leader_speed: float, row: Array) -> float:
    """Acceleration [m/s^2] by the law of a driver's row (WIDTH,), if that is not adaptiveSeek.

    The gap [m] is infinite without a leader; speeds are in m/s. NaN for a number that no law has.
    """
    acceleration: float = _acceleration(gap, speed, leader_speed, row)
    return acceleration


@kernel(allocates=False)
def noise_factor(speed: float, row: Array) -> float:
    """Factor of the std of the acceleration noise at a speed [m/s]."""
    if any_of(_NOISY, row):
        factor: float = _factor(speed, row)
        return factor
    return 1.0


@kernel(allocates=False)
def intend(seen: Seen, row: Array, scratch: Array, period: float, horizon: int) -> tuple[float, float]:
    """Tell what the driver means the car to do, and what the environment adds; both [m/s^2].

    The row (WIDTH,) is that of the period; it is changed on the way and restored. ``scratch`` is made by
    ``scratch_for`` the actions that the driver considers.
    """
    perceived = _perceived(seen, row) if any_of(_PERCEIVING, row) else seen
    v_star, kappa_v = row[V_STAR], row[KAPPA_V]
    if any_of(_PREFERRING, row):
        row[V_STAR], row[KAPPA_V] = _preferred(v_star, kappa_v, perceived, row)
    gap, speed, leader_speed = perceived.gap, perceived.speed, perceived.leader_speed
    if row[_LAW] == ADAPTIVE_SEEK:
        driver = preferences(row)
        utilities(gap, speed, leader_speed, driver, scratch, period, horizon)
        if any_of(_VALUING, row):
            for k in range(scratch.shape[1]):
                scratch[UTILITY_ROW, k] += _valued(perceived, scratch[GRID_ROW, k], period, horizon, row)
        action = boltzmann_mean(scratch, driver[-1])
    else:
        action = law_acceleration(gap, speed, leader_speed, row)
    row[V_STAR], row[KAPPA_V] = v_star, kappa_v
    if any_of(_ACTUATING, row):
        action = _actuated(action, seen, row)
    return action, _pushed(seen, row) if any_of(_PUSHING, row) else 0.0


@kernel(allocates=False)
def carry_out(meant: float, held: float, row: Array, period: float) -> float:
    """Acceleration [m/s^2] that the driver makes the car do, after ``held`` in the last period."""
    if not any_of(_REMEMBERING, row):
        return meant
    return float(held + _changed(meant - held, period, row))


@kernel(allocates=False)
def expect_change(wanted: float, variance: float, row: Array, period: float) -> tuple[float, float, float]:
    """Moments of what is carried out of a wanted change of the acceleration that is known as a normal distribution.

    Returns the mean [m/s^2], the regression on the wanted change, and the variance that the regression leaves.
    """
    mean, slope, left = _expected(wanted, variance, period, row)
    return mean, slope, left


@kernel(allocates=False)
def remembers(row: Array) -> bool:
    """Whether what is carried out depends on what was in the last period."""
    return any_of(_REMEMBERING, row)


@kernel(allocates=False)
def feels_accelerations(row: Array) -> bool:
    """Whether what the driver does depends on accelerations that are not known exactly."""
    return any_of(_FEELING, row)
