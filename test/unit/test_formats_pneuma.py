"""pNEUMA: lines of different lengths."""

from pathlib import Path

import numpy as np
import pytest

from sugiyama_ros.errors import InputError
from sugiyama_ros.formats.registry import format_of, read_tracks
from sugiyama_ros.trajectories.tracks import UNKNOWN

HEADER = "track_id; type; traveled_d; avg_speed; lat; lon; speed; lon_acc; lat_acc; time"


def line(name: int, kind: str, samples: int, north: float, east: float) -> str:
    groups = [
        f"{37.98 + north * i * 1e-6:.8f}; {23.73 + east * i * 1e-6:.8f}; 36.0; 0.0; 0.0; {0.04 * i:.6f}"
        for i in range(samples)
    ]
    return f"{name}; {kind}; 100.0; 36.0; " + "; ".join(groups) + "; "


def test_every_direction_is_a_road(tmp_path: Path) -> None:
    path = tmp_path / "20181024_d1.csv"
    lines = [line(1, "Car", 100, 3.6, 0.0), line(2, "Bus", 50, -3.6, 0.0), line(3, "Taxi", 70, 0.0, 4.6)]
    path.write_text("\n".join([HEADER, *lines]) + "\n")
    assert format_of(path).name == "pneuma"
    tracks = read_tracks(path)
    assert np.diff(tracks.start).tolist() == [100, 50, 70]
    assert tracks.road.values()[tracks.start[:-1]].tolist() == ["north", "south", "east"]
    assert tracks.vehicle_class.values()[tracks.start[:-1]].tolist() == ["car", "bus", "taxi"]
    # A millionth of a degree is 0.111 m.
    np.testing.assert_allclose(np.diff(tracks.s_m[:100]), 3.6 * 0.1112, rtol=1e-3)
    assert (tracks.leader_row == UNKNOWN).all()
    assert any("the file has no lanes" in note for note in tracks.about.notes)


def test_damaged_lines_are_named(tmp_path: Path) -> None:
    path = tmp_path / "a.csv"
    good = line(1, "Car", 3, 3.6, 0.0)
    path.write_text("\n".join([HEADER, good, good + "7; "]) + "\n")
    with pytest.raises(InputError, match=r"a.csv:3: 23 fields are not four and groups of six"):
        read_tracks(path)
    path.write_text("\n".join([HEADER, good.replace("36.0; 0.0", "fast; 0.0")]) + "\n")
    with pytest.raises(InputError, match=r"a.csv:2: value 'fast' is not a finite number"):
        read_tracks(path)
    path.write_text(HEADER + "\n")
    with pytest.raises(InputError, match=r"a.csv: no samples"):
        read_tracks(path)
