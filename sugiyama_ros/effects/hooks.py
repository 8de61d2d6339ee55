"""The functions of effects and laws, which compiled code calls by their address.

A hook is a place in the model where effects act, such as what a driver perceives. The table of ``by_address`` holds,
for each hook, the effects that have a function there: its address, where the effect's parameters stand in a row, and
which entries of a row switch the effect on. Compiled code goes through them in the order of the registry, and calls a
function only if its effect is switched on. So nothing that is compiled depends on which effects there are.
"""

import types as python_types
from collections.abc import Iterable
from functools import partial
from itertools import count
from typing import Any

from numba import types

from sugiyama_ros import by_address
from sugiyama_ros.arrays import Array
from sugiyama_ros.by_address import calling, entry_of, type_of, word
from sugiyama_ros.driver.parameters import REFERENCE_HORIZON
from sugiyama_ros.driver.utility import Preferences
from sugiyama_ros.effects.effect import (
    ACTUATION,
    ENVIRONMENT,
    MEASUREMENT,
    PERCEPTION,
    PREFERENCE,
    UTILITY,
    Effect,
    Seen,
)
from sugiyama_ros.effects.registry import EFFECTS, ROW
from sugiyama_ros.errors import InputError
from sugiyama_ros.jit import Kernel, kernel
from sugiyama_ros.laws.registry import ADAPTIVE_SEEK, LAWS

#: The hooks. The table begins with four words for each: first function, end, first switch, end.
PERCEIVE, PREFER, VALUE, ACTUATE, PUSH, CHANGE, EXPECT, NOISE, DISPLACE, UNEVEN, WEIGH, LAW, FEEL, LOOK_BACK = range(14)
# Words of a function: its address, first and end of its parameters in a row, first and end of its switches; for a law
# its number in place of the switches.
_ADDRESS, PARAMETERS, _END, _SWITCH, _LAST_SWITCH = range(5)
# Number of words of a function.
_WORDS = 5
_HEADS = by_address.HOOKS_AT

_seen = type_of(Seen(*(0.0 for _ in Seen._fields)))
_number, _numbers = types.float64, types.float64[::1]
_pair, _triple, _driver = (type_of((0.0,) * entries) for entries in (2, 3, 7))
# Signature of the functions of each hook, and the function that calls one of them.
_PERCEIVE, call_perceive = calling(_triple, _seen, _numbers)
_PREFER, call_prefer = calling(_pair, _number, _number, _seen, _numbers)
_VALUE, call_value = calling(types.void, _seen, _numbers, _number, types.int64, _numbers, _driver, _numbers)
_ACTUATE, call_actuate = calling(_number, _number, _seen, _numbers)
_PUSH, call_push = calling(_number, _seen, _numbers)
_CHANGE, call_change = calling(_number, _number, _number, _numbers)
_EXPECT, call_expect = calling(_triple, _number, _number, _number, _numbers)
_NOISE, call_noise = calling(_number, _number, _numbers)
_DISPLACE, call_displace = calling(_pair, _number, _number, _numbers)
_UNEVEN, call_uneven = calling(_number, _number, _number, _numbers)
_WEIGH, call_weigh = calling(_triple, _number, _number, _number, _numbers)
_LAW, call_law = calling(_number, _number, _number, _number, _numbers)


@kernel(allocates=False)
def functions_of(hook: int) -> Any:
    """Return the places of the functions of a hook in the table."""
    return range(word(_HEADS + 4 * hook), word(_HEADS + 4 * hook + 1), _WORDS)


@kernel(allocates=False)
def acts(hook: int, row: Array) -> bool:
    """Whether an effect with a function of this hook is switched on in a row (width,)."""
    for place in range(word(_HEADS + 4 * hook + 2), word(_HEADS + 4 * hook + 3)):  # noqa: SIM110 (numba has no any())
        if entry_of(row, place) != 0.0:
            return True
    return False


