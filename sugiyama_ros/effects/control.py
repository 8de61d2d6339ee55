"""What a driver does and how it is measured, with all effects: from what the driver can see to a measured position.

A hook is a place in the model where effects act, such as what a driver perceives. Compiled code calls the functions of
effects and laws by their address. The table of ``by_address`` holds, for each hook, the effects that have a function
there: its address, where the effect's parameters stand in a row, and which entries of a row switch the effect on.
Compiled code goes through them in the order of the registry, and calls a function only if its effect is switched on. So
nothing that is compiled depends on which effects there are.
"""

import math
import types as python_types
from collections.abc import Iterable
from functools import partial
from itertools import count
from typing import Any

import numpy as np
from numba import types

from sugiyama_ros import by_address
from sugiyama_ros.arrays import Array
from sugiyama_ros.by_address import calling, entry_of, part_of, type_of, word
from sugiyama_ros.driver.line import TIME_GAP_S, attention
from sugiyama_ros.driver.parameters import REFERENCE_HORIZON
from sugiyama_ros.driver.utility import (
    FREE_ROW,
    GRID_ROW,
    UTILITY_ROW,
    Preferences,
    boltzmann_mean,
    preferences,
    risk_ahead,
    utilities,
)
from sugiyama_ros.effects.effect import (
    ACTUATION,
    ATTENTION,
    ENVIRONMENT,
    MEASUREMENT,
    PERCEPTION,
    PREFERENCE,
    UTILITY,
    Effect,
    Seen,
    takes_preferences,
    with_view,
)
from sugiyama_ros.effects.registry import EFFECTS, ROW
from sugiyama_ros.errors import InputError
from sugiyama_ros.jit import Kernel, kernel
from sugiyama_ros.laws.registry import ADAPTIVE_SEEK, LAWS

# The hooks. The table begins with four words for each: first function, end, first switch, end.
_PERCEIVE, _PREFER, _VALUE, _ACTUATE, _PUSH, _CHANGE, _EXPECT = range(7)
_NOISE, _DISPLACE, _UNEVEN, _WEIGH, _LAW, _FEEL, _LOOK_BACK, _ATTEND = range(7, 15)
# Words of a function: its address, first and end of its parameters in a row, first and end of its switches; for a law
# its number in place of the switches.
_ADDRESS, _PARAMETERS, _END, _SWITCH, _LAST_SWITCH = range(5)
# Number of words of a function.
_WORDS = 5
_HEADS = by_address.HOOKS_AT

_seen = type_of(Seen(*(0.0 for _ in Seen._fields)))
_number, _numbers = types.float64, types.float64[::1]
_pair, _triple, _driver = (type_of((0.0,) * entries) for entries in (2, 3, 7))
# Signature of the functions of each hook, and the function that calls one of them.
_perceive_type, _call_perceive = calling(_triple, _seen, _numbers)
_attend_type, _call_attend = calling(_number, _number, _seen, _numbers)
_prefer_type, _call_prefer = calling(_pair, _number, _number, _seen, _numbers)
_value_type, _call_value = calling(types.void, _seen, _numbers, _number, types.int64, _numbers, _driver, _numbers)
_actuate_type, _call_actuate = calling(_number, _number, _seen, _numbers)
_push_type, _call_push = calling(_number, _seen, _numbers)
_change_type, _call_change = calling(_number, _number, _number, _numbers)
_expect_type, _call_expect = calling(_triple, _number, _number, _number, _numbers)
_noise_type, _call_noise = calling(_number, _number, _numbers)
_displace_type, _call_displace = calling(_pair, _number, _number, _numbers)
_uneven_type, _call_uneven = calling(_number, _number, _number, _numbers)
_weigh_type, _call_weigh = calling(_triple, _number, _number, _number, _numbers)
_law_type, _call_law = calling(_number, _number, _number, _number, _numbers)


@kernel(allocates=False)
def _functions_of(hook: int) -> Any:
    """Return the places of the functions of a hook in the table."""
    return range(word(_HEADS + 4 * hook), word(_HEADS + 4 * hook + 1), _WORDS)


@kernel(allocates=False)
def _acts(hook: int, row: Array) -> bool:
    """Whether an effect with a function of this hook is switched on in a row (width,)."""
    for place in range(word(_HEADS + 4 * hook + 2), word(_HEADS + 4 * hook + 3)):  # noqa: SIM110 (numba has no any())
        if entry_of(row, place) != 0.0:
            return True
    return False


