"""The verdict on adequacy: each kind of evidence against a model, and whole diagnoses of other laws' drivers."""

from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest

from sugiyama_ros.diagnosis.addition import Addition, least_gain
from sugiyama_ros.diagnosis.adequacy import Evidence, _is_clear, judge, told
from sugiyama_ros.diagnosis.candidates import named
from sugiyama_ros.diagnosis.coarseness import rounding_says, sampling_says
from sugiyama_ros.diagnosis.diagnosis import diagnose
from sugiyama_ros.diagnosis.discover import Discovery
from sugiyama_ros.diagnosis.doubts import wrong_signs
from sugiyama_ros.diagnosis.errors import HeldOutErrors, errors_of, held_out_errors
from sugiyama_ros.diagnosis.free_runs import FreeRuns
from sugiyama_ros.diagnosis.innovations import correlation_says
from sugiyama_ros.diagnosis.law_check import LawCheck, check_laws, closer_laws, laws_say_as_much, open_laws
from sugiyama_ros.diagnosis.rivals import start_of
from sugiyama_ros.diagnosis.verdict import document, sentences
from sugiyama_ros.driver.parameters import defaults
from sugiyama_ros.effects.registry import ROW
from sugiyama_ros.fit.cross_validation import Gain, gain, sum_error, without_folds
from sugiyama_ros.fit.score import PointwiseDensity
from sugiyama_ros.laws.registry import LAWS, number_of
from sugiyama_ros.road import Road
from sugiyama_ros.simulation.simulator import Simulator, evenly, simulate

CARS, RING_M, LENGTH_M = 8, 84.0, 4.33


def recording(law="adaptive_seek", seed=3, duration_s=120.0):
    rng = np.random.default_rng(seed)
    rows, places = ROW.with_effects(defaults(CARS)), ROW.law_places.get(law, range(0))
    rows[:, ROW.law] = number_of(law)
    for k in range(places.start, places.stop):
        rows[:, k] = ROW.declared[k].default
    length, road = np.full(CARS, LENGTH_M), Road(RING_M)
    simulator = Simulator(rows, length, evenly(length, road), road, rng, speed=np.full(CARS, 4.0))
    run = simulate(simulator, duration_s)
    assert not run.collisions
    return run.measured


@pytest.fixture(scope="module")
def own():
    return diagnose(recording(), quick=True, workers=2)


def evidence_of(d, **changes):
    known = Evidence(d.before, d.after, d.named, d.where_after, {}, [], [])
    return replace(known, **changes)


def test_drivers_of_the_model_are_adequate(own):
    assert own.adequacy.outcome == "adequate"
    assert own.adequacy.better_law is None
    assert own.adequacy.explained_share is None
    assert sentences(own)[0] == told(own.adequacy) == "The model is adequate: nothing in these data speaks against it."
    assert document(own)["verdict"]["adequacy"]["reasons"] == []


def test_a_better_law_speaks_against_the_model(own):
    better = own.after.samples.copy()
    better.log_likelihood[:] += 0.05
    worse = own.after.samples.copy()
    worse.log_likelihood[:] -= 0.05
    worse, better = (replace(own.after, samples=samples) for samples in (worse, better))
    found = judge(own.data, evidence_of(own, laws={"worse": worse, "better": better}))
    assert (found.outcome, found.better_law, found.explained_share) == ("not_explained", "better", 0.0)
    assert "better predicts held-out samples better" in told(found)
    assert judge(own.data, evidence_of(own, laws={"worse": worse})).outcome == "adequate"


def test_the_law_that_gains_most_is_named_although_it_scatters_most(own):
    def law(gained, scattered):
        samples = own.after.samples.copy()
        by_driver = gained + scattered * (np.arange(CARS) % 2 - 0.5)
        samples.log_likelihood[:] += by_driver[:, None]
        return replace(own.after, samples=samples)

    firm, loose = law(0.05, 0.0), law(0.06, 0.4)
    found = judge(own.data, evidence_of(own, laws={"firm": firm, "loose": loose}))
    assert found.better_law == "loose"
    assert found.reasons[0].startswith("loose predicts held-out samples better")
    assert "(firm about as well)" in found.reasons[0]
    # a gain that is in doubt, and no other law
    assert judge(own.data, evidence_of(own, laws={"loose": loose})).better_law is None


