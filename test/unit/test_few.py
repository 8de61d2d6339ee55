"""Effects of some drivers only: how they are found, fitted and told; standard errors; what a model is for."""

from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest

from sugiyama_ros.diagnosis import few_screen
from sugiyama_ros.diagnosis import last_part as driving
from sugiyama_ros.diagnosis import search as searching
from sugiyama_ros.diagnosis.addition import feigning
from sugiyama_ros.diagnosis.candidacy import LEAST_GAIN, Candidacy, NullGains
from sugiyama_ros.diagnosis.candidates import candidates
from sugiyama_ros.diagnosis.errors import held_out_errors, searched_errors
from sugiyama_ros.diagnosis.few import Few, cost_of, fit_few, rises, who_shows
from sugiyama_ros.diagnosis.few_screen import chosen, fits_of_few, shown_by_few
from sugiyama_ros.diagnosis.free_runs import FreeRuns
from sugiyama_ros.diagnosis.last_part import LastPart, last_part
from sugiyama_ros.diagnosis.refits import fit_from_nothing
from sugiyama_ros.diagnosis.screen import FULL, QUICK, Screened, with_candidate
from sugiyama_ros.diagnosis.search import LEVEL, Search
from sugiyama_ros.diagnosis.use import Goal, Use, drivers_worse, purpose_of, worse_where
from sugiyama_ros.driver.parameters import KAPPA_V, SIGMA_A, SIGMA_NU, V_STAR, defaults
from sugiyama_ros.effects.registry import ROW, index_of, switch_on
from sugiyama_ros.errors import InputError
from sugiyama_ros.fit.cross_validation import Gain, without_folds
from sugiyama_ros.fit.joint import start_fit
from sugiyama_ros.fit.model_file import own_stds
from sugiyama_ros.fit.population import fit_base
from sugiyama_ros.fit.recording import prepare
from sugiyama_ros.fit.sandwich import shared_stds
from sugiyama_ros.road import Road
from sugiyama_ros.simulation.simulator import Simulator, platoon, simulate

CARS, RING_M = 8, 88.0
SLOW = (1, 5)
PLACE = index_of("slow_patch", "reduction")


@pytest.fixture(scope="module")
def work():
    with ThreadPoolExecutor(2) as pool:
        yield pool


@pytest.fixture(scope="module")
def fitted(work):
    """Eight drivers, of whom two are slower on a patch."""
    rows = ROW.with_effects(defaults(CARS))
    slow = switch_on(rows, "slow_patch", {"reduction": 0.3, "centre": 44.0, "width": 30.0})
    rows = np.where(np.isin(np.arange(CARS), SLOW)[:, None], slow, rows)
    length = np.full(CARS, 4.33)
    run = simulate(Simulator(rows, length, platoon(length, 4.0), Road(RING_M), np.random.default_rng(1)), 80.0)
    assert not run.collisions
    data = prepare(run.measured)
    return data, fit_base(data, (SIGMA_NU, SIGMA_A, V_STAR, KAPPA_V), work)


@pytest.fixture(scope="module")
def patch(fitted):
    return next(c for c in candidates(fitted[0]) if c.name == "slow_patch")


@pytest.fixture(scope="module")
def grown(fitted, patch, work):
    data, base = fitted
    return fit_few(data, base, patch, Few(SLOW, cost_of(len(SLOW), CARS)), 1, work).fit


def test_the_drivers_who_show_an_effect_are_found_where_the_others_lose_by_it(fitted, patch, grown, work):
    data, base = fitted
    everybody = with_candidate(data, base, patch, work)
    assert who_shows(base, everybody) == Few(SLOW, cost_of(len(SLOW), CARS))
    # whose data say nothing of it may have it, too
    assert rises(base, grown)[list(SLOW)].sum() > 0.9 * rises(base, grown).sum()
    assert who_shows(base, grown) is None


