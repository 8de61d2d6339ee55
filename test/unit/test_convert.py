"""``sugiyama convert`` and ``sugiyama info`` on tracks, as a user sees them."""

import json
import sys
from collections.abc import Callable
from pathlib import Path

import pytest

from sugiyama_ros import cli
from sugiyama_ros.formats.registry import read_tracks

Run = Callable[..., tuple[int, str, str]]


@pytest.fixture
def sugiyama(monkeypatch: pytest.MonkeyPatch, capfd: pytest.CaptureFixture[str]) -> Run:
    """Run a command in this process: exit code, stdout, stderr."""

    def run(*arguments: object) -> tuple[int, str, str]:
        monkeypatch.setattr(sys, "argv", ["sugiyama", *map(str, arguments)])
        with pytest.raises(SystemExit) as end:
            cli.main()
        out, err = capfd.readouterr()
        return int(end.value.code or 0), out, err

    return run


@pytest.fixture
def two_lanes(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """Four vehicles on two lanes for 20 s at 25 Hz, one of them a truck."""
    monkeypatch.chdir(tmp_path)
    lines = ["time_s,vehicle,s_m,lane,class,length_m"]
    for k in range(4):
        for i in range(501):
            length, kind = (12, "truck") if k == 3 else (4, "car")
            lines.append(f"{0.04 * i:.2f},veh_{k},{100 - 20 * k + 0.4 * i:.3f},{k % 2},{kind},{length}")
    path = tmp_path / "two.csv"
    path.write_text("\n".join(lines) + "\n")
    return path


def test_convert_and_info(sugiyama: Run, two_lanes: Path) -> None:
    code, out, err = sugiyama("convert", two_lanes, "two.parquet")
    assert (code, err) == (0, "")
    assert out.startswith("4 vehicles, 2004 rows, in two.parquet\n")
    told = sugiyama("info", "two.parquet")[1]
    for line in (
        "Format:      tracks",
        "Source:      two.csv",
        "Vehicles:    4",
        "Classes:     2: car (3), truck (1)",
        "Lanes:       2: 0 (2), 1 (2)",
        "Time:        0 to 20 s",
        "Period:      0.04 s",
        "Leaders:     50.0% in the table, 0.0% free road, 50.0% unknown",
    ):
        assert line in told
    document = json.loads(sugiyama("info", "two.parquet", "--json")[1])
    assert document["format"] == "tracks"
    assert document["classes"] == {"car": 3, "truck": 1}
    assert document["driven_s"] == pytest.approx(80.0)


def test_a_lane_is_cut_out_and_resampled(sugiyama: Run, two_lanes: Path) -> None:
    options = ("--lane", "1", "--from", "2", "--to", "10", "--period", "0.1")
    code, out, err = sugiyama("convert", two_lanes, "one.parquet", *options)
    assert (code, err) == (0, "")
    assert "Period:      0.1 s" in out
    assert " not selected" in out
    tracks = read_tracks(Path("one.parquet"))
    assert tracks.vehicle.used() == ("veh_1", "veh_3")
    assert (tracks.time_s.min(), tracks.time_s.max()) == (2.0, 10.0)
    assert read_tracks(Path("one.parquet")).dense().vehicle.tolist() == [1, 3]
    # The same lane as a bag.
    assert sugiyama("convert", two_lanes, "one.mcap", *options)[0] == 0
    assert read_tracks(Path("one.mcap")).dense().position_m.shape == (81, 2)


def test_classes_and_csv(sugiyama: Run, two_lanes: Path) -> None:
    code, _, _ = sugiyama("convert", two_lanes, "cars.csv", "--class", "car")
    assert code == 0
    assert read_tracks(Path("cars.csv")).runs == 3
    assert sugiyama("convert", two_lanes, "front.csv", "--reference", "front")[0] == 0
    shift = read_tracks(two_lanes).s_m - read_tracks(Path("front.csv")).s_m
    assert set(shift.round(9).tolist()) == {2.0, 6.0}


@pytest.mark.parametrize(
    ("arguments", "said"),
    [
        (("convert", "two.csv", "two.parquet", "--lane", "7"), "--lane 7: does not occur; choose among 0, 1"),
        (("convert", "two.csv", "two.parquet", "--format", "shp"), "format 'shp': not known; choose among"),
        (("convert", "two.csv", "two.parquet", "--reference", "middle"), "choose among centre, front, rear"),
        (("convert", "two.csv", "two.parquet", "--period", "0"), "period: 0 s cannot be used"),
        (("convert", "two.csv", "two.parquet", "--from", "30"), "no row is left; the times go from 0 to 20 s"),
        (("convert", "two.csv", "two.xlsx"), "two.xlsx: cannot be written as .xlsx"),
        (("convert", "two.csv", "two.mcap"), "2 lanes (0, 1) where one is needed"),
        (("convert", "two.csv", "none/two.parquet"), "none/two.parquet: cannot be written"),
        (("convert", "two.csv", "two.parquet", "--columns", "none.yaml"), "none.yaml: cannot be read"),
        (("info", "none.parquet"), "none.parquet: cannot be read"),
        (("study", "order", "two.csv"), "choose: sugiyama convert two.csv one.parquet --lane 0"),
    ],
)
def test_refusals_are_one_line(sugiyama: Run, two_lanes: Path, arguments: tuple[str, ...], said: str) -> None:
    code, out, err = sugiyama(*arguments)
    assert code == 2
    assert out == ""
    assert err.count("\n") == 1
    assert said in err
    assert [file.name for file in sorted(two_lanes.parent.iterdir())] == ["two.csv"]


@pytest.mark.parametrize(
    ("words", "why"),
    [
        (["--bridge", "none.yaml"], "--bridge: needs a bag of sightings"),
        (["--frame", "none"], "--frame: needs a bag of sightings"),
        (["--odometry", "/o", "--centerline", "line.csv", "--road-file", "m.osm"], "--road-file: does nothing with"),
        (["--odometry", "/o", "--centerline", "line.csv", "--ring", "40"], "--ring: does nothing with --odometry"),
    ],
)
def test_what_another_source_takes_is_refused(sugiyama: Run, two_lanes: Path, words: list[str], why: str) -> None:
    code, out, err = sugiyama("convert", two_lanes, "new.parquet", *words)
    assert (code, out, err.count("\n")) == (2, "", 1)
    assert err.startswith(f"error: {why}")
    assert not Path("new.parquet").exists()


def test_files_of_centres_take_no_reference(sugiyama: Run, two_lanes: Path) -> None:
    sugiyama("convert", two_lanes, "two.parquet")
    code, _, err = sugiyama("convert", "two.parquet", "new.parquet", "--reference", "front")
    assert (code, err.count("\n")) == (2, 1)
    assert "leave out the reference" in err
    assert sugiyama("convert", two_lanes, "new.parquet", "--reference", "front")[0] == 0