def test_one_block_that_gains_most_does_not_hide_what_all_others_gain(own):
    def law(everywhere, in_first_block):
        samples = own.after.samples.copy()
        samples.log_likelihood[:] += np.where(own.data.block == 0, in_first_block, everywhere)
        return replace(own.after, samples=samples)

    assert judge(own.data, evidence_of(own, laws={"law": law(0.05, 2.0)})).better_law == "law"
    assert judge(own.data, evidence_of(own, laws={"law": law(0.0, 2.0)})).better_law is None


def test_biases_speak_against_the_model_only_beyond_its_own_simulations(own):
    biased = replace(own.where_after, bins=tuple(replace(b, bias=0.3, flagged=True) for b in own.where_after.bins))
    found = judge(own.data, evidence_of(own, located=biased, simulated=[own.where_after] * 2))
    assert found.outcome == "not_explained"
    assert found.bins_flagged == len(biased.bins) > found.bins_expected
    assert judge(own.data, evidence_of(own, located=biased, simulated=[biased] * 2)).outcome == "adequate"


def test_a_filter_that_is_too_sure_of_itself_speaks_against_the_model(own):
    samples = own.after.samples.copy()
    samples.innovation_var[:] *= 0.5
    surer = replace(own.after, samples=samples)
    found = judge(own.data, evidence_of(own, final=surer, own=[own.after] * 2))
    assert found.outcome == "not_explained"
    assert "surer of itself" in found.reasons[0]
    # with gross errors of measurement, the mean NIS is above 1 in the model's own simulations, too
    assert judge(own.data, evidence_of(own, final=surer, own=[surer] * 2)).outcome == "adequate"


def test_innovations_that_are_correlated_in_time_speak_against_the_model(own):
    def with_innovations(correlation, seed):
        rng, samples = np.random.default_rng(seed), own.after.samples.copy()
        shocks, z = rng.standard_normal(samples.innovation_m.shape), np.zeros(samples.innovation_m.shape)
        for t in range(1, z.shape[1]):
            z[:, t] = correlation * z[:, t - 1] + np.sqrt(1.0 - correlation**2) * shocks[:, t]
        samples.innovation_m[:] = z * np.sqrt(samples.innovation_var)
        return replace(own.after, samples=samples)

    white = [with_innovations(0.0, seed) for seed in range(198)]
    said = correlation_says(with_innovations(0.3, 1), white[:2], own.data)
    assert said[0].startswith("innovations 0.33 s apart are correlated by 0.")
    # the same correlation in its own simulations is the filter's, and without simulations nothing is known
    assert correlation_says(with_innovations(0.3, 1), [with_innovations(0.3, seed) for seed in (2, 3)], own.data) == []
    assert correlation_says(with_innovations(0.3, 1), [], own.data) == []
    # at a level of 1 %, more than 4 of 66 have a probability of 5e-4
    assert sum(bool(correlation_says(white[k], white[k + 1 : k + 3], own.data)) for k in range(0, 198, 3)) <= 4


def test_coarse_positions_speak_against_what_is_named(own):
    def with_steps_of(step_m):
        around = own.data.vicinity
        return replace(own.data, vicinity=replace(around, position_m=step_m * np.round(around.position_m / step_m)))

    variance = float(np.nanmedian(own.after.samples.innovation_var))
    said = rounding_says(with_steps_of(1.0), own.after)
    assert said[0].startswith(f"positions are rounded to 1 m, {100.0 / 12.0 / variance:.0f} % of the variance")
    assert rounding_says(with_steps_of(0.1), own.after) == rounding_says(own.data, own.after) == []
    # nothing is named, so nothing is said
    assert judge(with_steps_of(1.0), evidence_of(own)).outcome == "adequate"


def test_samples_that_are_far_apart_are_a_reason_against_names(own):
    assert sampling_says(own.data) == []
    (said,) = sampling_says(replace(own.data, every=3))
    assert said.startswith("samples are 1 s apart, and drivers decide 3 times")


def test_a_force_that_is_left_speaks_against_the_model(own):
    force = Discovery("gap", 0.7, 1e-6, 40.0, (), ())
    found = judge(own.data, evidence_of(own, forces=[force]))
    assert found.reasons == ("a force that depends on gap is missing, by 0.7 m/s² (40 nats)",)
    earlier = replace(force, covariate="past_speed", ago_s=4.0, alike=("gap",))
    found = judge(own.data, evidence_of(own, forces=[earlier]))
    assert found.reasons[0].startswith("a force that depends on past_speed (4 s ago) or gap is missing")


