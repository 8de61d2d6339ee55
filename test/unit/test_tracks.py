"""Tracks: rows are sorted and checked, leaders are found, and tables of Arrow and pandas come back unchanged."""

from pathlib import Path

import numpy as np
import pytest

import sugiyama_ros as sg
from sugiyama_ros.errors import InputError, OutputError
from sugiyama_ros.formats.registry import read_tracks
from sugiyama_ros.trajectories.about import About
from sugiyama_ros.trajectories.assemble import assemble
from sugiyama_ros.trajectories.leaders import gaps
from sugiyama_ros.trajectories.selection import EVERYTHING, Selection, chosen, select
from sugiyama_ros.trajectories.tracks import FREE, NOBODY, UNKNOWN, Tracks


def columns(vehicles: int = 4, samples: int = 60, period: float = 0.1, **more: object) -> dict[str, object]:
    """A platoon: vehicle 1 is in front, the others follow 20 m apart at 10 m/s."""
    vehicle, step = (one.ravel() for one in np.meshgrid(np.arange(vehicles), np.arange(samples), indexing="ij"))
    table = {"vehicle": vehicle + 1, "time_s": step * period, "s_m": 1000.0 - 20.0 * vehicle + step * period * 10.0}
    return {**table, "length_m": np.full(len(step), 4.0), **more}


def names(tracks: Tracks) -> list[str | None]:
    return tracks.leader.values().tolist()


def test_rows_are_sorted_by_recording_vehicle_and_time() -> None:
    table = columns(12, 5)
    shuffled = np.random.default_rng(3).permutation(60)
    sorted_, back = assemble(table), assemble({name: np.asarray(c)[shuffled] for name, c in table.items()})
    np.testing.assert_array_equal(back.s_m, sorted_.s_m)
    np.testing.assert_array_equal(back.leader_row, sorted_.leader_row)
    assert back.vehicle.text == tuple(map(str, range(1, 13)))  # 2 before 10
    np.testing.assert_array_equal(back.start, np.arange(0, 61, 5))
    assert back.runs == 12
    assert repr(back) == "<Tracks: 12 vehicles in 1 recording, 60 rows, leaders known in 91.7 %, from memory>"


def test_the_leader_is_the_next_ahead_at_the_same_time_in_the_same_lane() -> None:
    lane = np.repeat(["a", "b", "a", "a"], 60)
    tracks = assemble(columns(lane=lane))
    assert names(tracks)[::60] == [None, None, "1", "3"]
    assert (tracks.leader_row[120:180] == np.arange(60)).all()
    np.testing.assert_allclose(gaps(tracks)[120:180], 36.0)


@pytest.mark.parametrize("missing", ["row", "lane"])
@pytest.mark.parametrize("ring_m", [0.0, 3000.0])
def test_who_drives_behind_a_vehicle_without_a_sample_has_an_unknown_leader(missing: str, ring_m: float) -> None:
    """One sample, several in a row, and a change of lanes meanwhile; nobody takes the vehicle for absent."""
    table = columns(4, lane=np.full(240, "a", dtype=object))
    gone = (table["vehicle"] == 2) & np.isin(np.arange(240) % 60, [10, 30, 31, 32])
    moved = (table["vehicle"] == 2) & (np.arange(240) % 60 >= 33)
    table["lane"][moved] = "b"
    if missing == "lane":
        table["lane"][gone] = None
    keep = ~gone | (missing == "lane")
    tracks = assemble({name: np.asarray(c)[keep] for name, c in table.items()}, About(ring_m=ring_m))
    third = tracks.leader.values()[tracks.start[2] : tracks.start[3]]
    assert np.flatnonzero(third == None).tolist() == [10, 30, 31, 32]  # noqa: E711
    assert third[[9, 11, 29]].tolist() == ["2"] * 3
    assert set(third[33:]) == {"1"}
    assert set(tracks.leader.values()[tracks.start[3] :]) == {"3"}