def test_who_gains_more_held_out_than_by_the_fit_feigns(fitted, grown, work):
    data, base = fitted
    errors = held_out_errors(data, base, work, searched=False)
    gained = np.where(data.scored, rises(base, grown)[:, None] / data.scored.sum(axis=1, keepdims=True), 0.0)
    samples = replace(errors.samples, log_likelihood=errors.samples.log_likelihood + gained)
    counted = np.isfinite(samples.log_likelihood)
    samples.log_likelihood[3, np.flatnonzero(counted[3])[0]] += 1000.0
    assert feigning((base, errors), (grown, replace(errors, samples=samples))) == [3]
    # where only these search, what was found before stays if it is better
    again = searched_errors(data, base, errors, work, [3])
    assert again.is_searched
    assert again.samples.total >= errors.samples.total
    others = np.arange(CARS) != 3
    np.testing.assert_array_equal(again.samples.log_likelihood[others], errors.samples.log_likelihood[others])


def test_the_screen_shows_who_would_gain(fitted, patch, work):
    data, base = fitted
    possible = [c for c in candidates(data) if c.name in {"slow_patch", "comfort_limits", "preference_drift"}]
    best, *others = shown_by_few(data, base, possible, work, lambda *_: None)
    assert (best.candidate, best.few.drivers) == (patch, SLOW)
    assert best.gain > LEAST_GAIN
    assert {one.candidate.name for one in others} == {"comfort_limits", "preference_drift"}
    fits = fits_of_few(data, base, [best], len(possible), work, lambda *_: None)
    assert [f.few.drivers for f in fits] == [SLOW]
    assert fits[0].p_value < 1e-6