def added(own, name, parameters, worse=()):
    gained = Gain(40.0, 10.0, (), ())
    return Addition(
        name, "effect", parameters, (), (), 1e-6, gained, own.before, own.after, own.final, name, worse=worse
    )


def test_a_force_without_a_name_explains_nothing(own):
    force = added(own, "discovered_force", {"covariate": 6.0})
    found = judge(own.data, evidence_of(own, named=[force]))
    assert found.outcome == "not_explained"
    assert found.reasons == ("a force that depends on leader_acceleration was added, and has no name",)
    assert judge(own.data, evidence_of(own, named=[added(own, "drag", {"c0": 0.3})])).outcome == "explained"


def test_three_names_that_explain_the_data_as_well_are_none(own):
    drag = added(own, "drag", {"c0": 0.3})
    two, three = (replace(drag, indistinguishable=names) for names in (("rationality",), ("rationality", "harshness")))
    assert judge(own.data, evidence_of(own, named=[two])).outcome == "explained"
    found = judge(own.data, evidence_of(own, named=[three]))
    said = "drag, rationality and harshness explain the data as well: the cause may be none of them"
    assert (found.outcome, found.reasons) == ("not_explained", (said,))
    four = replace(drag, indistinguishable=("rationality", "harshness", "road_grade"))
    (reason,) = judge(own.data, evidence_of(own, named=[four])).reasons
    assert reason.startswith("drag, rationality, harshness and road_grade explain")


def test_freed_constants_that_gain_little_explain_nothing(own):
    drag = added(own, "drag", {"c0": 0.3})
    little, much = (
        replace(added(own, "response_constants", {}), kind="constants", heldout=Gain(nats, 10.0, (), ()))
        for nats in (40.0, 60.0)
    )
    found = judge(own.data, evidence_of(own, named=[little]))
    said = (
        "response_constants gains 40 nats, as freed constants do whatever is missing: the cause may be something else"
    )
    assert (found.outcome, found.reasons) == ("not_explained", (said,))
    assert judge(own.data, evidence_of(own, named=[much])).outcome == "explained"
    # what was found first is judged
    assert judge(own.data, evidence_of(own, named=[drag, little])).outcome == "explained"


def test_a_law_that_explains_as_much_without_additions_speaks_against_them():
    """30 drivers in 10 blocks; parts of each driver and block scatter by a little more than they are."""
    rng = np.random.default_rng(3)
    data = SimpleNamespace(block=np.repeat(np.arange(10), 5)[None].repeat(30, 0))

    def predicting(nats, spread=0.0):
        log_likelihood = nats / 1500.0 + spread * rng.standard_normal((30, 50))
        return SimpleNamespace(samples=SimpleNamespace(log_likelihood=log_likelihood))

    base, final = predicting(0.0), predicting(70.0)
    close, far = predicting(65.0, spread=0.3), predicting(20.0, spread=0.1)
    (said,) = laws_say_as_much(data, base, final, {"idm": close, "fvdm": far})
    assert said.startswith("idm explains what was missing about as well: it predicts better than the model without")
    assert laws_say_as_much(data, base, final, {"fvdm": far}) == []
    # a law that is no better than the base model explains nothing
    assert laws_say_as_much(data, close, final, {"idm": close}) == []


def test_what_is_explained_is_what_has_a_name(own):
    def ahead_by(nats):
        samples = own.before.samples.copy()
        samples.log_likelihood[:] += nats / np.isfinite(samples.log_likelihood).sum()
        return replace(own.before, samples=samples)

    drag = replace(added(own, "drag", {"c0": 0.3}), after=ahead_by(60.0))
    force = replace(added(own, "discovered_force", {"covariate": 1.0}), before=ahead_by(60.0), after=ahead_by(80.0))
    found = judge(own.data, evidence_of(own, final=ahead_by(80.0), named=[drag, force]))
    assert found.explained_share == pytest.approx(60.0 / 80.0)
    # a law that leads by 120 nats over the base model is 60 ahead of what has a name
    laws = {"law": ahead_by(120.0)}
    found = judge(own.data, evidence_of(own, final=ahead_by(60.0), named=[drag], laws=laws))
    assert (found.better_law, found.explained_share) == ("law", pytest.approx(0.5))
    # the sign of the drag makes no sense: the law is compared with the base model, and the share is still the same
    wrong = replace(drag, parameters={"c0": -0.3})
    found = judge(own.data, evidence_of(own, final=ahead_by(60.0), named=[wrong], laws=laws))
    assert found.explained_share == pytest.approx(0.5)


