"""The filters against the dense joint Gaussian and each other; rings, missing samples and changing leaders."""

from dataclasses import replace

import numpy as np
import pytest

from benchmarks.away.cases import cases, recorded
from sugiyama_ros.driver.parameters import (
    RHO,
    SIGMA_A,
    SIGMA_NU,
    SIGMA_V,
    SIGMA_X,
    UTILITY,
    V_STAR,
    defaults,
    population,
)
from sugiyama_ros.driver.utility import ACTIONS, mean_action
from sugiyama_ros.effects.registry import ROW, switch_on
from sugiyama_ros.errors import InputError
from sugiyama_ros.filters import paper
from sugiyama_ros.filters.causal import (
    ChainJob,
    filter_chain,
    log_likelihood,
    predict_samples,
    predict_states,
)
from sugiyama_ros.filters.chain import Adaptation
from sugiyama_ros.filters.extract import chain_behind
from sugiyama_ros.filters.online import ADAPT, OnlineFilter
from sugiyama_ros.filters.state import LAST_RHO, LAST_SHOCK_STD
from sugiyama_ros.road import Road
from sugiyama_ros.simulation.simulator import Simulator, platoon, simulate
from sugiyama_ros.trajectories.dense import DenseTracks

DT = 1.0 / 3.0


@pytest.fixture(scope="module")
def jam():
    length = np.full(22, 4.33)
    start = platoon(length, 2.0)
    return simulate(Simulator(defaults(22), length, start, Road(230.0), np.random.default_rng(0)), 100.0)


@pytest.fixture(scope="module")
def with_holes(jam):
    position = jam.dense.position_m.copy()
    position[np.random.default_rng(5).random(position.shape) < 0.1] = np.nan
    m = jam.dense
    return DenseTracks(position, m.length_m, m.vehicle, m.road, m.period_s)


def dense_posterior(z, phi, controls, q, start_mean, start_cov, noise_var):
    """Filtered means (T, 3), innovations and their variances by conditioning one joint Gaussian on all of z[:t]."""
    samples, n = len(z), len(start_mean)
    mean, cov = [start_mean], np.zeros((samples * n, samples * n))
    cov[:n, :n] = start_cov
    for t in range(1, samples):
        mean.append(phi @ mean[-1] + controls[t])
        a, b = slice(n * (t - 1), n * t), slice(n * t, n * (t + 1))
        cov[b, : n * t] = phi @ cov[a, : n * t]
        cov[: n * t, b] = cov[b, : n * t].T
        cov[b, b] = phi @ cov[a, a] @ phi.T + q
    mean = np.concatenate(mean)
    seen = np.arange(samples) * n
    filtered, innovation, variance = [], [], []
    for t in range(samples):

        def condition(on, t=t):
            if len(on) == 0:
                return mean[n * t : n * t + n], cov[n * t : n * t + n, n * t : n * t + n]
            s = cov[np.ix_(on, on)] + noise_var * np.eye(len(on))
            c = cov[n * t : n * t + n][:, on]
            gain = np.linalg.solve(s, c.T).T
            return mean[n * t : n * t + n] + gain @ (z[: len(on)] - mean[on]), cov[
                n * t : n * t + n, n * t : n * t + n
            ] - gain @ c.T

        before_mean, before_cov = condition(seen[:t])
        innovation.append(z[t] - before_mean[0])
        variance.append(before_cov[0, 0] + noise_var)
        filtered.append(condition(seen[: t + 1])[0])
    return np.array(filtered), np.array(innovation), np.array(variance)


