"""The utility, the anticipation and the mean action against the paper's formulas and against finite differences."""

import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from sugiyama_ros.driver.moments import mean_actions
from sugiyama_ros.driver.parameters import (
    COUNT,
    KAPPA_V,
    NAMES,
    PARAMETERS,
    RATIONALITY,
    REFERENCE_PERIOD_S,
    RHO,
    SIGMA_A,
    UTILITY,
    V_STAR,
    at_period,
    check,
    defaults,
    horizon_at,
    index,
    jacobian_at_reference,
    population,
)
from sugiyama_ros.driver.utility import (
    ACTIONS,
    UTILITY_ROW,
    anticipate,
    backward_penalty,
    collision_penalty,
    forward_reward,
    gap_scale,
    mean_action,
    preferences,
    scratch_for,
    utilities,
)
from sugiyama_ros.errors import InputError

DT, H = 1.0 / 3.0, 4
seen = st.tuples(st.floats(0.3, 30.0), st.floats(0.0, 14.0), st.floats(0.0, 14.0))


def literal_utility(a, gap, v, leader_v, p, dt=DT, h=H):
    """The paper's equations, written out; not optimised."""
    q = dict(zip(NAMES, p, strict=True))
    v1 = v + dt * a
    phi1 = (1 - math.exp(-10 * (v1 + 0.25))) - (
        1 - math.exp(-(((v1 - q["v_star"]) / (q["kappa_1"] * q["v_star"])) ** 2))
    )
    x, x_leader, speed, phi2 = 0.0, gap, v, []
    for _ in range(h):
        x, x_leader, speed = x + dt * speed, x_leader + dt * leader_v, speed + dt * a
        sigma = q["kappa_c"] + q["kappa_v"] * abs(speed) + q["kappa_d"] * max(speed - leader_v, 0)
        r = (x_leader - x) / sigma
        phi2.append(1.0 if r <= 0 else math.exp(-r * r - 2 * r))
    return phi1 + q["omega_2"] * max(phi2)


def literal_mean_action(gap, v, leader_v, p):
    u = np.array([literal_utility(a, gap, v, leader_v, p) for a in ACTIONS])
    w = np.exp(p[RATIONALITY] * (u - u.max()))
    return float(w @ ACTIONS / w.sum())


@settings(deadline=None)
@given(seen, st.floats(-6.0, 4.0))
def test_utility_is_the_papers(s, a):
    p = defaults()
    scratch = scratch_for(np.array([a]))
    utilities(*s, preferences(p), scratch, DT, H)
    assert scratch[UTILITY_ROW, 0] == pytest.approx(literal_utility(a, *s, p), rel=1e-12, abs=1e-12)


@settings(deadline=None)
@given(seen)
def test_mean_action_is_the_papers(s):
    p = defaults()
    # a utility of up to 11 is rounded to 1e-15 of its size; where two actions tie, the mean moves by the rationality of
    # 200, times the rounding of both, times a part of the 10 m/s^2 between the actions
    assert mean_action(*s, p, ACTIONS, DT, H) == pytest.approx(literal_mean_action(*s, p), abs=2e-11)


def test_mean_action_tends_to_the_best_action():
    p = defaults()
    p[RATIONALITY] = 1e5
    best = max(ACTIONS, key=lambda a: literal_utility(a, 6.0, 5.0, 5.0, p))
    assert mean_action(6.0, 5.0, 5.0, p, ACTIONS, DT, H) == pytest.approx(best, abs=1e-9)


def test_grid_is_the_papers_and_any_other_works():
    assert (len(ACTIONS), ACTIONS[0], ACTIONS[-1]) == (41, -6.0, 4.0)
    fine = np.linspace(-6.0, 4.0, 401)
    coarse, finer = (mean_action(5.0, 6.0, 5.0, defaults(), grid, DT, H) for grid in (ACTIONS, fine))
    assert coarse == pytest.approx(finer, abs=0.25)  # one step of the paper's grid


def test_penalty_is_one_at_contact_and_falls():
    ratios = np.linspace(-1.0, 6.0, 200)
    values = np.array([collision_penalty(r) for r in ratios])
    assert np.all(values[ratios <= 0] == 1.0)
    assert np.all(np.diff(values[ratios > 0]) < 0)


def test_reward_is_largest_at_the_desired_speed():
    assert forward_reward(10.0, 10.0, 0.7) == pytest.approx(1.0)
    assert backward_penalty(-1.0) > 1000
    assert math.isfinite(backward_penalty(-1e4))


def test_scale_has_the_closing_term_only_when_closing():
    assert gap_scale(5.0, 6.0, 0.4, 0.2, 1.0) == pytest.approx(1.4)
    assert gap_scale(5.0, 3.0, 0.4, 0.2, 1.0) == pytest.approx(3.4)


def test_anticipation_is_eulers_rule():
    gap, speed, x = 7.0, 4.0, 0.0
    for tau in range(1, 7):
        x, speed = x + DT * speed, speed + DT * -2.0
        assert anticipate(-2.0, tau, gap, 4.0, 3.0, DT) == pytest.approx((gap + tau * DT * 3.0 - x, speed), abs=1e-12)


def test_without_a_leader_only_the_desired_speed_counts():
    p = defaults()
    assert mean_action(np.inf, p[V_STAR], 0.0, p, ACTIONS, DT, H) == pytest.approx(0.0, abs=0.1)
    value, partials = at_moments([(np.inf, 5.0, 0.0)], p)
    assert value[0] == pytest.approx(mean_action(np.inf, 5.0, 0.0, p, ACTIONS, DT, H), abs=1e-12)
    assert np.all(np.isfinite(partials))
    assert partials[0, UTILITY.index(KAPPA_V)] == pytest.approx(0.0, abs=1e-100)


