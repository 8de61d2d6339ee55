"""Every effect: well declared, neutral at zero strength, with the same physics in simulator and both filters."""

from functools import cache

import numpy as np
import pytest
from scipy.stats import norm

from sugiyama_ros.driver.parameters import (
    COUNT,
    KAPPA_V,
    RATIONALITY,
    REFERENCE_HORIZON,
    REFERENCE_PERIOD_S,
    SIGMA_NU,
    V_STAR,
    defaults,
    read_parameters,
)
from sugiyama_ros.driver.utility import ACTIONS, UTILITY_ROW, boltzmann_mean, preferences, scratch_for, utilities
from sugiyama_ros.effects import perception_threshold
from sugiyama_ros.effects.control import add_components
from sugiyama_ros.effects.effect import STAGES, UTILITY, Extent, Seen, takes_preferences
from sugiyama_ros.effects.registry import EFFECTS, ROW, active, effect, index_of, read_effects, switch_on
from sugiyama_ros.effects.shared import bump
from sugiyama_ros.errors import InputError
from sugiyama_ros.filters.causal import filter_chain
from sugiyama_ros.filters.extract import chain_behind
from sugiyama_ros.filters.online import ADAPT, NOBODY, OnlineFilter
from sugiyama_ros.road import Road
from sugiyama_ros.simulation.simulator import Simulator, evenly, simulate

#: Values at which each effect acts on the recording below.
ACTING = {
    "reaction_delay": {"delay": 0.1},
    "reaction_delay_others": {"delay": 0.5},
    "reaction_delay_all": {"delay": 0.5},
    "second_leader": {"weight": 0.6},
    "second_leader_utility": {"weight": 0.6, "share": 0.5},
    "gap_offset": {"offset": 0.5},
    "clock_offset": {"offset": 0.2},
    "perception_threshold": {"threshold": 1.0},
    "slow_patch": {"reduction": 0.2, "centre": 50.0, "width": 60.0},
    "preference_switch": {"v_star_change": -0.2, "kappa_v_change": 0.2, "time": 20.0},
    "preference_drift": {"std": 0.1, "time_constant": 20.0},
    "preference_drift_walk": {"std": 0.2, "time_constant": 3000.0},
    "preference_drift_trend": {"v_star_rate": -0.01, "kappa_v_rate": 0.01, "time": 20.0},
    "harshness": {"weight": 0.3},
    "roughness": {"weight": 0.3},
    "averaged_reward": {"share": 0.8},
    "look_ahead": {"extra": 0.7},
    "keeping_up": {"weight": 0.1, "range": 50.0},
    "anticipated_leader": {"weight": 1.0},
    "rear_pressure": {"strength": 2.0, "distance": 4.0},
    "rear_pressure_utility": {"weight": 0.2},
    "comfort_limits": {"limit": 1.0},
    "limited_power": {"power": 5.0},
    "limited_braking": {"limit": 0.5},
    "actuation_lag": {"time_constant": 0.3},
    "speed_dependent_noise": {"exponent": 0.5},
    "speed_dependent_noise_fading": {"full_speed": 12.0},
    "drag": {"c0": 0.3, "c2": 0.003},
    "drag_to_standstill": {"c0": 0.3, "c2": 0.003},
    "goal_ahead": {"deceleration": 1.0, "place": 60.0, "speed": 1.0},
    "road_grade": {"grade": 0.03, "centre": 50.0, "width": 60.0},
    "external_push": {"strength": -2.0, "time": 20.0, "duration": 1.0, "spared": 0.0},
    "discovered_force": {"covariate": 2.0, "first": 0.0, "last": 10.0, "force_0": 0.5, "force_7": -0.5},
    "outlier_noise": {"share": 0.1, "factor": 4.0},
    "sensor_eccentricity": {"cosine": 1.5, "sine": 1.0},
    "sensor_distortion": {"cosine_2": 1.0, "sine_2": 0.5, "cosine_3": -0.5, "sine_3": 0.3},
    "uneven_noise": {"cosine": 0.4, "sine": -0.3},
    "accepted_gap": {"longer": -1.0},
    "ignored_yield": {"share": 0.9},
    "blind_sector": {"sight": 5.0},
    "late_start": {"delay": 1.0},
    "curve_speed": {"lateral": 1.5},
}
#: Effects that draw random numbers of their own, or act on measurements alone.
CHANCE = ("preference_drift", "preference_drift_walk", "outlier_noise")
#: Effects by which drivers see another gap than the measured one.
SEEN = ("gap_offset", "clock_offset")
NAMES_OF_EFFECTS = list(EFFECTS)
#: Effects that need lines or curves, which no ring of this file has; `test_junctions` tests them.
AT_JUNCTIONS = ("accepted_gap", "ignored_yield", "blind_sector", "late_start", "curve_speed")
ON_A_RING = [name for name in NAMES_OF_EFFECTS if name not in AT_JUNCTIONS]
DRIVERS, RING_M = 8, 110.0