def test_the_papers_filter_is_the_dense_posterior(jam):
    perceived = paper.perceive(jam.dense, 3)
    kept = 40
    p = population()
    z = perceived.measured_m[:kept]
    action = np.array(
        [
            mean_action(*s, p, ACTIONS, DT, 4)
            for s in zip(perceived.gap_m, perceived.speed, perceived.leader_speed, strict=True)
        ]
    )[:kept]
    controls = np.zeros((kept, 3))
    controls[1:, 2] = action[1:] - p[RHO] * action[:-1]
    start = np.array([z[0], perceived.speed[0], 0.0])
    filtered, innovation, variance = dense_posterior(
        z, paper.phi(p[RHO], DT), controls, paper.omega(p), start, np.eye(3), p[SIGMA_NU] ** 2
    )
    y, s, means = np.empty(kept), np.empty(kept), np.empty((kept, 3))
    value = paper.run(
        paper.Control(action, np.zeros((kept, len(UTILITY)))),
        z,
        perceived.speed[0],
        p,
        DT,
        y,
        s,
        means,
        paper.LikelihoodDerivatives(np.empty(len(p)), np.empty((len(p), len(p)))),
    )
    assert means == pytest.approx(filtered, abs=1e-9)
    assert y == pytest.approx(innovation, abs=1e-9)
    assert s == pytest.approx(variance, abs=1e-9)
    scored = slice(paper.UNSCORED, None)
    assert value == pytest.approx(-0.5 * np.sum(np.log(s[scored]) + y[scored] ** 2 / s[scored]), abs=1e-9)


def test_the_causal_filter_is_the_dense_posterior_where_the_model_is_linear(jam):
    """A chain of one vehicle has no mean action: its state is position, speed and an AR(1) acceleration."""
    chain = chain_behind(jam.dense, 2, vehicles=1)
    z = jam.dense.road.unwrap(chain.position_m)[:40, 0]
    p = defaults()
    filtered = filter_chain(chain, p)
    noise_var = p[SIGMA_NU] ** 2
    start = np.array([z[1], (z[1] - z[0]) / DT, 0.0])
    speed_var = 2 * noise_var / DT**2 + DT**2
    start_cov = np.array(
        [[noise_var, noise_var / DT, 0], [noise_var / DT, speed_var, 0], [0, 0, LAST_SHOCK_STD**2 / (1 - LAST_RHO**2)]]
    )
    q = np.diag([p[SIGMA_X] ** 2, p[SIGMA_V] ** 2, LAST_SHOCK_STD**2])
    phi = paper.phi(LAST_RHO, DT)
    # the dense posterior starts after sample 1, which the start already includes
    expected, innovation, variance = dense_posterior(
        z[2:], phi, np.zeros((38, 3)), q, phi @ start, phi @ start_cov @ phi.T + q, noise_var
    )
    assert filtered.mean[2:40, :3] == pytest.approx(expected, abs=1e-9)
    assert filtered.innovation_m[2:40] == pytest.approx(innovation, abs=1e-9)
    assert filtered.innovation_var[2:40] == pytest.approx(variance, abs=1e-9)


@pytest.mark.parametrize(("driver", "adaptation"), [(0, Adaptation()), (13, ADAPT)])
def test_the_online_filter_is_the_compiled_one(with_holes, driver, adaptation):
    chain = chain_behind(with_holes, driver)
    batch = filter_chain(chain, population(), adaptation)
    online = OnlineFilter(chain.period_s, with_holes.road, population(), adaptation=adaptation, learning=None)
    steps = [online.step(*sample) for sample in zip(chain.position_m, chain.identity, chain.length_m, strict=True)]
    for name in ("innovation_m", "innovation_var"):
        ours, theirs = np.array([getattr(s, name) for s in steps]), getattr(batch, name)
        assert ours == pytest.approx(theirs, abs=1e-9, nan_ok=True)
    assert [s.speed for s in steps] == pytest.approx(batch.mean[:, 1], abs=1e-9)
    wrapped = with_holes.road.wrap(batch.mean[:, 0])
    assert np.abs(with_holes.road.difference(np.array([s.position_m for s in steps]), wrapped)).max() < 1e-9
    # close to contact the mean action changes by several m/s^2 within a millimetre, which magnifies rounding
    for name in ("acceleration", "mean_action"):
        ours, theirs = np.array([getattr(s, name) for s in steps]), getattr(batch, name)
        assert ours == pytest.approx(theirs, abs=1e-8)
        assert np.median(np.abs(ours - theirs)) < 1e-10
    assert [s.scored for s in steps] == batch.scored.tolist()
    total = sum(s.log_likelihood for s in steps if s.scored)
    assert total == pytest.approx(batch.log_likelihood, abs=1e-9)
    assert np.log(online.parameters[V_STAR]) == pytest.approx(
        batch.mean[-1, 12] if adaptation.names else np.log(population()[V_STAR]), abs=1e-9
    )


