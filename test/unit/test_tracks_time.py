"""Tracks on a regular time base, stretches for the filter, and one lane as a dense table."""

import numpy as np
import pytest

from sugiyama_ros.driver.parameters import population
from sugiyama_ros.errors import InputError
from sugiyama_ros.filters.causal import filter_chain
from sugiyama_ros.filters.extract import chain_behind, drives
from sugiyama_ros.road import Road
from sugiyama_ros.trajectories.about import About
from sugiyama_ros.trajectories.assemble import assemble
from sugiyama_ros.trajectories.dense import DenseTracks, tracks_of
from sugiyama_ros.trajectories.stretches import stretches
from sugiyama_ros.trajectories.time_base import is_regular, on_time_base, period_of, resample
from sugiyama_ros.trajectories.tracks import Tracks


def platoon(vehicles: int = 4, duration: float = 20.0, period: float = 0.1, about: About | None = None) -> Tracks:
    """Vehicle 1 is in front; all drive a parabola, 20 m apart."""
    return assemble(rows(vehicles, duration, period), about)


def rows(vehicles: int = 4, duration: float = 20.0, period: float = 0.1) -> dict[str, np.ndarray]:
    samples = round(duration / period) + 1
    vehicle, step = (one.ravel() for one in np.meshgrid(np.arange(vehicles), np.arange(samples), indexing="ij"))
    time = np.round(step * period, 6)
    return {
        "vehicle": vehicle + 1,
        "time_s": time,
        "s_m": way(time) - 20.0 * vehicle,
        "length_m": np.full(len(step), 4.0),
    }


def way(time: np.ndarray) -> np.ndarray:
    return 500.0 + 10.0 * time + 0.3 * time**2


def part(table: dict[str, np.ndarray], keep: np.ndarray) -> dict[str, np.ndarray]:
    return {name: column[keep] for name, column in table.items()}


@pytest.mark.parametrize("period", [0.04, 1.0 / 30.0, 0.1, 0.2, 1.0 / 3.0])
def test_the_period_is_found(period: float) -> None:
    tracks = platoon(period=period)
    assert period_of(tracks) == pytest.approx(period, abs=1e-9)
    assert is_regular(tracks)


@pytest.mark.parametrize("period", [0.04, 1.0 / 30.0])
def test_a_parabola_survives_the_change_from_25_and_30_to_10_hz(period: float) -> None:
    tracks = on_time_base(platoon(period=period))
    assert period_of(tracks) == 0.1
    behind = 20.0 * (tracks.vehicle.code)
    np.testing.assert_allclose(tracks.s_m, way(tracks.time_s) - behind, rtol=0.0, atol=1e-9)
    assert len(tracks) == 4 * 201
    assert tracks.leaders_known == 0.75
    assert "local parabola" in tracks.about.smoothing


def test_a_local_parabola_averages_noise() -> None:
    table = rows(period=0.04)
    noise = np.random.default_rng(1).normal(0.0, 0.1, len(table["s_m"]))
    tracks = on_time_base(assemble({**table, "s_m": table["s_m"] + noise}))
    error = tracks.s_m - way(tracks.time_s) + 20.0 * tracks.vehicle.code
    # Five samples around a target: the value of a parabola in the middle has 17/35 of the variance of one sample.
    assert 0.9 * 0.1 * np.sqrt(17 / 35) < error.std() < 1.1 * 0.1 * np.sqrt(17 / 35) + 0.005


def test_clocks_that_are_apart_meet_on_a_common_time_base() -> None:
    table = rows()
    table["time_s"] = table["time_s"] + 0.03 * (table["vehicle"] - 1)
    table["s_m"] = way(table["time_s"]) - 20.0 * (table["vehicle"] - 1)
    tracks = assemble(table)
    assert tracks.leaders_known == 0.0
    assert not is_regular(tracks)
    even = on_time_base(tracks)
    assert even.leaders_known > 0.74
    # Where a track begins or ends between two targets, only two samples are near.
    np.testing.assert_allclose(even.s_m, way(even.time_s) - 20.0 * even.vehicle.code, rtol=0.0, atol=1e-3)


def test_a_hole_is_bridged_up_to_half_a_second() -> None:
    table = rows(1, 20.0, 0.04)
    time = table["time_s"]
    keep = ~((time > 5.0) & (time < 5.4)) & ~((time > 10.0) & (time < 11.0))
    tracks = resample(assemble(part(table, keep)), 0.1)
    missing = set(np.round(np.arange(0.0, 20.05, 0.1), 1)) - set(np.round(tracks.time_s, 1))
    assert missing == {round(10.1 + 0.1 * k, 1) for k in range(9)}


def test_stretches_have_the_two_vehicles_ahead() -> None:
    found = list(stretches(platoon()))
    assert [one.vehicle for one in found] == ["2", "3", "4"]  # the leader of the first is beyond the view
    second, third, _ = found
    assert second.position_m.shape == (201, 2)  # the leader's leader is not known
    assert third.position_m.shape == (201, 3)
    np.testing.assert_array_equal(third.identity[0], [2, 1, 0])
    np.testing.assert_allclose(third.position_m[:, 0] + 40.0, third.position_m[:, 2], rtol=0.0, atol=1e-9)
    np.testing.assert_allclose(third.behind[:, 1] + 20.0, third.position_m[:, 0], rtol=0.0, atol=1e-9)
    assert third.scored.all()
    assert third.duration_s == pytest.approx(20.0)
    assert (third.length_m == 4.0).all()


