"""Changes of lane: what drivers see and choose, MOBIL, the simulator, the fit, and the manoeuvre filter."""

import doctest

import numpy as np
import pytest

import sugiyama_ros as sg
from benchmarks.lane_changes import manoeuvres_named
from sugiyama_ros.calibration import lane_changes
from sugiyama_ros.driver import lane_change
from sugiyama_ros.driver.lane_change import (
    CHANGE_S,
    KEEP,
    LEFT,
    RIGHT,
    TO_LANE,
    LaneSpan,
    OnLanes,
    ThreeLanes,
    choose,
    lane_features,
    neighbours,
    see_lanes,
)
from sugiyama_ros.driver.parameters import REFERENCE_HORIZON, REFERENCE_PERIOD_S, defaults
from sugiyama_ros.driver.utility import (
    ACTIONS,
    UTILITY_ROW,
    collision_penalty,
    gap_scale,
    preferences,
    risk_behind,
    scratch_for,
    utilities,
)
from sugiyama_ros.errors import InputError
from sugiyama_ros.filters import manoeuvres
from sugiyama_ros.filters.manoeuvres import ManoeuvreFilter
from sugiyama_ros.fit.lane_change import fit_choice
from sugiyama_ros.laws.idm import idm
from sugiyama_ros.simulation import multilane
from sugiyama_ros.simulation.mobil import mobil_features
from sugiyama_ros.simulation.multilane import END_OF_LANE, LANE_WIDTH_M, OnRoad, place_at_random, simulate_multilane
from sugiyama_ros.trajectories.assemble import assemble

LENGTH_M = 4.33
INF = np.inf
CHOICE = np.array([100.0, 0.5, 0.07])
TRUTH = np.array([100.0, 0.5, 0.07])


@pytest.mark.parametrize("module", [lane_change, multilane, lane_changes, manoeuvres])
def test_the_examples_run(module):
    found = doctest.testmod(module)
    assert found.attempted > 0
    assert found.failed == 0


def seen(gap=(INF, INF, INF), leader_speed=(0.0, 0.0, 0.0), rear=(INF, INF, INF), rear_speed=(0.0, 0.0, 0.0), **more):
    """What one driver at 8 m/s sees, with a lane on either side."""
    rows = [np.array([x], dtype=float) for x in (gap, leader_speed, rear, rear_speed, more.get("end", (INF, INF, INF)))]
    return ThreeLanes(np.array([8.0]), np.array([LENGTH_M]), *rows, np.array([more.get("is_open", (True, True, True))]))


def test_neighbours_are_the_nearest_on_each_lane():
    rng = np.random.default_rng(4)
    count = 300
    group, lane = rng.integers(0, 5, count), rng.integers(-2, 3, count)
    on = OnLanes(group, lane, rng.uniform(-500.0, 500.0, count), rng.uniform(0.0, 30.0, count), np.full(count, 4.0))
    for found, sign in zip(neighbours(on), (1.0, -1.0), strict=True):
        for i in range(count):
            for m, way in enumerate(TO_LANE):
                distance = sign * (on.s_m - on.s_m[i])
                there = (group == group[i]) & (lane == lane[i] + way) & (distance > 0.0)
                nearest = int(np.argmin(np.where(there, distance, INF))) if there.any() else -1
                assert found[i, m] == nearest


def test_a_lane_is_there_from_where_it_opens_to_its_end():
    place = np.array([50.0, 150.0, 250.0, 150.0, 50.0])
    on = OnLanes(np.arange(5), np.array([1, 1, 1, 0, 0]), place, np.full(5, 8.0), np.full(5, 4.0))
    lanes = see_lanes(on, {0: LaneSpan(100.0, 200.0), 1: LaneSpan()})
    assert lanes.is_open[:3].tolist() == [[True, False, False], [True, False, True], [True, False, False]]
    # nobody leaves a ramp before it opens
    assert lanes.is_open[3:].tolist() == [[True, True, False], [True, False, False]]
    assert lanes.end_m[3].tolist() == [48.0, INF, INF]
    assert lanes.end_m[1, RIGHT] == 48.0


