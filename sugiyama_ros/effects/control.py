"""What a driver does, with all effects: from what the driver can see to the acceleration of the car. Compiled."""

import math

import numpy as np

from sugiyama_ros.arrays import Array
from sugiyama_ros.driver.utility import (
    GRID_ROW,
    UTILITY_ROW,
    Preferences,
    boltzmann_mean,
    preferences,
    utilities,
)
from sugiyama_ros.effects import chains
from sugiyama_ros.effects.chains import Hook, any_of, chain, having, switches
from sugiyama_ros.effects.effect import ACTUATION, ENVIRONMENT, MEASUREMENT, PERCEPTION, PREFERENCE, UTILITY, Seen
from sugiyama_ros.effects.registry import EFFECTS, ROW
from sugiyama_ros.jit import kernel
from sugiyama_ros.laws.law import LawFunction
from sugiyama_ros.laws.registry import ADAPTIVE_SEEK, LAWS

_LAW = ROW.law
_PERCEIVE, _PREFER = having("function", PERCEPTION, MEASUREMENT), having("function", PREFERENCE)
_VALUE, _ACTUATE, _PUSH = (having("function", stage) for stage in (UTILITY, ACTUATION, ENVIRONMENT))
_REMEMBER, _NOISE = having("memory"), having("noise_factor")
# compiled code takes globals as constants, so the chains are complete before the functions below are compiled
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
_FEELING = switches(e for e in (*_PERCEIVE, *_VALUE) if e.sees_accelerations)
#: Places of the times that drivers look back.
LOOKING_BACK = np.array([ROW.places[e.name].start for e in EFFECTS.values() if e.looks_back], dtype=np.int64)


@kernel(cached=False)
def _no_law(gap: float, speed: float, leader_speed: float, row: Array) -> float:
    """Return NaN for a number that no law has."""
    return math.nan


def _then_law(before: Hook, number: float, name: str, law: LawFunction) -> Hook:
    """Add a law to the chain of laws."""
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
    """Compute the acceleration by the law of a driver's row; not for adaptiveSeek, which needs a scratch array.

    Parameters
    ----------
    gap, speed, leader_speed : float
        Gap [m], infinite without a leader, speed [m/s] and leader's speed [m/s].
    row : ndarray, shape (width,)
        Row of the driver.

    Returns
    -------
    float
        Acceleration [m/s^2]; NaN if no law has the number in the row.
    """
    acceleration: float = _acceleration(gap, speed, leader_speed, row)
    return acceleration


@kernel(allocates=False)
def noise_factor(speed: float, row: Array) -> float:
    """Compute the factor of the std of the acceleration noise at a speed [m/s], for a row (width,)."""
    if any_of(_NOISY, row):
        factor: float = _factor(speed, row)
        return factor
    return 1.0


@kernel(allocates=False)
def seeks(row: Array) -> bool:
    """Whether the driver of a row (width,) chooses among actions, as adaptiveSeek does; other laws are formulas."""
    return bool(row[_LAW] == ADAPTIVE_SEEK)


@kernel(allocates=False)
def perceive(seen: Seen, row: Array) -> Seen:
    """Return what the driver of a row (width,) perceives of what can be seen."""
    return _perceived(seen, row) if any_of(_PERCEIVING, row) else seen


@kernel(allocates=False)
def prefer(perceived: Seen, row: Array) -> Preferences:
    """Return what the driver of a row (width,) prefers, given what the driver perceives."""
    v_star, kappa_v, kappa_1, kappa_c, kappa_d, omega_2, rationality = preferences(row)
    if any_of(_PREFERRING, row):
        v_star, kappa_v = _preferred(v_star, kappa_v, perceived, row)
    return v_star, kappa_v, kappa_1, kappa_c, kappa_d, omega_2, rationality


@kernel(allocates=False)
def sees_as_it_is(row: Array) -> bool:
    """Whether no effect changes what the driver of a row (width,) perceives or prefers."""
    return not (any_of(_PERCEIVING, row) or any_of(_PREFERRING, row))


@kernel(allocates=False)
def has_components(row: Array) -> bool:
    """Whether effects add components to the utility, for a row (width,)."""
    return any_of(_VALUING, row)


