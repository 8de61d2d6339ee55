"""TGSIM and ARED: tables whose columns have other names."""

from pathlib import Path

import numpy as np
import pytest

from sugiyama_ros.errors import InputError
from sugiyama_ros.formats.registry import format_of, read_tracks
from sugiyama_ros.trajectories.leaders import gaps

TGSIM = (
    "id,time,xloc_kf,yloc_kf,lane_kf,speed_kf,acceleration_kf,length_smoothed,width_smoothed,type_most_common,run_index"
)
ARED = (
    "exp_id,veh_id,length,height,make,year,model,timestamp,cam_distance,cam_velocity,cam_acceleration,leader_id,"
    "cam_leader_gap"
)


def test_tgsim(tmp_path: Path) -> None:
    rows = [
        f"{k},{0.1 * i:.1f},{900 - 20 * k - 2 * i},{3.6 * lane},{lane},20,0,{4.5 + 0.01 * i},1.9,small-vehicle,{run}"
        for run in (1, 2)
        for k, lane in ((1, 1), (2, 1), (3, 2))
        for i in range(60)
    ]
    path = tmp_path / "I294.csv"
    path.write_text("\n".join([TGSIM, *rows]) + "\n")
    assert format_of(path).name == "tgsim"
    tracks = read_tracks(path)
    assert tracks.recording.used() == ("1", "2")
    # Positions decrease along the drive, so that the vehicle with the smallest one is ahead.
    assert tracks.leader.values()[::60].tolist() == ["2", None, None] * 2
    assert (np.diff(tracks.s_m)[np.diff(tracks.run) == 0] > 0.0).all()
    with pytest.raises(InputError, match=r"2 recordings \(1, 2\)"):
        read_tracks(path).dense()


def test_ared_is_on_its_ring(tmp_path: Path) -> None:
    rows = [
        f"A,{k},4.5,1.4,make,2015,model,{i / 30:.4f},{(200 - 60 * k + 0.3 * i) % 260:.3f},9,0,{(k - 1) % 4},{60 - 4.5}"
        for k in range(4)
        for i in range(240)
    ]
    path = tmp_path / "expA.csv"
    path.write_text("\n".join([ARED, *rows]) + "\n")
    tracks = read_tracks(path)
    assert tracks.about.ring_m == 260.0
    assert tracks.leader.values()[::240].tolist() == ["3", "0", "1", "2"]
    np.testing.assert_allclose(gaps(tracks)[240:], 55.5, atol=2e-3)
    dense = read_tracks(path).dense()
    assert dense.road.circumference_m == 260.0
    assert dense.period_s == 0.1


def test_a_damaged_line_is_named(tmp_path: Path) -> None:
    path = tmp_path / "I294.csv"
    path.write_text(f"{TGSIM}\n1,0.0,x,0,1,20,0,4.5,1.9,small,1\n")
    with pytest.raises(InputError, match=r"I294.csv:2: column xloc_kf: 'x' is not a number"):
        read_tracks(path)