def recording(rows, seed=0, duration_s=30.0):
    rng = np.random.default_rng(seed)
    length, road = np.full(DRIVERS, 4.33), Road(RING_M)
    start = evenly(length, road) + rng.uniform(-1.0, 1.0, DRIVERS)
    simulator = Simulator(rows, length, start, road, rng, speed=rng.uniform(3.0, 6.0, DRIVERS))
    return simulate(simulator, duration_s, stop_at_collision=False)


@cache
def base_recording():
    return recording(drivers())


@cache
def acting_recording(name):
    return recording(switch_on(ROW.with_effects(drivers()), name, ACTING[name]))


def drivers():
    p = defaults(DRIVERS)
    p[:, KAPPA_V] = 0.4
    return p


def online_steps(t, driver, row, ahead=None, adaptation=ADAPT):
    chain = chain_behind(t, driver)
    online = OnlineFilter(t.period_s, t.road, row, ahead, adaptation, None)
    behind = int(np.flatnonzero(t.leader[0] == driver)[0])
    return online, [
        online.step(
            chain.position_m[k],
            chain.identity[k],
            chain.length_m[k],
            chain.start_s + k * t.period_s,
            (t.position_m[k, behind], behind, t.length_m[behind]),
        )
        for k in range(len(chain.position_m))
    ]


def test_every_effect_of_the_catalogue_is_tested():
    assert set(ACTING) == set(NAMES_OF_EFFECTS)
    assert len(ROW.entries) == len(ROW.declared) == ROW.width
    assert len(set(ROW.entries)) == ROW.width


@pytest.mark.parametrize("name", NAMES_OF_EFFECTS)
def test_an_effect_is_declared(name):
    e = effect(name)
    assert e.stage in STAGES
    assert e.title
    assert e.summary
    assert e.source
    for p in e.parameters:
        assert p.default == 0.0
        assert p.lower < p.upper
        assert p.unit
        assert p.description
    assert set(e.switches) <= {p.name for p in e.parameters}
    for start in e.starts(Extent(0.0, 100.0, 230.0, 0.0, 230.0, has_lines=True, has_curves=True)):
        assert set(start) == {p.name for p in e.parameters}
        switch_on(np.zeros(ROW.width), name, start)


@pytest.mark.parametrize("name", ON_A_RING)
def test_at_zero_strength_the_model_is_the_base_model(name):
    """The models agree bit for bit, whatever the other parameters of the effect are."""
    weak = ROW.with_effects(drivers())
    for parameter, value in ACTING[name].items():
        if parameter not in effect(name).switches:
            weak[:, index_of(name, parameter)] = value
    if name == "discovered_force":
        weak[:, index_of(name, "covariate")] = 0.0
    base, same = base_recording(), recording(weak)
    assert np.array_equal(base.position_m, same.position_m)
    assert np.array_equal(base.dense.position_m, same.dense.position_m)
    chain = chain_behind(base.dense, 3)
    plain, with_zero = filter_chain(chain, drivers()[3]), filter_chain(chain, weak[3], ahead=weak[4])
    plain = filter_chain(chain, drivers()[3], ahead=drivers()[4])
    assert np.array_equal(plain.innovation_m, with_zero.innovation_m, equal_nan=True)
    assert np.array_equal(plain.mean, with_zero.mean)
    _, first = online_steps(base.dense, 3, drivers()[3])
    _, second = online_steps(base.dense, 3, weak[3])
    assert [s.speed for s in first] == [s.speed for s in second]


