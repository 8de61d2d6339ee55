"""Scores of forecasts, scores of candidates, what chance gives, and one false-discovery rate over checks."""

import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.integrate import quad
from scipy.optimize import minimize_scalar
from scipy.stats import kstest, norm
from scipy.stats import t as student

from sugiyama_ros.diagnosis.candidates import Candidate
from sugiyama_ros.diagnosis.chance import chance_of
from sugiyama_ros.diagnosis.check import Check, judged
from sugiyama_ros.diagnosis.forecast import judged_runs
from sugiyama_ros.diagnosis.score import Score, ScoreOfSome, of_some
from sugiyama_ros.fit.recording import FOLDS

_DRIVERS, _BLOCKS = 20, 10


def ends_of(error: np.ndarray, var: float, share: float = 0.0, wide: float = 0.0) -> np.ndarray:
    """Forecasts of starts (S,) of one driver at one horizon."""
    known = np.stack([error, *(np.full_like(error, one) for one in (var, share, wide or var))])
    return known[:, :, None, None]


ERROR = np.random.default_rng(0).standard_normal(40)
FOLD = (np.arange(40) % FOLDS)[:, None]


def most_probable(errors: np.ndarray) -> float:
    """Logarithm of the variance of Student's t distribution (7 degrees of freedom) that makes errors most probable."""
    return float(minimize_scalar(
        lambda log: -student(df=7, scale=math.sqrt(math.exp(log) * 5.0 / 7.0)).logpdf(errors).sum(), (-2.0, 2.0)
    ).x)  # fmt: skip


#: Variance of each forecast, as the errors in the other folds make most probable.
VARIANCE = np.exp([most_probable(ERROR[FOLD[:, 0] != f]) for f in FOLD[:, 0]])


def test_a_forecast_by_few_members_is_students_distribution() -> None:
    found = judged_runs(ends_of(ERROR, 0.3), FOLD)
    scale = np.sqrt(VARIANCE * 5.0 / 7.0)
    expected = student(df=7, scale=scale).logpdf(ERROR) + 0.5 * math.log(2.0 * math.pi)
    np.testing.assert_allclose(found.log_score.ravel(), expected, atol=1e-6)
    np.testing.assert_allclose(found.normal.ravel(), ERROR / math.sqrt(0.3), atol=1e-12)


def test_crps_is_the_integral_of_the_squared_difference_of_the_distributions() -> None:
    found, std = judged_runs(ends_of(ERROR, 0.3), FOLD).crps.ravel(), np.sqrt(VARIANCE)
    for k in range(5):
        expected, _ = quad(lambda x, k=k: (norm.cdf(x, ERROR[k], std[k]) - (x > 0.0)) ** 2, -9.0, 9.0, points=[0.0])
        assert found[k] == pytest.approx(expected, rel=1e-5)


def test_a_spread_that_is_wrong_everywhere_is_left_to_a_check() -> None:
    usual, wider = (judged_runs(ends_of(ERROR, var), FOLD) for var in (0.3, 30.0))
    np.testing.assert_allclose(wider.log_score, usual.log_score, atol=1e-12)
    np.testing.assert_allclose(wider.crps, usual.crps, atol=1e-12)
    np.testing.assert_allclose(10.0 * wider.normal, usual.normal, atol=1e-12)


def test_a_gross_error_of_measurement_costs_little_where_the_model_knows_of_them() -> None:
    error = np.where(np.arange(40) == 7, 25.0, ERROR)
    usual, robust = (judged_runs(ends_of(error, 1.0, *bad), FOLD).log_score for bad in ((), (0.05, 400.0)))
    assert robust[7] > usual[7] + 2.0
    assert robust.sum() > usual.sum()


def _score(rng: np.random.Generator, name: str, strength: float = 0.0, who: int = _DRIVERS, places: int = 1) -> Score:
    """Scores of blocks with information 1 each, of an effect that some drivers have; strength: in stds of a block."""
    candidate = Candidate(name, name, "effect", tuple(range(places)), ({0: 1.0},) * places)
    driver = np.repeat(np.arange(_DRIVERS), _BLOCKS)
    score = rng.standard_normal((len(driver), places)) + strength * (driver < who)[:, None]
    information = np.tile(np.eye(places), (len(driver), 1, 1))
    starts = tuple({0: 1.0 + k} for k in range(places))
    return Score(candidate, starts, score, information, information.sum(axis=0), driver, driver, _DRIVERS)


