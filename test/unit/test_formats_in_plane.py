"""Vehicles in the plane: INTERACTION, inD and floating car data of SUMO, put on the lanes of a road."""

import re
import sys
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

import sugiyama_ros as sg
from sugiyama_ros import cli
from sugiyama_ros.errors import InputError
from sugiyama_ros.formats.registry import format_of
from sugiyama_ros.formats.road_csv import write_road
from sugiyama_ros.roads.examples import roundabout
from sugiyama_ros.roads.network import Lanelet, Network
from sugiyama_ros.roads.network import Path as Route

#: Routes of three vehicles, and the step at which each begins; the second follows the first.
WAYS = ((["in1", "ring1_2", "out2"], 0), (["in1", "ring1_2", "out2"], 40), (["in3", "ring3_4", "out4"], 0))
SPEED = 8.0
HEAD = "case_id,track_id,frame_id,timestamp_ms,agent_type,x,y,vx,vy,psi_rad,length,width"


@pytest.fixture
def network() -> Network:
    return roundabout()


def drives(network: Network, step_s: float) -> list[tuple[int, int, float, float, float]]:
    """Vehicle, number of the step, place x, y [m], and heading [rad] of each row."""
    rows = []
    for vehicle, (way, first) in enumerate(WAYS):
        path: Route = network.path(way)
        s = np.arange(5.0, path.length_m, SPEED * step_s)
        x, y, heading = path.at(s)
        rows += [(vehicle, first + k, *row) for k, row in enumerate(zip(x, y, heading, strict=True))]
    return rows


def interaction(folder: Path, network: Network) -> Path:
    path = folder / "vehicle_tracks_000.csv"
    lines = [HEAD]
    for v, k, x, y, heading in drives(network, 0.1):
        speed = f"{SPEED * np.cos(heading):.4f},{SPEED * np.sin(heading):.4f}"
        lines.append(f"1,{v},{k},{100 * k},car,{x:.3f},{y:.3f},{speed},{heading:.4f},4.5,1.8")
    path.write_text("\n".join(lines) + "\n")
    return path


def ind(folder: Path, network: Network) -> Path:
    path = folder / "07_tracks.csv"
    lines = ["recordingId,trackId,frame,trackLifetime,xCenter,yCenter,heading,width,length,xVelocity,yVelocity"]
    for v, k, x, y, heading in drives(network, 0.04):
        speed = f"{SPEED * np.cos(heading):.4f},{SPEED * np.sin(heading):.4f}"
        degrees = np.degrees(heading) % 360.0
        # places count from an origin of the recording
        lines.append(f"7,{v},{k},0,{x + 100.0:.3f},{y - 50.0:.3f},{degrees:.3f},1.8,4.5,{speed}")
    walker = [f"7,9,{k},0,{100.0 + 0.05 * k},-50,0,0,0,1,0" for k in range(50)]
    path.write_text("\n".join(lines + walker) + "\n")
    (folder / "07_tracksMeta.csv").write_text("trackId,class\n0,car\n1,car\n2,truck_bus\n9,pedestrian\n")
    (folder / "07_recordingMeta.csv").write_text("recordingId,frameRate,xUtmOrigin,yUtmOrigin\n7,25,-100,50\n")
    return path


def sumo(folder: Path, network: Network) -> Path:
    path = folder / "fcd.xml"
    steps: dict[int, list[str]] = {}
    for v, k, x, y, heading in drives(network, 0.1):
        place = f'x="{x:.3f}" y="{y:.3f}" angle="{(90.0 - np.degrees(heading)) % 360.0:.3f}"'
        steps.setdefault(k, []).append(f'<vehicle id="{v}" {place} speed="{SPEED}" pos="0" lane="e_0" type="car"/>')
    text = "".join(f'<timestep time="{0.1 * k:.1f}">{"".join(rows)}</timestep>' for k, rows in sorted(steps.items()))
    path.write_text(f"<fcd-export>{text}</fcd-export>")
    return path


