"""Intervals that the data do not close, what is then identified, and what goes on with it."""

import re
from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

import sugiyama_ros as sg
from sugiyama_ros.calibration.soundness import cautions
from sugiyama_ros.driver.parameters import KAPPA_V, OMEGA_2, PARAMETERS, SIGMA_NU, V_STAR, index
from sugiyama_ros.effects.registry import ROW
from sugiyama_ros.errors import InputError
from sugiyama_ros.fit.classes import search_of
from sugiyama_ros.fit.coordinates import has_both_ends, with_open_ends
from sugiyama_ros.fit.preparation import prepare_stretches
from sugiyama_ros.results import to_json

FCD = Path(__file__).parents[2].parent / "shared/cases/classes_interval_without_end/fcd.xml"
INF = np.inf
PLACES, ENDS = (V_STAR, OMEGA_2), np.array([[0.5, -1e3], [30.0, -1e-3]])


@pytest.fixture(scope="module")
def run():
    """A short recording of drivers who change lanes, without measurement noise."""
    return sg.simulate_lane_changes(12, 2, 30.0, seed=3)


@pytest.fixture(scope="module")
def calibrated(run):
    return sg.calibrate(run.tracks)


@pytest.mark.parametrize(
    ("v_star", "omega_2", "left"),
    [
        ([9.0, 11.0], [-12.0, -8.0], [[9.0, 11.0], [-12.0, -8.0]]),
        ([9.0, 30.0], [-1e3, -8.0], [[9.0, INF], [-INF, -8.0]]),
        ([0.5, 5.8e76], [-12.0, -1e-9], [[0.0, INF], [-12.0, 0.0]]),
        ([np.nan, 11.0], [-8.0, np.nan], [[0.0, 11.0], [-8.0, 0.0]]),
    ],
)
def test_an_end_on_a_bound_of_the_search_is_open(v_star, omega_2, left):
    found = with_open_ends(np.array([v_star, omega_2]), PLACES, ENDS)
    assert np.array_equal(found, left)
    assert has_both_ends(found).tolist() == [v_star == left[0], omega_2 == left[1]]


def check(found):
    """Check that intervals end within the bounds, or are open, and that text and documents have no wild numbers."""
    for driver in found.document(0.0)["drivers"]:
        for name, (low, high) in driver["interval"].items():
            p = PARAMETERS[index(name)]
            assert low == 0.0 or p.lower <= low <= driver[name]
            assert high is None or driver[name] <= high <= p.upper
            if driver["identified"][name]:
                assert low > 0.0
                assert high is not None
    said = "\n".join([*found.class_sentences(), str(found), to_json(found.document(0.0))])
    assert not re.search(r"inf\b|nan|[0-9]{8}\.", said)


SETTINGS = [{}, {"regularise": False}, {"regularise": False, "profile": True}, {"classes": 2}]


@pytest.mark.parametrize("settings", SETTINGS, ids=str)
def test_intervals_end_within_the_bounds_or_are_open(run, settings):
    """Warnings are errors: no number on the way is beyond what a number can be."""
    check(sg.calibrate(run.tracks, **settings))


@pytest.mark.skipif(not FCD.exists(), reason="needs a recording that is not part of the repository")
def test_so_they_do_where_classes_of_vehicles_say_nothing_of_noises():
    tracks = sg.read(FCD)
    found = sg.calibrate(tracks.select(tracks.time_s < 40.0), classes="vehicle")
    check(found)
    assert all("sigma_v" in line and "(not identified)" in line for line in found.class_sentences())


def test_an_open_end_is_said(run):
    found = sg.calibrate(run.tracks, classes=1)
    interval = found.classes.interval.copy()
    interval[0, [SIGMA_NU, V_STAR, KAPPA_V]] = [[0.0, 0.0034], [9.3, INF], [0.0, INF]]
    (line,) = replace(found, classes=replace(found.classes, interval=interval)).class_sentences()
    assert re.search(r"sigma_nu [0-9.e-]+ \(at most 0\.0034\), sigma_a [0-9.]+ \([0-9.]+ to [0-9.]+\)", line)
    assert re.search(r"v_star [0-9.]+ \(at least 9\.300\), kappa_v [0-9.]+ \(not identified\)", line)


def test_drivers_who_are_alike_make_fewer_classes(run):
    """Clusters of equal drivers are empty. Warnings are errors."""
    data = prepare_stretches(run.tracks)
    places = [index(name) for name in data.even.estimated()]
    with ThreadPoolExecutor(2) as work:
        search = search_of(data, 3, places, work)
        drivers = np.tile(ROW.with_effects(data.even.typical(data.speed)), (data.drivers, 1))
        found = search.start(drivers, seed=0)
    assert np.isfinite(found.x).all()
    assert np.isfinite(found.log_likelihood).all()


def vague(calibrated, drivers):
    """A calibration that does not tell the desired speeds of some drivers."""
    interval = calibrated.interval.copy()
    interval[drivers, V_STAR, 1] = INF
    known = [{**one, "v_star": k not in drivers} for k, one in enumerate(calibrated.identified)]
    return replace(calibrated, interval=interval, identified=tuple(known))


def test_desired_speeds_that_are_not_identified_are_not_gone_on_with(run, calibrated):
    drivers = len(calibrated.drivers)
    assert calibrated.has_value("v_star").all()
    assert cautions(calibrated) == []
    found = vague(calibrated, [0])
    assert cautions(found) == []
    # a driver whose desired speed is not known counts as the median driver of those who have one
    rows = found.rows.copy()
    rows[0] = 2.0 * rows[0]
    assert (
        sg.lane_changes(run.tracks, found).log_loss == sg.lane_changes(run.tracks, replace(found, rows=rows)).log_loss
    )
    most = list(range(drivers // 2 + 1))
    found = vague(calibrated, most)
    (line,) = cautions(found)
    assert line.startswith(f"v_star is not identified for {len(most)} of {drivers} drivers: ")
    with pytest.raises(InputError, match=f"the desired speeds of {len(most)} of {drivers} drivers are not identified"):
        sg.lane_changes(run.tracks, found)


def test_a_column_of_classes_stands_where_there_are_classes(calibrated):
    assert calibrated.table().headings[:2] == ("vehicle", "following [s]")
    assert {len(row) for row in calibrated.table().rows} == {len(calibrated.table().headings)}
    cars = tuple(replace(driver, vehicle_class="car") for driver in calibrated.drivers)
    table = replace(calibrated, drivers=cars).table()
    assert table.headings[:3] == ("vehicle", "class", "following [s]")
    assert [row[1] for row in table.rows] == ["car"] * (len(cars) + 1)