@pytest.mark.parametrize(
    ("name", "factor", "said"),
    [
        ("time_s", 1000.0, r"a vehicle has a sample every 100 s; check the unit of the times"),
        ("time_s", 1 / 60, r"vehicles move at 600 m/s; check the units of positions and times"),
        ("time_s", 1 / 3600, r"vehicles move at 3.6e\+04 m/s; check the units of positions and times"),
        ("s_m", 100.0, r"vehicles move at 1e\+03 m/s; check the units of positions and times"),
    ],
)
def test_units_that_cannot_be_right_are_named(name: str, factor: float, said: str) -> None:
    table = columns()
    with pytest.raises(InputError, match=said):
        assemble({**table, name: table[name] * factor})


def test_on_a_ring_the_last_leads_the_first() -> None:
    tracks = assemble(columns(), About(ring_m=100.0))
    assert names(tracks)[::60] == ["4", "1", "2", "3"]
    np.testing.assert_allclose(gaps(tracks)[:60], 36.0)
    assert set(assemble(columns(1), About(ring_m=100.0)).leader_row.tolist()) == {FREE}


def test_leaders_by_brute_force() -> None:
    random = np.random.default_rng(7)
    rows = 3000
    table = {
        "recording": random.integers(0, 3, rows),
        "vehicle": np.arange(rows),
        "time_s": random.integers(0, 20, rows) * 0.1,
        "s_m": random.uniform(0.0, 1e4, rows),
        "lane": random.integers(0, 4, rows),
        "length_m": np.full(rows, 0.1),
    }
    tracks = assemble(table, checked=False)
    for row in range(rows):
        same = (
            (tracks.recording.code == tracks.recording.code[row])
            & (tracks.lane.code == tracks.lane.code[row])
            & (tracks.time_s == tracks.time_s[row])
            & (tracks.s_m > tracks.s_m[row])
        )
        ahead = np.flatnonzero(same)
        assert tracks.leader_row[row] == (ahead[np.argmin(tracks.s_m[ahead])] if len(ahead) else UNKNOWN)


def test_positions_that_decrease_along_the_drive_are_turned_round() -> None:
    table = columns(lane=np.repeat(["a", "a", "b", "b"], 60))
    there = np.repeat([False, False, True, True], 60)
    table["s_m"] = np.where(there, 2000.0 - np.asarray(table["s_m"]), table["s_m"])
    tracks = assemble(table, reference="front")
    assert names(tracks)[::60] == [None, "1", None, "3"]
    assert (np.diff(tracks.s_m.reshape(4, 60)) > 0.0).all()
    assert "positions decrease along the drive in 50 % of the rows; they were turned round" in tracks.about.notes


def test_overlapping_vehicles_are_refused_with_the_cure() -> None:
    def checked(table: dict[str, np.ndarray]) -> None:
        chosen(assemble(table), EVERYTHING)

    table = columns(40, 60)
    with pytest.raises(InputError, match=r"below zero, as -.* m behind vehicle .* give the column lane or recording"):
        checked({**table, "length_m": np.full(2400, 21.0)})
    with pytest.raises(InputError, match="check units, lengths and the reference"):
        checked({**table, "length_m": np.full(2400, 21.0), "lane": np.full(2400, 1)})
    # Trucks of 16 m follow cars of 4 m, and the front bumpers are 6 m apart where they are nearest.
    length = np.repeat(np.where(np.arange(40) % 2, 16.0, 4.0), 60)
    front = np.asarray(table["s_m"]) - np.repeat(np.where(np.arange(40) % 2, -11.0, 0.0), 60)
    mixed = {**table, "s_m": front, "length_m": length}
    with pytest.raises(InputError, match="positions look like front bumpers; give --reference front"):
        checked(mixed)
    assert np.nanmin(gaps(assemble(mixed, reference="front"))) > 0.0


