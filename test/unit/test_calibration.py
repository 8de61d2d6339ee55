"""Calibration: its maximum, its errors and its bounds."""

import os
import signal
from concurrent.futures import ThreadPoolExecutor

import numpy as np
import pytest
from scipy.optimize import minimize

import sugiyama_ros as sg
from sugiyama_ros.calibration.calibrate import calibrate_drivers, each_driver
from sugiyama_ros.calibration.result import AUTO, Settings
from sugiyama_ros.driver.parameters import KAPPA_V, NAMES, SIGMA_A, SIGMA_NU, V_STAR, defaults, index
from sugiyama_ros.errors import InputError
from sugiyama_ros.filters import paper
from sugiyama_ros.fit.driver import SearchOptions, calibrate, end_of_profile, regularised
from sugiyama_ros.fit.goals import Goal
from sugiyama_ros.fit.model_file import read_model
from sugiyama_ros.fit.smooth_positions import ESTIMATED
from sugiyama_ros.road import Road
from sugiyama_ros.simulation.simulator import Simulator, evenly, platoon, simulate
from sugiyama_ros.trajectories.dense import tracks_of
from sugiyama_ros.workers import workers

PLACES = [SIGMA_NU, SIGMA_A, V_STAR, KAPPA_V]


@pytest.fixture(scope="module")
def jam():
    """22 cars on the ring, from rest with gaps of 2 m, for 250 s. All drivers have the paper's parameters."""
    length, road = np.full(22, 4.33), Road(230.0)
    rng = np.random.default_rng(4)
    return simulate(Simulator(defaults(22), length, platoon(length, 2.0), road, rng), 250.0).dense


@pytest.fixture(scope="module")
def causal_fits(jam):
    with ThreadPoolExecutor(2) as work:
        return each_driver(jam, Settings(), work=work)


@pytest.fixture(scope="module")
def paper_fits(jam):
    return list(calibrate(jam, "paper"))


def test_the_truth_lies_within_the_errors_of_the_causal_fits(causal_fits):
    """The sum of z² over 22 drivers is chi-squared for each parameter. The bounds have p = 1e-4 on either side."""
    std = np.array([[s[name] for name in ESTIMATED] for s in causal_fits.std])
    z = (causal_fits.rows[:, PLACES] - defaults()[PLACES]) / std
    assert np.all(np.sum(z**2, axis=0) < 60.0)  # chi2.isf(1e-4, 22) = 54.9, plus a tenth for the approximation
    assert np.all(np.sum(z**2, axis=0) > 5.2)  # chi2.ppf(1e-4, 22) = 5.2


def test_the_papers_fits_are_maxima(jam, paper_fits):
    for fit in paper_fits:
        score = paper.score(paper.perceive(jam, fit.vehicle), fit.parameters)
        scale = fit.parameters[PLACES]
        gradient = score.gradient[PLACES] * scale
        information = score.information[np.ix_(PLACES, PLACES)] * np.outer(scale, scale)
        assert float(gradient @ np.linalg.solve(information, gradient)) < 1e-3
        assert fit.at_bound == ()


def test_the_papers_information_is_the_mean_curvature(jam, paper_fits):
    """Summed over the drivers, minus the Hessian agrees with the information to 30 % for each parameter."""
    observed, expected = np.zeros(len(NAMES)), np.zeros(len(NAMES))
    for fit in paper_fits:
        perceived = paper.perceive(jam, fit.vehicle)
        score = paper.score(perceived, fit.parameters)
        for k in PLACES:
            e = 1e-4 * fit.parameters[k]
            sides = []
            for step in (e, -e):
                moved = fit.parameters.copy()
                moved[k] += step
                sides.append(paper.log_likelihood(perceived, moved)[1][k])
            observed[k] -= (sides[0] - sides[1]) / (2 * e)
            expected[k] += score.information[k, k]
    assert observed[PLACES] / expected[PLACES] == pytest.approx(1.0, abs=0.3)