def test_those_who_share_an_effect_share_its_sign(fitted, work, monkeypatch):
    data, base = fitted
    drag = next(c for c in candidates(data) if c.name == "drag")
    would = [(60.0 * sign, sign) for sign in (1.0, -1.0) * (CARS // 2)]
    monkeypatch.setattr(few_screen, "_scaled", lambda *arguments: would)
    best = shown_by_few(data, base, [replace(drag, starts=drag.starts[:1])], work, lambda *_: None)[0]
    assert len(best.few.drivers) == 2
    assert len({driver % 2 for driver in best.few.drivers}) == 1


def test_the_choice_of_drivers_seldom_gains_by_chance():
    # a strength of one's own gains half a chi-squared variable (Wilks)
    rng = np.random.default_rng(3)
    gains = 0.5 * rng.chisquare(1, (1000, 22))
    assert sum(chosen(one)[1] > 2.0 for one in gains) < 10
    gains[:, [3, 8, 15]] += 20.0
    assert all(set(chosen(one)[0].drivers) >= {3, 8, 15} for one in gains)


@pytest.mark.parametrize(("predicts", "hides"), [(False, 0.0), (True, 1000.0)])
def test_only_what_predicts_better_hides_a_few_drivers(fitted, patch, grown, work, monkeypatch, predicts, hides):
    data, base = fitted
    search = Search(data, base, True, 0, work, on_progress=lambda *_: None)
    look = Screened(patch, grown, gain=1000.0, predicted_gain=1000.0)
    supported = Candidacy(look, grown, 1000.0, 0.0, 1.0, p_value=0.0, p_alone=0.0, refined=True)
    added = SimpleNamespace(kind="effect", form=patch.name, fit=grown, heldout=Gain(50.0, 1.0, ()), drivers=())
    asked = []
    monkeypatch.setattr(search, "_look_at_all", lambda: [supported])
    monkeypatch.setattr(search, "_predicts_more", lambda *_: True)
    monkeypatch.setattr(search, "_grow", lambda *_: added if predicts else None)
    monkeypatch.setattr(search, "_shown_by_few", lambda gained: asked.append(gained) or [])
    monkeypatch.setattr(search, "_take", lambda one: one is not None)
    assert search.add_effect() is predicts
    assert asked == [hides]


@pytest.mark.parametrize(
    ("forecast", "gain", "is_grown"), [(30.0, 70.0, True), (30.0, 45.0, False), (20.0, 70.0, False)]
)
def test_a_forecast_for_a_few_drivers_may_be_half_of_what_a_fit_gains(
    fitted, patch, grown, work, monkeypatch, forecast, gain, is_grown
):
    """All drivers gain 100 nats by something else."""
    data, base = fitted
    search, few = Search(data, base, True, 0, work, on_progress=lambda *_: None), Few(SLOW, cost=0.0)
    shown = few_screen.ShownByFew(patch, few, forecast)
    fit = SimpleNamespace(candidate=patch, few=few, fit=grown, gain=gain, p_value=0.0)
    added = SimpleNamespace(after=search.errors, before=search.errors)
    monkeypatch.setattr(searching, "shown_by_few", lambda *_: [shown])
    monkeypatch.setattr(searching, "fits_of_few", lambda data, base, those, *_: [fit for _ in those])
    monkeypatch.setattr(search, "_grow", lambda *_: added)
    assert search._of_few(search._shown_by_few(100.0), 50.0) == ([added] if is_grown else [])


def test_a_search_simulates_nothing_where_nothing_is_in_doubt(fitted, patch, grown, work, monkeypatch):
    data, base = fitted
    search = Search(data, base, True, 0, work, goal=Goal(only=(patch.name,)), on_progress=lambda *_: None)
    monkeypatch.setattr(searching, "closer", lambda data, look, work: look)
    monkeypatch.setattr(search, "_in_full", lambda one: replace(one, refined=True))
    monkeypatch.setattr(searching, "null_gains", lambda *_: pytest.fail("simulated"))
    for gain, is_supported in ((0.5, False), (100.0, True)):
        look = Screened(patch, grown, gain=gain, predicted_gain=0.0)
        monkeypatch.setattr(search._looks, "look", lambda candidate, current, look=look: look)
        (one,) = search._look_at_all()
        assert search.runs == 0
        assert (one.p_value <= LEVEL) is is_supported


@pytest.mark.parametrize(("further_gain", "is_supported"), [(3.0, True), (16.0, False)])
def test_a_quick_search_simulates_more_before_it_names(
    fitted, patch, grown, work, monkeypatch, further_gain, is_supported
):
    # 20 nats against two simulations that gain nothing; four more may gain more
    data, base = fitted
    search = Search(data, base, True, 0, work, goal=Goal(only=(patch.name,)), on_progress=lambda *_: None)
    look = Screened(patch, grown, gain=20.0, predicted_gain=0.0)
    asked = []

    def null_gains(simulations, candidates, effort, work, on_progress):
        asked.append(len(simulations))
        gains = [0.5] * 2 if len(simulations) == 2 else [further_gain] * len(simulations)
        return NullGains({patch.name: gains}, {patch.name: 1.0})

    monkeypatch.setattr(searching, "null_gains", null_gains)
    monkeypatch.setattr(searching, "closer", lambda data, look, work: look)
    monkeypatch.setattr(search._looks, "look", lambda candidate, current: look)
    monkeypatch.setattr(search, "_in_full", lambda one: replace(one, refined=True))
    monkeypatch.setattr(search, "simulations", lambda runs=0: [None] * max(runs, QUICK.runs))
    (one,) = search._look_at_all()
    assert asked == [QUICK.runs, FULL.runs - QUICK.runs]
    assert search.runs == FULL.runs
    assert (one.p_value <= LEVEL) is is_supported


@pytest.mark.parametrize(("every", "asked"), [(1, 0), (3, 1)])
def test_a_large_gain_is_obvious_unless_samples_are_far_apart(fitted, patch, grown, work, monkeypatch, every, asked):
    data, base = fitted
    sparse = replace(data, every=every)
    search = Search(data, base, True, 0, work, goal=Goal(only=(patch.name,)), on_progress=lambda *_: None)
    look, simulated = Screened(patch, grown, gain=119.0, predicted_gain=0.0), []

    def null_gains(simulations, candidates, effort, work, on_progress):
        simulated.append(candidates)
        return NullGains({patch.name: [75.0, 140.0]}, {patch.name: 1.0})

    search.data = sparse
    monkeypatch.setattr(searching, "null_gains", null_gains)
    monkeypatch.setattr(searching, "closer", lambda data, look, work: look)
    search._looks.keep([replace(look, candidate=replace(patch, name="another"))], base)
    monkeypatch.setattr(search._looks, "worth_a_look", lambda *_: [patch])
    monkeypatch.setattr(search._looks, "look", lambda candidate, current: look)
    monkeypatch.setattr(search, "_in_full", lambda one: replace(one, refined=True))
    monkeypatch.setattr(search, "simulations", lambda runs=0: [None] * max(runs, QUICK.runs))
    (one,) = search._look_at_all()
    assert len(simulated) == asked
    assert (one.p_value <= LEVEL) is (every == 1)
    if every > 1:
        assert shown_by_few(sparse, base, [patch], work, lambda *_: None) == []


def test_a_driver_who_gains_nothing_is_left_out(fitted, patch, work):
    data, base = fitted
    found = fit_few(data, base, patch, Few((SLOW[0], 6), cost_of(2, CARS)), 1, work)
    assert 6 not in found.few.drivers


def test_nobody_is_picked_out_where_everybody_gains(fitted, grown):
    base = fitted[1]
    everybody = replace(grown, slopes=(grown.slopes[SLOW[0]],) * CARS)
    assert who_shows(replace(base, slopes=(base.slopes[SLOW[0]],) * CARS), everybody) is None


def test_a_driver_who_was_missed_is_taken_in(fitted, patch, work):
    data, base = fitted
    found = fit_few(data, base, patch, Few(SLOW[1:], cost_of(1, CARS)), 1, work)
    assert found.few.drivers == SLOW
    assert found.p_value < 1e-6


def test_only_these_drivers_get_the_effect(fitted, grown):
    _, base = fitted
    strength = grown.model.rows[:, PLACE]
    assert np.count_nonzero(strength) == len(SLOW)
    assert strength[list(SLOW)] == pytest.approx([0.3, 0.3], abs=0.12)
    assert grown.log_likelihood > base.log_likelihood + 20.0
    assert grown.model.has[:, list(grown.model.shared).index(PLACE)].tolist() == [i in SLOW for i in range(CARS)]


def test_held_out_models_keep_the_others_without_it(fitted, grown, work):
    data, _ = fitted
    for model in without_folds(data, grown, work, searched=False):
        assert np.flatnonzero(model.rows[:, PLACE]).tolist() == list(SLOW)


def test_standard_errors_hold(fitted, grown, work):
    data, _ = fitted
    stds = shared_stds(data, grown, work)
    assert set(stds) == {f"slow_patch.{name}" for name in ("reduction", "centre", "width")}
    information = sum(np.diag(s.information.sum(axis=0))[-3:] for s in grown.slopes)
    # no smaller than what the information says of each parameter alone; the reduction is no logarithm
    assert stds["slow_patch.reduction"] > 1.0 / np.sqrt(information[0])
    assert stds["slow_patch.width"] < 20.0
    assert len(own_stds(grown)) == CARS
    assert shared_stds(data, fitted[1], work) == {}


def test_a_choice_among_drivers_has_a_price():
    assert cost_of(22, 22) == pytest.approx(0.0, abs=1e-9)
    assert cost_of(3, 22) == pytest.approx(2.0 * np.log(1540.0))


def runs(error, gap=5.0, speed=6.0):
    full = np.full((10, 3, 4), 1.0)
    wave = 1.0 + 0.05 * np.sin(np.arange(10))[:, None, None]
    return FreeRuns(
        coupled=error * full * wave,
        single=error * full,
        coupled_speed=full,
        single_speed=full,
        coupled_gap=0.0 * full - error,
        gap=gap * full,
        touches=0.0 * full,
        speed=speed * full,
        start=np.arange(10),
    )


def test_what_makes_the_last_part_worse_is_told():
    base = LastPart(runs(1.0), np.zeros(4), 10.0)
    assert worse_where(base, base, "simulation") == ()
    worse = worse_where(LastPart(runs(2.0), np.zeros(4), 10.0), base, "simulation")
    assert worse[0] == "free runs of 2 s into the first half of the last part end 2.02 m off instead of 1.01 m"
    assert any("in free flow" in one for one in worse)
    assert worse_where(LastPart(runs(2.0), np.zeros(4), 10.0), base, "online") == ()
    lost = LastPart(runs(1.0), np.full(4, -10.0) + np.arange(4), 10.0)
    assert worse_where(lost, base, "online") == ("one step ahead into the last part it loses 34 nats",)


def test_what_is_worse_by_chance_in_one_of_many_comparisons_is_not_told():
    # nothing differs but the noise of the starts; 9 comparisons in each of 200 recordings
    rng, base = np.random.default_rng(8), LastPart(runs(1.0), np.zeros(4), 10.0)
    told, refused = 0, 0
    for _ in range(200):
        noise = np.exp(0.3 * rng.standard_normal((10, 3, 1))) * np.full((10, 3, 4), 1.0)
        then = np.exp(0.3 * rng.standard_normal((10, 3, 1))) * np.full((10, 3, 4), 1.0)
        ours, theirs = (LastPart(replace(base.runs, coupled=one), np.zeros(4), 10.0) for one in (noise, then))
        told += bool(worse_where(ours, theirs, "prediction"))
        refused += bool(worse_where(ours, theirs, "simulation"))
    # at most 5 % of 200 are expected; 20 or more are, with 5 %, less likely than 0.2 %
    assert told < 20 < refused


def test_a_model_for_simulations_is_at_no_horizon_worse():
    # a single car that ends 3 % further off in each run: nothing against the scatter of runs, and still refused
    base = LastPart(runs(1.0), np.zeros(4), 10.0)
    ours = LastPart(replace(base.runs, single=1.03 * base.runs.single), np.zeros(4), 10.0)
    assert worse_where(ours, base, "prediction") == ()
    refused = worse_where(ours, base, "simulation")
    assert len(refused) == 6
    assert (
        refused[0]
        == "free runs of a single car of 2 s into the first half of the last part end 1.03 m off instead of 1 m"
    )
    # better over all starts, but worse in the second half
    factor = np.where(np.arange(10) < 5, 0.9, 1.01)[:, None, None]
    ours = LastPart(replace(base.runs, single=factor * base.runs.single), np.zeros(4), 10.0)
    assert ["second half" in one for one in worse_where(ours, base, "simulation")] == [True, True, True]


def test_a_car_inside_its_leader_is_a_collision():
    base = LastPart(runs(1.0), np.zeros(4), 10.0)
    inside = LastPart(replace(runs(1.0), touches=np.ones((10, 3, 4))), np.zeros(4), 10.0)
    assert (base.collisions, inside.collisions) == (0, 120)
    assert worse_where(inside, base, "simulation")[-1].startswith("120 cars collide")
    assert worse_where(inside, base, "prediction")[-1].startswith("120 cars collide")
    # one car may collide by chance
    touches = np.zeros((10, 3, 4))
    touches[0, 0, 0] = 1.0
    once = LastPart(replace(runs(1.0), touches=touches), np.zeros(4), 10.0)
    assert worse_where(once, base, "prediction") == ()
    assert worse_where(once, base, "simulation") == ("1 car collides in free runs into the last part instead of 0",)


def test_a_model_drives_into_the_part_that_it_was_not_fitted_to(fitted, work):
    data, base = fitted
    found = last_part(data, base, work)
    assert found.runs.start.min() >= 0.6 * len(data.fold)
    assert found.drivers.shape == (CARS,)
    assert worse_where(found, found, "simulation") == ()


@pytest.mark.parametrize(("time_s", "stays"), [(60.0, True), (12.0, False)])
def test_what_happens_in_the_last_part_is_not_learnt_before(fitted, work, monkeypatch, time_s, stays):
    data, base = fitted
    driven = []
    monkeypatch.setattr(driving, "_driven_on", lambda data, model, work: driven.append(model))
    switch = ("v_star_change", "kappa_v_change", "time")
    values = dict(zip(switch, (0.1, 0.1, time_s), strict=True))
    rows = switch_on(base.model.rows, "preference_switch", values)
    shared = tuple(index_of("preference_switch", name) for name in switch)
    last_part(data, start_fit(data, replace(base.model, rows=rows, shared=shared), work), work)
    (model,) = driven
    assert (model.rows[:, shared] == rows[:, shared]).all() == stays
    # the drivers' own parameters follow the first part
    assert (model.rows[:, V_STAR] != rows[:, V_STAR]).any()


def test_for_simulations_models_are_fitted_to_the_first_part_alone(fitted, patch, grown, work, monkeypatch):
    data, base = fitted
    driven = []

    def drive_on(data, model, work):
        driven.append(model)
        return LastPart(runs(1.0), np.zeros(CARS), 10.0)

    monkeypatch.setattr(driving, "_driven_on", drive_on)
    use, one = Use(data, base, "simulation", work), SimpleNamespace(form=patch.name, drivers=())
    assert use.worse([one], grown, base) == ()
    # nothing of the last part can be in the model: it is the model of a recording that ends before
    whole = data.trajectories
    early = prepare(replace(whole, position_m=whole.position_m[: int(0.6 * data.samples)]))
    expected = [fit_from_nothing(replace(early, even=data.even), effects, work) for effects in ([patch], [])]
    for model, fit in zip(driven, expected, strict=True):
        np.testing.assert_array_equal(model.rows, fit.model.rows)
    # models are kept; what cannot be fitted from nothing begins with the fit to the whole recording
    assert use.worse([one], grown, base) == ()
    assert len(driven) == 2
    assert use.worse([SimpleNamespace(form="a force", drivers=())], grown, base) == ()
    assert len(driven) == 4


def test_drivers_who_get_worse_are_listed():
    assert drivers_worse([(0.0, 1.0), (0.0, 1.0)], [(5.0, 1.1), (5.0, 1.3)]) == [1]


def test_an_unknown_purpose_is_refused():
    assert purpose_of("online") == "online"
    with pytest.raises(InputError, match="--for fun: is not known; give prediction, simulation, online"):
        purpose_of("fun")


@pytest.mark.parametrize(("gained", "is_named"), [(25.0, True), (-300.0, True), (1118.0, False)])
def test_a_push_that_seems_to_change_everything_is_not_named(fitted, patch, grown, work, monkeypatch, gained, is_named):
    # what happens once cannot be held out; but no push gains more elsewhere than it gains in all
    data, base = fitted
    search = Search(data, base, True, 0, work, on_progress=lambda *_: None)
    push, errors = replace(patch, name="external_push", mechanism="external_push", elsewhere=6.0), search.errors
    monkeypatch.setattr(searching, "converged", lambda data, fitted, candidate, work: grown)
    monkeypatch.setattr(searching, "held_out_errors", lambda *_, **__: errors)
    monkeypatch.setattr(searching, "searched_errors", lambda *_: errors)
    monkeypatch.setattr(searching, "gain", lambda *_: Gain(gained, 1173.0, (), ()))
    monkeypatch.setattr(searching, "rise", lambda *_: 30.0)
    monkeypatch.setattr(searching, "wrong_signs", lambda *_: ())
    assert (search._grow(push, grown, 1e-4) is not None) is is_named