def test_given_leaders_are_compared_or_believed() -> None:
    leader = np.repeat(["", "1", "2", "3"], 60).astype(object)
    agreed = assemble(columns(leader=leader))
    assert agreed.about.notes == ("the next vehicle ahead is the given leader in 100 %",)
    leader[60:180] = "4"
    (note,) = assemble(columns(leader=leader)).about.notes
    assert note.startswith("warning: the next vehicle ahead is the given leader in 33.33 %, fewer than 98 %")
    believed = assemble(columns(leader=np.repeat(["", NOBODY, None, "1"], 60)), About(leaders="given"))
    assert names(believed)[::60] == [None, NOBODY, None, "1"]
    assert believed.leader_row[::60].tolist() == [UNKNOWN, FREE, UNKNOWN, 0]


def test_a_vehicle_has_one_row_at_a_time() -> None:
    table = {name: np.concatenate((c, c[:30])) for name, c in columns().items()}
    tracks = assemble(table)
    assert len(tracks) == 240
    assert tracks.about.dropped == (("second row of a vehicle at the same time", 30),)
    table["s_m"][240:] += 50.0
    with pytest.raises(InputError, match=r"vehicle 1 is at 1000 m and at 1050 m at 0 s: .* give the column recording"):
        assemble(table)


def test_a_number_that_is_used_again_is_another_vehicle() -> None:
    table = {name: np.concatenate((c, c)) for name, c in columns(2).items()}
    table["time_s"][120:] += 100.0
    tracks = assemble(table)
    assert tracks.vehicle.used() == ("1", "1~2", "2", "2~2")
    assert names(tracks)[::60] == [None, None, "1", "1~2"]
    assert "used again 2 times" in tracks.about.notes[0]


def test_a_part_of_tracks_forgets_leaders_that_are_left_out() -> None:
    tracks = assemble(
        columns(lane=np.repeat(["a", "b", "a", "a"], 60), **{"class": np.repeat(["car", "truck"] * 2, 60)})
    )
    lane_a = select(tracks, Selection(lane=("a",)))
    assert names(lane_a)[::60] == [None, "1", "3"]
    assert names(select(tracks, Selection(without=("3",))))[::60] == [None, None, None]
    late = select(tracks, Selection(from_s=2.0, to_s=3.0))
    assert late.time_s.min() == 2.0
    assert late.time_s.max() == 3.0
    assert names(late)[-1] == "3"
    assert dict(late.about.dropped) == {"not selected": 240 - len(late)}
    with pytest.raises(InputError, match="--class van: does not occur; choose among car, truck"):
        select(tracks, Selection(vehicle_class=("van",)))
    with pytest.raises(InputError, match="--road x: does not occur; the tracks do not say it"):
        select(tracks, Selection(road=("x",)))
    with pytest.raises(InputError, match=r"no row is left; the times go from 0 to 5.9 s"):
        select(tracks, Selection(from_s=7.0))


def test_pandas_and_back() -> None:
    pytest.importorskip("pandas")
    given = assemble(columns(lane=np.full(240, 1)))
    frame = given.to_frame()
    assert list(frame.columns) == list(given.columns)
    back = sg.read(frame)
    np.testing.assert_array_equal(back.s_m, given.s_m)
    np.testing.assert_array_equal(back.leader_row, given.leader_row)
    with pytest.raises(InputError, match="no column s_m or position_m"):
        sg.read(frame.drop(columns="s_m"))
    with pytest.raises(InputError, match=r"data frame: column s_m: 'far' is not a number"):
        sg.read(frame.assign(s_m="far"))


def test_tracks_are_saved(tmp_path: Path) -> None:
    pytest.importorskip("matplotlib")
    tracks = assemble(columns())
    for name in ("a.parquet", "a.csv", "a.png"):
        tracks.save(tmp_path / name)
        assert (tmp_path / name).stat().st_size > 0
    back = read_tracks(tmp_path / "a.parquet")
    np.testing.assert_array_equal(back.leader_row, tracks.leader_row)
    np.testing.assert_array_equal(read_tracks(tmp_path / "a.csv").leader_row, tracks.leader_row)
    with pytest.raises(OutputError, match=r"a.parquet: cannot be written: .*; choose another place"):
        tracks.save(tmp_path / "none" / "a.parquet")
