"""Plain tables, tracks in Parquet and folders: accepted, or refused with one line that says the cure."""

import json
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from pyarrow import parquet

from sugiyama_ros.errors import InputError
from sugiyama_ros.formats.choices import Choices, read_choices
from sugiyama_ros.formats.convert import convert
from sugiyama_ros.formats.registry import format_of, read_tracks
from sugiyama_ros.formats.tracks_parquet import write_tracks
from sugiyama_ros.trajectories.dense import DenseTracks
from sugiyama_ros.trajectories.exchange import KEY
from sugiyama_ros.trajectories.time_base import is_regular, period_of
from sugiyama_ros.trajectories.tracks import Tracks

HEADER = ("time_s", "vehicle", "position_m", "length_m")
Cells = Callable[[int, int, float, float], tuple[object, ...]]


def plain(k: int, i: int, time: float, s: float) -> tuple[object, ...]:
    return f"{time:.1f}", k, f"{s:.3f}", 4.5


def table(cells: Cells = plain, separator: str = ",", vehicles: int = 3, header: tuple[str, ...] = HEADER) -> str:
    """A platoon of 200 samples; vehicle 0 is in front, 20 m between two of them, 10 m/s."""
    lines = [separator.join(header)]
    for k in range(vehicles):
        for i in range(200):
            lines.append(separator.join(map(str, cells(k, i, 0.1 * i, 20.0 * (vehicles - k) + i))))
    return "\n".join(lines) + "\n"


def both(path: Path, content: str) -> tuple[Tracks, DenseTracks]:
    path.write_text(content)
    return read_tracks(path), read_tracks(path).dense()


def refused(act: Callable[[Path], object], path: Path, content: str) -> str:
    path.write_text(content)
    with pytest.raises(InputError) as caught:
        act(path)
    text = str(caught.value)
    assert "\n" not in text
    assert path.name in text
    return text


@pytest.mark.parametrize(
    ("cells", "separator", "numbers"),
    [
        (lambda k, i, t, s: (f"{t:.1f}", f"veh_{k + 4}", f"{s:.3f}", 4.5), ",", [4, 5, 6]),
        (lambda k, i, t, s: (f"{t:.1f}", f"{k + 10}.0", f"{s:.3f}", 4.5), ",", [10, 11, 12]),
        (lambda k, i, t, s: (1700000000000 + 100 * i, k, f"{s:.3f}", 4.5), ",", [0, 1, 2]),
        (plain, ";", [0, 1, 2]),
        (plain, "\t", [0, 1, 2]),
        (plain, "   ", [0, 1, 2]),
        (lambda k, i, t, s: (f"{t:.1f}".replace(".", ","), k, f"{s:.3f}".replace(".", ","), "4,5"), ";", [0, 1, 2]),
        (lambda k, i, t, s: (f"{t:.1f}", k, "nan" if i % 17 == 3 else f"{s:.3f}", 4.5), ",", [0, 1, 2]),
        (lambda k, i, t, s: (f"{t:.1f}", k, "" if i % 17 == 3 else f"{s:.3f}", 4.5), ",", [0, 1, 2]),
    ],
    ids=["veh_1", "12.0", "epoch ms", ";", "tabs", "blanks", "decimal comma", "nan", "empty"],
)
def test_what_users_write_is_accepted(tmp_path: Path, cells: Cells, separator: str, numbers: list[int]) -> None:
    tracks, dense = both(tmp_path / "a.csv", table(cells, separator))
    assert dense.vehicle.tolist() == numbers
    assert dense.period_s == pytest.approx(0.1, abs=1e-6)
    assert dense.position_m.shape == (200, 3)
    np.testing.assert_array_equal(dense.leader[0], [-1, 0, 1])
    assert tracks.runs == 3
    assert tracks.leader.used()[:2] == tracks.vehicle.used()[:2]
    assert len(tracks) + sum(dict(tracks.about.dropped).values()) == 600


