"""SUMO's floating car data as XML, CSV and Parquet."""

from pathlib import Path

import numpy as np
import pytest

from sugiyama_ros.errors import InputError
from sugiyama_ros.formats.registry import format_of, read_tracks
from sugiyama_ros.trajectories.leaders import gaps

EDGE_M, JUNCTION_M, SPEED, PERIOD = 100.0, 6.0, 10.0, 0.5
NAMES = ("timestep_time", "vehicle_id", "vehicle_x", "vehicle_type", "vehicle_speed", "vehicle_pos", "vehicle_lane")


def rows(samples: int = 60) -> list[tuple[float, str, float, str, float, float, str, str]]:
    """Two lanes over two edges with a junction between them: three vehicles on lane 0, two on lane 1."""
    found = []
    for i in range(samples):
        for name, lane, start in (("a", 0, 60.0), ("b", 0, 40.0), ("c", 0, 15.0), ("d", 1, 50.0), ("e", 1, 20.0)):
            s = start + SPEED * PERIOD * i
            if s >= 2.0 * EDGE_M + JUNCTION_M:
                continue
            if s < EDGE_M:
                edge, pos = "in", s
            elif s < EDGE_M + JUNCTION_M:
                edge, pos = ":mid_0", s - EDGE_M
            else:
                edge, pos = "out", s - EDGE_M - JUNCTION_M
            leader = {"b": "a", "c": "b", "e": "d"}.get(name, "")
            found.append((PERIOD * i, name, s, "car", SPEED, pos, f"{edge}_{lane}", leader))
    return found


def xml(**more: str) -> str:
    lines, time = ["<?xml version='1.0'?>", "<fcd-export>"], None
    for t, name, x, kind, speed, pos, lane, leader in rows():
        if t != time:
            lines += ["</timestep>"] * (time is not None) + [f'<timestep time="{t:.2f}">']
            time = t
        lines.append(
            f'<vehicle id="{name}" x="{x}" y="0" angle="90" type="{kind}" speed="{speed}" pos="{pos}" lane="{lane}"'
            f' slope="0" leaderID="{leader}"/>'
        )
    return "\n".join([*lines, "</timestep>", '<timestep time="99.00"/>', "</fcd-export>"]) + "\n"


def check(path: Path) -> None:
    assert format_of(path).name == "sumo"
    tracks = read_tracks(path)
    assert tracks.vehicle.used() == ("a", "b", "c", "d", "e")
    assert tracks.lane.used() == ("0", "1")
    assert tracks.road is None
    leaders = tracks.leader.values()
    firsts = dict(
        zip(tracks.vehicle.values()[tracks.start[:-1]].tolist(), leaders[tracks.start[:-1]].tolist(), strict=True)
    )
    assert firsts == {"a": None, "b": "a", "c": "b", "d": None, "e": "d"}
    # The edges follow one another without a jump: speed is the same everywhere, and so are the gaps.
    moved = np.diff(tracks.s_m)[np.diff(tracks.run) == 0]
    np.testing.assert_allclose(moved, SPEED * PERIOD, atol=1e-9)
    gap = gaps(tracks)
    np.testing.assert_allclose(gap[(tracks.vehicle.code == 1) & np.isfinite(gap)], 15.0, atol=1e-9)
    assert "lengths are not in the file: every vehicle counts as 5 m long" in tracks.about.notes


def test_xml(tmp_path: Path) -> None:
    path = tmp_path / "fcd.xml"
    path.write_text(xml())
    check(path)
    assert "the next vehicle ahead is the given leader in 100 %" in read_tracks(path).about.notes


@pytest.mark.parametrize("order", [1, -1])
def test_csv_in_any_order_of_columns(tmp_path: Path, order: int) -> None:
    path = tmp_path / "fcd.csv"
    lines = [";".join(map(str, row[:7][::order])) for row in rows()]
    path.write_text("\n".join([";".join(NAMES[::order]), *lines]) + "\n")
    check(path)


def test_parquet(tmp_path: Path) -> None:
    import pyarrow
    from pyarrow import parquet

    path = tmp_path / "fcd.parquet"
    parquet.write_table(
        pyarrow.table(dict(zip(NAMES, map(list, zip(*(r[:7] for r in rows()), strict=True)), strict=True))), path
    )
    check(path)


@pytest.mark.parametrize(
    ("old", "new", "said"),
    [
        ('pos="60.0"', 'pos="x"', "fcd.xml: vehicle a at 0 s: pos 'x' is not a number"),
        ('speed="10.0"', "", "fcd.xml: vehicle a at 0 s: no attribute speed; write the file with it"),
        ("</timestep>", "</step>", "fcd.xml:9: not XML"),
        ('lane="in_0"', 'lane="in"', "lane 'in': does not end in _ and a number"),
        ("<?xml version='1.0'?>", '<?xml version="1.0" encoding="UTF-32"?>', "fcd.xml: its encoding cannot be read"),
        ("<fcd-export>", "<!DOCTYPE x [<!ENTITY a 'b'>]><fcd-export>", "fcd.xml: declares a document type"),
    ],
)
def test_damaged_xml(tmp_path: Path, old: str, new: str, said: str) -> None:
    path = tmp_path / "fcd.xml"
    path.write_text(xml().replace(old, new))
    with pytest.raises(InputError) as caught:
        read_tracks(path)
    assert said in str(caught.value)
    assert "\n" not in str(caught.value)


def test_edges_that_close_make_a_ring(tmp_path: Path) -> None:
    path = tmp_path / "fcd.csv"
    lines = []
    for i in range(120):
        for name, start in (("a", 100.0), ("b", 60.0), ("c", 20.0)):
            s = (start + SPEED * PERIOD * i) % 150.0
            edge, pos = ("north", s) if s < 90.0 else ("south", s - 90.0)
            lines.append(f"{PERIOD * i};{name};0;car;{SPEED};{pos};{edge}_0")
    path.write_text("\n".join([";".join(NAMES), *lines]) + "\n")
    tracks = read_tracks(path)
    assert tracks.about.ring_m == pytest.approx(150.0)
    assert tracks.leader.values()[tracks.start[:-1]].tolist() == ["c", "a", "b"]
    assert read_tracks(path).dense().road.circumference_m == pytest.approx(150.0)


def test_roads_that_part_are_roads_of_their_own(tmp_path: Path) -> None:
    path = tmp_path / "fcd.csv"
    lines = []
    for i in range(30):
        for name, start, after in (("a", 60.0, "left"), ("b", 40.0, "right"), ("c", 20.0, "right")):
            s = start + SPEED * PERIOD * i
            edge, pos = ("in", s) if s < EDGE_M else (after, s - EDGE_M)
            lines.append(f"{PERIOD * i};{name};0;car;{SPEED};{pos};{edge}_0")
    path.write_text("\n".join([";".join(NAMES), *lines]) + "\n")
    tracks = read_tracks(path)
    assert tracks.road.used() == ("in", "left")
    assert tracks.leader.values()[tracks.start[1:] - 1].tolist() == [None, None, "b"]