@pytest.mark.parametrize(
    ("write", "name", "front_m"), [(interaction, "interaction", 0.0), (ind, "highd", 0.0), (sumo, "sumo", 2.5)]
)
def test_vehicles_in_the_plane_are_put_on_a_road(
    tmp_path: Path, network: Network, write: Callable[[Path, Network], Path], name: str, front_m: float
) -> None:
    path = write(tmp_path, network)
    assert format_of(path).name == name
    tracks = sg.read(path, road=network)
    assert tracks.vehicle.used() == ("0", "1", "2")
    for vehicle, (way, _) in enumerate(WAYS):
        rows = tracks.vehicle.code == vehicle
        assert set(tracks.lane.values()[rows].tolist()) == set(way)
        s = tracks.s_m[rows]
        np.testing.assert_allclose(s - s[0], SPEED * (tracks.time_s[rows] - tracks.time_s[rows][0]), atol=0.01)
        assert s[0] + front_m == pytest.approx(5.0, abs=0.01)
        np.testing.assert_allclose(tracks.d_m[rows], 0.0, atol=0.01)


def test_a_file_in_the_plane_needs_a_road_and_others_take_none(tmp_path: Path, network: Network) -> None:
    path = interaction(tmp_path, network)
    with pytest.raises(
        InputError,
        match=r"without lanes; convert .*: sugiyama convert \S+ tracks.parquet --road-file",
    ):
        sg.read(path)
    with pytest.raises(
        InputError,
        match=r"no column leadId: .*; convert .*: sugiyama convert \S+ tracks.parquet --road-file",
    ):
        sg.read(ind(tmp_path, network))
    table = tmp_path / "table.csv"
    table.write_text("vehicle,time_s,s_m\na,0,0\na,1,1\n")
    with pytest.raises(InputError, match=r"format table, which takes no road; those do: highd, interaction, sumo"):
        sg.read(table, road=network)
    with pytest.raises(InputError, match=r"road: a data frame has positions along a road of its own"):
        sg.read(sg.read(table).to_frame(), road=network)


def test_lengths_follow_from_gaps_over_two_edges_of_a_road(tmp_path: Path) -> None:
    """A truck, a car behind it, and a car that nobody follows."""
    path, steps = tmp_path / "fcd.xml", []
    for k in range(40):
        rows = []
        for name, kind, front, led in (
            ("t", "truck", 80.0, 'leaderID="" leaderGap="-1"'),
            ("a", "car", 50.0, 'leaderID="t" leaderGap="18"'),
            ("b", "car", 30.0, 'leaderID="a" leaderGap="15.5"'),
        ):
            x = front + 2.0 * k
            lane, pos = ("e_0", x) if x < 100.0 else ("f_0", x - 100.0)
            at = f'x="{x}" y="0" angle="90" pos="{pos}" lane="{lane}" speed="10"'
            rows.append(f'<vehicle id="{name}" type="{kind}" {at} {led}/>')
        steps.append(f'<timestep time="{0.2 * k:.1f}">{"".join(rows)}</timestep>')
    path.write_text(f"<fcd-export>{''.join(steps)}</fcd-export>")
    lanes = (
        Lanelet("e_0", np.array([0.0, 100.0]), np.zeros(2), ("f_0",)),
        Lanelet("f_0", np.array([100.0, 300.0]), np.zeros(2)),
    )
    tracks = sg.read(path, road=Network(lanes))
    lengths = dict(zip(tracks.vehicle.values().tolist(), tracks.length_m.tolist(), strict=True))
    assert lengths == {"t": 12.0, "a": 4.5, "b": 4.5}
    assert (
        "lengths of 2 vehicles follow from the gaps of those behind, of 1 from others of their type"
        in tracks.about.notes
    )


def shifted(path: Path, east_m: float, north_m: float, scale: float = 1.0) -> Path:
    """Floating car data in another frame."""

    def moved(said: "re.Match[str]") -> str:
        x, y = float(said[1]) * scale + east_m, float(said[2]) * scale + north_m
        return f'x="{x:.7f}" y="{y:.7f}"'

    path.write_text(re.sub(r'x="([^"]*)" y="([^"]*)"', moved, path.read_text()))
    return path