def test_the_online_filter_starts_anew_after_a_reset(jam):
    chain = chain_behind(jam.dense, 0)
    online = OnlineFilter(chain.period_s, jam.dense.road)
    samples = list(zip(chain.position_m, chain.identity, chain.length_m, strict=True))[:60]
    first = [online.step(*s).innovation_m for s in samples]
    online.reset()
    assert [online.step(*s).innovation_m for s in samples] == pytest.approx(first, abs=0.0, nan_ok=True)


def test_nothing_depends_on_where_the_ring_begins(jam):
    m = jam.dense
    shifted = DenseTracks(m.road.wrap(m.position_m + 100.0), m.length_m, m.vehicle, m.road, m.period_s)
    for driver in (0, 11):
        values = [log_likelihood(chain_behind(t, driver), defaults()) for t in (m, shifted)]
        assert values[0] == pytest.approx(values[1], abs=1e-6)
        paper_values = [paper.log_likelihood(paper.perceive(t, driver), defaults())[0] for t in (m, shifted)]
        assert paper_values[0] == pytest.approx(paper_values[1], abs=1e-6)


def test_nothing_depends_on_the_vehicles_names(jam):
    m = jam.dense
    order = np.random.default_rng(0).permutation(22)
    renamed = DenseTracks(m.position_m[:, order], m.length_m[order], np.arange(22) + 100, m.road, m.period_s)
    new = int(np.flatnonzero(order == 5)[0])
    assert log_likelihood(chain_behind(renamed, new), defaults()) == pytest.approx(
        log_likelihood(chain_behind(m, 5), defaults()), abs=1e-9
    )


def test_innovations_are_white_and_of_unit_variance_on_the_models_own_data(jam):
    """NIS over 22 x 294 samples. The mean over n samples has a std of sqrt(2 / n); five of these are allowed."""
    nis, lag_one = [], []
    for driver in range(22):
        filtered = filter_chain(chain_behind(jam.dense, driver), defaults(), ahead=defaults())
        y = (filtered.innovation_m / np.sqrt(filtered.innovation_var))[filtered.scored]
        nis.append(y**2)
        lag_one.append(np.mean(y[1:] * y[:-1]))
    n = sum(len(x) for x in nis)
    assert np.mean(np.concatenate(nis)) == pytest.approx(1.0, abs=5 * np.sqrt(2 / n))
    assert np.mean(lag_one) == pytest.approx(0.0, abs=5 / np.sqrt(n))


def test_the_causal_likelihood_is_smooth(jam):
    """With a linearisation at a point it is not smooth: a change of 1e-10 in a parameter moves it by units."""
    chain = chain_behind(jam.dense, 7)
    p = defaults()
    value = log_likelihood(chain, p)
    for k in (SIGMA_A, V_STAR):
        q = p.copy()
        q[k] *= 1 + 1e-8
        assert log_likelihood(chain, q) == pytest.approx(value, abs=1e-4)


@pytest.mark.parametrize(("wrong", "off_m"), [(0, -3.0), (1, 3.0)])
def test_a_filter_that_begins_with_an_outlier_finds_the_vehicle(jam, wrong, off_m):
    """It must not take all that follows for outliers, as it once did until the end: after 20 samples
    it knows the speed as well as a filter that takes in everything.
    """
    position = jam.dense.position_m[:60]
    plain = ROW.with_effects(defaults())
    row = switch_on(plain, "outlier_noise", {"share": 0.006, "factor": 4.0})
    for driver in range(position.shape[1]):
        spoiled = position.copy()
        spoiled[wrong, driver] += off_m
        chain = chain_behind(replace(jam.dense, position_m=spoiled), driver)
        filtered, other = filter_chain(chain, row), filter_chain(chain, plain)
        assert filtered.mean[20, 1] == pytest.approx(other.mean[20, 1], abs=filtered.covariance[20, 1, 1] ** 0.5)


