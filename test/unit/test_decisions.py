"""How often drivers decide between the samples of a recording."""

from concurrent.futures import ThreadPoolExecutor

import numpy as np
import pytest

from benchmarks.away.drivers import drawn
from benchmarks.away.world import Setup, record
from sugiyama_ros.calibration.on_tracks import calibrate_tracks
from sugiyama_ros.calibration.result import Settings
from sugiyama_ros.diagnosis.base import with_more_decisions
from sugiyama_ros.driver.parameters import KAPPA_V, V_STAR
from sugiyama_ros.fit.driver import calibrate
from sugiyama_ros.fit.joint import fit_base
from sugiyama_ros.fit.preparation import prepare
from sugiyama_ros.fit.smooth_positions import divided, measured
from sugiyama_ros.trajectories.dense import tracks_of


@pytest.fixture(scope="module")
def work():
    with ThreadPoolExecutor(2) as pool:
        yield pool


def _seen(period_s: float, every: int):
    """A jam of drivers who decide every ``period_s``; a camera keeps one sample of ``every``."""
    scene, rng = (
        Setup(period_s=period_s, every=every),
        np.random.default_rng(7),
    )
    recording = record(scene, drawn(scene.drivers, rng), (), rng)
    assert recording is not None
    return recording


@pytest.mark.parametrize(
    ("period_s", "every", "is_finer"),
    [(0.1, 3, True), (0.3, 1, False), (0.5, 1, False)],
)
def test_drivers_who_decide_between_two_samples_are_found(period_s, every, is_finer, work):
    recording = _seen(period_s, every)
    data = prepare(tracks_of(recording))
    base = fit_base(data, data.even.individual(V_STAR, KAPPA_V), work)
    finer = with_more_decisions(tracks_of(recording), data, base, work)
    assert (finer is not None) == is_finer
    if finer is not None:
        again, fitted = finer
        assert again.decisions == again.every > 1
        assert again.apart_s == pytest.approx(data.apart_s)
        np.testing.assert_allclose(again.trajectories.position_m[:: again.every], data.trajectories.position_m)
        assert fitted.log_likelihood > base.log_likelihood


def test_a_divided_recording_is_the_recording_where_somebody_is_measured():
    recording = _seen(0.5, 1)
    finer = divided(recording, 3)
    assert finer.period_s == pytest.approx(recording.period_s / 3)
    assert np.isnan(finer.position_m[1::3]).all()
    np.testing.assert_array_equal(measured(finer).position_m, recording.position_m)


def test_single_drivers_are_calibrated_with_the_decisions_between_their_samples():
    recording = _seen(1.0 / 3.0, 3)
    names = ("sigma_nu", "sigma_a", "v_star", "kappa_v")
    found = [one.parameters[KAPPA_V] for one in calibrate(recording, "causal", names)]
    on_tracks = calibrate_tracks(tracks_of(recording), Settings(estimated=names)).rows[:, KAPPA_V]
    # true median 0.215; the median of 22 estimates of std 0.028 has a standard error of 0.0075, and three of them are
    # 0.022. With one decision for each sample of 1 s, the median on tracks was 0.37.
    assert np.median(found) == pytest.approx(0.215, abs=0.022)
    assert np.median(on_tracks) == pytest.approx(0.215, abs=0.022)
