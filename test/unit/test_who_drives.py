"""Who is a vehicle, and what somebody chooses before anything is checked."""

from pathlib import Path

import numpy as np
import pandas as pd
import pytest

import sugiyama_ros as sg
from sugiyama_ros.errors import InputError
from sugiyama_ros.formats.choices import Choices
from sugiyama_ros.formats.registry import read_tracks
from sugiyama_ros.trajectories.kinds import class_name
from sugiyama_ros.trajectories.selection import Selection, select
from sugiyama_ros.trajectories.tracks import Tracks

SAMPLES = 60


def rows(*vehicles: tuple[str, str, float, float]) -> pd.DataFrame:
    """Vehicles on one lane: name, class, position [m] at the start and speed [m/s]."""
    parts = [
        {"vehicle": name, "class": kind, "time_s": 0.1 * k, "s_m": start + 0.1 * speed * k, "lane": 1, "length_m": 4.5}
        for name, kind, start, speed in vehicles
        for k in range(SAMPLES)
    ]
    return pd.DataFrame(parts)


def first_leaders(tracks: Tracks) -> dict[str, str]:
    """The leader of each vehicle at its first sample; nothing where it is not known."""
    return {tracks.vehicle.at(row): tracks.leader.at(row) for row in tracks.start[:-1].tolist()}


@pytest.mark.parametrize(
    ("text", "name"),
    [
        ("Car", "car"),
        (" CAR ", "car"),
        ("parkedVehicle", "parked_vehicle"),
        ("Medium Vehicle", "medium_vehicle"),
        ("small-vehicle", "small_vehicle"),
        ("truck@f.1", "truck"),
        ("pedestrian/bicycle", "pedestrian/bicycle"),
    ],
)
def test_a_class_has_one_spelling(text: str, name: str) -> None:
    assert class_name(text) == class_name(name) == name


def test_a_walker_and_a_barrier_drive_nothing_and_hide_who_is_ahead() -> None:
    there = (("a", "Car", 90.0, 8.0), ("w", "Pedestrian", 80.0, 1.0), ("b", "car", 60.0, 1.0), ("c", "CAR", 30.0, 1.0))
    tracks = sg.read(rows(*there, ("x", "Barrier", 400.0, 0.0), ("y", "bicycle", 10.0, 1.0)))
    assert first_leaders(tracks) == {"a": "", "b": "", "c": "b", "y": "c"}
    assert tracks.vehicle_class is not None
    assert tracks.vehicle_class.used() == ("bicycle", "car")
    assert select(tracks, Selection(without=("w", "b"))).vehicle.used() == ("a", "c", "y")
    assert any("left out: 1 barrier, 1 pedestrian" in note for note in tracks.about.notes)
    assert dict(tracks.about.dropped) == {"no driver": 2 * SAMPLES}


def test_classes_that_change_count_by_most_of_their_rows() -> None:
    table = rows(("a", "car", 90.0, 8.0), ("b", "car", 60.0, 8.0), ("c", "car", 30.0, 8.0))
    table.loc[(table.vehicle == "a") & (table.time_s < 1.0), "class"] = "pedestrian"
    table.loc[(table.vehicle == "b") & (table.time_s > 1.0), "class"] = "pedestrian"
    assert set(first_leaders(sg.read(table))) == {"a", "c"}


def test_a_file_of_walkers_alone_is_refused() -> None:
    with pytest.raises(InputError, match=r"nobody drives a vehicle: 2 pedestrian; give a file with vehicles"):
        sg.read(rows(("a", "pedestrian", 90.0, 1.0), ("b", "Pedestrian", 60.0, 1.0)))


#: Six cars; a van is parked beside the lane, where they pass.
PASSED = (*((str(k), "car", 100.0 - 15.0 * k, 10.0) for k in range(6)), ("van", "van", 120.0, 0.0))


def test_who_is_in_the_way_is_named_and_can_be_left_out(tmp_path: Path) -> None:
    path = tmp_path / "passed.csv"
    rows(*PASSED).to_csv(path, index=False)
    with pytest.raises(InputError, match=r"behind vehicle van \(van\).*leave them out with --without van$"):
        read_tracks(path)
    for selection in (Selection(without=("van",)), Selection(vehicle_class=("Car",)), Selection(to_s=1.0)):
        tracks = read_tracks(path, Choices(selection=selection))
        assert np.isfinite(tracks.s_m).all()
    with pytest.raises(InputError, match="--class bus: does not occur; choose among car, van"):
        read_tracks(path, Choices(selection=Selection(vehicle_class=("bus",))))


def test_speeds_are_compared_with_those_of_the_chosen(tmp_path: Path) -> None:
    path, table = tmp_path / "speeds.csv", rows(("a", "car", 90.0, 8.0), ("b", "car", 60.0, 8.0))
    table["speed_mps"] = np.where(table.vehicle == "a", 8.0, 20.0)
    table.to_csv(path, index=False)
    with pytest.raises(InputError, match="by the speeds in the file"):
        read_tracks(path)
    assert read_tracks(path, Choices(selection=Selection(without=("b",)))).runs == 1


def test_files_are_chosen_from_before_they_are_checked(tmp_path: Path) -> None:
    for name in ("one", "two"):
        rows(*PASSED).to_csv(tmp_path / f"{name}.csv", index=False)
    with pytest.raises(InputError, match="--without van"):
        read_tracks(tmp_path)
    tracks = read_tracks(tmp_path, Choices(selection=Selection(recording=("two",), without=("van",))))
    assert (tracks.recording.used(), tracks.runs) == (("two",), 6)


@pytest.mark.parametrize("given", ["rear", None])
def test_noise_of_a_queue_that_stands_is_no_overlap(tmp_path: Path, given: str | None) -> None:
    """Rear bumpers with errors of 6 cm, and 10 cm between two vehicles; the vehicles ahead are longer."""
    rng, length = np.random.default_rng(1), np.array([12.0, 9.0, 6.0, 4.0])
    place = 100.0 - np.cumsum(length + 0.1) + 0.1
    table = rows(*((str(k), "car", s, 0.0) for k, s in enumerate(place.tolist())))
    table["s_m"] += rng.normal(0.0, 0.06, len(table))
    table["length_m"] = np.repeat(length, SAMPLES)
    if given is None:
        with pytest.raises(InputError, match="positions look like rear bumpers; give --reference rear"):
            sg.read(table)
    else:
        assert first_leaders(sg.read(table, reference=given)) == {"0": "", "1": "0", "2": "1", "3": "2"}
