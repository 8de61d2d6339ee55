"""Simulated lanes: vehicles come into view and leave, each behind the next one on its lane."""

import numpy as np
import pytest

from sugiyama_ros.driver.parameters import KAPPA_V, SIGMA_A, V_STAR, defaults
from sugiyama_ros.effects.registry import ROW
from sugiyama_ros.errors import InputError
from sugiyama_ros.simulation.experiment import Experiment, spread_out
from sugiyama_ros.simulation.lanes import Lane, alike_lanes, simulate_lanes


def lane(vehicles=4, noise=0.1, length_m=4.0):
    rows = defaults(vehicles)
    rows[:, SIGMA_A] = noise
    return Lane(rows, np.full(vehicles, length_m), ["car"] * (vehicles - 1) + ["truck"])


def test_vehicles_come_into_view_follow_the_next_one_on_their_lane_and_leave():
    tracks = simulate_lanes([lane(), lane(3, length_m=8.0)], 60.0, np.random.default_rng(1), view_m=(20.0, 200.0))
    names = [tracks.vehicle.at(k) for k in range(len(tracks))]
    assert set(names) == {"1-1", "1-2", "1-3", "1-4", "2-1", "2-2", "2-3"}
    assert tracks.s_m.min() >= 20.0
    assert tracks.s_m.max() < 200.0
    led = 0
    for k, row in enumerate(tracks.leader_row.tolist()):
        number, vehicle = names[k].split("-")
        if row >= 0:
            assert names[row] == f"{number}-{int(vehicle) + 1}"
            assert tracks.time_s[row] == tracks.time_s[k]
            led += 1
    assert led > 100
    first = [k for k, name in enumerate(names) if name in ("1-4", "2-3")]
    # nobody knows who drives ahead of the first vehicle in view
    assert (tracks.leader_row[first] == -2).all()
    vehicle_class = tracks.column("class")
    assert {vehicle_class.at(k) for k in first} == {"truck"}
    assert set(tracks.length_m[[name[0] == "2" for name in names]].tolist()) == {8.0}


def test_a_road_on_which_nobody_is_seen_and_a_collision_are_one_clear_line():
    with pytest.raises(InputError, match="nobody comes between"):
        simulate_lanes([lane()], 5.0, np.random.default_rng(1), view_m=(1e5, 2e5))
    with pytest.raises(InputError, match="collide on lane 1"):
        simulate_lanes([lane(8, noise=6.0)], 120.0, np.random.default_rng(1))


def test_lanes_of_an_experiment_differ_and_start_out_of_a_jam():
    experiment = Experiment(duration_s=20.0, gap_m=3.0, spread=0.1, seed=4)
    tracks = alike_lanes(experiment, ROW.with_effects(defaults(8)), 2, (-np.inf, np.inf))
    assert tracks.runs == 8
    first = tracks.start[:-1]
    # 4.33 m long vehicles with gaps of 3 m; positions are measured with a noise of 0.26 m
    assert sorted(tracks.s_m[first]) == pytest.approx(np.repeat([-21.99, -14.66, -7.33, 0.0], 2), abs=1.3)


def test_drivers_who_differ_differ_in_their_wishes_alone():
    rows = defaults(400)
    spread_out(rows, 0.1, np.random.default_rng(5))
    changed = np.flatnonzero((rows != defaults(400)).any(axis=0))
    assert changed.tolist() == sorted([V_STAR, KAPPA_V])
    assert np.log(rows[:, V_STAR]).std() == pytest.approx(0.1, rel=0.15)