def test_a_lane_is_worth_its_best_action_and_an_end_is_a_standing_leader():
    driver, scratch = preferences(defaults()), scratch_for(ACTIONS)
    lanes = seen(gap=(6.0, 20.0, INF), leader_speed=(7.0, 9.0, 0.0), end=(INF, INF, 25.0))
    worth = lane_features(lanes, defaults())[0, :, 0]
    for m, (gap, leader_speed) in enumerate(((6.0, 7.0), (20.0, 9.0), (25.0, 0.0))):
        utilities(gap, 8.0, leader_speed, driver, scratch, REFERENCE_PERIOD_S, REFERENCE_HORIZON)
        assert worth[m] == pytest.approx(scratch[UTILITY_ROW].max(), abs=1e-12)


def test_the_follower_counts_with_the_roles_exchanged():
    driver = preferences(defaults())
    _, kappa_v, _, kappa_c, kappa_d, omega_2, _ = driver
    # the follower sees a leader who brakes with 2 m/s^2, and keeps the own speed
    ratios = []
    for tau in range(1, REFERENCE_HORIZON + 1):
        t, way = tau * REFERENCE_PERIOD_S, REFERENCE_PERIOD_S**2 * tau * (tau - 1) / 2.0
        gap = 7.0 + t * (8.0 - 10.0) - 2.0 * way
        ratios.append(gap / gap_scale(10.0, 8.0 - 2.0 * t, kappa_c, kappa_v, kappa_d))
    risk = risk_behind(7.0, 8.0, 10.0, -2.0, REFERENCE_PERIOD_S, REFERENCE_HORIZON, driver)
    assert risk == pytest.approx(collision_penalty(min(ratios)), abs=1e-12)
    followed = lane_features(seen(rear=(7.0, 7.0, INF), rear_speed=(10.0, 10.0, 0.0)), defaults())[0]
    assert followed[KEEP].tolist() == [followed[KEEP, 0], 0.0, 0.0]
    assert omega_2 <= followed[LEFT, 1] < 0.0
    assert followed[:, 2].tolist() == [0.0, -1.0, -1.0]


def test_drivers_change_to_the_better_lane_unless_it_costs_too_much():
    slow = {"gap": (4.0, INF, INF), "leader_speed": (4.0, 0.0, 0.0)}
    keep, left, right = choose(seen(**slow), defaults(), CHOICE)[0]
    assert left == pytest.approx(right, abs=1e-12)
    assert keep < 0.01
    # polite drivers leave the lane with a fast follower alone; nobody goes where somebody drives abreast
    behind = {**slow, "rear": (INF, 4.0, INF), "rear_speed": (0.0, 12.0, 0.0)}
    assert choose(seen(**behind), defaults(), CHOICE)[0, LEFT] < 0.01
    assert choose(seen(**behind), defaults(), np.array([100.0, 0.0, 0.07]))[0, LEFT] == pytest.approx(left, abs=1e-6)
    abreast = choose(seen(**{**slow, "gap": (4.0, -1.0, INF)}), defaults(), CHOICE)[0]
    assert abreast[LEFT] == 0.0
    assert choose(seen(**slow, is_open=(True, False, True)), defaults(), CHOICE)[0, LEFT] == 0.0
    # nothing to gain: a change costs; without rationality all that is possible is alike
    assert choose(seen(), defaults(), CHOICE)[0, KEEP] == pytest.approx(1.0 / (1.0 + 2.0 * np.exp(-7.0)), abs=1e-12)
    assert choose(seen(), defaults(), np.zeros(3))[0] == pytest.approx([1 / 3] * 3, abs=1e-12)


def test_a_lane_that_ends_is_left_the_more_surely_the_nearer_its_end():
    far, near, nearest = (choose(seen(end=(end, INF, INF)), defaults(), CHOICE)[0, KEEP] for end in (80.0, 25.0, 15.0))
    assert far > 0.99 > near > nearest
    assert nearest < 0.01


