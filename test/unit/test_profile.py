"""Parameters by which drivers decide: the filter that follows a decision, and the profile of a staircase."""

import math
from concurrent.futures import ThreadPoolExecutor

import numpy as np
import pytest

from sugiyama_ros.diagnosis.candidates import candidates, chosen, with_candidate
from sugiyama_ros.driver.parameters import KAPPA_V, V_STAR
from sugiyama_ros.effects.registry import index_of
from sugiyama_ros.filters.causal import filter_chain
from sugiyama_ros.filters.extract import drives
from sugiyama_ros.fit.joint import fit, fit_base
from sugiyama_ros.fit.preparation import prepare
from sugiyama_ros.fit.profile import parabola, profiled
from sugiyama_ros.fit.standard_errors import shared_stds
from sugiyama_ros.studies.scenes import hide_at_scene


def test_the_filter_finds_back_to_a_driver_who_decides_otherwise():
    """Two of these drivers brake where the filter expects them to go on; with the true parameters, it has to follow."""
    run, _, _ = hide_at_scene("roundabout", None, 1)
    total, worst = 0.0, 0.0
    for drive in drives(run.measured):
        if drive.stretch.vehicle not in ("31", "47"):
            continue
        scored = filter_chain(drive.chain, run.travellers[int(drive.stretch.vehicle)].row).sample_log_likelihood
        total, worst = total + float(np.nansum(scored)), min(worst, float(np.nanmin(scored)))
    # it was -34 for one sample: a filter that is sure of the other decision stayed sure of it
    assert -15.0 < worst < -2.0
    assert total > 150.0


def test_a_parabola_has_the_vertex_and_the_error_of_a_profile():
    x = np.linspace(-0.4, 0.6, 11)
    smooth = 7.0 - 0.5 * np.square((x - 0.1) / 0.2)
    vertex, std = parabola(x, smooth)
    assert (vertex, std) == (pytest.approx(0.1, abs=1e-12), pytest.approx(0.2, rel=1e-9))
    # steps say less, and a valley says nothing
    vertex, rough = parabola(x, smooth + 6.0 * np.random.default_rng(3).standard_normal(11))
    assert abs(vertex - 0.1) < 3.0 * rough
    assert rough > 1.2 * std
    assert parabola(x, np.square(x))[1] == math.inf


def test_the_sight_of_a_blind_sector_is_found_from_afar():
    """Derivatives of a staircase do not lead from 10 m to 8 m; the profile does, and says how well."""
    run, _, _ = hide_at_scene("roundabout", None, 8001, drivers=30)
    place = index_of("blind_sector", "sight")
    with ThreadPoolExecutor(2) as work:
        data = prepare(run.measured)
        base = fit_base(data, data.even.individual(V_STAR, KAPPA_V), work)
        far = with_candidate(base.model, chosen(data, candidates(data), "blind_sector"), {place: 10.0})
        start = fit(data, far, work)
        found = profiled(data, start, place, work)
        std = shared_stds(data, found, work)["blind_sector.sight"]
    assert found.stds == {"blind_sector.sight": std}
    assert 0.1 < std < 1.5
    assert abs(found.model.rows[0, place] - 8.0) < 2.5 * std
    assert np.ptp(found.model.rows[:, place]) == 0.0