def test_a_law_that_nearly_all_drivers_follow_better_is_better_although_one_driver_gains_most():
    scattered = np.r_[800.0, np.full(21, 20.0)]
    blocks = np.r_[800.0, np.full(9, 40.0), 60.0]
    # one driver in one block gains most: the standard error is larger than half of the gain
    won = Gain(1220.0, 800.0, tuple(scattered), tuple(blocks))
    assert _is_clear(replace(won, blocks=tuple(blocks)))
    # 15 of 22 drivers gain: 7 % by chance
    few = tuple(np.r_[800.0, np.full(14, 20.0), np.full(7, -20.0)])
    assert not _is_clear(replace(won, drivers=few, blocks=tuple(np.r_[1500.0, np.full(10, -40.0)])))
    assert not _is_clear(replace(won, drivers=few, blocks=tuple(np.r_[810.0, 1.0, 1.0, np.full(7, -0.1)])))


def test_what_makes_no_physical_sense_is_no_name(own):
    pull = added(own, "drag", {"c0": 0.1, "c2": -0.3})
    assert wrong_signs(pull, lambda: {"drag.c2": 0.1}) == ("c2 is -0.3",)
    # a value below its bound by 1.5 standard errors may be above it
    assert wrong_signs(pull, lambda: {"drag.c2": 0.2}) == ()
    found = judge(own.data, evidence_of(own, senseless=[("drag", ("c2 is -0.3",))]))
    assert found.outcome == "not_explained"
    assert found.reasons == ("drag would predict better, but makes no physical sense: c2 is -0.3",)


def test_additions_that_do_worse_where_they_were_not_fitted_explain_nothing(own):
    lost = added(own, "drag", {"c0": 0.3}, worse=("one step ahead into the last part it loses 34 nats",))
    found = judge(own.data, evidence_of(own, named=[lost]))
    assert (found.outcome, len(found.reasons)) == ("not_explained", 1)
    assert "worse there than the base model" in found.reasons[0]
    # a further addition may cure it
    assert judge(own.data, evidence_of(own, named=[lost, replace(lost, worse=())])).outcome == "explained"


def test_additions_whose_free_runs_get_worse_explain_nothing(own):
    runs = own.before.runs
    worse = replace(own.before, runs=replace(runs, coupled=1.5 * runs.coupled, single=1.5 * runs.single))
    found = judge(own.data, evidence_of(own, named=[replace(added(own, "drag", {"c0": 0.3}), after=worse)]))
    base_m, off_m = own.before.free_run_10s_m, worse.free_run_10s_m
    told_of = f"its free runs get worse: after 10 s they end {off_m:.2g} m off instead of {base_m:.2g} m"
    assert found.outcome == "not_explained"
    assert found.reasons[0].startswith(told_of)
    # a little worse, within what counts as the same
    little = replace(own.before, runs=replace(runs, coupled=1.02 * runs.coupled, single=1.02 * runs.single))
    named = [replace(added(own, "drag", {"c0": 0.3}), after=little)]
    assert judge(own.data, evidence_of(own, named=named)).outcome == "explained"


def test_drivers_of_another_law_are_not_explained():
    d = diagnose(recording("fvdm"), quick=True, workers=2)
    assert d.adequacy.outcome == "not_explained"
    assert d.adequacy.better_law == "fvdm"
    assert "fvdm predicts held-out samples better" in d.headline()


def test_a_held_out_step_that_fails_is_searched_after_all(own):
    """With the information of a parameter far too small, the step to each fold leads nowhere."""
    weak = [
        replace(s, information=s.information * 1e-3, score=s.score + np.where(np.arange(5)[:, None] == 0, 40.0, -10.0))
        for s in own.base.slopes
    ]
    broken = replace(own.base, slopes=tuple(weak))
    with ThreadPoolExecutor(2) as work:
        stepped = errors_of(own.data, without_folds(own.data, broken, work, searched=False), work)
        guarded = held_out_errors(own.data, broken, work, searched=False)
    assert stepped.samples.total < own.base.log_likelihood - 4.0 * 4 * CARS
    assert guarded.samples.total > stepped.samples.total


