"""Compiled chains, which call the hooks of all effects one after another.

A ``then_...`` function takes the chain so far and one effect, and returns the chain with the effect as a new link. A
link does nothing if the effect's strengths are 0. Each chain is built once, from ``EFFECTS``. Compiled code then calls
the chain like any other function.
"""

from collections.abc import Callable, Iterable
from typing import Any, TypeAlias

import numpy as np

from sugiyama_ros.arrays import Array, Ints
from sugiyama_ros.driver.parameters import REFERENCE_HORIZON
from sugiyama_ros.driver.utility import Preferences
from sugiyama_ros.effects.effect import Effect, Seen, with_view
from sugiyama_ros.effects.registry import EFFECTS, ROW
from sugiyama_ros.jit import kernel

Hook: TypeAlias = Callable[..., Any]


def chain(start: Hook, link: Callable[[Hook, Effect], Hook], effects: Iterable[Effect]) -> Hook:
    """Build a chain.

    Parameters
    ----------
    start : callable
        Compiled function that does nothing; the chain without effects.
    link : callable
        (chain so far, effect) -> chain with the effect.
    effects : iterable of Effect
        Effects in the order of the chain.

    Returns
    -------
    callable
        Compiled function.
    """
    for effect in effects:
        start = link(start, effect)
    return start


def having(hook: str, *stages: str) -> tuple[Effect, ...]:
    """Find the effects that declare a hook, such as ``"memory"``; only effects of these stages, if any are given."""
    return tuple(e for e in EFFECTS.values() if getattr(e, hook) is not None and (not stages or e.stage in stages))


def switches(effects: Iterable[Effect]) -> Ints:
    """Find the entries of a row that switch one of these effects on; indices, shape (K,)."""
    return np.array([ROW.index_of(e.name, name) for e in effects for name in e.switches], dtype=np.int64)


@kernel(allocates=False)
def any_of(places: Ints, row: Array) -> bool:
    """Whether an entry of a row at one of these indices is not 0, so that a chain without active links is skipped."""
    for k in places:  # noqa: SIM110 (numba has no any())
        if row[k] != 0.0:
            return True
    return False


def _places(effect: Effect) -> tuple[int, int, Any]:
    """Find the slice of an effect's parameters in a row, and make a function that says whether a row has it off."""
    at = tuple(ROW.index_of(effect.name, name) for name in effect.switches)

    @kernel(cached=False, inline=True)
    def is_off(row: Array) -> bool:
        for k in at:  # noqa: SIM110 (numba has no all())
            if row[k] != 0.0:
                return False
        return True

    return ROW.places[effect.name].start, ROW.places[effect.name].stop, is_off


@kernel(cached=False)
def nothing_perceived(seen: Seen, row: Array) -> Seen:
    """Perceive everything as it is."""
    return seen


def then_perceive(before: Hook, effect: Effect) -> Hook:
    """Add an effect that changes how the driver perceives the gap and the speeds."""
    first, last, is_off = _places(effect)
    perceive: Any = effect.function

    @kernel(cached=False)
    def perceived(seen: Seen, row: Array) -> Seen:
        seen = before(seen, row)
        if is_off(row):
            return seen
        gap, speed, leader_speed = perceive(seen, row[first:last])
        return with_view(seen, gap, speed, leader_speed)

    return perceived


@kernel(cached=False)
def nothing_preferred(v_star: float, kappa_v: float, seen: Seen, row: Array) -> tuple[float, float]:
    """Leave the preferences as they are."""
    return v_star, kappa_v


def then_prefer(before: Hook, effect: Effect) -> Hook:
    """Add an effect that changes the desired speed and the risk premium."""
    first, last, is_off = _places(effect)
    prefer: Any = effect.function

    @kernel(cached=False)
    def preferred(v_star: float, kappa_v: float, seen: Seen, row: Array) -> tuple[float, float]:
        v_star, kappa_v = before(v_star, kappa_v, seen, row)
        if is_off(row):
            return v_star, kappa_v
        v_star, kappa_v = prefer(v_star, kappa_v, seen, row[first:last])
        return v_star, kappa_v

    return preferred


@kernel(cached=False)
def nothing_valued(
    seen: Seen, actions: Array, period: float, horizon: int, row: Array, driver: Preferences, out: Array, stride: int
) -> None:
    """Add nothing to the utilities."""


def then_value(before: Hook, effect: Effect) -> Hook:
    """Add an effect with a component of the utility; every ``stride``-th entry of ``out`` is the utility of an action.

    The loop over the actions stands inside, so that an effect that is off costs one comparison and not one for each
    action. At the reference period the horizon is a constant, so that compilers can unroll a component's loop over it,
    and make vector instructions of the loop over the actions.
    """
    first, last, is_off = _places(effect)
    component: Any = effect.function

    @kernel(cached=False)
    def alone(seen: Seen, action: float, period: float, horizon: int, p: Array, driver: Preferences) -> float:
        return float(component(seen, action, period, horizon, p))

    value: Any = component if effect.knows_preferences else alone

    @kernel(cached=False)
    def valued(
        seen: Seen,
        actions: Array,
        period: float,
        horizon: int,
        row: Array,
        driver: Preferences,
        out: Array,
        stride: int,
    ) -> None:
        before(seen, actions, period, horizon, row, driver, out, stride)
        if is_off(row):
            return
        p = row[first:last]
        if horizon == REFERENCE_HORIZON:
            for k in range(len(actions)):
                out[stride * k] += value(seen, actions[k], period, REFERENCE_HORIZON, p, driver)
        else:
            for k in range(len(actions)):
                out[stride * k] += value(seen, actions[k], period, horizon, p, driver)

    return valued


