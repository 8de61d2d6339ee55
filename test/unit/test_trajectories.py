"""Roads, trajectories, leaders and regular time bases."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from sugiyama_ros.errors import InputError
from sugiyama_ros.road import Road
from sugiyama_ros.trajectories.dense import DenseTracks

OPEN = Road()


def on_road(position, road=OPEN, **more):
    position = np.asarray(position, dtype=np.float64)
    vehicles = position.shape[1]
    return DenseTracks(position, np.full(vehicles, 4.0), np.arange(vehicles), road, 0.5, **more)


@given(st.floats(-1e6, 1e6), st.floats(1.0, 1e4))
def test_wrapped_positions_lie_on_the_ring(x, circumference):
    wrapped = float(Road(circumference).wrap(np.array(x)))
    assert 0.0 <= wrapped < circumference
    turns = (x - wrapped) / circumference
    assert turns == pytest.approx(round(turns), abs=1e-6)


@given(st.floats(0.0, 229.0), st.floats(-100.0, 100.0), st.floats(-1e3, 1e3))
def test_differences_do_not_depend_on_the_origin(x, way, origin):
    road = Road(230.0)
    ahead, behind = road.wrap(np.array([x + way + origin, x + origin]))
    assert road.difference(ahead, behind) == pytest.approx(way, abs=1e-9)


def test_space_headways_around_a_ring_add_up_to_it():
    road = Road(230.0)
    x = np.sort(np.random.default_rng(0).uniform(0, 230, 22))
    assert road.space_headway(np.roll(x, -1), x).sum() == pytest.approx(230.0, abs=1e-12)


def test_an_open_road_is_left_alone():
    x = np.array([-5.0, 1e5])
    assert np.array_equal(Road().wrap(x), x)
    with pytest.raises(InputError, match="not a circumference"):
        Road(-1.0)


def test_unwrapping_skips_missing_samples():
    x = np.array([[220.0], [np.nan], [3.0], [15.0]])
    assert Road(230.0).unwrap(x)[[0, 2, 3], 0] == pytest.approx([220.0, 233.0, 245.0])


def test_the_next_on_the_ring_leads():
    road = Road(100.0)
    start = np.array([50.0, 10.0, 80.0])
    x = road.wrap(start + 8.0 * np.arange(40)[:, None])
    assert np.all(on_road(x, road).leader == [2, 0, 1])


def test_a_wild_sample_does_not_change_the_leader():
    road = Road(100.0)
    x = road.wrap(np.array([50.0, 10.0, 80.0]) + 8.0 * np.arange(40)[:, None])
    x[20, 1] = 55.0
    assert np.all(on_road(x, road).leader == [2, 0, 1])


def test_on_an_open_road_the_first_has_no_leader_and_gaps_close_when_one_leaves():
    t = np.arange(6)[:, None]
    x = np.array([0.0, 20.0, 40.0]) + 5.0 * t
    x[3:, 1] = np.nan
    leader = on_road(x).leader
    assert leader[:3].tolist() == [[1, 2, -1]] * 3
    assert leader[3:].tolist() == [[2, -1, -1]] * 3


def test_a_missing_sample_between_two_known_is_present():
    x = np.array([[0.0], [np.nan], [2.0], [np.nan]])
    assert on_road(x).present[:, 0].tolist() == [True, True, True, False]


def test_impossible_trajectories_are_refused():
    x = np.zeros((3, 2))
    with pytest.raises(InputError, match="one length"):
        DenseTracks(x, np.ones(3), np.arange(2), Road(), 1.0)
    with pytest.raises(InputError, match="occurs twice"):
        DenseTracks(x, np.ones(2), np.array([1, 1]), Road(), 1.0)
    with pytest.raises(InputError, match="negative or not a number"):
        DenseTracks(x, np.array([1.0, np.nan]), np.arange(2), Road(), 1.0)
    with pytest.raises(InputError, match="time between samples"):
        DenseTracks(x, np.ones(2), np.arange(2), Road(), 0.0)


def test_the_follower_is_the_first_vehicle_whose_leader_is_this_vehicle():
    rng = np.random.default_rng(4)
    position = np.sort(rng.uniform(0.0, 300.0, 12)) + 3.0 * np.arange(60)[:, None]
    position[rng.random(position.shape) < 0.1] = np.nan
    position[:20, 2] = position[35:, 7] = np.nan
    for road in (OPEN, Road(300.0)):
        t = on_road(road.wrap(position), road)
        for vehicle in range(12):
            follows = (t.leader == vehicle) & t.present
            first = np.where(follows.any(axis=1), follows.argmax(axis=1), -1)
            assert np.array_equal(t.follower[:, vehicle], first)
