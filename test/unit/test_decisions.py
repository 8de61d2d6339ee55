"""How often drivers decide between the samples of a recording."""

from concurrent.futures import ThreadPoolExecutor

import numpy as np
import pytest

from sugiyama_ros.diagnosis.decisions import with_more_decisions
from sugiyama_ros.driver.parameters import KAPPA_V, V_STAR
from sugiyama_ros.fit.population import fit_base
from sugiyama_ros.fit.recording import prepare
from sugiyama_ros.fit.sampling import divided, measured
from sugiyama_ros.studies.away.drivers import drawn
from sugiyama_ros.studies.away.world import Setup, record


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
    data = prepare(_seen(period_s, every))
    base = fit_base(data, data.even.individual(V_STAR, KAPPA_V), work)
    finer = with_more_decisions(data, base, work)
    assert (finer is not None) == is_finer
    if finer is not None:
        assert finer.decisions == finer.every > 1
        assert finer.apart_s == pytest.approx(data.apart_s)
        np.testing.assert_allclose(finer.trajectories.position_m[:: finer.every], data.trajectories.position_m)


def test_a_divided_recording_is_the_recording_where_somebody_is_measured():
    recording = _seen(0.5, 1)
    finer = divided(recording, 3)
    assert finer.period_s == pytest.approx(recording.period_s / 3)
    assert np.isnan(finer.position_m[1::3]).all()
    np.testing.assert_array_equal(measured(finer).position_m, recording.position_m)