def test_mobil_compares_accelerations_of_the_driver_and_of_the_followers():
    p = np.array([15.0, 1.0, 2.0, 1.0, 1.5])
    lanes = seen((10.0, 30.0, INF), (6.0, 9.0, 0.0), (12.0, 8.0, INF), (8.0, 11.0, 0.0), end=(INF, INF, 40.0))
    own, others, change = mobil_features(lanes, p[None])[0].T
    assert own[[LEFT, RIGHT]] == pytest.approx(
        [idm(30.0, 8.0, 9.0, p) - idm(10.0, 8.0, 6.0, p), idm(40.0, 8.0, 0.0, p) - idm(10.0, 8.0, 6.0, p)], abs=1e-12
    )
    old = idm(12.0 + LENGTH_M + 10.0, 8.0, 6.0, p) - idm(12.0, 8.0, 8.0, p)
    new = idm(8.0, 11.0, 8.0, p) - idm(8.0 + LENGTH_M + 30.0, 11.0, 9.0, p)
    assert others == pytest.approx([0.0, old + new, old], abs=1e-12)
    assert change.tolist() == [0.0, -1.0, -1.0]


def test_a_simulated_run_repeats_and_respects_the_road():
    """On a ramp that opens at 150 m and ends at 350 m, nobody enters it before, and nobody drives beyond."""
    runs = [
        sg.simulate_lane_changes(30, 2, 90.0, spans={0: (150.0, 350.0)}, parameters={"v_star": 12.0}, seed=3)
        for _ in range(2)
    ]
    run, again = runs
    assert np.array_equal(run.tracks.s_m, again.tracks.s_m)
    assert run.changes == again.changes
    assert len(run.changes) > 10
    t = run.tracks
    on_ramp = t.lane.values() == "0"
    assert t.s_m[on_ramp].max() < 350.0
    for change in run.changes:
        own = (t.vehicle.values() == f"v{change.vehicle}") & (np.abs(t.time_s - change.time_s) < 1e-6)
        assert abs(change.to_lane - change.from_lane) == 1
        assert 150.0 <= t.s_m[own][0] < 350.0
        assert t.d_m[own][0] == pytest.approx(LANE_WIDTH_M * change.from_lane, abs=1e-9)
    # the movement is smooth: no faster than twice the mean of a movement
    same = np.diff(t.run) == 0
    assert np.abs(np.diff(t.d_m)[same]).max() < 2.01 * LANE_WIDTH_M / CHANGE_S * REFERENCE_PERIOD_S


def test_contacts_are_reported():
    """A driver far too fast behind a standing one on a single lane, and one who meets the end of it."""
    start = place_at_random(2, 1, 30.0, np.random.default_rng(0), {"sigma_a": 0.0, "sigma_v": 0.0, "sigma_x": 0.0})
    start = start._replace(s_m=np.array([0.0, 6.0]), speed=np.array([20.0, 0.0]))
    run = simulate_multilane(start, {0: LaneSpan()}, 5.0, np.random.default_rng(0))
    assert [(one.vehicle, one.leader) for one in run.collisions] == [(0, 1)]
    alone = OnRoad(*(field[:1] for field in start))
    run = simulate_multilane(alone, {0: LaneSpan(end_m=10.0)}, 5.0, np.random.default_rng(0))
    assert [(one.vehicle, one.leader) for one in run.collisions] == [(0, END_OF_LANE)]
    assert "1 collisions" in run.headline()


def test_the_likelihood_of_choices_has_the_maximum_of_a_closed_form():
    """One feature that is 1 for the second of two alternatives: the logarithm of the odds, with its known error."""
    chosen = np.repeat([0, 1], [75, 25])
    features = np.tile(np.array([[0.0], [1.0]]), (100, 1, 1))
    fit = fit_choice(features, np.ones((100, 2), dtype=bool), chosen)
    assert fit.weights[0] == pytest.approx(np.log(25 / 75), abs=1e-9)
    assert fit.covariance[0, 0] == pytest.approx(1.0 / (100 * 0.25 * 0.75), rel=1e-6)
    assert fit.log_likelihood == pytest.approx(75 * np.log(0.75) + 25 * np.log(0.25), abs=1e-9)