def test_a_held_out_step_that_fails_for_one_driver_is_searched_after_all(own):
    off = np.where(np.arange(5)[:, None] == 0, 20.0, -5.0)
    first = replace(own.base.slopes[0], information=0.3 * own.base.slopes[0].information)
    broken = replace(own.base, slopes=(replace(first, score=first.score + off), *own.base.slopes[1:]))
    with ThreadPoolExecutor(2) as work:
        stepped = errors_of(own.data, without_folds(own.data, broken, work, searched=False), work)
        guarded = held_out_errors(own.data, broken, work, searched=False)
    # little of all that the drivers may lose, and far too much for one of them
    assert 4.0 * (4 + 1) < own.base.log_likelihood - stepped.samples.total < 4.0 * 4 * CARS
    assert guarded.samples.total > stepped.samples.total + 4.0


def test_a_law_whose_free_runs_end_closer_speaks_against_the_model_unless_simulations_show_the_same(own):
    runs = own.after.runs
    closer = replace(own.after, runs=replace(runs, coupled=runs.coupled / 3.0, single=runs.single / 3.0))
    assert open_laws(own.data, own.after, {"closer": closer}) == ("closer",)
    checks = {"closer": LawCheck((0.0, 0.0), (0.1, -0.1))}
    found = judge(own.data, evidence_of(own, laws={"closer": closer}, checks=checks))
    assert found.reasons[0].startswith("free runs of closer end closer: ")
    checks = {"closer": LawCheck((0.0, 0.0), (1.0, 1.2))}
    assert judge(own.data, evidence_of(own, laws={"closer": closer}, checks=checks)).outcome == "adequate"


def test_laws_whose_free_runs_end_clearly_closer_are_told_whatever_the_reason(own):
    runs = own.after.runs

    def law(factor):
        return replace(own.after, runs=replace(runs, coupled=runs.coupled * factor, single=runs.single * factor))

    found = closer_laws(own.after, {"near": law(0.95), "second": law(0.6), "first": law(0.3), "far": law(2.0)})
    assert list(found) == ["first", "second"]
    assert found["first"] == pytest.approx(0.3 * own.after.free_run_10s_m)
    told_of = "\n".join(sentences(replace(own, closer=found)))
    assert (
        f"free runs of the model are {own.after.free_run_10s_m:.3g} m off, those of first {found['first']:.3g} m"
        in told_of
    )
    assert "free runs of the model" not in "\n".join(sentences(replace(own, closer={})))


def test_a_law_that_predicts_as_well_speaks_against_the_model_where_simulations_know_better(own):
    samples = own.after.samples.copy()
    samples.log_likelihood[:] += 0.05 * np.sign(np.random.default_rng(0).standard_normal((CARS, 1)))
    samples.log_likelihood[:] -= np.nanmean(samples.log_likelihood - own.after.samples.log_likelihood) - 1e-4
    laws = {"even": replace(own.after, samples=samples)}
    assert open_laws(own.data, own.after, laws) == ("even",)
    found = judge(own.data, evidence_of(own, laws=laws, checks={"even": LawCheck((-900.0, -800.0), (0.0, 0.0))}))
    assert (found.outcome, found.better_law) == ("not_explained", "even")
    assert "850 nats behind in recordings that the model simulates" in told(found)
    samples.log_likelihood[:] -= 0.1
    behind = {"even": replace(own.after, samples=samples)}
    found = judge(own.data, evidence_of(own, laws=behind, checks={"even": LawCheck((-9e3, -8e3), (0.0, 0.0))}))
    assert found.reasons[0].startswith("even is ")
    assert "nats behind on held-out samples, but it is 8500 nats behind in recordings" in found.reasons[0]
    samples.log_likelihood[:] += 0.1
    checks = {"even": LawCheck((-5.0, 5.0), (0.0, 0.0))}
    assert judge(own.data, evidence_of(own, laws=laws, checks=checks)).outcome == "adequate"