def test_holes_and_unknown_leaders_divide_stretches() -> None:
    table = rows(3)
    time, vehicle = table["time_s"], table["vehicle"]
    keep = ~((vehicle == 3) & (time > 6.0) & (time < 6.8)) & ~((vehicle != 3) & (time > 12.0) & (time < 13.5))
    spans = [(one.start_s, one.duration_s) for one in stretches(assemble(part(table, keep))) if one.vehicle == "3"]
    assert spans == [(0.0, pytest.approx(6.0)), (pytest.approx(6.8), pytest.approx(5.2)), (pytest.approx(13.5), 6.5)]
    short = [(one.start_s, one.duration_s) for one in stretches(assemble(part(table, keep)), 6.2) if one.vehicle == "3"]
    assert short == [(pytest.approx(13.5), pytest.approx(6.5))]


def test_flicker_of_leader_and_lane_is_ignored() -> None:
    table = rows(3)
    time, vehicle = table["time_s"], table["vehicle"]
    lane = np.full(len(time), 1)
    lane[(vehicle == 2) & (time >= 5.0) & (time < 5.8)] = 2  # too short to count
    lane[(vehicle == 2) & (time >= 12.0)] = 2
    lane[(vehicle == 3) & (time >= 3.0) & (time < 3.5)] = 3
    (third,) = (one for one in stretches(assemble({**table, "lane": lane})) if one.vehicle == "3")
    np.testing.assert_array_equal(third.identity[:120, 1], 1)
    np.testing.assert_array_equal(third.identity[120:, 1], 0)
    assert third.scored.all()
    assert np.isfinite(third.position_m[:, 1]).all()


def test_samples_around_an_own_lane_change_are_not_scored() -> None:
    table = rows(3)
    lane = np.where((table["vehicle"] == 3) & (table["time_s"] >= 10.0), 2, 1)
    lane[table["vehicle"] == 1] = np.where(table["time_s"][table["vehicle"] == 1] >= 10.0, 2, 1)
    (third,) = (one for one in stretches(assemble({**table, "lane": lane})) if one.vehicle == "3")
    np.testing.assert_array_equal(np.flatnonzero(~third.scored), np.arange(80, 120))
    np.testing.assert_array_equal(third.identity[[99, 100], 1], [1, 0])


def test_chains_are_those_of_the_dense_table() -> None:
    """On one lane with everybody present, a chain out of tracks is filtered as a chain out of trajectories is."""
    time = np.arange(0.0, 30.0, 1.0 / 3.0)
    position = way(time)[:, None] - 20.0 * np.arange(4) + np.random.default_rng(5).normal(0.0, 0.2, (len(time), 4))
    dense = DenseTracks(np.mod(position, 200.0), np.full(4, 4.0), np.arange(4), Road(200.0), 1.0 / 3.0)
    found = list(drives(tracks_of(dense)))
    assert len(found) == 4
    for driver, drive in enumerate(found):
        assert drive.scored.all()
        expected = filter_chain(chain_behind(dense, driver), population()).log_likelihood
        assert filter_chain(drive.chain, population()).log_likelihood == pytest.approx(expected, rel=1e-12)
        np.testing.assert_allclose(drive.chain.around, chain_behind(dense, driver).around, rtol=0.0, atol=1e-9)


def test_what_is_not_one_lane_is_refused_with_the_cure() -> None:
    table = rows()
    two = assemble({**table, "lane": (table["vehicle"] > 2).astype(int)})
    with pytest.raises(InputError, match=r"a.csv: 2 lanes \(0, 1\) where one is needed; .* --lane 0"):
        two.dense("a.csv")
    with pytest.raises(InputError, match=r"2 recordings .*--recording 0"):
        assemble({**table, "recording": (table["vehicle"] > 2).astype(int)}).dense("a.csv")
    leader = np.array(["", "1", "9", "3"])[table["vehicle"] - 1]
    with pytest.raises(InputError, match=r"ahead of 3 was not always recorded.* rest.parquet --without 3$"):
        assemble({**table, "leader": leader}).dense("a.csv")
    keep = (table["vehicle"] != 2) | (table["time_s"] > 5.05)
    known = {**table, "leader": np.array(["", "1", "2", "3"])[table["vehicle"] - 1]}
    with pytest.raises(InputError, match=r"rest.parquet --from 5.1 --to 20$"):
        assemble(part(known, keep)).dense("a.csv")
    leader = np.array(["", "1", "1", "3"])[table["vehicle"] - 1]
    with pytest.raises(InputError, match=r"only 66.7 % of the leaders are the next vehicle in this lane"):
        assemble({**table, "leader": leader}, About(leaders="given")).dense("a.csv")
    sparse = rows(100, 6.0)
    sparse["time_s"] = sparse["time_s"] + 50.0 * sparse["vehicle"]
    with pytest.raises(InputError, match=r"come and go .*--from SECONDS --to SECONDS"):
        assemble(sparse).dense("a.csv")