def test_regularisation_is_the_papers(jam, paper_fits):
    perceived, p = paper.perceive(jam, 3), defaults()
    plain = paper.score(perceived, p)
    pulled = regularised(plain, p)
    v_star, kappa_v = p[V_STAR], p[KAPPA_V]
    penalty = 50.0 * (v_star - 11.0) ** 2 + 500.0 * (kappa_v - 0.5) ** 2
    assert plain.log_likelihood - pulled.log_likelihood == pytest.approx(penalty)
    assert plain.gradient[V_STAR] - pulled.gradient[V_STAR] == pytest.approx(100.0 * (v_star - 11.0))
    fits = list(calibrate(jam, "paper", options=SearchOptions(is_regularised=True)))
    free = paper_fits
    assert all(a.log_likelihood <= b.log_likelihood + 1e-3 for a, b in zip(fits, free, strict=True))
    assert np.mean([f.parameters[KAPPA_V] for f in fits]) > np.mean([f.parameters[KAPPA_V] for f in free]) + 0.02


def test_a_population_narrows_what_single_drivers_leave_wide(jam, causal_fits, tmp_path):
    population = calibrate_drivers(tracks_of(jam), Settings(is_regularised=True))
    spread = [np.std(c.rows[:, V_STAR]) for c in (population, causal_fits)]
    assert spread[0] < spread[1]
    # all drivers are alike here
    error = [np.mean((c.rows[:, V_STAR] - defaults()[V_STAR]) ** 2) for c in (population, causal_fits)]
    assert error[0] < error[1]
    population.write(tmp_path / "model.yaml")
    assert read_model(tmp_path / "model.yaml").rows == pytest.approx(population.rows)


def test_any_parameters_may_be_estimated(jam):
    fit = next(iter(calibrate(jam, "paper", ("omega_2", "rho"))))
    assert fit.parameters[index("omega_2")] < 0.0
    assert fit.std[index("rho")] > 0.0
    assert fit.parameters[V_STAR] == defaults()[V_STAR]
    with pytest.raises(InputError, match="parameter 'speed': not known"):
        next(iter(calibrate(jam, "paper", ("speed",))))


def test_a_dask_cluster_gives_the_same_also_when_a_worker_dies(jam):
    distributed = pytest.importorskip("distributed")
    with (
        distributed.LocalCluster(n_workers=2, threads_per_worker=1, processes=True, dashboard_address=":0") as cluster,
        workers(22, cluster.scheduler_address) as work,
    ):
        pids = distributed.default_client().run(os.getpid)
        fits = calibrate(jam, "causal", work=work)
        first = next(fits)
        os.kill(min(pids.values()), signal.SIGKILL)
        spread = [first, *fits]
    alone = list(calibrate(jam, "causal"))
    assert [fit.vehicle for fit in spread] == list(range(22))
    assert np.array_equal([fit.parameters for fit in spread], [fit.parameters for fit in alone])


@pytest.mark.parametrize("shape", [lambda x: x / 0.1, lambda x: 3.0 * np.sqrt(x), lambda x: 40.0 * x * x])
def test_an_interval_ends_where_the_profile_has_fallen_by_half_of_1_96_squared(shape):
    end = end_of_profile(shape, 0.1, 5.0)
    assert shape(end) == pytest.approx(1.96, abs=0.06)
    assert end_of_profile(lambda x: min(shape(x), 1.9), 0.1, 5.0) == np.inf


def test_profile_intervals_equal_the_intervals_of_another_search(jam):
    """At the ends of the intervals, scipy maximises the paper's likelihood over the other parameters."""
    fit = next(calibrate(jam, "paper", options=SearchOptions(profiled=True)))
    perceived = paper.perceive(jam, 0)
    assert np.all(fit.interval[PLACES, 0] < fit.parameters[PLACES])
    assert np.all(fit.interval[PLACES, 1] > fit.parameters[PLACES])
    below, above = np.abs(np.log(fit.interval[V_STAR] / fit.parameters[V_STAR]))
    assert above > 1.1 * below
    for k in PLACES:
        others = [j for j in PLACES if j != k]
        for end in fit.interval[k]:
            row = fit.parameters.copy()
            row[k] = end

            def lost(x, row=row, others=others):
                row[others] = np.exp(x)
                value, gradient = paper.log_likelihood(perceived, row)
                return -value, -gradient[others] * row[others]

            found = minimize(lost, np.log(fit.parameters[others]), jac=True, method="L-BFGS-B")
            assert 2.0 * (fit.log_likelihood + found.fun) == pytest.approx(1.96**2, abs=0.3)