@pytest.mark.parametrize(
    ("frame", "error"),
    [
        ((11.0, 48.0, 1e-5), r"places such as 1\d\.\d+, 4\d\.\d+ are degrees; write the file without --fcd-output.geo"),
        (
            (3e5, 5e6),
            r"they are 5,009 km beside it; the road likely counts from an origin of its own",
        ),
        ((0.0, 2000.0), r"they are 1,801 m beside it; the road is of another place; write the file"),
    ],
)
def test_vehicles_beside_the_road_are_told_how_far(
    tmp_path: Path, network: Network, frame: tuple[float, ...], error: str
) -> None:
    with pytest.raises(InputError, match=rf"^fcd\.xml: no vehicle is on the road: {error}"):
        sg.read(shifted(sumo(tmp_path, network), *frame), road=network)


def test_vehicles_from_an_origin_of_their_own_need_the_metadata(tmp_path: Path, network: Network) -> None:
    far = Network(tuple(replace(one, x_m=one.x_m + 4e5, y_m=one.y_m + 5e6) for one in network.lanes))
    path = ind(tmp_path, network)
    (tmp_path / "07_recordingMeta.csv").rename(tmp_path / "away.csv")
    with pytest.raises(InputError, match=r"5,016 km beside it; the vehicles .*; put 07_recordingMeta\.csv beside"):
        sg.read(path, road=far)
    # the cure works
    text = "recordingId,frameRate,xUtmOrigin,yUtmOrigin\n7,25,399900,5000050\n"
    (tmp_path / "07_recordingMeta.csv").write_text(text)
    assert sg.read(path, road=far).lane.used() == sg.read(sumo(tmp_path, network), road=network).lane.used()


def test_vehicles_that_drive_against_all_lanes_are_told_so(tmp_path: Path) -> None:
    path, place = tmp_path / "vehicle_tracks_000.csv", np.array([0.0, 200.0])
    rows = [f"1,0,{k},{100 * k},car,{150.0 - k},0,-10,0,{np.pi},4.5,1.8" for k in range(100)]
    path.write_text("\n".join([HEAD, *rows]) + "\n")
    with pytest.raises(InputError, match=r"they are among its lanes, but not on a lane that points their way; check"):
        sg.read(path, road=Network((Lanelet("east", place, np.zeros(2)),)))


def test_the_command_takes_a_road(tmp_path: Path, network: Network, monkeypatch: pytest.MonkeyPatch) -> None:
    write_road(network, tmp_path / "road.csv")
    path, output = interaction(tmp_path, network), tmp_path / "tracks.parquet"
    command = ["sugiyama", "convert", str(path), str(output), "--road-file", str(tmp_path / "road.csv")]
    monkeypatch.setattr(sys, "argv", command)
    with pytest.raises(SystemExit) as end:
        cli.main()
    assert not end.value.code
    assert set(sg.read(output).lane.used()) == {"in1", "ring1_2", "out2", "in3", "ring3_4", "out4"}


def test_info_takes_a_road(
    tmp_path: Path, network: Network, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    write_road(network, tmp_path / "road.csv")
    command = ["sugiyama", "info", str(interaction(tmp_path, network)), "--road-file", str(tmp_path / "road.csv")]
    monkeypatch.setattr(sys, "argv", command)
    with pytest.raises(SystemExit) as end:
        cli.main()
    assert not end.value.code
    assert "Vehicles:    3" in capsys.readouterr().out


def test_who_may_walk_or_ride_is_no_driver_and_a_bicycle_is(tmp_path: Path, network: Network) -> None:
    path = interaction(tmp_path, network)
    text = path.read_text()
    path.write_text(text.replace(",car,", ",Bicycle,"))
    tracks = sg.read(path, road=network)
    assert tracks.vehicle_class is not None
    assert (tracks.runs, tracks.vehicle_class.used()) == (3, ("bicycle",))
    rows = text.splitlines()
    path.write_text(
        "\n".join(row.replace(",car,", ",pedestrian/bicycle,") if row[:3] == "1,2" else row for row in rows)
    )
    tracks = sg.read(path, road=network)
    assert tracks.vehicle.used() == ("0", "1")
    assert "no drivers, and left out: 1 pedestrian/bicycle" in tracks.about.notes
    path.write_text(text.replace(",car,", ",pedestrian/bicycle,"))
    with pytest.raises(InputError, match="nobody drives a vehicle: 3 pedestrian/bicycle; give a file with vehicles"):
        sg.read(path, road=network)