@kernel(allocates=False)
def _is_on(function: int, row: Array) -> bool:
    """Whether the effect of a function in the table is switched on in a row (width,)."""
    for place in range(word(function + _SWITCH), word(function + _LAST_SWITCH)):  # noqa: SIM110
        if entry_of(row, place) != 0.0:
            return True
    return False


def _value_alone(
    seen: Seen, actions: Array, period: float, horizon: int, p: Array, driver: Preferences, added: Array
) -> None:
    """Compute a component of the utility of every action, into ``added``.

    At the reference period the horizon is a constant, so that compilers can unroll a component's loop over it, and make
    vector instructions of the loop over the actions.
    """
    if horizon == REFERENCE_HORIZON:
        for k in range(len(actions)):
            added[k] = _component(seen, actions[k], period, REFERENCE_HORIZON, p)
    else:
        for k in range(len(actions)):
            added[k] = _component(seen, actions[k], period, horizon, p)


def _value_with_preferences(
    seen: Seen, actions: Array, period: float, horizon: int, p: Array, driver: Preferences, added: Array
) -> None:
    """Compute a component of the utility that depends on the driver's preferences; otherwise as ``_value_alone``."""
    if horizon == REFERENCE_HORIZON:
        for k in range(len(actions)):
            added[k] = _component(seen, actions[k], period, REFERENCE_HORIZON, p, driver)
    else:
        for k in range(len(actions)):
            added[k] = _component(seen, actions[k], period, horizon, p, driver)


def _component(*arguments: Any) -> float:
    """Stand for the component, which `_of_all_actions` puts in its place."""
    raise NotImplementedError


def _of_all_actions(component: Any) -> Kernel:
    """Make a function that values all actions, out of a component of the utility for one action."""
    of_one: Any = _kernel(component)
    template = _value_with_preferences if takes_preferences(of_one.py_func) else _value_alone
    function = python_types.FunctionType(
        # where compiled code is kept follows from the file
        template.__code__.replace(co_filename=of_one.py_func.__code__.co_filename),
        {**template.__globals__, "_component": of_one},
        template.__name__,
    )
    function.__module__, function.__qualname__ = of_one.py_func.__module__, f"{of_one.py_func.__qualname__}.all_actions"
    function.__annotations__ = template.__annotations__
    return _kernel(function)


def _kernel(function: Any) -> Kernel:
    """Return the kernel of a function of an effect or a law; it may be one, or a function of ``njit``, or neither."""
    if isinstance(function, Kernel):
        return function
    given = {"nogil": True, **getattr(function, "targetoptions", {})}
    function = getattr(function, "py_func", function)
    try:
        return Kernel(function, given, made_of=(Seen,))
    except RuntimeError:  # numba finds no file beside which it could keep the code
        return Kernel(function, given, cached=False)


def _of(hook: str, *stages: str) -> list[tuple[Effect, Any]]:
    """Find the effects that declare a hook, such as ``"memory"``; only effects of these stages, if any are given."""
    found = ((e, getattr(e, hook)) for e in EFFECTS.values() if not stages or e.stage in stages)
    return [(e, function) for e, function in found if function is not None]


def _switches(effects: Iterable[Effect]) -> list[int]:
    """Find the entries of a row that switch one of these effects on."""
    return [ROW.index_of(e.name, name) for e in effects for name in e.switches]


def _put(words: list[int]) -> tuple[int, int]:
    """Put words into the table; returns the first place and the end."""
    first = by_address.reserve(len(words))
    by_address.put(first, words)
    return first, first + len(words)


def _fill(hook: int, effects: list[tuple[Effect, Any]], signature: Any) -> None:
    """Put the functions of a hook into the table; without a signature only the switches."""
    places = [_switches([e]) for e, _ in effects]
    first, end = _put([k for each in places for k in each])
    start, last = _put([0] * (_WORDS * len(effects) if signature else 0))
    at = first
    for place, (e, function), own_switches in zip(count(start, _WORDS), effects, places, strict=False):
        if signature:
            row = ROW.places[e.name]
            by_address.put(place, [0, row.start, row.stop, at, at + len(own_switches)])
            make = partial(_of_all_actions if hook == _VALUE else _kernel, function)
            _offer(place, f"effect {e.name}", function, make, signature)
            at += len(own_switches)
    by_address.put(_HEADS + 4 * hook, [start, last, first, end])


def _offer(place: int, what: str, function: Any, make: Any, signature: Any) -> None:
    """Offer a function at a place; those of other packages are compiled at once, so that an error names the package."""
    by_address.offer(place + _ADDRESS, make, signature)
    module = getattr(getattr(function, "py_func", function), "__module__", "")
    if module.partition(".")[0] == __name__.partition(".")[0]:
        return
    try:
        by_address.look_up(place + _ADDRESS)
    except Exception as error:
        lines = [line for line in str(error).splitlines() if line.strip() and not line.startswith("Failed in")]
        why = lines[0] if lines else type(error).__name__
        name = getattr(function, "__name__", repr(function))
        raise InputError(f"{what}: {module}.{name} cannot be compiled: {why}; correct it, or uninstall it") from None