def test_the_papers_likelihood_is_searched_from_several_starts():
    """From one start, the search for driver 1 ends 301 nats below another maximum."""
    trajectories = sg.simulate(22, ring_m=230.0, duration_s=250.0, seed=3, spread=0.3).dense
    once = [fit.log_likelihood for fit in calibrate(trajectories, "paper")]
    found = sg.calibrate(tracks_of(trajectories), "paper").to_frame()
    assert (found["log_likelihood"] > np.array(once) - 0.02).all()
    assert found["log_likelihood"][1] > once[1] + 300.0
    assert found["v_star"][1] == pytest.approx(4.76, abs=0.1)
    # what is not estimated does not move
    alone = sg.calibrate(tracks_of(trajectories), "paper", ["sigma_nu", "v_star"])
    assert set(alone.rows[:, KAPPA_V]) == {defaults()[KAPPA_V]}


def test_drivers_of_two_kinds_are_divided_into_two_classes(tmp_path):
    """22 drivers for 30 s. This is too short to determine the desired speed of each driver."""
    kind = np.arange(22) % 2
    rows = defaults(22)
    rows[:, V_STAR], rows[:, SIGMA_A] = np.where(kind, 8.5, 11.5), np.where(kind, 0.44, 0.22)
    length, road = np.full(22, 4.33), Road(400.0)
    short = simulate(Simulator(rows, length, evenly(length, road), road, np.random.default_rng(3)), 30.0).dense
    asked = Settings(classes=2)
    two, again = (calibrate_drivers(tracks_of(short), asked) for _ in range(2))
    assert np.array_equal(two.rows, again.rows)
    assert two.classes.probability.sum(axis=1) == pytest.approx(np.ones(22))
    label = two.classes.probability.argmax(axis=1)
    assert np.array_equal(label == label[0], kind == kind[0])
    assert two.classes.share == pytest.approx([0.5, 0.5], abs=0.01)
    for k in (0, 1):
        row = rows[np.argmax(label == k)]
        for place in (V_STAR, SIGMA_A):
            low, high = two.classes.interval[k, place]
            middle, half = 0.5 * (low + high), 0.5 * (high - low)
            assert abs(row[place] - middle) < 2.0 * half  # four standard errors
    two.write(tmp_path / "types.yaml")
    model = read_model(tmp_path / "types.yaml")
    assert np.array_equal(model.types.rows, two.classes.rows[:, : len(NAMES)])
    assert model.types.share == pytest.approx(two.classes.share)
    # what a driver is expected to be who is not in the file
    median, log_std = model.population.parameters["v_star"]
    assert median == pytest.approx(np.sqrt(8.5 * 11.5), rel=0.05)
    assert log_std == pytest.approx(0.5 * np.log(11.5 / 8.5), abs=0.05)
    alone = np.array([f.parameters[V_STAR] for f in calibrate(short, "paper")])
    off, off_alone = (np.abs(np.log(v / rows[:, V_STAR])).mean() for v in (two.rows[:, V_STAR], alone))
    assert off < 0.5 * off_alone
    with pytest.raises(InputError, match="22 drivers, 30 classes; give --classes 22 at most"):
        calibrate_drivers(tracks_of(short), Settings(classes=30))


@pytest.mark.parametrize("shared", [{"classes": 2}, {"classes": AUTO}, {"goals": (Goal("exit", 60.0, 2.0),)}])
def test_classes_need_a_parameter_of_how_drivers_drive(shared):
    with pytest.raises(
        InputError, match=r"--parameters: sigma_nu, sigma_x: noises belong to a recording.*add a parameter"
    ):
        Settings(estimated=("sigma_nu", "sigma_x"), **shared).check("--{}".format)
    Settings(estimated=("sigma_nu", "kappa_v"), **shared).check("--{}".format)