def at_moments(seen, p, wanted=UTILITY):
    """Mean actions at several moments, and their derivatives by the wanted parameters."""
    gap, speed, leader_speed = np.array(seen, dtype=float).T.copy()
    mean, partials = np.empty(len(seen)), np.empty((len(seen), len(UTILITY)))
    ahead, by = tuple(range(1, 1 + H)), np.array([k in wanted for k in UTILITY])
    mean_actions(gap, speed, leader_speed, p, ACTIONS, DT, ahead, by, mean, partials)
    return mean, partials


def test_many_moments_are_as_many_single_ones():
    """The moments fill several blocks; the last block is not full."""
    rng = np.random.default_rng(3)
    seen = np.column_stack([rng.uniform(-1, 30, 700), rng.uniform(-1, 14, 700), rng.uniform(-1, 14, 700)])
    p = defaults()
    mean, _ = at_moments(seen, p)
    assert mean == pytest.approx([mean_action(*s, p, ACTIONS, DT, H) for s in seen], abs=1e-12)


def test_each_derivative_is_independent_of_the_other_derivatives_asked_for():
    seen, p = [(2.0, 3.0, 1.0), (10.0, 8.0, 9.0), (0.5, 6.0, 2.0)], defaults()
    mean, partials = at_moments(seen, p)
    for j, k in enumerate(UTILITY):
        alone_mean, alone = at_moments(seen, p, [k])
        assert np.array_equal(alone_mean, mean)
        assert np.array_equal(alone[:, j], partials[:, j])
        assert alone.any()
        assert not np.delete(alone, j, axis=1).any()


@settings(deadline=None, max_examples=200)
@given(seen, st.lists(st.floats(0.8, 1.2), min_size=COUNT, max_size=COUNT))
def test_derivatives_equal_finite_differences(s, factors):
    p = defaults() * np.array(factors)
    # round numbers lie on kinks, where a speed or a closing speed of the look-ahead is exactly 0
    s = (s[0], s[1] + 1.37e-3, s[2] + 3.11e-3)
    (value,), partials = at_moments([s], p)

    def moved(j, step):
        changed = p.copy()
        changed[UTILITY[j]] += step
        return mean_action(*s, changed, ACTIONS, DT, H)

    for j in range(len(UTILITY)):
        e = 1e-5
        one_sided = [(moved(j, e) - value) / e, (value - moved(j, -e)) / e]
        central = (8 * (moved(j, e) - moved(j, -e)) - (moved(j, 2 * e) - moved(j, -2 * e))) / (12 * e)
        # |v|, max(closing, 0) and the period of the smallest ratio have kinks; at a kink the two sides disagree
        if abs(one_sided[0] - one_sided[1]) < 1e-3 * (1 + abs(central)):
            assert partials[0, j] == pytest.approx(central, rel=1e-6, abs=1e-6)


def test_parameters_are_declared_once_and_in_bounds():
    assert len(set(NAMES)) == COUNT
    check(np.stack([defaults(), population()]))
    assert all(p.lower <= p.default <= p.upper and p.unit and p.description for p in PARAMETERS)
    # Eq. SimulatedModelParameters and section 5
    assert dict(zip(NAMES, defaults(), strict=True)) == {
        "sigma_nu": 0.263, "sigma_a": 0.273, "v_star": 10.26, "kappa_v": 0.215, "kappa_1": 0.7, "kappa_c": 0.4,
        "kappa_d": 1.0, "omega_2": -10.0, "rationality": 200.0, "rho": 0.7, "sigma_x": 0.05, "sigma_v": 0.1,
    }  # fmt: skip


def test_errors_name_the_bad_parameter():
    p = defaults()
    p[KAPPA_V] = -1.0
    with pytest.raises(InputError, match="kappa_v: -1 s is out of bounds"):
        check(p)
    with pytest.raises(InputError, match=r"'kapa': not known; the parameters are sigma_nu, "):
        index("kapa")


def test_other_periods_rescale_as_in_the_paper():
    assert np.allclose(at_period(defaults(), REFERENCE_PERIOD_S), defaults(), rtol=0, atol=1e-15)
    assert horizon_at(REFERENCE_PERIOD_S) == 4
    assert horizon_at(0.2) == 6  # section 5.4
    scaled = at_period(defaults(), 0.2)
    assert scaled[RHO] == pytest.approx(0.7 ** (2 / 3), abs=1e-15)  # section 5.4
    stationary = [q[SIGMA_A] ** 2 / (1 - q[RHO] ** 2) for q in (defaults(), scaled)]
    assert stationary[0] == pytest.approx(stationary[1], rel=1e-12)


def test_gradient_is_pulled_back_to_the_reference_period():
    p, period = population(), 0.1
    weights = np.arange(1.0, COUNT + 1)
    gradient = jacobian_at_reference(p, at_period(p, period), period) @ weights
    for k in range(COUNT):
        e = 1e-6 * max(abs(p[k]), 1e-2)
        low, high = p.copy(), p.copy()
        low[k] -= e
        high[k] += e
        slope = weights @ (at_period(high, period) - at_period(low, period)) / (2 * e)
        assert gradient[k] == pytest.approx(slope, rel=1e-6)
