"""OpenACC: a platoon on a path with curves, made here and measured."""

from pathlib import Path

import numpy as np
import pytest

from sugiyama_ros.errors import InputError
from sugiyama_ros.formats.registry import format_of, read_tracks
from sugiyama_ros.trajectories.leaders import gaps
from sugiyama_ros.trajectories.tracks import UNKNOWN

RADIUS_M, LENGTH_M = 80.0, 4.6


def place(way_m: np.ndarray) -> np.ndarray:
    """A place on a circle, (T, 2)."""
    return RADIUS_M * np.stack((np.cos(way_m / RADIUS_M), np.sin(way_m / RADIUS_M)), axis=-1)


def wide_table(cars: tuple[int, ...] = (1, 2, 3), samples: int = 600, degrees: bool = False) -> str:
    """Cars 25 m apart on a circle that they drive round more than once, with the gaps between them."""
    time = 0.1 * np.arange(samples)
    names, columns = ["Time"], [time + 100.0]
    for car in cars:
        east, north = place(12.0 * time - 25.0 * (car - cars[-1])).T
        first, second = (f"Lat{car}", f"Lon{car}") if degrees else (f"N{car}", f"E{car}")
        if degrees:
            # Zalaegerszeg, where a degree of longitude is shorter than one of latitude.
            north = 46.9 + np.degrees(north / 6_371_000.0)
            east = 16.8 + np.degrees(east / 6_371_000.0) / np.cos(np.radians(46.9))
        names += [f"Speed{car}", first, second]
        columns += [np.full(samples, 12.0), north, east]
    for car in cars:
        if car + 1 in cars:
            names.append(f"IVS{car}")
            columns.append(np.full(samples, 25.0 - LENGTH_M))
    head = [
        "Date,1,2,2019",
        "Vehicle_order,AUDI_A6,BMW_X5,TESLA_3,FIAT_500",
        "Number_of_vehicles,3",
        "ACC,1",
        "Distance_setting,min",
    ]
    rows = [",".join(f"{value:.12g}" for value in row) for row in np.stack(columns, axis=1)]
    return "\n".join([*head, ",".join(names), *rows]) + "\n"


@pytest.mark.parametrize("degrees", [False, True])
def test_positions_lie_along_the_common_path(tmp_path: Path, degrees: bool) -> None:
    path = tmp_path / "platoon.csv"
    path.write_text(wide_table(degrees=degrees))
    assert format_of(path).name == "openacc"
    tracks = read_tracks(path)
    assert tracks.vehicle.used() == ("1", "2", "3")
    assert tracks.vehicle_class.values()[::600].tolist() == ["audi_a6", "bmw_x5", "tesla_3"]
    assert tracks.leader.values()[::600].tolist() == [None, "1", "2"]
    # The path is made of chords of the circle, each a metre long or a bit more.
    np.testing.assert_allclose(np.diff(tracks.s_m[:600]), 1.2, atol=0.05)
    np.testing.assert_allclose(gaps(tracks)[600:], 25.0 - LENGTH_M, atol=0.03)
    np.testing.assert_allclose(tracks.length_m, LENGTH_M, atol=0.03)
    assert read_tracks(path).dense().vehicle.tolist() == [1, 2, 3]


def test_who_drives_behind_a_car_that_was_not_recorded_has_an_unknown_leader(tmp_path: Path) -> None:
    path = tmp_path / "platoon.csv"
    path.write_text(wide_table((1, 2, 4)))
    tracks = read_tracks(path)
    assert (tracks.leader_row[1200:] == UNKNOWN).all()
    with pytest.raises(InputError, match=r"vehicle ahead of 4 was not always recorded.* --without 4$"):
        read_tracks(path).dense()


def test_damaged_files_are_refused(tmp_path: Path) -> None:
    path = tmp_path / "platoon.csv"
    lines = wide_table().splitlines()
    path.write_text("\n".join([*lines[:10], lines[10].replace(",12,", ",fast,", 1), *lines[11:]]) + "\n")
    with pytest.raises(InputError, match=r"platoon.csv:11: column Speed1: 'fast' is not a number"):
        read_tracks(path)
    path.write_text("\n".join(lines[:6]).replace("E1", "X1") + "\n" + "\n".join(lines[6:]) + "\n")
    with pytest.raises(InputError, match=r"no column E1, N1 or Lat1, Lon1"):
        read_tracks(path)


def test_a_car_without_any_place_is_left_out(tmp_path: Path) -> None:
    path = tmp_path / "platoon.csv"
    lines = wide_table().splitlines()
    names = lines[5].split(",")
    gone = {names.index(name) for name in ("E2", "N2", "Speed2", "IVS1", "IVS2")}
    rows = [",".join("" if k in gone else one for k, one in enumerate(line.split(","))) for line in lines[6:]]
    path.write_text("\n".join([*lines[:6], *rows]) + "\n")
    tracks = read_tracks(path)
    assert tracks.vehicle.used() == ("1", "3")
    assert (tracks.leader_row == UNKNOWN).all()
    assert dict(tracks.about.dropped) == {"a car was not recorded": 600}
