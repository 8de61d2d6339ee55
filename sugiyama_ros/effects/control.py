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
from sugiyama_ros.effects.effect import Seen, with_view
from sugiyama_ros.effects.hooks import (
    ACTUATE,
    CHANGE,
    DISPLACE,
    EXPECT,
    FEEL,
    LAW,
    LOOK_BACK,
    NOISE,
    PARAMETERS,
    PERCEIVE,
    PREFER,
    PUSH,
    UNEVEN,
    VALUE,
    WEIGH,
    acts,
    call_actuate,
    call_change,
    call_displace,
    call_expect,
    call_law,
    call_noise,
    call_perceive,
    call_prefer,
    call_push,
    call_uneven,
    call_value,
    call_weigh,
    functions_of,
    has_number,
    is_on,
    longest,
)
from sugiyama_ros.effects.registry import EFFECTS, ROW
from sugiyama_ros.jit import kernel
from sugiyama_ros.laws.registry import ADAPTIVE_SEEK

_LAW = ROW.law
#: Places of the times that drivers look back.
LOOKING_BACK = np.array([ROW.places[e.name].start for e in EFFECTS.values() if e.looks_back], dtype=np.int64)


@kernel(allocates=False)
def law_acceleration(gap: float, speed: float, leader_speed: float, row: Array) -> float:
    """Compute the acceleration by the law of a driver's row; not for adaptiveSeek, which needs a scratch array.

    gap, speed, leader_speed: gap [m], infinite without a leader, speed [m/s] and leader's speed [m/s]; row: (width,),
    row of the driver. Returns acceleration [m/s^2]; naN if no law has the number in the row.
    """
    for f in functions_of(LAW):
        if has_number(f, row[_LAW]):
            acceleration: float = call_law(f, gap, speed, leader_speed, part_of(row, f + PARAMETERS))
            return acceleration
    return math.nan


@kernel(allocates=False)
def noise_factor(speed: float, row: Array) -> float:
    """Compute the factor of the std of the acceleration noise at a speed [m/s], for a row (width,)."""
    factor = 1.0
    for f in functions_of(NOISE):
        if is_on(f, row):
            factor *= call_noise(f, speed, part_of(row, f + PARAMETERS))
    return factor


@kernel(allocates=False)
def seeks(row: Array) -> bool:
    """Whether the driver of a row (width,) chooses among actions, as adaptiveSeek does; other laws are formulas."""
    return bool(row[_LAW] == ADAPTIVE_SEEK)


@kernel(allocates=False)
def perceive(seen: Seen, row: Array) -> Seen:
    """Return what the driver of a row (width,) perceives of what can be seen."""
    for f in functions_of(PERCEIVE):
        if is_on(f, row):
            gap, speed, leader_speed = call_perceive(f, seen, part_of(row, f + PARAMETERS))
            seen = with_view(seen, gap, speed, leader_speed)
    return seen


@kernel(allocates=False)
def prefer(perceived: Seen, row: Array) -> Preferences:
    """Return what the driver of a row (width,) prefers, given what the driver perceives."""
    v_star, kappa_v, kappa_1, kappa_c, kappa_d, omega_2, rationality = preferences(row)
    for f in functions_of(PREFER):
        if is_on(f, row):
            v_star, kappa_v = call_prefer(f, v_star, kappa_v, perceived, part_of(row, f + PARAMETERS))
    return v_star, kappa_v, kappa_1, kappa_c, kappa_d, omega_2, rationality


@kernel(allocates=False)
def sees_as_it_is(row: Array) -> bool:
    """Whether no effect changes what the driver of a row (width,) perceives or prefers."""
    return not (acts(PERCEIVE, row) or acts(PREFER, row))


@kernel(allocates=False)
def has_components(row: Array) -> bool:
    """Whether effects add components to the utility, for a row (width,)."""
    return acts(VALUE, row)


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
    """Add what effects add to the utilities of actions (K,) [m/s^2]; the other arguments as for ``intend``.

    Every ``stride``-th entry of ``utility`` is the utility of an action. ``added`` (K,) is overwritten.
    """
    for f in functions_of(VALUE):
        if is_on(f, row):
            call_value(f, perceived, actions, period, horizon, part_of(row, f + PARAMETERS), driver, added)
            for k in range(len(actions)):
                utility[stride * k] += added[k]


@kernel(allocates=False)
def acts_on_intention(row: Array) -> bool:
    """Whether effects change the intended acceleration or add to it, for a row (width,)."""
    return acts(ACTUATE, row) or acts(PUSH, row)


@kernel(allocates=False)
def act(action: float, seen: Seen, row: Array) -> tuple[float, float]:
    """Return what becomes of the acceleration [m/s^2] that the driver chooses; results as of ``intend``."""
    for f in functions_of(ACTUATE):
        if is_on(f, row):
            action = call_actuate(f, action, seen, part_of(row, f + PARAMETERS))
    pushed = 0.0
    for f in functions_of(PUSH):
        if is_on(f, row):
            pushed += call_push(f, seen, part_of(row, f + PARAMETERS))
    return action, pushed