@kernel(allocates=False)
def add_components(
    perceived: Seen,
    actions: Array,
    period: float,
    horizon: int,
    row: Array,
    driver: Preferences,
    utility: Array,
    stride: int,
) -> None:
    """Add what effects add to the utilities of actions (K,) [m/s^2]; the other arguments as for ``intend``.

    Every ``stride``-th entry of ``utility`` is the utility of an action.
    """
    _valued(perceived, actions, period, horizon, row, driver, utility, stride)


@kernel(allocates=False)
def acts_on_intention(row: Array) -> bool:
    """Whether effects change the intended acceleration or add to it, for a row (width,)."""
    return any_of(_ACTUATING, row) or any_of(_PUSHING, row)


@kernel(allocates=False)
def act(action: float, seen: Seen, row: Array) -> tuple[float, float]:
    """Return what becomes of the acceleration [m/s^2] that the driver chooses; results as of ``intend``."""
    if any_of(_ACTUATING, row):
        action = _actuated(action, seen, row)
    return action, _pushed(seen, row) if any_of(_PUSHING, row) else 0.0


@kernel(allocates=False)
def intend(seen: Seen, row: Array, scratch: Array, period: float, horizon: int) -> tuple[float, float]:
    """Compute the acceleration that the driver intends, and the acceleration that the environment adds.

    Parameters
    ----------
    seen : Seen
        What the driver can see.
    row : ndarray, shape (width,)
        Row of the driver at this period.
    scratch : ndarray, shape (5, at least K)
        Made by ``scratch_for`` from the K actions that the driver considers.
    period : float
        Length of the period [s].
    horizon : int
        Periods of look-ahead.

    Returns
    -------
    meant, pushed : float
        Acceleration [m/s^2] that the driver intends, and acceleration [m/s^2] that the environment adds.
    """
    perceived = perceive(seen, row)
    gap, speed, leader_speed = perceived.gap, perceived.speed, perceived.leader_speed
    if seeks(row):
        driver = prefer(perceived, row)
        utilities(gap, speed, leader_speed, driver, scratch, period, horizon)
        if has_components(row):
            add_components(perceived, scratch[GRID_ROW], period, horizon, row, driver, scratch[UTILITY_ROW], 1)
        action = boltzmann_mean(scratch, driver[-1])
    else:
        action = law_acceleration(gap, speed, leader_speed, row)
    return act(action, seen, row)


@kernel(allocates=False)
def carry_out(meant: float, held: float, row: Array, period: float) -> float:
    """Compute the acceleration that the driver makes the car do.

    Parameters
    ----------
    meant, held : float
        Intended acceleration [m/s^2], and ``carry_out`` [m/s^2] of the last period.
    row : ndarray, shape (width,)
        Row of the driver at this period.
    period : float
        Length of the period [s].

    Returns
    -------
    float
        Acceleration [m/s^2].
    """
    if not any_of(_REMEMBERING, row):
        return meant
    return float(held + _changed(meant - held, period, row))


@kernel(allocates=False)
def expect_change(wanted: float, variance: float, row: Array, period: float) -> tuple[float, float, float]:
    """Compute the moments of the change of the acceleration that the driver carries out.

    Parameters
    ----------
    wanted, variance : float
        Mean [m/s^2] and variance [m^2/s^4] of the wanted change, which has a normal distribution.
    row : ndarray, shape (width,)
        Row of the driver at this period.
    period : float
        Length of the period [s].

    Returns
    -------
    mean, slope, variance_left : float
        Mean [m/s^2] of the change that is carried out, its regression on the wanted change, and the variance [m^2/s^4]
        that the regression leaves.
    """
    mean, slope, left = _expected(wanted, variance, period, row)
    return mean, slope, left


@kernel(allocates=False)
def remembers(row: Array) -> bool:
    """Whether the acceleration depends on the acceleration of the last period, for a row (width,)."""
    return any_of(_REMEMBERING, row)


@kernel(allocates=False)
def feels_accelerations(row: Array) -> bool:
    """Whether the driver reacts to accelerations, which a filter does not know exactly, for a row (width,)."""
    return any_of(_FEELING, row)


@kernel(allocates=False)
def looks_back(row: Array) -> float:
    """Return how far the driver of a row (width,) looks back [s]; 0 for a driver who sees what there is now."""
    longest = 0.0
    for k in LOOKING_BACK:
        longest = max(longest, row[k])
    return longest
