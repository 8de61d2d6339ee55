"""NGSIM as text and CSV: feet, front bumpers, milliseconds, numbers that are used again."""

from pathlib import Path

import numpy as np
import pytest

from sugiyama_ros.errors import InputError
from sugiyama_ros.formats.registry import format_of, read_tracks

HEADER = (
    "Vehicle_ID,Frame_ID,Total_Frames,Global_Time,Local_X,Local_Y,Global_X,Global_Y,v_length,v_Width,v_Class,v_Vel,"
    "v_Acc,Lane_ID,O_Zone,D_Zone,Int_ID,Section_ID,Direction,Movement,Preceding,Following,Space_Headway,Time_Headway,"
    "Location"
)
FOOT_M = 0.3048


def text(vehicles: int = 3, samples: int = 80, lane: int = 2) -> str:
    """The original text: vehicle 1 is in front, a truck of 40 ft, 100 ft between the fronts, 30 ft/s."""
    lines = []
    for k in range(vehicles):
        for i in range(samples):
            lines.append(
                f"{k + 1:>5} {i + 10:>6} {samples:>5} {1118846979700 + 100 * i}  18.000 {900 - 100 * k + 3 * i:.3f} "
                f" 6042842.116 2133117.662 {40.0 if k == 0 else 15.0} 8.0 {3 if k == 0 else 2} 30.00 0.00 {lane}"
                f" {k:>4} {k + 2 if k + 1 < vehicles else 0:>4} {100.0 if k else 0.0:.2f} {3.33:.2f}"
            )
    return "\n".join(lines) + "\n"


def table(place: str = "i-80", start: int = 1118846979700) -> list[str]:
    rows = []
    for line in text().splitlines():
        f = line.split()
        clock = int(f[3]) - 1118846979700 + start
        rows.append(",".join([*f[:3], str(clock), *f[4:14], *[""] * 6, *f[14:18], place]))
    return rows


def test_text(tmp_path: Path) -> None:
    path = tmp_path / "trajectories-0400-0415.txt"
    path.write_text(text())
    assert format_of(path).name == "ngsim"
    tracks = read_tracks(path)
    assert len(tracks) == 240
    assert tracks.vehicle.used() == ("1", "2", "3")
    assert tracks.lane.used() == ("2",)
    assert tracks.vehicle_class.values()[[0, 80]].tolist() == ["truck", "car"]
    np.testing.assert_allclose(tracks.length_m[[0, 80]], [40.0 * FOOT_M, 15.0 * FOOT_M])
    # Front bumpers become centres.
    np.testing.assert_allclose(tracks.s_m[0], (900.0 - 20.0) * FOOT_M)
    np.testing.assert_allclose(tracks.time_s[:3], [0.0, 0.1, 0.2])
    assert tracks.leader.values()[::80].tolist() == [None, "1", "2"]
    assert "the next vehicle ahead is the given leader in 100 %" in tracks.about.notes
    assert read_tracks(path).dense().vehicle.tolist() == [1, 2, 3]


def test_csv_with_several_places_and_periods(tmp_path: Path) -> None:
    path = tmp_path / "NGSIM.csv"
    path.write_text("\n".join([HEADER, *table(), *table(start=1118846979700 + 900_000), *table("us-101")]) + "\n")
    tracks = read_tracks(path)
    assert tracks.recording.used() == ("i-80 period 1", "i-80 period 2", "us-101 period 1")
    assert tracks.runs == 9
    assert tracks.time_s.max() == pytest.approx(7.9)
    assert tracks.leader.values()[::80].tolist() == [None, "1", "2"] * 3
    with pytest.raises(InputError, match=r"3 recordings .* one.parquet --recording 'i-80 period 1'$"):
        read_tracks(path).dense()


def test_high_sim_is_read_alike(tmp_path: Path) -> None:
    header = (
        "Vehicle ID,Global Time (s),Frame ID,Local X (ft),Local Y (ft),Global X (Longitude),Global Y (Latitude),Width"
        " (ft),Length (ft),Class,Speed (ft/s),Acceleration (ft/s2),Lane Num,Preceding Vehicle ID,Space Headway (ft)"
    )
    rows = [
        f"{k},{i / 30:.4f},{i},5.0,{900 - 100 * k + i},0,0,6,15,1,30,0,1,{k - 1 if k else -1},100"
        for k in range(2)
        for i in range(200)
    ]
    path = tmp_path / "highsim.csv"
    path.write_text("\n".join([header, *rows]) + "\n")
    tracks = read_tracks(path)
    assert tracks.runs == 2
    assert tracks.leaders_known == 0.5
    np.testing.assert_allclose(tracks.time_s[:2], [0.0, 1.0 / 30.0], atol=1e-3)


def test_a_damaged_line_is_named(tmp_path: Path) -> None:
    path = tmp_path / "a.txt"
    good = text().splitlines()
    path.write_text("\n".join([*good[:50], "1 2 3", *good[50:]]) + "\n")
    with pytest.raises(InputError, match=r"a.txt:51: 3 fields, but 18 columns; correct the line"):
        read_tracks(path)
    path.write_text("\n".join([*good[:50], good[50].replace(good[50].split()[5], "far"), *good[51:]]) + "\n")
    with pytest.raises(InputError, match=r"a.txt:51: column Local_Y: 'far' is not a number; correct the line"):
        read_tracks(path)
