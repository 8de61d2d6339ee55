"""highD and exiD: both directions of a motorway, with the files of metadata beside the tracks."""

from pathlib import Path

import numpy as np
import pytest

from sugiyama_ros.errors import InputError
from sugiyama_ros.formats.registry import format_of, read_tracks
from sugiyama_ros.trajectories.leaders import gaps
from sugiyama_ros.trajectories.time_base import on_time_base

HIGHD = (
    "frame,id,x,y,width,height,xVelocity,yVelocity,xAcceleration,yAcceleration,frontSightDistance,backSightDistance,dhw,"
    "thw,ttc,precedingXVelocity,precedingId,followingId,leftPrecedingId,leftAlongsideId,leftFollowingId,"
    "rightPrecedingId,rightAlongsideId,rightFollowingId,laneId"
)
EXID = (
    "recordingId,trackId,frame,trackLifetime,xCenter,yCenter,heading,width,length,xVelocity,yVelocity,xAcceleration,"
    "yAcceleration,lonVelocity,latVelocity,lonAcceleration,latAcceleration,laneletId,leadId"
)
#: Number, length, direction along x, x of the centre at the start, lane and leader of each vehicle.
VEHICLES = ((1, 4.0, 1, 100.0, 5, 0), (2, 16.0, 1, 60.0, 5, 1), (3, 4.0, -1, 200.0, 2, 0), (4, 12.0, -1, 240.0, 2, 3))


def highd(tmp_path: Path, rate: float = 25.0, samples: int = 200) -> Path:
    rows = []
    for name, length, sign, x, lane, leader in VEHICLES:
        for i in range(samples):
            corner = x + sign * 30.0 * i / rate - 0.5 * length
            rest = [0.0] * 9 + [leader] + [0] * 7 + [lane]
            rows.append(",".join(map(str, [i + 1, name, corner, 8.0, length, 2.0, sign * 30.0, *rest])))
    path = tmp_path / "02_tracks.csv"
    path.write_text("\n".join([HIGHD, *rows]) + "\n")
    return path


def test_both_directions_grow_along_the_drive(tmp_path: Path) -> None:
    path = highd(tmp_path)
    assert format_of(path).name == "highd"
    tracks = read_tracks(path)
    assert tracks.recording.used() == ("02",)
    assert tracks.road.values()[::200].tolist() == ["lower", "lower", "upper", "upper"]
    assert tracks.leader.values()[::200].tolist() == [None, "1", None, "3"]
    np.testing.assert_allclose(np.diff(tracks.s_m.reshape(4, 200)), 30.0 / 25.0, atol=1e-9)
    np.testing.assert_allclose(gaps(tracks)[200:400], 30.0)
    np.testing.assert_allclose(gaps(tracks)[600:], 32.0)
    assert "the next vehicle ahead is the given leader in 100 %" in tracks.about.notes
    assert tracks.vehicle_class is None
    even = on_time_base(tracks)
    np.testing.assert_allclose(np.diff(even.s_m[even.vehicle.code == 3]), 3.0, atol=1e-9)


def test_the_files_of_metadata_count(tmp_path: Path) -> None:
    path = highd(tmp_path, rate=10.0)
    (tmp_path / "02_recordingMeta.csv").write_text("id,frameRate,locationId\n2,10,1\n")
    (tmp_path / "02_tracksMeta.csv").write_text("id,width,class\n1,4,Car\n2,16,Truck\n3,4,Car\n4,12,Truck\n")
    tracks = read_tracks(path)
    assert tracks.vehicle_class.values()[::200].tolist() == ["car", "truck", "car", "truck"]
    np.testing.assert_allclose(np.diff(tracks.time_s[:200]), 0.1)
    (tmp_path / "02_recordingMeta.csv").write_text("id,frameRate,locationId\n2,0,1\n")
    with pytest.raises(InputError, match=r"02_recordingMeta.csv: frameRate 0 is no rate"):
        read_tracks(path)


def test_exid_is_measured_along_its_main_direction(tmp_path: Path) -> None:
    angle = np.radians(30.0)
    rows = []
    for name, length, sign, x, lane, leader in VEHICLES:
        for i in range(100):
            along = x + sign * 30.0 * i / 25.0
            place = [along * np.cos(angle), along * np.sin(angle)]
            heading = 30.0 if sign > 0 else 210.0
            rest = [0.0] * 8 + [lane, leader or -1]
            rows.append(",".join(map(str, [7, name, i, i, *place, heading, 2.0, length, *rest])))
    path = tmp_path / "07_tracks.csv"
    path.write_text("\n".join([EXID, *rows]) + "\n")
    tracks = read_tracks(path)
    assert tracks.leader.values()[::100].tolist() == [None, "1", None, "3"]
    np.testing.assert_allclose(gaps(tracks)[100:200], 30.0, atol=1e-6)
    np.testing.assert_allclose(np.diff(tracks.s_m.reshape(4, 100)), 30.0 / 25.0, atol=1e-6)


def test_crossings_have_no_leaders(tmp_path: Path) -> None:
    path = tmp_path / "00_tracks.csv"
    path.write_text(EXID.rpartition(",laneletId")[0] + "\n" + ",".join(["0"] * 17) + "\n")
    with pytest.raises(InputError, match=r"00_tracks.csv:1: no column leadId: crossings \(inD, rounD\)"):
        read_tracks(path)


def test_a_damaged_line_is_named(tmp_path: Path) -> None:
    path = highd(tmp_path)
    lines = path.read_text().splitlines()
    path.write_text("\n".join([*lines[:3], "3,1,oops" + lines[3][3:], *lines[4:]]) + "\n")
    with pytest.raises(InputError, match=r"02_tracks.csv:4: "):
        read_tracks(path)