@kernel(allocates=False)
def intend(seen: Seen, row: Array, scratch: Array, period: float, horizon: int) -> tuple[float, float]:
    """Compute the acceleration that the driver intends, and the acceleration that the environment adds.

    row: (width,), row of the driver at this period; scratch: (5, at least K), made by ``scratch_for`` from the K
    actions that the driver considers; period: length of the period [s]. Returns acceleration [m/s^2] that the driver
    intends, and acceleration [m/s^2] that the environment adds.
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
    """Compute the acceleration that the driver makes the car do.

    meant, held: intended acceleration [m/s^2], and ``carry_out`` [m/s^2] of the last period; row: (width,), row of the
    driver at this period; period: length of the period [s]. Returns acceleration [m/s^2].
    """
    if not acts(CHANGE, row):
        return meant
    wanted = meant - held
    for f in functions_of(CHANGE):
        if is_on(f, row):
            wanted = call_change(f, wanted, period, part_of(row, f + PARAMETERS))
    return held + wanted


@kernel(allocates=False)
def expect_change(wanted: float, variance: float, row: Array, period: float) -> tuple[float, float, float]:
    """Compute the moments of the change of the acceleration that the driver carries out.

    wanted, variance: mean [m/s^2] and variance [m^2/s^4] of the wanted change, which has a normal distribution; row:
    (width,), row of the driver at this period; period: length of the period [s]. Returns mean [m/s^2] of the change
    that is carried out, its regression on the wanted change, and the variance [m^2/s^4] that the regression leaves.
    """
    mean, slope, left = wanted, 1.0, 0.0
    for f in functions_of(EXPECT):
        if is_on(f, row):
            # between two effects the change counts as normally distributed
            spread = slope * slope * variance + left
            mean, by_wanted, new = call_expect(f, mean, spread, period, part_of(row, f + PARAMETERS))
            slope, left = by_wanted * slope, new + by_wanted * by_wanted * left
    return mean, slope, left


@kernel(allocates=False)
def remembers(row: Array) -> bool:
    """Whether the acceleration depends on the acceleration of the last period, for a row (width,)."""
    return acts(CHANGE, row)


@kernel(allocates=False)
def feels_accelerations(row: Array) -> bool:
    """Whether the driver reacts to accelerations, which a filter does not know exactly, for a row (width,)."""
    return acts(FEEL, row)


@kernel(allocates=False)
def looks_back(row: Array) -> float:
    """Return how far the driver of a row (width,) looks back [s]; 0 for a driver who sees what there is now."""
    return longest(LOOK_BACK, row)


@kernel(allocates=False)
def displacement(position: float, circumference: float, row: Array) -> tuple[float, float]:
    """Compute how far a position is displaced when it is measured.

    position, circumference: true position [m], and circumference [m] of the ring; 0 for an open road; row: (width,),
    row of the driver. Returns measured minus true position [m], and its derivative by the position.
    """
    offset, slope = 0.0, 0.0
    for f in functions_of(DISPLACE):
        if is_on(f, row):
            more, steeper = call_displace(f, position, circumference, part_of(row, f + PARAMETERS))
            offset, slope = offset + more, slope + steeper
    return offset, slope


@kernel(allocates=False)
def noise_std_factor(position: float, circumference: float, row: Array) -> float:
    """Compute the factor of the std of the measurement noise; arguments as for ``displacement``."""
    factor = 1.0
    for f in functions_of(UNEVEN):
        if is_on(f, row):
            factor *= call_uneven(f, position, circumference, part_of(row, f + PARAMETERS))
    return factor


@kernel(allocates=False)
def is_contaminated(row: Array) -> bool:
    """Whether an effect in a row (width,) makes some measurements worse than others."""
    return acts(WEIGH, row)


@kernel(allocates=False)
def weigh(innovation: float, variance: float, noise_var: float, row: Array) -> tuple[float, float, float]:
    """Weigh a sample from a mixture of good and bad measurements.

    innovation: measured minus predicted position [m]; variance, noise_var: variances [m^2] of the innovation and of the
    noise of a good measurement; row: (width,), row of the driver, with an effect for which ``is_contaminated`` is true.
    Returns probability that the sample is bad, variance [m^2] of the innovation of a bad sample, and log-likelihood of
    the sample.
    """
    probability, wide, density = 0.0, variance, 0.0
    for f in functions_of(WEIGH):
        if is_on(f, row):
            probability, wide, density = call_weigh(f, innovation, variance, noise_var, part_of(row, f + PARAMETERS))
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
    """Make some measurements worse than others.

    noise: (N,), measurement noise [m] of N vehicles; rows: (N, width), rows of the drivers. Returns (N,), measurement
    noise [m] with the bad measurements.
    """
    for effect in EFFECTS.values():
        values = rows[:, ROW.places[effect.name]]
        if effect.contamination is not None and rows[:, ROW.index_of(effect.name, effect.switches[0])].any():
            noise = effect.contamination.sample(noise, values, rng)
    return noise
