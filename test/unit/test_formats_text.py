"""The MSTF ring file and plain CSV, good and bad."""

import hashlib
from pathlib import Path

import numpy as np
import pytest

from sugiyama_ros.errors import InputError
from sugiyama_ros.formats.choices import Choices
from sugiyama_ros.formats.registry import read_tracks
from sugiyama_ros.road import Road
from sugiyama_ros.trajectories.about import DEFAULT_LENGTH_M
from sugiyama_ros.trajectories.dense import DenseTracks, whole_road
from sugiyama_ros.trajectories.time_base import regular_time_base

MSTF = """# Some experiment
#   Total number of car is 2 and circuit length is 100m.
#
10.0 0.000
13.0 0.333
16.0 0.667

98.0 0.000
100.0 0.333
2.0 0.667
"""

CSV = """vehicle,time_s,position_m,length_m
7,0.0,1.5,4.0
7,0.1,2.5,4.0
3,0.0,11.5,5.0
3,0.1,,5.0
3,0.2,12.5,
"""


def one_line(error: BaseException) -> str:
    """The text of an error, which is one line."""
    text = str(error)
    assert "\n" not in text
    assert text
    return text


def read(tmp_path: Path, name: str, content: str | bytes, ring_m: float | None = None) -> DenseTracks:
    path = tmp_path / name
    path.write_bytes(content.encode() if isinstance(content, str) else content)
    return read_tracks(path, Choices(ring_m=ring_m)).dense()


def refused(tmp_path: Path, name: str, content: str | bytes, ring_m: float | None = None) -> str:
    with pytest.raises(InputError) as caught:
        read(tmp_path, name, content, ring_m)
    text = one_line(caught.value)
    assert name in text
    return text


def test_mstf(tmp_path: Path) -> None:
    trajectories = read(tmp_path, "a.data", MSTF)
    assert trajectories.period_s == 1.0 / 3.0
    assert trajectories.start_s == 0.0
    assert trajectories.road == Road(100.0)
    np.testing.assert_array_equal(trajectories.position_m, [[10.0, 98.0], [13.0, 0.0], [16.0, 2.0]])
    np.testing.assert_array_equal(trajectories.vehicle, [0, 1])
    np.testing.assert_array_equal(trajectories.length_m, DEFAULT_LENGTH_M)
    assert trajectories.sha256 == hashlib.sha256(MSTF.encode()).hexdigest()
    assert trajectories.source == "a.data"


def test_mstf_with_a_missing_line_has_a_missing_sample(tmp_path: Path) -> None:
    trajectories = read(tmp_path, "a.data", MSTF.replace("100.0 0.333\n", ""))
    np.testing.assert_array_equal(trajectories.position_m[:, 1], [98.0, np.nan, 2.0])


def test_the_ring_may_be_given_twice_but_not_contradicted(tmp_path: Path) -> None:
    assert read(tmp_path, "a.data", MSTF, 100.0).road == Road(100.0)
    assert "says a ring of 100 m, but 230 m was given" in refused(tmp_path, "a.data", MSTF, 230.0)
    without = MSTF.replace("circuit length is 100m", "")
    assert "--ring" in refused(tmp_path, "a.data", without)
    assert read(tmp_path, "a.data", without, 100.0).road == Road(100.0)
    assert read_tracks(tmp_path / "a.data", Choices(ring_m=0.0)).about.ring_m == 0.0


@pytest.mark.parametrize(
    ("content", "said"),
    [
        ("", "empty file"),
        ("# circuit length is 100m\n", "no samples"),
        (MSTF.replace("16.0 0.667", "nan 0.667"), ":6: position 'nan' is not a finite number"),
        (MSTF.replace("16.0 0.667", "16.0 inf"), ":6: time 'inf' is not a finite number"),
        (MSTF.replace("16.0 0.667", "16.0 twelve"), ":6: time 'twelve'"),
        (MSTF.replace("16.0 0.667", "16.0 0.333"), "vehicle 0 is at 13 m and at 16 m at 0.333 s"),
        (MSTF.replace("16.0 0.667", "16.0"), ":6: 1 columns"),
        (MSTF.encode() + b"\xff\xfe\n", ":11: not UTF-8"),
        (MSTF + "1" * 20_000, ":11: a line of more than"),
    ],
)
def test_bad_mstf(tmp_path: Path, content: str | bytes, said: str) -> None:
    assert said in refused(tmp_path, "bad.data", content)


def test_csv(tmp_path: Path) -> None:
    trajectories = read(tmp_path, "a.csv", CSV)
    assert trajectories.period_s == 0.1
    assert not trajectories.road.is_ring
    np.testing.assert_array_equal(trajectories.vehicle, [3, 7])
    np.testing.assert_array_equal(trajectories.length_m, [5.0, 4.0])
    np.testing.assert_array_equal(trajectories.position_m, [[11.5, 1.5], [np.nan, 2.5], [12.5, np.nan]])
    assert read(tmp_path, "a.csv", CSV, 12.0).position_m[2, 0] == 0.5


