"""What a driver does and how it is measured, with all effects: from what the driver can see to a measured position."""

import math

import numpy as np

from sugiyama_ros.arrays import Array
from sugiyama_ros.by_address import part_of
from sugiyama_ros.driver.utility import (
    FREE_ROW,
    GRID_ROW,
    UTILITY_ROW,
    Preferences,
    boltzmann_mean,
    preferences,
    utilities,
)
from sugiyama_ros.effects import hooks
from sugiyama_ros.effects.effect import Seen, with_view
from sugiyama_ros.effects.hooks import PARAMETERS
from sugiyama_ros.effects.registry import EFFECTS, ROW
from sugiyama_ros.jit import kernel
from sugiyama_ros.laws.registry import ADAPTIVE_SEEK

_LAW = ROW.law
#: Places of the times that drivers look back.
LOOKING_BACK = np.array([ROW.places[e.name].start for e in EFFECTS.values() if e.looks_back], dtype=np.int64)


@kernel(allocates=False)
def law_acceleration(gap: float, speed: float, leader_speed: float, row: Array) -> float:
    """Compute the acceleration [m/s^2] by the law of a row, NaN if there is none; not for adaptiveSeek."""
    for f in hooks.functions_of(hooks.LAW):
        if hooks.has_number(f, row[_LAW]):
            acceleration: float = hooks.call_law(f, gap, speed, leader_speed, part_of(row, f + PARAMETERS))
            return acceleration
    return math.nan


@kernel(allocates=False)
def noise_factor(speed: float, row: Array) -> float:
    """Compute the factor of the std of the acceleration noise at a speed [m/s], for a row (width,)."""
    factor = 1.0
    for f in hooks.functions_of(hooks.NOISE):
        if hooks.is_on(f, row):
            factor *= hooks.call_noise(f, speed, part_of(row, f + PARAMETERS))
    return factor


@kernel(allocates=False)
def seeks(row: Array) -> bool:
    """Whether the driver of a row (width,) chooses among actions, as adaptiveSeek does; other laws are formulas."""
    return bool(row[_LAW] == ADAPTIVE_SEEK)


@kernel(allocates=False)
def perceive(seen: Seen, row: Array) -> Seen:
    """Return what the driver of a row (width,) perceives of what can be seen."""
    for f in hooks.functions_of(hooks.PERCEIVE):
        if hooks.is_on(f, row):
            gap, speed, leader_speed = hooks.call_perceive(f, seen, part_of(row, f + PARAMETERS))
            seen = with_view(seen, gap, speed, leader_speed)
    return seen


@kernel(allocates=False)
def prefer(perceived: Seen, row: Array) -> Preferences:
    """Return what the driver of a row (width,) prefers, given what the driver perceives."""
    v_star, kappa_v, kappa_1, kappa_c, kappa_d, omega_2, rationality = preferences(row)
    for f in hooks.functions_of(hooks.PREFER):
        if hooks.is_on(f, row):
            v_star, kappa_v = hooks.call_prefer(f, v_star, kappa_v, perceived, part_of(row, f + PARAMETERS))
    return v_star, kappa_v, kappa_1, kappa_c, kappa_d, omega_2, rationality


@kernel(allocates=False)
def sees_as_it_is(row: Array) -> bool:
    """Whether no effect changes what the driver of a row (width,) perceives or prefers."""
    return not (hooks.acts(hooks.PERCEIVE, row) or hooks.acts(hooks.PREFER, row))


@kernel(allocates=False)
def has_components(row: Array) -> bool:
    """Whether effects add components to the utility, for a row (width,)."""
    return hooks.acts(hooks.VALUE, row)


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
    """Add what effects add to the utilities of actions (K,) [m/s^2], to every ``stride``-th entry of ``utility``."""
    for f in hooks.functions_of(hooks.VALUE):
        if hooks.is_on(f, row):
            hooks.call_value(f, perceived, actions, period, horizon, part_of(row, f + PARAMETERS), driver, added)
            for k in range(len(actions)):
                utility[stride * k] += added[k]


@kernel(allocates=False)
def acts_on_intention(row: Array) -> bool:
    """Whether effects change the intended acceleration or add to it, for a row (width,)."""
    return hooks.acts(hooks.ACTUATE, row) or hooks.acts(hooks.PUSH, row)