@pytest.mark.parametrize("name", ON_A_RING)
def test_an_effect_acts_and_leaves_the_noise_alone(name):
    base, changed = base_recording(), acting_recording(name)
    if name in SEEN:
        assert not np.array_equal(base.position_m, changed.position_m)
    else:
        assert not np.array_equal(base.dense.position_m, changed.dense.position_m)
    noise = [r.dense.road.difference(r.dense.position_m, r.position_m) for r in (base, changed)]
    if effect(name).stage != "measurement" or name in SEEN:
        assert noise[0] == pytest.approx(noise[1], abs=1e-9)


# The online filter keeps no past in its state: it carries what drivers see back at its present rates.
@pytest.mark.parametrize("name", [n for n in ON_A_RING if not effect(n).looks_back])
def test_the_online_filter_is_the_batch_filter(name):
    row = switch_on(ROW.with_effects(drivers()[0]), name, ACTING[name])
    t = acting_recording(name).dense
    online, steps = online_steps(t, 2, row)
    ahead = online.kalman.model.rows[1]
    chain = chain_behind(t, 2)
    batch = filter_chain(chain, row, ADAPT, ahead)
    for field in ("innovation_m", "innovation_var"):
        ours = np.array([getattr(s, field) for s in steps])
        assert ours == pytest.approx(getattr(batch, field), abs=1e-9, nan_ok=True)
    total = sum(s.log_likelihood for s in steps if s.scored)
    assert total == pytest.approx(batch.log_likelihood, abs=1e-8)
    assert online.parameters[V_STAR] > 0.0


@pytest.mark.parametrize(
    "name",
    [
        n
        for n in ON_A_RING
        if effect(n).stage != "measurement" and n not in (*CHANCE, "perception_threshold", "limited_braking")
    ],
)
def test_without_noise_the_filter_follows_the_simulator(name):
    """With hardly any noise, the batch filter predicts better with the effect than without it.

    The filter cannot take back a wrong guess at a perception threshold, and no driver brakes hard in this traffic, so
    both effects are left out.
    """
    quiet = drivers()
    quiet[:, [SIGMA_NU, 1, 10, 11]] = 1e-4
    rows = switch_on(ROW.with_effects(quiet), name, ACTING[name])
    t = recording(rows, duration_s=60.0).dense
    with_effect, without = (
        [filter_chain(chain_behind(t, i), r, ahead=r).innovation_m[20:] for i in range(0, DRIVERS, 2)]
        for r in (rows[0], ROW.with_effects(quiet)[0])
    )
    ours, theirs = (float(np.sqrt(np.nanmean(np.square(e)))) for e in (with_effect, without))
    if effect(name).is_noise:
        assert ours == pytest.approx(theirs, rel=0.5)
    else:
        assert ours < theirs


@pytest.mark.parametrize("threshold", [0.02, 0.5, 4.0])
@pytest.mark.parametrize(("wanted", "std"), [(0.0, 0.4), (0.6, 0.3), (-1.5, 1.0), (0.501, 1e-4)])
def test_a_threshold_and_an_uncertain_change_match_numerical_sums(wanted, std, threshold):
    """Mean, regression and remaining variance agree with sums over 200,000 equal parts of a normal distribution."""
    p = np.array([threshold])
    want = norm.ppf((np.arange(200_000) + 0.5) / 200_000, wanted, std)
    done = np.where(np.abs(want) < threshold, 0.0, want)
    mean, slope, left = perception_threshold.expected_change(wanted, std * std, 1.0, p)
    assert mean == pytest.approx(done.mean(), abs=1e-4 * std)
    assert slope == pytest.approx(np.cov(want, done)[0, 1] / std**2, abs=1e-3)
    assert left == pytest.approx(np.var(done - slope * want), abs=1e-3 * std**2 + 1e-12)
    assert perception_threshold.change(wanted, 1.0, p) == pytest.approx(
        perception_threshold.expected_change(wanted, 1e-24, 1.0, p)[0], abs=1e-12
    )