def test_simulated_drivers_are_recovered_and_predicted_better_than_by_mobil():
    """20 recordings; of 20 intervals of 95 %, fewer than 16 hold the truth with a probability of 0.003."""
    found = [sg.lane_changes(sg.simulate_lane_changes(seed=seed)) for seed in range(20)]
    inside = np.array([np.abs(one.estimate - TRUTH) < 1.96 * one.std for one in found])
    assert (inside.sum(axis=0) >= 16).all(), inside.sum(axis=0)
    gain = np.array([one.gain for one in found])
    assert gain.mean() > 4.0 * gain.std(ddof=1) / np.sqrt(len(gain))
    spread = gain.std(ddof=1)
    assert 0.5 * spread < np.mean([one.gain_std for one in found]) < 2.0 * spread
    assert found[0].log_loss < found[0].mobil_log_loss
    assert "a gain of" in found[0].headline()


def test_drivers_of_a_calibration_serve_as_well_as_the_true_ones():
    """In the same recording, so that only the errors of the calibration differ."""
    run = sg.simulate_lane_changes(seed=1)
    true, calibrated = sg.lane_changes(run), sg.lane_changes(run.tracks, sg.calibrate(run.tracks))
    assert (np.abs(calibrated.estimate - true.estimate) < true.std).all()
    assert calibrated.decisions == true.decisions


def test_decisions_at_a_higher_rate_are_taken_once_in_a_reference_period():
    """Rows between those of 3 Hz, put in between, change nothing but the rounding of times."""
    tracks = sg.simulate_lane_changes(30, 3, 60.0, parameters={"sigma_x": 0.0}, seed=2).tracks
    frame = tracks.to_frame()
    half = frame.groupby("vehicle", observed=True)
    between = frame.assign(time_s=frame.time_s + 0.5 * REFERENCE_PERIOD_S, s_m=0.5 * (frame.s_m + half.s_m.shift(-1)))
    both = np.concatenate([frame.to_numpy(), between.dropna(subset=["s_m"]).to_numpy()])
    columns = dict(zip(frame.columns, both.T, strict=True))
    columns = {name: columns[name].astype(float) for name in ("time_s", "s_m", "length_m")} | {
        name: columns[name].tolist() for name in ("vehicle", "lane")
    }
    denser = assemble(columns, tracks.about, checked=False)
    once, twice = sg.lane_changes(tracks), sg.lane_changes(denser)
    assert twice.changes == once.changes
    assert twice.decisions == once.decisions


def test_what_cannot_be_fitted_is_refused_in_one_line():
    run = sg.simulate_lane_changes(4, 2, 5.0, parameters={"change_cost": 10.0})
    with pytest.raises(InputError, match="the decisions do not determine the parameters; record more changes of lane"):
        sg.lane_changes(run)
    with pytest.raises(InputError, match="changes of lane need tracks with lanes on an open road"):
        sg.lane_changes(sg.simulate(vehicles=3, ring_m=40.0, duration_s=10.0).measured)
    with pytest.raises(InputError, match="there is no lane 2; lanes have the numbers 0 to 1"):
        sg.simulate_lane_changes(4, 2, 5.0, spans={2: (0.0, 100.0)})
    for span in ((100.0, 0.0), (float("nan"), 5.0), (0.0, float("nan")), (5.0, 5.0)):
        with pytest.raises(InputError, match=r"spans: lane 0 opens at .* m and ends at .* m; give the end last"):
            sg.simulate_lane_changes(4, 2, 5.0, spans={0: span})
    with pytest.raises(InputError, match="vehicles: 0 is not possible; give 1 to 100000"):
        sg.simulate_lane_changes(0)
    with pytest.raises(InputError, match="parameter 'polite': not known"):
        sg.simulate_lane_changes(4, 2, 5.0, parameters={"polite": 1.0})
    with pytest.raises(InputError, match="politeness: out of bounds; give -10 to 10"):
        sg.simulate_lane_changes(4, 2, 5.0, parameters={"politeness": 11.0})
    with pytest.raises(InputError, match="noise_std = 0 must be positive"):
        ManoeuvreFilter(0.1, 0.0)


def test_the_filter_names_a_manoeuvre_before_half_of_the_movement():
    """With 0.2 m of noise, in 91 % of the changes, and wrongly in 0.6 % of the samples (docs/lane_changes.md)."""
    early, false = manoeuvres_named(sg.simulate_lane_changes(40, 3, 60.0, seed=0), 0.2, seed=0)
    assert early > 0.75
    assert false < 0.02