def _fill_all() -> None:
    """Put all functions of effects and laws into the table."""
    memories = _of("memory")
    perceiving, valuing = _of("function", PERCEPTION, MEASUREMENT), _of("function", UTILITY)
    table: dict[int, tuple[list[tuple[Effect, Any]], Any]] = {
        _PERCEIVE: (perceiving, _perceive_type),
        _ATTEND: (_of("function", ATTENTION), _attend_type),
        _PREFER: (_of("function", PREFERENCE), _prefer_type),
        _VALUE: (valuing, _value_type),
        _ACTUATE: (_of("function", ACTUATION), _actuate_type),
        _PUSH: (_of("function", ENVIRONMENT), _push_type),
        _CHANGE: ([(e, memory.change) for e, memory in memories], _change_type),
        _EXPECT: ([(e, memory.expected_change) for e, memory in memories], _expect_type),
        _NOISE: (_of("noise_factor"), _noise_type),
        _DISPLACE: (_of("displacement"), _displace_type),
        _UNEVEN: (_of("measurement_noise_factor"), _uneven_type),
        _WEIGH: ([(e, one.weigh) for e, one in _of("contamination")], _weigh_type),
        _FEEL: ([one for one in (*perceiving, *valuing) if one[0].sees_accelerations], None),
    }
    for hook, (effects, signature) in table.items():
        _fill(hook, effects, signature)
    first, end = _put([ROW.places[e.name].start for e in EFFECTS.values() if e.looks_back])
    by_address.put(_HEADS + 4 * _LOOK_BACK, [0, 0, first, end])
    laws = [(number, one) for number, one in enumerate(LAWS.values()) if number != ADAPTIVE_SEEK]
    start, last = _put([0] * _WORDS * len(laws))
    for place, (number, law) in zip(count(start, _WORDS), laws, strict=False):
        row = ROW.law_places[law.name]
        by_address.put(place, [0, row.start, row.stop, number])
        _offer(place, f"law {law.name}", law.function, partial(_kernel, law.function), _law_type)
    by_address.put(_HEADS + 4 * _LAW, [start, last, 0, 0])


def compile_functions() -> None:
    """Compile the functions of all effects and laws now, or load them."""
    for place in by_address.offered():
        by_address.look_up(place)


_LAW_ENTRY = ROW.law
#: Places of the times that drivers look back.
LOOKING_BACK = np.array([ROW.places[e.name].start for e in EFFECTS.values() if e.looks_back], dtype=np.int64)


@kernel(allocates=False)
def law_acceleration(gap: float, speed: float, leader_speed: float, row: Array) -> float:
    """Compute the acceleration [m/s^2] by the law of a row, NaN if there is none; not for adaptiveSeek."""
    for f in _functions_of(_LAW):
        if word(f + _SWITCH) == row[_LAW_ENTRY]:
            acceleration: float = _call_law(f, gap, speed, leader_speed, part_of(row, f + _PARAMETERS))
            return acceleration
    return math.nan


@kernel(allocates=False)
def law_action(perceived: Seen, row: Array) -> float:
    """Compute the acceleration [m/s^2] by the law of a row, behind the leader and behind the line."""
    free = law_acceleration(perceived.gap, perceived.speed, perceived.leader_speed, row)
    paid = attend(perceived, row)
    if paid == 0.0:
        return free
    return free + paid * min(law_acceleration(perceived.line_gap, perceived.speed, 0.0, row) - free, 0.0)


@kernel(allocates=False)
def noise_factor(speed: float, row: Array) -> float:
    """Compute the factor of the std of the acceleration noise at a speed [m/s], for a row (width,)."""
    factor = 1.0
    for f in _functions_of(_NOISE):
        if _is_on(f, row):
            factor *= _call_noise(f, speed, part_of(row, f + _PARAMETERS))
    return factor


@kernel(allocates=False)
def seeks(row: Array) -> bool:
    """Whether the driver of a row (width,) chooses among actions, as adaptiveSeek does; other laws are formulas."""
    return bool(row[_LAW_ENTRY] == ADAPTIVE_SEEK)


