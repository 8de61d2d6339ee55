"""Compiled chains: the hooks of all effects, called one after the other.

Each builder takes the chain so far and one effect. A link of a chain does nothing where the effect's strengths are 0.
A chain is made once, from ``EFFECTS``; compiled code then calls it like any other function.
"""

from collections.abc import Callable, Iterable
from typing import Any, TypeAlias

import numpy as np

from sugiyama_ros.arrays import Array, Ints
from sugiyama_ros.effects.effect import Effect, Seen, with_view
from sugiyama_ros.effects.registry import EFFECTS, ROW
from sugiyama_ros.jit import kernel

Hook: TypeAlias = Callable[..., Any]


def chain(start: Hook, link: Callable[[Hook, Effect], Hook], effects: Iterable[Effect]) -> Hook:
    """Make a chain of a hook of these effects."""
    for effect in effects:
        start = link(start, effect)
    return start


def having(hook: str, *stages: str) -> tuple[Effect, ...]:
    """Effects that have a hook, of some stages if any are given."""
    return tuple(e for e in EFFECTS.values() if getattr(e, hook) is not None and (not stages or e.stage in stages))


def switches(effects: Iterable[Effect]) -> Ints:
    """Places in a row of everything that switches one of these effects on."""
    return np.array([ROW.index_of(e.name, name) for e in effects for name in e.switches], dtype=np.int64)


@kernel(allocates=False)
def any_of(places: Ints, row: Array) -> bool:
    """Whether an effect is on; a driver without effects need not go through all of them."""
    for k in places:  # noqa: SIM110 (numba has no any())
        if row[k] != 0.0:
            return True
    return False


def _places(effect: Effect) -> tuple[int, int, int, int]:
    """First and last entry in a row, and the places of the first and the last switch."""
    at = [ROW.index_of(effect.name, name) for name in effect.switches]
    return ROW.places[effect.name].start, ROW.places[effect.name].stop, at[0], at[-1]


@kernel(cached=False)
def nothing_perceived(seen: Seen, row: Array) -> Seen:
    """What is seen is perceived as it is."""
    return seen


def then_perceive(before: Hook, effect: Effect) -> Hook:
    """Perceive the gap and the speeds."""
    first, last, switch, other = _places(effect)
    perceive: Any = effect.function

    @kernel(cached=False)
    def perceived(seen: Seen, row: Array) -> Seen:
        seen = before(seen, row)
        if row[switch] == 0.0 and row[other] == 0.0:
            return seen
        gap, speed, leader_speed = perceive(seen, row[first:last])
        return with_view(seen, gap, speed, leader_speed)

    return perceived


@kernel(cached=False)
def nothing_preferred(v_star: float, kappa_v: float, seen: Seen, row: Array) -> tuple[float, float]:
    """Preferences stay as they are."""
    return v_star, kappa_v


def then_prefer(before: Hook, effect: Effect) -> Hook:
    """Change the desired speed and the risk premium."""
    first, last, switch, other = _places(effect)
    prefer: Any = effect.function

    @kernel(cached=False)
    def preferred(v_star: float, kappa_v: float, seen: Seen, row: Array) -> tuple[float, float]:
        v_star, kappa_v = before(v_star, kappa_v, seen, row)
        if row[switch] == 0.0 and row[other] == 0.0:
            return v_star, kappa_v
        v_star, kappa_v = prefer(v_star, kappa_v, seen, row[first:last])
        return v_star, kappa_v

    return preferred


@kernel(cached=False)
def nothing_valued(seen: Seen, action: float, period: float, horizon: int, row: Array) -> float:
    """Nothing is added to the utility."""
    return 0.0


def then_value(before: Hook, effect: Effect) -> Hook:
    """Add a component to the utility of an action."""
    first, last, switch, other = _places(effect)
    component: Any = effect.function

    @kernel(cached=False)
    def valued(seen: Seen, action: float, period: float, horizon: int, row: Array) -> float:
        total = before(seen, action, period, horizon, row)
        if row[switch] == 0.0 and row[other] == 0.0:
            return float(total)
        return float(total + component(seen, action, period, horizon, row[first:last]))

    return valued


@kernel(cached=False)
def nothing_actuated(acceleration: float, seen: Seen, row: Array) -> float:
    """The car does what is meant."""
    return acceleration


def then_actuate(before: Hook, effect: Effect) -> Hook:
    """Change the acceleration that is meant."""
    first, last, switch, other = _places(effect)
    actuate: Any = effect.function

    @kernel(cached=False)
    def actuated(acceleration: float, seen: Seen, row: Array) -> float:
        acceleration = before(acceleration, seen, row)
        if row[switch] == 0.0 and row[other] == 0.0:
            return acceleration
        return float(actuate(acceleration, seen, row[first:last]))

    return actuated


@kernel(cached=False)
def nothing_pushes(seen: Seen, row: Array) -> float:
    """The environment adds nothing."""
    return 0.0


