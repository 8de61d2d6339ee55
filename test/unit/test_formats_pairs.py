"""Car-following pairs and platoons, made here and measured."""

from pathlib import Path

import numpy as np
import pytest

from sugiyama_ros.errors import InputError
from sugiyama_ros.formats.registry import format_of, read_tracks
from sugiyama_ros.trajectories.leaders import gaps
from sugiyama_ros.trajectories.stretches import stretches

FHWA = (
    "run_no,timestamp,xLeaderReal,vLeaderReal,aLeaderReal,xFollowerReal,vFollowerReal,aFollowerReal,xLeaderReal_next,"
    "vLeaderReal_next,aLeaderReal_next,xFollowerReal_next,vFollowerReal_next,aFollowerReal_next,spacing,"
    "speed_difference,follower_id,leader_id"
)


def fhwa(follower: int, samples: int = 90, off: float = 0.0) -> list[str]:
    """Vehicle ``follower`` follows the vehicle with the next lower number, 25 m behind its front."""
    rows = []
    for i in range(samples):
        leader, own = 500.0 - 25.0 * (follower - 1) + 2.0 * i + off, 500.0 - 25.0 * follower + 2.0 * i
        rows.append(
            f"7,{2.5 + 0.1 * i:.1f},{leader},20,0,{own},20,0,0,0,0,0,0,0,{leader - own - 5.0},0,{follower},"
            f"{follower - 1}"
        )
    return rows


def test_fhwa(tmp_path: Path) -> None:
    path = tmp_path / "run-7.csv"
    path.write_text("\n".join([FHWA, *fhwa(2)]) + "\n")
    assert format_of(path).name == "pairs"
    tracks = read_tracks(path)
    assert tracks.recording.used() == ("7",)
    assert tracks.vehicle.used() == ("1", "2")
    np.testing.assert_allclose(tracks.length_m, 5.0)
    np.testing.assert_allclose(gaps(tracks)[90:], 20.0)
    assert tracks.leaders_known == 0.5
    assert read_tracks(path).dense().vehicle.tolist() == [1, 2]


def test_pairs_that_share_a_vehicle_make_a_platoon(tmp_path: Path) -> None:
    path = tmp_path / "run-7.csv"
    path.write_text("\n".join([FHWA, *fhwa(3), *fhwa(2), *fhwa(4)]) + "\n")
    tracks = read_tracks(path)
    assert tracks.leader.values()[::90].tolist() == [None, "1", "2", "3"]
    assert dict(tracks.about.dropped) == {"second row of a vehicle at the same time": 180}
    assert [one.position_m.shape[1] for one in stretches(tracks)] == [2, 3, 3]


def test_pairs_that_do_not_fit_together_are_refused(tmp_path: Path) -> None:
    path = tmp_path / "run-7.csv"
    path.write_text("\n".join([FHWA, *fhwa(3, off=2.0), *fhwa(2)]) + "\n")
    with pytest.raises(InputError, match=r"vehicle 2 is at 450 m and at 452 m at 2.5 s: .*give the column recording"):
        read_tracks(path)


def test_unified_tables(tmp_path: Path) -> None:
    header = (
        "Trajectory_ID,Time_Index,ID_LV,Type_LV,Pos_LV,Speed_LV,Acc_LV,ID_FAV,Pos_FAV,Speed_FAV,Acc_FAV,Space_Gap,"
        "Space_Headway,Speed_Diff"
    )
    rows = [
        f"{trip},{0.1 * i:.1f},0,0,{100 + 2 * i},20,0,1,{70 + 2 * i},20,0,25.4,30,0"
        for trip in (1, 2)
        for i in range(70)
    ]
    path = tmp_path / "unified.csv"
    path.write_text("\n".join([header, *rows]) + "\n")
    tracks = read_tracks(path)
    assert tracks.runs == 4
    np.testing.assert_allclose(tracks.length_m, 4.6)
    np.testing.assert_allclose(gaps(tracks)[70:140], 25.4)


def test_platoon(tmp_path: Path) -> None:
    path = tmp_path / "dataVehicle101.txt"
    rows = [f"{31993 + i}\t{200 + 0.5 * i:.5f}\t{188 + 0.5 * i:.5f}\t5.0\t5.0\t5.00000" for i in range(80)]
    path.write_text("\n".join(rows) + "\n")
    assert format_of(path).name == "platoon"
    tracks = read_tracks(path)
    assert tracks.vehicle.used() == ("100", "101")
    assert tracks.time_s[0] == pytest.approx(3199.3)
    np.testing.assert_allclose(gaps(tracks)[80:], 7.0)
    assert read_tracks(path).dense().vehicle.tolist() == [100, 101]
    path.write_text("\n".join([*rows[:9], "1\t2\t3", *rows[9:]]) + "\n")
    with pytest.raises(InputError, match=r"dataVehicle101.txt:10: 3 fields, but 6 columns"):
        read_tracks(path)
