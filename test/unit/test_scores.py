"""Scores of forecasts, scores of candidates, what chance gives, and one false-discovery rate over checks."""

import math

import numpy as np
import pytest
from scipy.integrate import quad
from scipy.stats import kstest, norm
from scipy.stats import t as student

from sugiyama_ros.diagnosis.candidates import Candidate
from sugiyama_ros.diagnosis.chance import chance_of
from sugiyama_ros.diagnosis.check import Check, judged
from sugiyama_ros.diagnosis.forecast import scored
from sugiyama_ros.diagnosis.score import Score, ScoreOfSome, of_some
from sugiyama_ros.driver.parameters import defaults
from sugiyama_ros.effects.registry import ROW, switch_on

_DRIVERS, _BLOCKS = 20, 10
ROWS = ROW.with_effects(defaults(1))


def test_the_density_of_an_ensemble_is_students_with_the_noise_of_the_measurement() -> None:
    off = np.array([-1.2, 0.4, 0.1, -0.6, 1.1, 0.3])
    noise_var = 0.04
    log_score, *_ = scored(off[:, None, None], np.array([[noise_var]]), ROWS)
    scale = math.sqrt(off.var(ddof=1) * (1.0 + 1.0 / len(off)) + noise_var)
    expected = student(df=len(off) - 1, loc=off.mean(), scale=scale).logpdf(0.0) + 0.5 * math.log(2.0 * math.pi)
    assert log_score[0, 0] == pytest.approx(expected, abs=1e-12)


def test_crps_is_the_integral_of_the_squared_difference_of_the_distributions() -> None:
    off = np.random.default_rng(0).standard_normal(4000) * 0.7 + 0.3
    _, crps, error, normal = scored(off[:, None, None], np.zeros((1, 1)), ROWS)
    std = off.std(ddof=1)
    expected, _ = quad(lambda x: (norm.cdf(x, off.mean(), std) - (x > 0.0)) ** 2, -8.0, 8.0, points=[0.0])
    assert crps[0, 0] == pytest.approx(expected, rel=1e-3)
    assert error[0, 0] == pytest.approx(off.mean(), abs=1e-12)
    assert normal[0, 0] == pytest.approx(off.mean() / std, rel=1e-3)


def test_a_gross_error_of_measurement_costs_little_where_the_model_knows_of_them() -> None:
    off, noise_var = np.array([3.0, 3.1, 2.9, 3.05, 2.95, 3.0])[:, None, None], np.full((1, 1), 0.01)
    bad = switch_on(ROWS, "outlier_noise", {"share": 0.05, "factor": 20.0})
    usual, robust = (scored(off, noise_var, rows)[0][0, 0] for rows in (ROWS, bad))
    assert robust > usual + 5.0
    near = off - 3.0
    # where nothing is off, the share of bad measurements is all that is lost
    assert scored(near, noise_var, ROWS)[0][0, 0] - scored(near, noise_var, bad)[0][0, 0] < 0.1


def _score(rng: np.random.Generator, name: str, strength: float = 0.0, who: int = _DRIVERS, places: int = 1) -> Score:
    """Scores of blocks with information 1 each, of an effect that some drivers have; strength: in stds of a block."""
    candidate = Candidate(name, name, "effect", tuple(range(places)), ({0: 1.0},) * places)
    driver = np.repeat(np.arange(_DRIVERS), _BLOCKS)
    score = rng.standard_normal((len(driver), places)) + strength * (driver < who)[:, None]
    information = np.tile(np.eye(places), (len(driver), 1, 1))
    starts = tuple({0: 1.0 + k} for k in range(places))
    return Score(candidate, starts, score, information, information.sum(axis=0), driver, _DRIVERS)


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


def test_what_simulations_show_as_well_is_no_evidence() -> None:
    rng = np.random.default_rng(2)
    found = [_score(rng, "shifted", strength=0.5), *(_score(rng, f"c{k}") for k in range(10))]
    simulated = [[_score(rng, "shifted", strength=0.5), *(_score(rng, f"c{k}") for k in range(10))] for _ in range(2)]
    assert chance_of(found, simulated, 0).p_values["shifted"] > 0.05


def test_one_block_that_is_far_off_is_no_evidence() -> None:
    """As after hard braking, where the filter's forecast is wrong for a moment."""
    rng = np.random.default_rng(3)
    found = [_score(rng, f"c{k}") for k in range(10)]
    found[0].score[5] += 15.0
    assert chance_of(found, [[_score(rng, f"c{k}") for k in range(10)]], 0).p_values["c0"] > 0.05


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
    found = judged([Check(f"c{k}", 0.0, 0.0, "1", p) for k, p in enumerate(p_values_)])
    assert [one.name for one in found if one.failed] == ["c0", "c1"]
    assert len(found) == len(p_values_) - 1