@kernel(allocates=False)
def act(action: float, seen: Seen, row: Array) -> tuple[float, float]:
    """Return what becomes of the acceleration [m/s^2] that the driver chooses; results as of ``intend``."""
    for f in hooks.functions_of(hooks.ACTUATE):
        if hooks.is_on(f, row):
            action = hooks.call_actuate(f, action, seen, part_of(row, f + PARAMETERS))
    pushed = 0.0
    for f in hooks.functions_of(hooks.PUSH):
        if hooks.is_on(f, row):
            pushed += hooks.call_push(f, seen, part_of(row, f + PARAMETERS))
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
        if has_components(row):
            actions, utility = scratch[GRID_ROW], scratch[UTILITY_ROW]
            add_components(perceived, actions, period, horizon, row, driver, scratch[FREE_ROW], utility, 1)
        action = boltzmann_mean(scratch, driver[-1])
    else:
        action = law_acceleration(gap, speed, leader_speed, row)
    return act(action, seen, row)


@kernel(allocates=False)
def carry_out(meant: float, held: float, row: Array, period: float) -> float:
    """Compute the acceleration [m/s^2] that the driver makes the car do, who held ``held`` in the last period [s]."""
    if not hooks.acts(hooks.CHANGE, row):
        return meant
    wanted = meant - held
    for f in hooks.functions_of(hooks.CHANGE):
        if hooks.is_on(f, row):
            wanted = hooks.call_change(f, wanted, period, part_of(row, f + PARAMETERS))
    return held + wanted


@kernel(allocates=False)
def expect_change(wanted: float, variance: float, row: Array, period: float) -> tuple[float, float, float]:
    """Compute the moments of the change of the acceleration that the driver carries out.

    The wanted change has a normal distribution. Returns the mean [m/s^2], its regression on the wanted change, and the
    variance [m^2/s^4] that the regression leaves.
    """
    mean, slope, left = wanted, 1.0, 0.0
    for f in hooks.functions_of(hooks.EXPECT):
        if hooks.is_on(f, row):
            # between two effects the change counts as normally distributed
            spread = slope * slope * variance + left
            mean, by_wanted, new = hooks.call_expect(f, mean, spread, period, part_of(row, f + PARAMETERS))
            slope, left = by_wanted * slope, new + by_wanted * by_wanted * left
    return mean, slope, left


@kernel(allocates=False)
def remembers(row: Array) -> bool:
    """Whether the acceleration depends on the acceleration of the last period, for a row (width,)."""
    return hooks.acts(hooks.CHANGE, row)


@kernel(allocates=False)
def feels_accelerations(row: Array) -> bool:
    """Whether the driver reacts to accelerations, which a filter does not know exactly, for a row (width,)."""
    return hooks.acts(hooks.FEEL, row)


@kernel(allocates=False)
def looks_back(row: Array) -> float:
    """Return how far the driver of a row (width,) looks back [s]; 0 for a driver who sees what there is now."""
    return hooks.longest(hooks.LOOK_BACK, row)


@kernel(allocates=False)
def displacement(position: float, circumference: float, row: Array) -> tuple[float, float]:
    """Compute the measured minus the true position [m], and its derivative by the position."""
    offset, slope = 0.0, 0.0
    for f in hooks.functions_of(hooks.DISPLACE):
        if hooks.is_on(f, row):
            more, steeper = hooks.call_displace(f, position, circumference, part_of(row, f + PARAMETERS))
            offset, slope = offset + more, slope + steeper
    return offset, slope


@kernel(allocates=False)
def noise_std_factor(position: float, circumference: float, row: Array) -> float:
    """Compute the factor of the std of the measurement noise at a position [m]."""
    factor = 1.0
    for f in hooks.functions_of(hooks.UNEVEN):
        if hooks.is_on(f, row):
            factor *= hooks.call_uneven(f, position, circumference, part_of(row, f + PARAMETERS))
    return factor


@kernel(allocates=False)
def is_contaminated(row: Array) -> bool:
    """Whether an effect in a row (width,) makes some measurements worse than others."""
    return hooks.acts(hooks.WEIGH, row)


@kernel(allocates=False)
def weigh(innovation: float, variance: float, noise_var: float, row: Array) -> tuple[float, float, float]:
    """Weigh a sample from a mixture of good and bad measurements, as ``contaminated_normal``."""
    probability, wide, density = 0.0, variance, 0.0
    for f in hooks.functions_of(hooks.WEIGH):
        if hooks.is_on(f, row):
            probability, wide, density = hooks.call_weigh(
                f, innovation, variance, noise_var, part_of(row, f + PARAMETERS)
            )
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