@pytest.mark.parametrize("name", [name for name, e in EFFECTS.items() if e.stage == UTILITY])
@pytest.mark.parametrize("horizon", [REFERENCE_HORIZON, REFERENCE_HORIZON - 1])
@pytest.mark.parametrize("stride", [1, 16])
def test_a_component_adds_the_same_to_each_utility_as_for_one_action(name, horizon, stride):
    """Whether compilers know the horizon or not, and wherever the utilities stand."""
    row = switch_on(ROW.with_effects(drivers()), name, ACTING[name])[0]
    seen = Seen(
        6.0, 5.0, 4.0, 10.0, 3.0, RING_M, 0.5, -0.5, 8.0, 4.5, 3.0, 6.0, 6.0, 5.0, 4.0, np.inf, np.inf, np.inf, 0.0
    )
    e, preferred, before = effect(name), preferences(row), np.linspace(-1.0, 1.0, len(ACTIONS))
    after = np.repeat(before, stride)
    add_components(seen, ACTIONS, 1.0 / 3.0, horizon, row, preferred, np.empty(len(ACTIONS)), after, stride)
    rest = (preferred,) if takes_preferences(e.function) else ()
    p = row[ROW.places[name]]
    alone = np.array([e.function(seen, action, 1.0 / 3.0, horizon, p, *rest) for action in ACTIONS])
    assert np.ptp(alone) > 0.001
    assert after[::stride] == pytest.approx(before + alone, abs=1e-14)
    others = np.arange(len(after)) % stride > 0
    assert np.array_equal(after[others], np.repeat(before, stride)[others])


def mean_action_with(name: str, gap: float, leader_speed: float, horizon: int = 4, **values: float) -> float:
    """Mean action [m/s^2] of the paper's driver at 8 m/s with an effect, at the reference period."""
    row, scratch = defaults(), scratch_for(ACTIONS)
    seen = Seen(*[0.0] * len(Seen._fields))._replace(gap=gap, speed=8.0, leader_speed=leader_speed)
    utilities(gap, 8.0, leader_speed, preferences(row), scratch, REFERENCE_PERIOD_S, horizon)
    if name:
        p = np.array([values[one.name] for one in effect(name).parameters])
        more = (preferences(row),) if takes_preferences(effect(name).function) else ()
        for k, action in enumerate(ACTIONS):
            scratch[UTILITY_ROW, k] += effect(name).function(
                seen, action, REFERENCE_PERIOD_S, REFERENCE_HORIZON, p, *more
            )
    return boltzmann_mean(scratch, float(row[RATIONALITY]))


@pytest.mark.parametrize(("gap", "leader_speed"), [(8.0, 6.0), (3.0, 9.0), (30.0, 4.0)])
@pytest.mark.parametrize("periods", [-2, 1, 5])
def test_a_look_ahead_of_other_length_is_that_of_as_many_periods(gap, leader_speed, periods):
    longer = mean_action_with("look_ahead", gap, leader_speed, extra=periods * REFERENCE_PERIOD_S)
    assert longer == pytest.approx(mean_action_with("", gap, leader_speed, REFERENCE_HORIZON + periods), abs=1e-9)


def test_who_keeps_up_drives_as_fast_as_the_car_ahead_near_it_and_as_they_like_far_from_it():
    strong = {"weight": 50.0, "range": 50.0}
    for leader_speed in (7.0, 9.0):
        # with nothing else that counts, the speeds are equal at the end of the look-ahead
        wanted = (leader_speed - 8.0) / (REFERENCE_HORIZON * REFERENCE_PERIOD_S)
        assert mean_action_with("keeping_up", 40.0, leader_speed, **strong) == pytest.approx(wanted, abs=0.05)
        alone = mean_action_with("", 2000.0, leader_speed)
        assert mean_action_with("keeping_up", 2000.0, leader_speed, **strong) == pytest.approx(alone, abs=1e-9)


def test_any_set_of_effects_combines():
    rows = ROW.with_effects(drivers())
    all_at_once = {name: values for name, values in ACTING.items() if not effect(name).looks_back}
    for name, values in all_at_once.items():
        gentle = {
            k: v * (0.3 if k in effect(name).switches and k not in ("covariate", "limit", "power") else 1.0)
            for k, v in values.items()
        }
        rows = switch_on(rows, name, gentle)
    assert set(active(rows)) == set(all_at_once)
    # in this recording no sample is so far off that the online filter refuses it, which the batch filter never does
    t = recording(rows, seed=1, duration_s=40.0).dense
    assert np.isfinite(t.position_m).all()
    online, steps = online_steps(t, 1, rows[1])
    batch = filter_chain(chain_behind(t, 1), rows[1], ADAPT, online.kalman.model.rows[1])
    assert np.isfinite(batch.mean).all()
    assert [s.innovation_m for s in steps] == pytest.approx(batch.innovation_m, abs=1e-8, nan_ok=True)