def test_a_law_that_predicts_better_is_judged_by_simulations_where_samples_are_far_apart(own):
    better = own.after.samples.copy()
    better.log_likelihood[:] += 0.05
    laws, sparse = {"better": replace(own.after, samples=better)}, replace(own.data, every=3)
    assert open_laws(own.data, own.after, laws) == ()
    assert open_laws(sparse, own.after, laws) == ("better",)
    gained = float(np.nansum(better.log_likelihood - own.after.samples.log_likelihood))
    # in recordings that the model simulates, it gains as much; then it is far behind in them
    for gains, law in (((0.9 * gained, gained), None), ((-900.0, -800.0), "better")):
        found = judge(sparse, evidence_of(own, laws=laws, checks={"better": LawCheck(gains, (0.0, 0.0))}))
        assert (found.outcome, found.better_law) == ("not_explained" if law else "adequate", law)
    assert "better predicts held-out samples better (+" in told(found)


def test_a_law_is_far_behind_in_recordings_that_the_model_simulates(own):
    with ThreadPoolExecutor(2) as work:
        errors = held_out_errors(own.data, own.final, work, searched=False)
        found = check_laws({"constant_speed": own.after}, [(own.data, errors)], work)
        some = own.after.among(own.after, range(CARS))
        for array in (some.samples.log_likelihood, some.runs.single.T, some.runs.coupled.T):
            array[::2] = np.nan
        of_some = check_laws({"constant_speed": some}, [(own.data, errors)], work)
    assert max(found["constant_speed"].gains) < -100.0
    # fitted to the same drivers as in the data, half of all
    share = max(of_some["constant_speed"].gains) / max(found["constant_speed"].gains)
    assert 0.3 < share < 0.7


def test_a_law_of_some_drivers_is_compared_on_their_runs_and_samples_alone(own):
    """The law predicts and drives like the model, and some drivers are not predicted by it."""
    who = list(range(0, CARS, 3))
    samples, runs = own.after.samples, own.after.runs
    part = {name: getattr(runs, name)[:, :, who] for name in vars(runs) if name != "start"}
    alone = PointwiseDensity(samples.innovation_m[who], samples.innovation_var[who], samples.log_likelihood[who])
    few = HeldOutErrors(alone, FreeRuns(**part, start=runs.start), own.after.block_position_m[:, who])
    law = few.among(own.after, who)
    assert law.predicted_drivers == who
    assert law.free_run_10s_beside(own.after) == own.after.free_run_10s_beside(law)
    assert law.free_run_10s_m != own.after.free_run_10s_m
    won = gain(own.data, law.samples, own.after.samples)
    assert (won.nats, won.se, len(won.drivers)) == (0.0, 0.0, len(who))
    assert closer_laws(own.after, {"same": law}) == {}
    # of starts of which these drivers have only some, too
    later = replace(few, runs=FreeRuns(**{k: v[2:] for k, v in part.items()}, start=runs.start[2:])).among(
        own.after, who
    )
    np.testing.assert_array_equal(later.runs.single[2:], law.runs.single[2:])
    assert np.isnan(later.runs.single[:2]).all()


def test_freed_constants_have_to_gain_twice_as_much_as_an_effect(own):
    drivers = (1.0, 2.0, 0.0, 3.0, 1.0, 2.0, 0.0, 3.0)
    won, (constants, effect) = Gain(24.0, 9.0, drivers), named(own.data, ["rationality", "drag"])
    least = [least_gain(won, one) for one in (constants, effect)]
    assert least == pytest.approx([2.0 * sum_error(drivers), sum_error(drivers)])
    # blocks of time may tell less than drivers do, and a small gain may be chance
    assert least_gain(replace(won, nats=12.0), effect) == 18.0


def test_one_driver_who_is_predicted_leaves_the_error_to_blocks_of_time(own):
    alone, better = own.after.samples.copy(), own.after.samples.copy()
    alone.log_likelihood[1:] = better.log_likelihood[1:] = np.nan
    better.log_likelihood[0] += 0.1 + 0.1 * own.data.block[0]
    won = gain(own.data, better, alone)
    assert won.drivers == pytest.approx((won.nats,))
    assert 0.0 < won.se == sum_error(won.blocks) < won.nats
    effect = named(own.data, ["drag"])[0]
    assert least_gain(won, effect) == won.se


def test_a_law_starts_at_the_speeds_of_the_data():
    slow, fast = start_of("fvdm", 5.0), start_of("fvdm", 30.0)
    assert np.array_equal(slow, [p.default for p in LAWS["fvdm"].parameters])
    free = [LAWS["fvdm"].function(1e9, 29.0, 29.0, values) > 0.0 for values in (slow, fast)]
    assert free == [False, True]
    assert len(start_of("constant_speed", 30.0)) == 0
