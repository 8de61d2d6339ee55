"""A scene from above on the page: the lanes, and each vehicle on its own way."""

import re
from dataclasses import replace

import numpy as np
from bokeh.models import MultiLine

from sugiyama_ros.cli.demo import _above
from sugiyama_ros.driver.parameters import defaults
from sugiyama_ros.page.panels.base import Chosen
from sugiyama_ros.page.panels.measured import ring
from sugiyama_ros.page.recording import Recording
from sugiyama_ros.page.report import _curves, _tile
from sugiyama_ros.simulation.scenes import simulate_scene


def recorded(run):
    """What a bag of a run holds, as `demo` reads it."""
    left_out = dict.fromkeys(("line_m", "arrive_s", "clear_s", "curvature_per_m", "leader_shift_m"))
    tracks = replace(run.measured, about=replace(run.measured.about, view="whole", leaders="found"), **left_out)
    t = tracks.dense("run")
    time = t.start_s + t.period_s * np.arange(len(t.position_m))
    return Recording(t, time, {"speed": np.full_like(t.position_m, np.nan)}, np.empty(0), {}, {}, above=_above(run))


def test_vehicles_are_on_the_lanes_of_their_own_ways():
    run = simulate_scene("roundabout", defaults(6), 3)
    r = recorded(run)
    x, y = r.above.at(r.trajectories.vehicle, r.trajectories.position_m)
    assert np.array_equal(np.isfinite(x), np.isfinite(r.trajectories.position_m))
    for column, number in enumerate(r.trajectories.vehicle.tolist()):
        known = np.isfinite(x[:, column])
        way = run.paths[run.travellers[number].route]
        right = way.at(r.trajectories.position_m[known, column])[:2]
        np.testing.assert_allclose([x[known, column], y[known, column]], right, atol=0.05)
    known = np.isfinite(x)
    assert np.ptp(x[known]) > 100.0
    assert np.ptp(y[known]) > 100.0


def test_the_page_draws_the_lanes():
    run = simulate_scene("roundabout", defaults(6), 3)
    r = recorded(run)
    lanes = list(ring(r, Chosen(r.trajectories.vehicle, 0)).select({"type": MultiLine}))
    assert lanes
    assert not list(ring(replace(r, above=None), Chosen(r.trajectories.vehicle, 0)).select({"type": MultiLine}))


def test_a_tile_says_which_laws_have_smaller_errors():
    errors = {"before": {"e": 2.0}, "after": {"e": 0.5}, "idm": {"e": 0.4}, "ovm": {"e": 0.6}}
    assert "smaller with another law: IDM" in _tile("Free run", "error", "e", errors).replace(
        "Intelligent Driver", "IDM"
    )
    errors["idm"]["e"] = 0.7
    assert "another law" not in _tile("Free run", "error", "e", errors)


def test_the_tile_draws_errors_over_the_time_ahead_of_the_best_law_alone():
    ends = {"before": 4.0, "after": 2.0, "idm": 3.0, "gipps": 8.0, "floor": 1.0}
    errors = {
        m: {"free_run_5s_m": 0.5 * end, "free_run_10s_m": end, "free_run_10s_crps_m": end} for m, end in ends.items()
    }
    lines = re.findall(r'class="(\w+)" points="([^"]*)"><title>([^<]*)<', _curves("free_run", errors))
    assert [kind for kind, *_ in lines] == ["law", "floor", "before", "after"]
    assert lines[0][2] == "IDM"
    assert lines[2][1] == "0,40.0 50,20.0 100,0.0"