def then_push(before: Hook, effect: Effect) -> Hook:
    """Add an acceleration of the environment."""
    first, last, switch, other = _places(effect)
    push: Any = effect.function

    @kernel(cached=False)
    def pushed(seen: Seen, row: Array) -> float:
        total = before(seen, row)
        if row[switch] == 0.0 and row[other] == 0.0:
            return float(total)
        return float(total + push(seen, row[first:last]))

    return pushed


@kernel(cached=False)
def all_changed(wanted: float, period: float, row: Array) -> float:
    """A wanted change is carried out at once."""
    return wanted


def then_change(before: Hook, effect: Effect) -> Hook:
    """Carry out a wanted change of the acceleration."""
    first, last, switch, other = _places(effect)
    change: Any = effect.memory.change if effect.memory else None

    @kernel(cached=False)
    def changed(wanted: float, period: float, row: Array) -> float:
        wanted = before(wanted, period, row)
        if row[switch] == 0.0 and row[other] == 0.0:
            return wanted
        return float(change(wanted, period, row[first:last]))

    return changed


@kernel(cached=False)
def all_expected(wanted: float, variance: float, period: float, row: Array) -> tuple[float, float, float]:
    """Moments of a wanted change that is carried out at once."""
    return wanted, 1.0, 0.0


def then_expect(before: Hook, effect: Effect) -> Hook:
    """Moments of a change that is carried out, as a normal distribution from link to link."""
    first, last, switch, other = _places(effect)
    expect: Any = effect.memory.expected_change if effect.memory else None

    @kernel(cached=False)
    def expected(wanted: float, variance: float, period: float, row: Array) -> tuple[float, float, float]:
        mean, slope, left = before(wanted, variance, period, row)
        if row[switch] == 0.0 and row[other] == 0.0:
            return mean, slope, left
        spread = slope * slope * variance + left
        mean, by_wanted, new = expect(mean, spread, period, row[first:last])
        return mean, by_wanted * slope, new + by_wanted * by_wanted * left

    return expected


@kernel(cached=False)
def no_factor(at: float, row: Array) -> float:
    """The noise is the driver's own."""
    return 1.0


def then_factor(before: Hook, effect: Effect) -> Hook:
    """Multiply the std of the acceleration noise."""
    first, last, switch, other = _places(effect)
    factor_of: Any = effect.noise_factor

    @kernel(cached=False)
    def factor(speed: float, row: Array) -> float:
        factor = before(speed, row)
        if row[switch] == 0.0 and row[other] == 0.0:
            return float(factor)
        return float(factor * factor_of(speed, row[first:last]))

    return factor


@kernel(cached=False)
def no_displacement(position: float, circumference: float, row: Array) -> tuple[float, float]:
    """Positions are measured where they are."""
    return 0.0, 0.0


def then_displace(before: Hook, effect: Effect) -> Hook:
    """Displace a measured position."""
    first, last, switch, other = _places(effect)
    displacement: Any = effect.displacement

    @kernel(cached=False)
    def displaced(position: float, circumference: float, row: Array) -> tuple[float, float]:
        offset, slope = before(position, circumference, row)
        if row[switch] == 0.0 and row[other] == 0.0:
            return offset, slope
        more, steeper = displacement(position, circumference, row[first:last])
        return offset + more, slope + steeper

    return displaced


@kernel(cached=False)
def no_measurement_factor(position: float, circumference: float, row: Array) -> float:
    """The measurement noise is the same everywhere."""
    return 1.0


def then_measurement_factor(before: Hook, effect: Effect) -> Hook:
    """Multiply the std of the measurement noise."""
    first, last, switch, other = _places(effect)
    factor_of: Any = effect.measurement_noise_factor

    @kernel(cached=False)
    def factor(position: float, circumference: float, row: Array) -> float:
        factor = before(position, circumference, row)
        if row[switch] == 0.0 and row[other] == 0.0:
            return float(factor)
        return float(factor * factor_of(position, circumference, row[first:last]))

    return factor


@kernel(cached=False)
def never_bad(innovation: float, variance: float, noise_var: float, row: Array) -> tuple[float, float, float]:
    """No measurement is worse than the others; never called where no contamination is on."""
    return 0.0, variance, 0.0


def then_weigh(before: Hook, effect: Effect) -> Hook:
    """Weigh a measurement; the last effect of this kind that is on decides."""
    first, last, switch, other = _places(effect)
    weigh: Any = effect.contamination.weigh if effect.contamination else None

    @kernel(cached=False)
    def weighed(innovation: float, variance: float, noise_var: float, row: Array) -> tuple[float, float, float]:
        if row[switch] == 0.0 and row[other] == 0.0:
            probability, wide, density = before(innovation, variance, noise_var, row)
        else:
            probability, wide, density = weigh(innovation, variance, noise_var, row[first:last])
        return probability, wide, density

    return weighed