def test_the_papers_gradient_is_the_slope(jam):
    perceived = paper.perceive(jam.dense, 9)
    p = population()
    value, gradient = paper.log_likelihood(perceived, p)
    assert np.isfinite(value)
    for k in range(len(p)):
        e = 1e-6 * max(abs(p[k]), 1e-2)
        low, high = p.copy(), p.copy()
        low[k] -= e
        high[k] += e
        slope = (paper.log_likelihood(perceived, high)[0] - paper.log_likelihood(perceived, low)[0]) / (2 * e)
        assert gradient[k] == pytest.approx(slope, rel=1e-4, abs=1e-4)


def test_smoothing_is_the_smoothing_of_section_2_3():
    z = np.array([0.0, 0.0, 4.0, 0.0, 0.0, 0.0, 0.0])
    assert paper.smooth(z, 1)[1:-1] == pytest.approx([1.0, 2.0, 1.0, 0.0, 0.0])
    assert np.isnan(paper.smooth(z, 2)[[0, 1, -2, -1]]).all()
    line = 3.0 * DT * np.arange(10)
    assert paper.smoothed_speed(line, 2, DT)[2:7] == pytest.approx(3.0)


def test_the_papers_formulation_refuses_missing_and_too_few_samples(with_holes):
    with pytest.raises(InputError, match="a sample is missing"):
        paper.perceive(with_holes, 0)
    short = DenseTracks(np.zeros((7, 1)), np.ones(1), np.zeros(1, int), Road(), DT)
    with pytest.raises(InputError, match="too few"):
        paper.perceive(short, 0)


def test_only_the_utilitys_parameters_can_be_adapted():
    with pytest.raises(InputError, match="'sigma_nu' cannot be adapted"):
        Adaptation(("sigma_nu",), (0.1,))
    with pytest.raises(InputError, match="give one each"):
        Adaptation(("v_star",))


def test_chains_of_unequal_length_run_side_by_side_with_the_results_of_each_alone(jam):
    """Chains of any length and start: a driver leaves early, one remembers, and a preference depends on the time."""
    rows = switch_on(ROW.with_effects(population()), "preference_switch", {"v_star_change": -0.3, "time": 40.0})
    jobs = []
    for i, (first, last) in enumerate(((0, 120), (50, 300), (10, 290), (200, 260), (0, 300))):
        whole = chain_behind(jam.dense, i)
        names = ("position_m", "identity", "length_m", "around")
        cut = {name: getattr(whole, name)[first:last].copy() for name in names}
        cut["identity"][150:, 0] = -1 if i == 2 else cut["identity"][150:, 0]
        row = switch_on(rows, "actuation_lag", {"time_constant": 0.3}) if i == 1 else rows
        chain = replace(whole, **cut, start_s=whole.start_s + first * whole.period_s)
        jobs.append(ChainJob(chain, row, np.stack([row, row])))
    for job, (y, variance, density, states) in zip(jobs, predict_states(jobs), strict=True):
        alone = filter_chain(job.chain, job.parameters, ahead=job.ahead)
        assert len(y) == len(job.chain.position_m)
        for ours, theirs in ((y, alone.innovation_m), (variance, alone.innovation_var)):
            assert np.array_equal(ours, theirs, equal_nan=True)
        assert np.array_equal(density, alone.sample_log_likelihood, equal_nan=True)
        there = job.chain.identity[:, 0] >= 0
        assert np.array_equal(states[there], alone.mean[there, :12])


@pytest.mark.parametrize("scene", ["dense", "smoothed 10 Hz"])
def test_single_precision_in_screens_changes_no_drivers_likelihood_by_1e_3_nats(scene):
    """Rounding errors of 6e-8 in utilities, of which the rationality of 200 makes 1e-5 in the weights of actions."""
    case = next(case for case in cases("conditions") if case.name == scene)
    recording = recorded(case, "strong", 41).first.dense()
    jobs = [ChainJob(chain_behind(recording, i), population()) for i in range(5)]
    exact, rough = predict_samples(jobs), predict_samples([job._replace(is_rough=True) for job in jobs])
    off = [np.nansum(a.log_likelihood) - np.nansum(b.log_likelihood) for a, b in zip(exact, rough, strict=True)]
    assert 0.0 < np.abs(off).max() < 1e-3