def test_an_effect_added_in_mid_run_keeps_what_was_learnt():
    t = acting_recording("drag").dense
    chain = chain_behind(t, 0)
    online = OnlineFilter(t.period_s, t.road, drivers()[0])
    for k in range(60):
        online.step(chain.position_m[k], chain.identity[k], chain.length_m[k], 0.0, NOBODY)
    learnt, state = online.parameters[V_STAR], online.kalman.x.copy()
    online.change(switch_on(ROW.with_effects(defaults()), "drag", ACTING["drag"]))
    assert active(online.parameters) == ("drag",)
    assert online.parameters[V_STAR] == learnt
    assert np.array_equal(online.kalman.x, state)
    estimate = online.step(chain.position_m[60], chain.identity[60], chain.length_m[60], 0.0, NOBODY)
    assert np.isfinite(estimate.innovation_m)


def test_bad_values_are_refused_in_one_line():
    row = np.zeros(ROW.width)
    with pytest.raises(InputError, match=r"effect 'drug': not known; did you mean drag\? choose among reaction_delay"):
        effect("drug")
    with pytest.raises(InputError, match="effect drag: has no parameter 'c3'; it has c0, c2"):
        switch_on(row, "drag", {"c3": 1.0})
    with pytest.raises(InputError, match=r"effect discovered_force: covariate = 1\.5 is no whole number; give 2"):
        switch_on(ROW.with_effects(defaults()), "discovered_force", {"covariate": 1.5})
    with pytest.raises(
        InputError, match="effect reaction_delay: delay = 9 s is out of bounds; give more than 0, and 2 s"
    ):
        switch_on(row, "reaction_delay", {"delay": 9.0})
    assert row[ROW.law] == 0.0
    assert ROW.with_effects(defaults())[:COUNT] == pytest.approx(defaults())
    assert ROW.places["drag"].stop - ROW.places["drag"].start == 2


def test_a_bump_is_the_raised_cosine_that_the_pages_show_and_goes_the_short_way_round_a_ring():
    nowhere = Seen(**dict.fromkeys(Seen._fields, 0.0))
    place = np.linspace(80.0, 120.0, 201)
    found = [bump(nowhere._replace(position=x), 100.0, 30.0) for x in place.tolist()]
    off = place - 100.0
    expected = np.where(abs(off) < 15.0, 0.5 + 0.5 * np.cos(2.0 * np.pi * off / 30.0), 0.0)
    np.testing.assert_allclose(found, expected, atol=1e-15)
    ring = nowhere._replace(position=5.0, circumference=100.0)
    assert bump(ring, 100.0, 30.0) == pytest.approx(bump(nowhere._replace(position=105.0), 100.0, 30.0), abs=1e-15)


@pytest.mark.parametrize(
    ("texts", "told"),
    [
        (["drag:c0=0.1,c0=0.2"], "--effect drag:c0=0.1,c0=0.2: c0 is given twice"),
        (["drag:c0=0.1", "drag:c1=0.2"], "--effect drag:c1=0.2: drag is given twice"),
        (["drag"], r"is not NAME:PARAMETER=VALUE.*; drag has c0 \("),
        (["drag:c9=1"], "'c9' is not known; the parameters are c0"),
        (["drag:c0=nan"], "c0 is nan; give -2 to 5 m/s"),
        (["drag:c0=1e9"], "c0 is 1e9; give -2 to 5 m/s"),
        (["drag:0.3"], "0.3 is not NAME=VALUE"),
    ],
)
def test_texts_of_effects_that_say_nothing_clear_are_refused(texts, told):
    with pytest.raises(InputError, match=told):
        read_effects(texts, "--effect")


def test_0_switches_an_effect_off_also_beyond_its_bounds():
    assert read_effects(["reaction_delay:delay=0", "drag: c0 = 0.3 , c2=0.01"], "") == {
        "reaction_delay": {"delay": 0.0},
        "drag": {"c0": 0.3, "c2": 0.01},
    }


def test_a_parameter_of_the_driver_is_given_once():
    assert read_parameters(["v_star=8", "kappa_v=0.3"], "--set") == {"v_star": 8.0, "kappa_v": 0.3}
    with pytest.raises(InputError, match="--set: v_star is given twice"):
        read_parameters(["v_star=8", "v_star=9"], "--set")
    with pytest.raises(InputError, match=r"--set: v_star is 900; give 0\.5 to 80 m/s"):
        read_parameters(["v_star=900"], "--set")
