"""The calibration of laws by least squares on gaps, against runs whose parameters are known."""

import numpy as np
import pytest

from sugiyama_ros.fit.law import Following, fit_gaps, gap_errors
from sugiyama_ros.laws.idm import idm
from sugiyama_ros.laws.registry import law

LAWS = (law("idm"), law("fvdm"))
IDM = np.array([p.default for p in law("idm").parameters])
DT, HALF_LENGTHS = 1.0 / 3.0, 4.33

BOTH = pytest.mark.parametrize(
    ("law", "function"), [(one, one.function) for one in LAWS], ids=lambda one: getattr(one, "name", "")
)


def follow(function, p, samples=450):
    """Positions and speeds of a car and its leader, without noise. The leader brakes to a stop and starts again."""
    time = DT * np.arange(samples)
    leader_speed = np.maximum(5.0 + 4.0 * np.sin(0.11 * time) + 3.0 * np.sin(0.31 * time), 0.0)
    leader = 20.0 + np.concatenate(([0.0], np.cumsum(DT * leader_speed[:-1])))
    x, v = np.zeros(samples), np.zeros(samples)
    v[0] = 4.0
    for t in range(samples - 1):
        a = function(leader[t] - x[t] - HALF_LENGTHS, v[t], leader_speed[t], p)
        x[t + 1], v[t + 1] = x[t] + DT * v[t], max(v[t] + DT * a, 0.0)
    return x, v, leader, leader_speed


def following(states):
    return Following(np.column_stack(states), HALF_LENGTHS, DT)


def rmse(law, parameters, of, chosen):
    return np.sqrt(np.nanmean(np.square(gap_errors(law, parameters, of, chosen))))


TRUTH = {"idm": np.array([11.0, 0.6, 1.1, 1.9, 2.6]), "fvdm": np.array([0.4, 0.7, 4.6, 5.8, 0.15, 0.8])}
EVERYWHERE = np.ones(450, dtype=bool)


@BOTH
def test_the_true_parameters_make_no_error(law, function):
    true = TRUTH[law.name]
    errors = gap_errors(law, true, following(follow(function, true)), EVERYWHERE)
    assert np.isnan(errors[0])
    assert np.abs(errors[1:]).max() < 1e-9


@BOTH
def test_the_true_parameters_are_found(law, function):
    true = TRUTH[law.name]
    seen = following(follow(function, true))
    found = fit_gaps(law, seen, EVERYWHERE)
    assert rmse(law, found, seen, EVERYWHERE) < 1e-4
    assert found == pytest.approx(true, rel=1e-3)


def test_a_run_starts_anew_from_the_measured_state_after_a_break():
    x, v, leader, leader_speed = follow(idm, TRUTH["idm"])
    chosen = EVERYWHERE.copy()
    chosen[200] = False
    errors = gap_errors(LAWS[0], IDM, following((x, v, leader, leader_speed)), chosen)
    assert np.array_equal(np.flatnonzero(np.isnan(errors)), [0, 200, 201])
    # Euler's rule: the first step shows the measured speed alone, the second step shows the law
    a = idm(leader[201] - x[201] - HALF_LENGTHS, v[201], leader_speed[201], IDM)
    assert errors[202] == pytest.approx(0.0, abs=1e-12)
    assert errors[203] == pytest.approx(x[203] - (x[202] + DT * max(v[201] + DT * a, 0.0)), abs=1e-12)