@kernel(allocates=False)
def is_on(function: int, row: Array) -> bool:
    """Whether the effect of a function in the table is switched on in a row (width,)."""
    for place in range(word(function + _SWITCH), word(function + _LAST_SWITCH)):  # noqa: SIM110
        if entry_of(row, place) != 0.0:
            return True
    return False


@kernel(allocates=False)
def has_number(function: int, number: float) -> bool:
    """Whether a law in the table has this number."""
    return bool(word(function + _SWITCH) == number)


@kernel(allocates=False)
def longest(hook: int, row: Array) -> float:
    """Return the largest switch of a hook in a row (width,); at least 0."""
    largest = 0.0
    for place in range(word(_HEADS + 4 * hook + 2), word(_HEADS + 4 * hook + 3)):
        largest = max(largest, entry_of(row, place))
    return largest


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


def _of_all_actions(component: Any, knows_preferences: bool) -> Kernel:
    """Make a function that values all actions, out of a component of the utility for one action."""
    template = _value_with_preferences if knows_preferences else _value_alone
    of_one: Any = _kernel(component)
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


def switches(effects: Iterable[Effect]) -> list[int]:
    """Find the entries of a row that switch one of these effects on."""
    return [ROW.index_of(e.name, name) for e in effects for name in e.switches]


def _put(words: list[int]) -> tuple[int, int]:
    """Put words into the table; returns the first place and the end."""
    first = by_address.reserve(len(words))
    by_address.put(first, words)
    return first, first + len(words)


def _fill(hook: int, effects: list[tuple[Effect, Any]], signature: Any) -> None:
    """Put the functions of a hook into the table; without a signature only the switches."""
    places = [switches([e]) for e, _ in effects]
    first, end = _put([k for each in places for k in each])
    start, last = _put([0] * (_WORDS * len(effects) if signature else 0))
    at = first
    for place, (e, function), own_switches in zip(count(start, _WORDS), effects, places, strict=False):
        if signature:
            row = ROW.places[e.name]
            by_address.put(place, [0, row.start, row.stop, at, at + len(own_switches)])
            make = (
                partial(_of_all_actions, function, e.knows_preferences) if hook == VALUE else partial(_kernel, function)
            )
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
        PERCEIVE: (perceiving, _PERCEIVE),
        PREFER: (_of("function", PREFERENCE), _PREFER),
        VALUE: (valuing, _VALUE),
        ACTUATE: (_of("function", ACTUATION), _ACTUATE),
        PUSH: (_of("function", ENVIRONMENT), _PUSH),
        CHANGE: ([(e, memory.change) for e, memory in memories], _CHANGE),
        EXPECT: ([(e, memory.expected_change) for e, memory in memories], _EXPECT),
        NOISE: (_of("noise_factor"), _NOISE),
        DISPLACE: (_of("displacement"), _DISPLACE),
        UNEVEN: (_of("measurement_noise_factor"), _UNEVEN),
        WEIGH: ([(e, one.weigh) for e, one in _of("contamination")], _WEIGH),
        FEEL: ([one for one in (*perceiving, *valuing) if one[0].sees_accelerations], None),
    }
    for hook, (effects, signature) in table.items():
        _fill(hook, effects, signature)
    first, end = _put([ROW.places[e.name].start for e in EFFECTS.values() if e.looks_back])
    by_address.put(_HEADS + 4 * LOOK_BACK, [0, 0, first, end])
    laws = [(number, one) for number, one in enumerate(LAWS.values()) if number != ADAPTIVE_SEEK]
    start, last = _put([0] * _WORDS * len(laws))
    for place, (number, law) in zip(count(start, _WORDS), laws, strict=False):
        row = ROW.law_places[law.name]
        by_address.put(place, [0, row.start, row.stop, number])
        _offer(place, f"law {law.name}", law.function, partial(_kernel, law.function), _LAW)
    by_address.put(_HEADS + 4 * LAW, [start, last, 0, 0])


def compile_all() -> None:
    """Compile the functions of all effects and laws now, or load them."""
    for place in by_address.offered():
        by_address.look_up(place)


_fill_all()