def test_csv_as_spreadsheets_write_it(tmp_path: Path) -> None:
    content = b'\xef\xbb\xbf"time_s","vehicle","position_m","note"\r\n0,1,5,x\r\n\r\n1,1,6,y\r\n'
    trajectories = read(tmp_path, "a.csv", content)
    np.testing.assert_array_equal(trajectories.position_m, [[5.0], [6.0]])
    np.testing.assert_array_equal(trajectories.length_m, [DEFAULT_LENGTH_M])


@pytest.mark.parametrize(
    ("content", "said"),
    [
        ("", "empty file"),
        ("\n", ":1: no column time_s, vehicle, position_m"),
        ("time_s,vehicle,x\n0,1,2\n", ":1: no column s_m or position_m"),
        ("time_s,vehicle,position_m\n", "no samples"),
        (CSV.replace("7,0.1,2.5,4.0", "7,0.1,two,4.0"), ":3: column position_m: 'two'"),
        (CSV.replace("7,0.1,2.5,4.0", "7,0.1,2.5,x"), ":3: column length_m: 'x'"),
        (CSV.replace("7,0.1,2.5,4.0", "7,0.1,2.5"), ":3: 3 fields, but 4 columns"),
        (CSV.replace("7,0.1,2.5,4.0", "7,0.0,2.5,4.0"), "vehicle 7 is at 1.5 m and at 2.5 m at 0 s"),
        (CSV.replace("7,0.1,2.5,4.0", '7,0.1,"2.5,4.0'), ":3: 3 fields"),
        (CSV.encode() + b"\x00\n", "no column time_s"),
    ],
)
def test_bad_csv(tmp_path: Path, content: str | bytes, said: str) -> None:
    assert said in refused(tmp_path, "bad.csv", content)


def test_a_file_of_no_known_format_is_refused(tmp_path: Path) -> None:
    assert "not a known file format" in refused(tmp_path, "a.dat", CSV)
    with pytest.raises(InputError, match="No such file"):
        read_tracks(tmp_path / "none.csv").dense()
    with pytest.raises(InputError, match="not a regular file"):
        read_tracks(tmp_path).dense()


@pytest.mark.parametrize("period", [1 / 3, 0.1, 0.04, 1 / 30, 0.017, 0.123456789])
@pytest.mark.parametrize("start", [0.0, 12.5, 1.7e9])
def test_periods_survive_the_rounding_of_stamps(period: float, start: float) -> None:
    exact = start + period * np.arange(1000)
    for digits, within in ((3, 1e-6), (9, 1e-8)):
        stamps = np.round(exact, digits)
        got_start, got_period, number = regular_time_base(stamps, "here")
        assert got_start == stamps[0]
        assert got_period == pytest.approx(period, abs=within)
        np.testing.assert_array_equal(number, np.arange(1000))
    if start == 0.0 and period in (1 / 3, 0.1, 0.04, 1 / 30):
        assert regular_time_base(np.round(exact, 3), "here")[1] == period


def test_skipped_times_are_counted() -> None:
    assert regular_time_base(np.array([0.0, 0.1, 0.2, 0.5, 0.6]), "here")[2].tolist() == [0, 1, 2, 5, 6]
    with pytest.raises(InputError, match="here: 4 times are there; 101 are expected"):
        regular_time_base(np.array([0.0, 0.1, 0.2, 10.0]), "here")
    with pytest.raises(InputError, match="only one time"):
        regular_time_base(np.array([0.0]), "here")


def test_a_vehicle_that_jumps_is_named_with_its_time(tmp_path: Path) -> None:
    file = tmp_path / "jump.csv"
    rows = [
        f"{0.5 * t},{v},{20.0 * v + 4.0 * t + (1000.0 if (t, v) == (17, 2) else 0.0)}"
        for t in range(60)
        for v in range(3)
    ]
    file.write_text("time_s,vehicle,position_m\n" + "\n".join(rows) + "\n")
    with pytest.raises(InputError, match=r"jump.csv: vehicle 2 jumps by 1004 m between 8 s and 8.5 s; 1 more jumps; c"):
        whole_road(read_tracks(file))
    notes = read_tracks(file).about.notes
    assert [note for note in notes if "jumps by 1004 m between 8 s and 8.5 s; 1 more jump" in note]
    rows = [f"{0.5 * t},1,{(4.0 * t) % 230.0}" for t in range(60)]
    file.write_text("time_s,vehicle,position_m\n" + "\n".join(rows) + "\n")
    assert read_tracks(file, Choices(ring_m=230.0)).dense().duration_s == 29.5