@kernel(allocates=False)
def perceive(seen: Seen, row: Array) -> Seen:
    """Return what the driver of a row (width,) perceives of what can be seen."""
    for f in _functions_of(_PERCEIVE):
        if _is_on(f, row):
            gap, speed, leader_speed = _call_perceive(f, seen, part_of(row, f + _PARAMETERS))
            seen = with_view(seen, gap, speed, leader_speed)
    return seen


@kernel(allocates=False)
def prefer(perceived: Seen, row: Array) -> Preferences:
    """Return what the driver of a row (width,) prefers, given what the driver perceives."""
    v_star, kappa_v, kappa_1, kappa_c, kappa_d, omega_2, rationality = preferences(row)
    for f in _functions_of(_PREFER):
        if _is_on(f, row):
            v_star, kappa_v = _call_prefer(f, v_star, kappa_v, perceived, part_of(row, f + _PARAMETERS))
    return v_star, kappa_v, kappa_1, kappa_c, kappa_d, omega_2, rationality


@kernel(allocates=False)
def sees_as_it_is(row: Array) -> bool:
    """Whether no effect changes what the driver of a row (width,) perceives or prefers."""
    return not (_acts(_PERCEIVE, row) or _acts(_PREFER, row))


@kernel(allocates=False)
def attend(perceived: Seen, row: Array) -> float:
    """Return the attention, from 0 to 1, that the driver of a row (width,) pays to the line ahead."""
    if math.isinf(perceived.line_gap):
        return 0.0
    paid = attention(perceived.line_gap, perceived.speed, perceived.arrive_s, perceived.clear_s, TIME_GAP_S)
    for f in _functions_of(_ATTEND):
        if _is_on(f, row):
            paid = _call_attend(f, paid, perceived, part_of(row, f + _PARAMETERS))
    return paid


@kernel(allocates=False)
def has_components(row: Array) -> bool:
    """Whether effects add components to the utility, for a row (width,)."""
    return _acts(_VALUE, row)


@kernel(allocates=False)
def add_components(
    perceived: Seen,
    actions: Array,
    period: float,
    horizon: int,
    row: Array,
    driver: Preferences,
    added: Array,
    utility: Array,
    stride: int,
) -> None:
    """Add the risk at the line, and what effects add, to the utilities of actions (K,) [m/s^2].

    ``utility`` holds the utility of each action in every ``stride``-th entry.
    """
    paid = attend(perceived, row)
    if paid != 0.0:
        weight, gap, speed = paid * driver[5], perceived.line_gap, perceived.speed
        for k in range(len(actions)):
            utility[stride * k] += weight * risk_ahead(gap, speed, 0.0, actions[k], period, horizon, driver)
    for f in _functions_of(_VALUE):
        if _is_on(f, row):
            _call_value(f, perceived, actions, period, horizon, part_of(row, f + _PARAMETERS), driver, added)
            for k in range(len(actions)):
                utility[stride * k] += added[k]


@kernel(allocates=False)
def acts_on_intention(row: Array) -> bool:
    """Whether effects change the intended acceleration or add to it, for a row (width,)."""
    return _acts(_ACTUATE, row) or _acts(_PUSH, row)


@kernel(allocates=False)
def act(action: float, seen: Seen, row: Array) -> tuple[float, float]:
    """Return what becomes of the acceleration [m/s^2] that the driver chooses; results as of ``intend``."""
    for f in _functions_of(_ACTUATE):
        if _is_on(f, row):
            action = _call_actuate(f, action, seen, part_of(row, f + _PARAMETERS))
    pushed = 0.0
    for f in _functions_of(_PUSH):
        if _is_on(f, row):
            pushed += _call_push(f, seen, part_of(row, f + _PARAMETERS))
    return action, pushed


@kernel(allocates=False)
def intend(seen: Seen, row: Array, scratch: Array, period: float, horizon: int) -> tuple[float, float]:
    """Compute the acceleration [m/s^2] that the driver intends, and what the environment adds.

    scratch: of ``scratch_for`` the actions that the driver considers; period [s].
    """
    perceived = perceive(seen, row)
    gap, speed, leader_speed = perceived.gap, perceived.speed, perceived.leader_speed
    if seeks(row):
        driver = prefer(perceived, row)
        utilities(gap, speed, leader_speed, driver, scratch, period, horizon)
        if has_components(row) or perceived.line_gap < math.inf:
            actions, utility = scratch[GRID_ROW], scratch[UTILITY_ROW]
            add_components(perceived, actions, period, horizon, row, driver, scratch[FREE_ROW], utility, 1)
        action = boltzmann_mean(scratch, driver[-1])
    else:
        action = law_action(perceived, row)
    return act(action, seen, row)