@pytest.mark.parametrize(
    "cells",
    [
        lambda k, i, t, s: (f"{t + 0.03 * np.sin(i * k + i):.3f}", k, f"{s:.3f}", 4.5),
        lambda k, i, t, s: (f"{t + 0.03 * k:.2f}", k, f"{s:.3f}", 4.5),
    ],
    ids=["jitter above 10 %", "offset clocks"],
)
def test_irregular_times_are_resampled(tmp_path: Path, cells: Cells) -> None:
    path = tmp_path / "a.csv"
    path.write_text(table(cells))
    tracks = read_tracks(path)
    assert is_regular(tracks)
    assert period_of(tracks) == 0.1
    assert tracks.leaders_known > 0.66
    write_tracks(tracks, tmp_path / "even.parquet")
    assert len(read_tracks(tmp_path / "even.parquet").dense().vehicle) == 3


def test_overlaid_pairs_are_refused(tmp_path: Path) -> None:
    path = tmp_path / "a.csv"
    same = table(lambda k, i, t, s: (f"{t:.1f}", k % 2, f"{s + 50 * k:.3f}", 4.5), vehicles=6)
    assert "vehicle 0 is at 120 m and at 180 m at 0 s" in refused(read_tracks, path, same)
    crossing = table(lambda k, i, t, s: (f"{t:.1f}", k, f"{s + 3 * t * (k // 2 % 2):.3f}", 4.5), vehicles=8)
    path.write_text(crossing)
    (note,) = [note for note in read_tracks(path).about.notes if "of the gaps are below zero" in note]
    assert "give the column lane or recording, or the unit (--columns)" in note
    apart = table(
        lambda k, i, t, s: (f"{t:.1f}", k, f"{s + 3 * t * (k // 2 % 2):.3f}", 4.5, k // 2),
        vehicles=8,
        header=(*HEADER, "recording"),
    )
    path.write_text(apart)
    assert len(read_tracks(path).recording.used()) == 4


@pytest.mark.parametrize(
    ("content", "said"),
    [
        ("a,b\n1,2\n", "a.csv:1: no column vehicle or vehicle_id, time_s, s_m or position_m; the columns are a, b"),
        (table().replace("19.9,2,", "19.9,veh_2,extra,"), "a.csv:601: 5 fields, but 4 columns"),
        (table(separator=";").replace("19.9;2;", "19.9;2;far;"), "a.csv:601: 5 fields, but 4 columns"),
        (
            table(separator=";").replace("0.3;1;43.000", "0.3;1;far"),
            "a.csv:205: column position_m: 'far' is not a number",
        ),
        (table(separator=";").replace("0.3;1;43.000", "0.3;1;"), ""),
        ("vehicle;time_s;s_m\n", "no samples"),
        ("vehicle;time_s;s_m\na;;\n", "no row has a vehicle, a time and a position"),
        ("vehicle;time_s;s_m\na;1;2\n", "no vehicle has two samples"),
        ("vehicle;time_s;s_m\nfree;1;2\nfree;2;2\n", "a vehicle is called 'free'"),
        ("vehicle;time_s;s_m\n" + "1" * 5_000_000, "not a table of positions"),
    ],
)
def test_bad_tables(tmp_path: Path, content: str, said: str) -> None:
    path = tmp_path / "a.csv"
    if not said:
        path.write_text(content)
        assert read_tracks(path).about.dropped == (("no position", 1),)
        return
    assert said in refused(lambda one: read_tracks(one).dense(), path, content)


def test_a_map_of_columns(tmp_path: Path) -> None:
    path, names = tmp_path / "mine.csv", tmp_path / "map.yaml"
    path.write_text(
        table(lambda k, i, t, s: (100 * i, f"car {k}", f"{s / 0.3048:.3f}", 15.0), header=("ms", "who", "feet", "long"))
    )
    names.write_text(
        "vehicle: who\ntime_s: {column: ms, factor: 0.001}\ns_m: {column: feet, factor: 0.3048}\n"
        "length_m: {column: long, factor: 0.3048}\nreference: rear\nview: whole\n"
    )
    choices = read_choices(names)
    tracks = read_tracks(path, choices)
    assert tracks.time_s[1] == pytest.approx(0.1)
    assert tracks.s_m[0] == pytest.approx(60.0 + 0.5 * 15.0 * 0.3048, abs=1e-3)
    assert tracks.leaders_known == 1.0
    with pytest.raises(InputError, match=r"mine.csv:1: no column far; the columns are ms, who, feet, long"):
        read_tracks(path, Choices({**choices.columns, "lane": ("far", 1.0)}))


@pytest.mark.parametrize(
    ("content", "said"),
    [
        ("[1, 2]", "not a map of columns"),
        ("lane: {", "is no YAML"),
        ("mood: v", "'mood' is no column of tracks"),
        ("lane: {name: a}", "lane: give the name of a column"),
        ("s_m: {column: a, factor: b}", "factor of s_m: 'b' is no finite number"),
        ("s_m: {column: a, factor: 0}", "factor of s_m: 0 is no unit's factor"),
        ("s_m: {column: a, factor: 1.0e+308}", "factor of s_m: 1e+308 is no unit's factor"),
        ("reference: middle", "reference 'middle' is not known; choose among centre, front, rear"),
        ("ring_m: round", "ring_m: 'round' is no finite number"),
        ("ring_m: -5", "ring: -5.0 m is not a circumference"),
        ("ring_m: " + "9" * 400, "is no finite number"),
        ("lane: &a [x]\nreference: *a", "has aliases"),
    ],
)
def test_bad_maps(tmp_path: Path, content: str, said: str) -> None:
    assert said in refused(read_choices, tmp_path / "map.yaml", content)


@pytest.mark.parametrize(("name", "value"), [("ring_m", float("inf")), ("view", "side"), ("source", 1)])
def test_tracks_that_say_odd_things_of_themselves_are_refused(tmp_path: Path, name: str, value: object) -> None:
    source, path = tmp_path / "a.csv", tmp_path / "a.parquet"
    source.write_text(table())
    write_tracks(read_tracks(source), path)
    tracks = parquet.read_table(path)
    said = json.loads(tracks.schema.metadata[KEY]) | {name: value}
    parquet.write_table(tracks.replace_schema_metadata({KEY: json.dumps(said)}), path)
    with pytest.raises(InputError, match=r"a.parquet: does not say that it holds tracks"):
        read_tracks(path, name="tracks")


def test_tracks_come_back_from_parquet_and_csv(tmp_path: Path) -> None:
    path = tmp_path / "a.csv"
    path.write_text(
        table(lambda k, i, t, s: (*plain(k, i, t, s), k // 2, "car"), header=(*HEADER, "lane", "class"), vehicles=4)
    )
    given = read_tracks(path)
    for name in ("b.parquet", "b.csv"):
        write_tracks(given, tmp_path / name)
        back = read_tracks(tmp_path / name)
        np.testing.assert_array_equal(back.leader_row, given.leader_row)
        np.testing.assert_array_equal(back.s_m, given.s_m)
        assert back.columns == given.columns
        assert back.vehicle_class.values().tolist() == given.vehicle_class.values().tolist()
    assert format_of(tmp_path / "b.parquet").name == "tracks"
    assert read_tracks(tmp_path / "b.parquet").about == given.about


def test_lanes_that_are_filled_in_say_who_leads(tmp_path: Path) -> None:
    path = tmp_path / "a.csv"
    path.write_text(table(lambda k, i, t, s: (*plain(k, i, t, s), "", ""), header=(*HEADER, "lane", "leader")))
    assert read_tracks(path).leaders_known == 0.0
    path.write_text(table(lambda k, i, t, s: (*plain(k, i, t, s), "1", ""), header=(*HEADER, "lane", "leader")))
    assert read_tracks(path).leader.values()[::200].tolist() == [None, "0", "1"]


def test_every_file_of_a_folder_is_a_recording(tmp_path: Path) -> None:
    folder = tmp_path / "drives"
    folder.mkdir()
    (folder / "one.csv").write_text(table())
    (folder / "two.csv").write_text(table(vehicles=2, separator=";"))
    (folder / "notes.txt").write_text("nothing of interest\n")
    (folder / "README.txt").write_text("read me\n")
    tracks = read_tracks(folder)
    assert tracks.recording.used() == ("one", "two")
    assert tracks.runs == 5
    assert "files of no known format were left out: notes.txt" in tracks.about.notes
    with pytest.raises(InputError, match=r"2 recordings \(one, two\)"):
        read_tracks(folder).dense()
    (folder / "three.csv").write_text("a,b\n")
    with pytest.raises(InputError, match=r"three.csv:1: no column"):
        read_tracks(folder)


LINES = """\
vehicle,time_s,s_m,length_m,leader,line_m,arrive_s,clear_s,curvature_per_m,leader_shift_m
a,0.0,10,4.5,b,60,2.5,4.5,0,-30
a,0.1,11,4.5,b,60,0,inf,0,-30
a,0.2,12,4.5,b,60,inf,-0.5,0.02,-30
a,0.3,13,4.5,free,,,,0.02,
a,0.4,14,4.5,free,60,3.0,,inf,
b,0.0,70,4.5,free,,,,,
b,0.1,71,4.5,free,,,,,
b,0.2,72,4.5,free,,,,,
b,0.3,73,4.5,free,,,,,
b,0.4,74,4.5,free,,,,,
"""


def test_lines_and_shifts_are_read_and_written_as_they_are(tmp_path: Path) -> None:
    """Times may be infinite. A line without its times is none, and no other number is infinite."""
    (tmp_path / "lines.csv").write_text(LINES)
    tracks = read_tracks(tmp_path / "lines.csv")
    nan, inf = np.nan, np.inf
    expected = {
        "line_m": [60, 60, 60, nan, nan],
        "arrive_s": [2.5, 0, inf, nan, 3.0],
        "clear_s": [4.5, inf, -0.5, nan, nan],
        "curvature_per_m": [0, 0, 0.02, 0.02, nan],
        "leader_shift_m": [-30, -30, -30, nan, nan],
    }
    for name, values in expected.items():
        np.testing.assert_array_equal(tracks.column(name)[:5], values)
    assert tracks.leader.at(1) == "b"
    assert "lines without arrive_s and clear_s: 1 rows" in tracks.about.notes[0]
    for name in ("again.csv", "again.parquet"):
        write_tracks(tracks, tmp_path / name)
        again = read_tracks(tmp_path / name)
        assert again.columns == tracks.columns
        for column in (*expected, "s_m", "leader_row"):
            np.testing.assert_array_equal(getattr(again, column), getattr(tracks, column))
    with pytest.raises(InputError, match=r"one lane is needed; keep them as tracks"):
        convert(tmp_path / "lines.csv", tmp_path / "one.mcap")


def test_where_positions_are_turned_round_lines_and_shifts_are_too(tmp_path: Path) -> None:
    rows = [line.split(",") for line in LINES.splitlines()]
    for row in rows[1:]:
        row[2], row[5] = str(100 - 10 * float(row[2])), str(100 - 10 * float(row[5])) if row[5] else ""
        row[9] = str(-10 * float(row[9])) if row[9] else ""
    (tmp_path / "back.csv").write_text("\n".join(map(",".join, rows)))
    tracks = read_tracks(tmp_path / "back.csv")
    assert "turned round" in " ".join(tracks.about.notes)
    np.testing.assert_allclose(tracks.line_m[:3] - tracks.s_m[:3], [500, 490, 480])
    ahead = tracks.s_m[tracks.leader_row[:3]] + tracks.leader_shift_m[:3]
    np.testing.assert_allclose(ahead - tracks.s_m[:3], 300)