@kernel(cached=False)
def nothing_actuated(acceleration: float, seen: Seen, row: Array) -> float:
    """Leave the intended acceleration as it is."""
    return acceleration


def then_actuate(before: Hook, effect: Effect) -> Hook:
    """Add an effect that changes the intended acceleration."""
    first, last, is_off = _places(effect)
    actuate: Any = effect.function

    @kernel(cached=False)
    def actuated(acceleration: float, seen: Seen, row: Array) -> float:
        acceleration = before(acceleration, seen, row)
        if is_off(row):
            return acceleration
        return float(actuate(acceleration, seen, row[first:last]))

    return actuated


@kernel(cached=False)
def nothing_pushes(seen: Seen, row: Array) -> float:
    """Return the acceleration 0 [m/s^2] of an environment without effects."""
    return 0.0


def then_push(before: Hook, effect: Effect) -> Hook:
    """Add an effect of the environment that accelerates or brakes the car."""
    first, last, is_off = _places(effect)
    push: Any = effect.function

    @kernel(cached=False)
    def pushed(seen: Seen, row: Array) -> float:
        total = before(seen, row)
        if is_off(row):
            return float(total)
        return float(total + push(seen, row[first:last]))

    return pushed


@kernel(cached=False)
def all_changed(wanted: float, period: float, row: Array) -> float:
    """Carry out all of a wanted change at once."""
    return wanted


def then_change(before: Hook, effect: Effect) -> Hook:
    """Add an effect that limits how much of a wanted change is carried out."""
    first, last, is_off = _places(effect)
    change: Any = effect.memory.change if effect.memory else None

    @kernel(cached=False)
    def changed(wanted: float, period: float, row: Array) -> float:
        wanted = before(wanted, period, row)
        if is_off(row):
            return wanted
        return float(change(wanted, period, row[first:last]))

    return changed


@kernel(cached=False)
def all_expected(wanted: float, variance: float, period: float, row: Array) -> tuple[float, float, float]:
    """Return the moments of a wanted change that is carried out at once."""
    return wanted, 1.0, 0.0


def then_expect(before: Hook, effect: Effect) -> Hook:
    """Add an effect with memory to the moments; between two links the change counts as normally distributed."""
    first, last, is_off = _places(effect)
    expect: Any = effect.memory.expected_change if effect.memory else None

    @kernel(cached=False)
    def expected(wanted: float, variance: float, period: float, row: Array) -> tuple[float, float, float]:
        mean, slope, left = before(wanted, variance, period, row)
        if is_off(row):
            return mean, slope, left
        spread = slope * slope * variance + left
        mean, by_wanted, new = expect(mean, spread, period, row[first:last])
        return mean, by_wanted * slope, new + by_wanted * by_wanted * left

    return expected


@kernel(cached=False)
def no_factor(at: float, row: Array) -> float:
    """Leave the std of the acceleration noise as it is."""
    return 1.0


def then_factor(before: Hook, effect: Effect) -> Hook:
    """Add an effect that multiplies the std of the acceleration noise by a factor."""
    first, last, is_off = _places(effect)
    factor_of: Any = effect.noise_factor

    @kernel(cached=False)
    def factor(speed: float, row: Array) -> float:
        factor = before(speed, row)
        if is_off(row):
            return float(factor)
        return float(factor * factor_of(speed, row[first:last]))

    return factor


@kernel(cached=False)
def no_displacement(position: float, circumference: float, row: Array) -> tuple[float, float]:
    """Displace no measured position."""
    return 0.0, 0.0


def then_displace(before: Hook, effect: Effect) -> Hook:
    """Add an effect that displaces measured positions."""
    first, last, is_off = _places(effect)
    displacement: Any = effect.displacement

    @kernel(cached=False)
    def displaced(position: float, circumference: float, row: Array) -> tuple[float, float]:
        offset, slope = before(position, circumference, row)
        if is_off(row):
            return offset, slope
        more, steeper = displacement(position, circumference, row[first:last])
        return offset + more, slope + steeper

    return displaced


@kernel(cached=False)
def no_measurement_factor(position: float, circumference: float, row: Array) -> float:
    """Leave the std of the measurement noise as it is."""
    return 1.0


def then_measurement_factor(before: Hook, effect: Effect) -> Hook:
    """Add an effect that multiplies the std of the measurement noise by a factor."""
    first, last, is_off = _places(effect)
    factor_of: Any = effect.measurement_noise_factor

    @kernel(cached=False)
    def factor(position: float, circumference: float, row: Array) -> float:
        factor = before(position, circumference, row)
        if is_off(row):
            return float(factor)
        return float(factor * factor_of(position, circumference, row[first:last]))

    return factor


@kernel(cached=False)
def never_bad(innovation: float, variance: float, noise_var: float, row: Array) -> tuple[float, float, float]:
    """Treat every measurement as good; nothing calls this function if no contamination acts."""
    return 0.0, variance, 0.0


def then_weigh(before: Hook, effect: Effect) -> Hook:
    """Add an effect that weighs measurements; the last effect that acts decides."""
    first, last, is_off = _places(effect)
    weigh: Any = effect.contamination.weigh if effect.contamination else None

    @kernel(cached=False)
    def weighed(innovation: float, variance: float, noise_var: float, row: Array) -> tuple[float, float, float]:
        if is_off(row):
            probability, wide, density = before(innovation, variance, noise_var, row)
        else:
            probability, wide, density = weigh(innovation, variance, noise_var, row[first:last])
        return probability, wide, density

    return weighed