@kernel(allocates=False)
def carry_out(meant: float, held: float, row: Array, period: float) -> float:
    """Compute the acceleration [m/s^2] that the driver makes the car do, who held ``held`` in the last period [s]."""
    if not _acts(_CHANGE, row):
        return meant
    wanted = meant - held
    for f in _functions_of(_CHANGE):
        if _is_on(f, row):
            wanted = _call_change(f, wanted, period, part_of(row, f + _PARAMETERS))
    return held + wanted


@kernel(allocates=False)
def expect_change(wanted: float, variance: float, row: Array, period: float) -> tuple[float, float, float]:
    """Compute the moments of the change of the acceleration that the driver carries out.

    The wanted change has a normal distribution. Returns the mean [m/s^2], its regression on the wanted change, and the
    variance [m^2/s^4] that the regression leaves.
    """
    mean, slope, left = wanted, 1.0, 0.0
    for f in _functions_of(_EXPECT):
        if _is_on(f, row):
            # between two effects the change counts as normally distributed
            spread = slope * slope * variance + left
            mean, by_wanted, new = _call_expect(f, mean, spread, period, part_of(row, f + _PARAMETERS))
            slope, left = by_wanted * slope, new + by_wanted * by_wanted * left
    return mean, slope, left


@kernel(allocates=False)
def remembers(row: Array) -> bool:
    """Whether the acceleration depends on the acceleration of the last period, for a row (width,)."""
    return _acts(_CHANGE, row)


@kernel(allocates=False)
def feels_accelerations(row: Array) -> bool:
    """Whether the driver reacts to accelerations, which a filter does not know exactly, for a row (width,)."""
    return _acts(_FEEL, row)


@kernel(allocates=False)
def looks_back(row: Array) -> float:
    """Return how far the driver of a row (width,) looks back [s]; 0 for a driver who sees what there is now."""
    largest = 0.0
    for place in range(word(_HEADS + 4 * _LOOK_BACK + 2), word(_HEADS + 4 * _LOOK_BACK + 3)):
        largest = max(largest, entry_of(row, place))
    return largest


@kernel(allocates=False)
def displacement(position: float, circumference: float, row: Array) -> tuple[float, float]:
    """Compute the measured minus the true position [m], and its derivative by the position."""
    offset, slope = 0.0, 0.0
    for f in _functions_of(_DISPLACE):
        if _is_on(f, row):
            more, steeper = _call_displace(f, position, circumference, part_of(row, f + _PARAMETERS))
            offset, slope = offset + more, slope + steeper
    return offset, slope


@kernel(allocates=False)
def noise_std_factor(position: float, circumference: float, row: Array) -> float:
    """Compute the factor of the std of the measurement noise at a position [m]."""
    factor = 1.0
    for f in _functions_of(_UNEVEN):
        if _is_on(f, row):
            factor *= _call_uneven(f, position, circumference, part_of(row, f + _PARAMETERS))
    return factor


@kernel(allocates=False)
def is_contaminated(row: Array) -> bool:
    """Whether an effect in a row (width,) makes some measurements worse than others."""
    return _acts(_WEIGH, row)


@kernel(allocates=False)
def weigh(innovation: float, variance: float, noise_var: float, row: Array) -> tuple[float, float, float]:
    """Weigh a sample from a mixture of good and bad measurements, as ``contaminated_normal``."""
    probability, wide, density = 0.0, variance, 0.0
    for f in _functions_of(_WEIGH):
        if _is_on(f, row):
            probability, wide, density = _call_weigh(f, innovation, variance, noise_var, part_of(row, f + _PARAMETERS))
    return probability, wide, density


@kernel
def displacements(position: Array, circumference: float, rows: Array) -> Array:
    """Compute the displacements (N,) [m] of N vehicles at positions (N,) [m], with rows (N, width)."""
    return np.array([displacement(position[i], circumference, rows[i])[0] for i in range(len(position))])


@kernel
def noise_std_factors(position: Array, circumference: float, rows: Array) -> Array:
    """Compute the factors (N,) of the measurement noise of N vehicles at positions (N,) [m], with rows (N, width)."""
    return np.array([noise_std_factor(position[i], circumference, rows[i]) for i in range(len(position))])


def spoil(noise: Array, rows: Array, rng: np.random.Generator) -> Array:
    """Return measurement noise (N,) [m] of N vehicles, of which some measurements are worse than others."""
    for effect in EFFECTS.values():
        values = rows[:, ROW.places[effect.name]]
        if effect.contamination is not None and rows[:, ROW.index_of(effect.name, effect.switches[0])].any():
            noise = effect.contamination.sample(noise, values, rng)
    return noise


_fill_all()
