"""Diagnosis and comparison on tracks: vehicles that come and go, on several lanes, behind measured leaders."""

import json
from concurrent.futures import ThreadPoolExecutor

import numpy as np
import pytest

import sugiyama_ros as sg
from sugiyama_ros.cli.app import app
from sugiyama_ros.diagnosis.candidates import candidates
from sugiyama_ros.diagnosis.forecast import forecasts
from sugiyama_ros.diagnosis.table import errors
from sugiyama_ros.driver.parameters import KAPPA_V, V_STAR
from sugiyama_ros.errors import InputError
from sugiyama_ros.fit.extent import not_searched
from sugiyama_ros.fit.model import Model, evaluate
from sugiyama_ros.fit.preparation import prepare, prepare_stretches
from sugiyama_ros.fit.recording import FOLDS
from sugiyama_ros.trajectories.assemble import assemble
from sugiyama_ros.trajectories.dense import whole_road
from sugiyama_ros.trajectories.stretches import SHORTEST_STRETCH_S

INDIVIDUAL = (V_STAR, KAPPA_V)
PERIOD_S = 0.5


@pytest.fixture(scope="module")
def work():
    with ThreadPoolExecutor(2) as pool:
        yield pool


@pytest.fixture(scope="module")
def ring():
    return sg.simulate(vehicles=6, ring_m=66.0, duration_s=80.0, seed=4)


@pytest.fixture(scope="module")
def two_lanes():
    """Two lanes of an open road; the trucks of lane 1 are 12 m long, and one car leaves after 50 s."""
    columns = {name: [] for name in ("vehicle", "time_s", "s_m", "lane", "class", "length_m")}
    for lane in (0, 1):
        t = sg.simulate(vehicles=4, ring_m=0.0, duration_s=70.0, period_s=PERIOD_S, seed=lane).dense
        for k in range(4):
            is_truck = lane == 1 and k % 2 == 0
            stays = t.time_s < (50.0 if (lane, k) == (0, 0) else np.inf)
            count = int(stays.sum())
            columns["vehicle"] += [f"v{lane}{k}"] * count
            columns["time_s"] += t.time_s[stays].tolist()
            # trucks are longer to the front: the gap ahead of them shrinks, and the gaps stay positive
            columns["s_m"] += (t.position_m[stays, k] + 20.0 * k).tolist()
            columns["lane"] += [str(lane)] * count
            columns["class"] += ["truck" if is_truck else "car"] * count
            columns["length_m"] += [12.0 if is_truck else 4.3] * count
    arrays = {name: np.array(one) if name.endswith("_m") or name == "time_s" else one for name, one in columns.items()}
    return assemble(arrays)


def of_truth(data, run):
    rows = run.parameters
    return Model(rows, INDIVIDUAL, (), (1.0, 1.0), rows)


def test_a_ring_has_the_same_likelihood_as_tracks(ring, work):
    dense, on_tracks = prepare(ring.measured), prepare_stretches(ring.measured)
    model = of_truth(dense, ring)
    known, found = (evaluate(data, model, work).log_likelihood for data in (dense, on_tracks))
    assert np.array_equal(np.isfinite(known), np.isfinite(found))
    assert found == pytest.approx(known, abs=1e-9, nan_ok=True)


def test_single_cars_drive_on_alike_on_a_ring_and_on_tracks(ring, work):
    """The leader is filtered in the follower's chain on tracks, and in the leader's own chain on the ring."""
    found = []
    for data in (prepare(ring.measured), prepare_stretches(ring.measured)):
        model = of_truth(data, ring)
        found.append(forecasts(data, [model] * FOLDS, work))
    on_ring, on_tracks = found
    assert errors(on_tracks)["single_car_10s_m"] == pytest.approx(errors(on_ring)["single_car_10s_m"], rel=0.1)
    assert np.nanstd(on_tracks.single.error - on_ring.single.error) < 0.3 * np.nanstd(on_ring.single.error)
    assert np.isfinite(on_ring.road.error).all()
    assert on_tracks.road is None


def test_only_a_road_on_which_everybody_is_known_is_a_whole_road(ring, two_lanes):
    tracks = ring.measured
    assert whole_road(tracks).vehicle.tolist() == ring.dense.vehicle.tolist()
    time_s, run = np.asarray(tracks.time_s), np.asarray(tracks.run)
    assert whole_road(tracks.select((run != 3) | (time_s < time_s[0] + 40.0))) is None
    assert whole_road(two_lanes) is None


def test_what_tracks_cannot_show_is_not_searched(two_lanes, ring):
    data = prepare_stretches(two_lanes)
    missing = not_searched(data)
    assert {"rear_pressure", "preference_switch", "sensor_eccentricity"} <= set(missing)
    assert not set(missing) & {c.name for c in candidates(data)}
    assert {"reaction_delay", "road_grade", "comfort_limits"} <= {c.name for c in candidates(data)}
    assert not_searched(prepare(ring.measured)) == {}


def test_the_commands_work_on_two_lanes(two_lanes, tmp_path, capsys):
    two_lanes.save(tmp_path / "lanes.parquet")
    app(["diagnose", str(tmp_path / "lanes.parquet"), "--json"], standalone_mode=False)
    found = json.loads(capsys.readouterr().out)
    assert [d["name"] for d in found["drivers"]] == ["v00", "v01", "v02", "v10", "v11", "v12"]
    assert len({d["vehicle"] for d in found["drivers"]}) == 6
    assert {d["class"] for d in found["drivers"]} == {"car", "truck"}
    base = found["errors"]["before"]
    assert base["free_run_10s_m"] is None
    assert base["single_car_10s_m"] > base["single_car_10s_crps_m"] > 0.0
    assert {one["name"] for one in found["verdict"]["not_searched"]} >= {"rear_pressure"}


def test_drivers_need_to_follow_for_long_enough(ring):
    tracks = ring.measured
    short = np.asarray(tracks.time_s) < tracks.time_s[0] + SHORTEST_STRETCH_S - 1.0
    with pytest.raises(InputError, match=r"nobody is seen for more than 3\.67 s"):
        prepare_stretches(tracks.select(short))