def test_the_smallest_p_value_is_uniform_by_chance() -> None:
    """Thirty candidates of one to three directions each, some of them alike: no factor for their number is needed."""
    smallest = []
    for seed in range(60):
        rng = np.random.default_rng(seed)
        found = [_score(rng, f"c{k}", places=1 + k % 3) for k in range(30)]
        simulated = [_score(rng, f"c{k}", places=1 + k % 3) for k in range(30)]
        smallest.append(min(chance_of(found, [simulated], seed).p_values.values()))
    assert kstest(smallest, "uniform").pvalue > 0.01


def test_one_candidate_of_many_that_acts_is_found() -> None:
    rng = np.random.default_rng(1)
    found = [_score(rng, f"c{k}", strength=0.5 * (k == 7)) for k in range(30)]
    simulated = [[_score(rng, f"c{k}") for k in range(30)]]
    p = chance_of(found, simulated, 0).p_values
    assert p["c7"] <= 0.002
    assert sorted(p, key=lambda name: p[name])[0] == "c7"
    # half of the square of the sum over its information
    assert found[7].gain == pytest.approx(0.5 * found[7].score.sum() ** 2 / (_DRIVERS * _BLOCKS), rel=1e-5)


def _once(gain: float) -> Score:
    """What was chosen among many places: one block, whose gain is known."""
    candidate, nowhere = Candidate("external_push", "external_push", "effect", (0,), ({0: 1.0},)), np.zeros(1, np.int64)
    return Score(candidate, candidate.starts, np.array([[gain]]), None, np.ones((1, 1)), nowhere, nowhere, 1)


@settings(max_examples=20)
@given(order=st.permutations(range(7)), simulated=st.permutations(range(6)), gain=st.floats(-20.0, 200.0))
def test_chance_does_not_depend_on_the_order_of_the_scores(order: list[int], simulated: list[int], gain: float) -> None:
    rng = np.random.default_rng(2)
    found = [_once(gain), *(_score(rng, f"c{k}", places=1 + k % 2, strength=0.3 * (k == 2)) for k in range(6))]
    there = [_score(rng, f"c{k}", places=1 + k % 2) for k in range(6)]
    first, again = (
        chance_of(found, [there], 0),
        chance_of([found[k] for k in order], [[there[k] for k in simulated]], 0),
    )
    assert again == first
    assert first.p_values["external_push"] < 0.01 if gain > 20.0 else first.p_values["c2"] < 0.05


def test_an_effect_of_few_drivers_does_not_hide_in_its_own_spread() -> None:
    """What three drivers of twenty have makes scores vary, but not by chance."""
    rng = np.random.default_rng(6)
    few, *others = (_score(rng, f"c{k}", strength=1.5 * (k == 0), who=3 if k == 0 else _DRIVERS) for k in range(20))
    (some,) = of_some(few)
    p = chance_of([few, some, *others], [[_score(rng, f"c{k}") for k in range(20)]], 0).p_values
    assert p["c0"] <= 0.002


def test_the_drivers_who_have_an_effect_are_told_from_the_others() -> None:
    rng = np.random.default_rng(4)
    score = _score(rng, "drag", strength=1.5, who=3)
    (some,) = of_some(score)
    assert isinstance(some, ScoreOfSome)
    assert some.probability[:3].min() > 0.9
    assert some.probability[3:].mean() < 0.1
    assert some.gain > score.gain + 5.0
    everybody = _score(rng, "drag", strength=1.5)
    assert all(one.gain < everybody.gain for one in of_some(everybody))


def test_checks_fail_at_one_false_discovery_rate() -> None:
    p_values_ = [0.001, 0.01, 0.04, 0.3, 0.5, 0.7, 0.9, math.nan]
    found = judged([Check(f"c{k}", 1.0, 0.0, "1", p) for k, p in enumerate(p_values_)])
    assert [one.name for one in found if one.failed] == ["c0", "c1"]
    assert len(found) == len(p_values_) - 1


def test_a_small_difference_does_not_fail_however_improbable_it_is() -> None:
    found = judged(
        [Check("wave_speed", 5.1, 5.0, "m/s", 1e-9, margin=0.2), Check("period_s", 9.0, 5.0, "s", 1e-9, 3.0)]
    )
    assert [one.failed for one in found] == [False, True]
