"""Files and data frames as users have them: what a user reads is right, or a message names the cure that works."""

import contextlib
import math
import re
import sys
from collections.abc import Iterable
from datetime import timedelta
from pathlib import Path

import numpy as np
import pyarrow
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

import sugiyama_ros as sg
from sugiyama_ros import cli
from sugiyama_ros.errors import InputError
from sugiyama_ros.trajectories.leaders import gaps
from sugiyama_ros.trajectories.tracks import UNKNOWN

pd = pytest.importorskip("pandas")
pytestmark = pytest.mark.system
#: Three cars behind one another at 12 m/s.
CARS = pd.DataFrame(
    [
        {"time_s": i / 10, "vehicle": v, "position_m": 260 + 20 * v + 1.2 * i, "length_m": 4.5}
        for i in range(100)
        for v in range(3)
    ]
)


@pytest.fixture
def sugiyama(tmp_path, monkeypatch, capfd):
    """Run a command in this process, in an empty folder: exit code, stdout, stderr."""
    monkeypatch.chdir(tmp_path)

    def run(*arguments):
        monkeypatch.setattr(sys, "argv", ["sugiyama", *map(str, arguments)])
        with pytest.raises(SystemExit) as end:
            cli.main()
        out, err = capfd.readouterr()
        return end.value.code or 0, out, err

    return run


def info(sugiyama, path) -> dict[str, str]:
    """What `sugiyama info` prints, by its first word."""
    code, out, err = sugiyama("info", path)
    assert (code, err) == (0, ""), err
    return {key: text.strip() for key, _, text in (line.partition(":") for line in out.splitlines())}


def is_the_cars(said: dict[str, str]) -> None:
    assert said["Vehicles"] == "3"
    assert said["Time"] == "0 to 9.9 s"
    assert said["Positions"] == "260 to 418.8 m, of the vehicles' centres"
    assert said["Leaders"] == "66.7% in the table, 33.3% free road, 0.0% unknown"


# ---- numbers and times as text


def german(frame, separator: str) -> str:
    """A table with decimal commas; numbers without a fraction are written without a comma."""
    rows = [separator.join(f"{value:.6g}".replace(".", ",") for value in row) for row in frame.itertuples(index=False)]
    return "\n".join([separator.join(frame.columns), *rows]) + "\n"


@pytest.mark.parametrize(("separator", "end"), [(";", "\r\n"), ("\t", "\r"), ("  ", "\n")])
def test_decimal_commas_and_ends_of_lines(sugiyama, separator, end):
    """The first row has no comma: all rows say how numbers are written."""
    Path("cars.csv").write_bytes(german(CARS, separator).replace("\n", end).encode())
    is_the_cars(info(sugiyama, "cars.csv"))
    assert sg.read("cars.csv").dense().position_m.shape == (100, 3)


@pytest.mark.parametrize(("separator", "block"), [(";", 64), ("  ", 1000)])
def test_lines_are_cut_nowhere(sugiyama, monkeypatch, separator, block):
    """Tables are read in blocks; the last line may have no end, and lines in between may be empty."""
    monkeypatch.setattr("sugiyama_ros.formats.sheet._BLOCK", block)
    lines = german(CARS, separator).splitlines()
    Path("cars.csv").write_text("\n".join([*lines[:200], "", *lines[200:]]))
    is_the_cars(info(sugiyama, "cars.csv"))


def test_comments_before_a_table_are_named_and_the_cure_works(sugiyama):
    Path("cars.csv").write_text("# made by hand\n# " + CARS.to_csv(index=False))
    code, _, err = sugiyama("info", "cars.csv")
    assert code == 2
    assert "remove the lines before the one with the names, and the # before the names" in err
    Path("cars.csv").write_text(CARS.to_csv(index=False))
    is_the_cars(info(sugiyama, "cars.csv"))


def clock(second: float) -> str:
    minutes, rest = divmod(second, 60.0)
    return f"{int(minutes) // 60:02}:{int(minutes) % 60:02}:{rest:04.1f}"


@pytest.mark.parametrize(
    ("write", "start"),
    [
        (lambda t: clock(t), 0.0),
        (lambda t: clock(t).replace(".", ","), 0.0),
        (lambda t: f"0 days {clock(t)}00000", 0.0),
        (lambda t: f"{int(t) // 60:02}:{t % 60:04.1f}", 0.0),
        (lambda t: f"2024-05-31T10:00:{t:04.1f}Z", 1717149600.0),
        (lambda t: f"2024-05-31 12:00:{t:04.1f}+02:00", 1717149600.0),
        # midnight passes
        (lambda t: clock((86395.0 + t) % 86400.0), 86395.0),
    ],
)
def test_times_that_people_read(sugiyama, write, start):
    CARS.assign(time_s=[write(t) for t in CARS.time_s]).to_csv("cars.csv", sep=";", index=False)
    is_the_cars(info(sugiyama, "cars.csv") | {"Time": "0 to 9.9 s"})
    tracks = sg.read("cars.csv")
    np.testing.assert_allclose(np.unique(tracks.time_s), start + np.arange(100) / 10, atol=1e-6)
    CARS.assign(time_s=[write(t) for t in CARS.time_s]).to_csv("plain.csv", index=False, quoting=1)
    assert sg.read("plain.csv").time_s.min() == pytest.approx(start, abs=1e-6)
    frame = sg.read(pd.read_csv("cars.csv", sep=";"))
    np.testing.assert_array_equal(frame.time_s, tracks.time_s)


@pytest.mark.parametrize("start", [86_395.0, 6 * 3600 + 59 * 60 + 55.0])
@pytest.mark.parametrize("unit", [1.0, 1000.0])
def test_clocks_written_as_digits(sugiyama, start, unit):
    """HHMMSS.f or HHMMSSfff, over midnight or over an hour: the recording lasts as long as it did."""

    def digits(t: float) -> float:
        ms = round(1000.0 * (start + t)) % 86_400_000
        hours, minutes, rest = ms // 3_600_000, ms // 60_000 % 60, ms % 60_000
        return round((10_000.0 * hours + 100.0 * minutes + rest / 1000.0) * unit, 1)

    CARS.assign(time_s=[digits(t) for t in CARS.time_s]).to_csv("digits.csv", index=False)
    said = info(sugiyama, "digits.csv")
    is_the_cars(said | {"Time": "0 to 9.9 s"})
    first, last = (float(word) for word in said["Time"].split() if word not in ("to", "s"))
    assert (first, last) == pytest.approx((start, start + 9.9))
    assert "digits of a clock" in said["Note"]


def test_seconds_with_holes_are_no_clock(sugiyama):
    """Two recordings, at 0 to 10 s and at 100 to 110 s, as digits of a clock would be of two minutes."""
    table = pd.concat([CARS, CARS.assign(time_s=CARS.time_s + 100.0)])
    table.to_csv("twice.csv", index=False)
    assert info(sugiyama, "twice.csv")["Time"] == "0 to 109.9 s"


def test_a_time_that_is_none_is_named(sugiyama):
    CARS.assign(time_s=["noon"] * 300).to_csv("cars.csv", sep=";", index=False)
    code, _, err = sugiyama("info", "cars.csv")
    assert code == 2
    assert "cars.csv:2: column time_s: 'noon' is not a time; give seconds, or a time such as 0:01:02.5" in err


# ---- names


def test_vehicles_with_names(sugiyama):
    CARS.assign(vehicle="car" + CARS.vehicle.astype(str)).to_csv("cars.csv", index=False)
    read = sg.read("cars.csv").dense()
    np.testing.assert_array_equal(read.vehicle, [0, 1, 2])
    np.testing.assert_array_equal(read.position_m, sg.read(CARS).dense().position_m)
    assert sg.read(pd.read_csv("cars.csv")).vehicle.used() == ("car0", "car1", "car2")
    code, out, _ = sugiyama("convert", "cars.csv", "cars.mcap")
    assert code == 0
    assert out.startswith("3 vehicles")


def test_whole_numbers_may_be_written_with_a_point(sugiyama):
    """Tables write the leader as 2.0 where some rows have none."""
    led = CARS.assign(leader=CARS.vehicle.map({0: 1.0, 1: 2.0, 2: np.nan}))
    led.to_csv("cars.csv", index=False)
    for tracks in (sg.read("cars.csv"), sg.read(led)):
        assert tracks.leader.values()[::100].tolist() == ["1", "2", None]
    text = led.assign(
        vehicle=led.vehicle.map({0: "5.0", 1: "5.1", 2: "5.2"}), leader=led.leader.map({1: "5.1", 2: "5.2"})
    )
    assert sg.read(text).leader.values()[::100].tolist() == ["5.1", "5.2", None]


# ---- data frames, CSV and Parquet are one


OPTIONAL = ("recording", "road", "lane", "d_m", "length_m", "width_m", "class", "driver", "leader", "measured")


@settings(max_examples=25, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(empty=st.sets(st.sampled_from(OPTIONAL)), left_out=st.sets(st.sampled_from(OPTIONAL)))
def test_a_column_that_may_be_empty_may_be_wholly_empty(tmp_path, empty, left_out):
    table = CARS.rename(columns={"position_m": "s_m"}).assign(
        **{"recording": "r", "road": "A", "lane": 1, "d_m": 0.1, "width_m": 1.8, "class": "car", "driver": "x"},
        leader=CARS.vehicle.map({0: 1, 1: 2}),
        measured=1,
    )
    table = table.assign(**dict.fromkeys(empty, pd.NA)).drop(columns=[*left_out])
    table.to_csv(tmp_path / "t.csv", index=False)
    table.to_parquet(tmp_path / "t.parquet")
    found = [sg.read(table), sg.read(tmp_path / "t.csv"), sg.read(tmp_path / "t.parquet")]
    # nobody knows who follows whom where a column of lanes or roads is there, but says nothing, and no leader is named
    named = "leader" not in empty | left_out
    known = named or not {"lane", "road"} - left_out & empty
    for tracks in found:
        assert len(tracks) == 300
        assert tracks.leader.values()[::100].tolist() == (["1", "2", None] if known else [None] * 3)
        np.testing.assert_allclose(tracks.length_m, 4.33 if "length_m" in empty | left_out else 4.5)


@pytest.mark.parametrize(
    "change",
    [
        lambda f: f.assign(time_s=pd.to_timedelta(f.time_s, unit="s")),
        lambda f: f.assign(time_s=pd.Series([timedelta(seconds=t) for t in f.time_s], dtype=object)),
        lambda f: f.assign(vehicle=f.vehicle.astype("category"), position_m=f.position_m.astype("string")),
        lambda f: f.assign(vehicle=f.vehicle.astype("Int64"), position_m=f.position_m.astype("Float64")),
        lambda f: f.assign(position_m=f.position_m.map("{:.2f}".format).str.replace(".", ",")),
        lambda f: f.set_index("time_s"),
        lambda f: f.set_index(["vehicle", "time_s"]),
        lambda f: f.sample(frac=1.0, random_state=1),
        lambda f: pyarrow.Table.from_pandas(f),
    ],
)
def test_types_of_a_data_frame(change):
    given = change(CARS)
    tracks = sg.read(given)
    np.testing.assert_allclose(tracks.s_m, sg.read(CARS).s_m)
    np.testing.assert_allclose(tracks.time_s, sg.read(CARS).time_s)


# ---- positions and speeds


TGSIM = (
    "id,time,xloc_kf,yloc_kf,lane_kf,speed_kf,acceleration_kf,length_smoothed,width_smoothed,type_most_common,run_index"
)


def tgsim(angle: float, origin: float = 0.0) -> str:
    """Two lanes of two cars at 12 m/s, on a road in a direction."""
    rows = [TGSIM]
    for car, lane, start in ((1, 1, 20.0), (2, 1, 50.0), (3, 2, 30.0), (4, 2, 75.0)):
        for i in range(100):
            s, d = start + 1.2 * i, 3.6 * lane
            x, y = s * math.cos(angle) - d * math.sin(angle), s * math.sin(angle) + d * math.cos(angle)
            rows.append(f"{car},{i / 10},{origin + x:.3f},{origin + y:.3f},{lane},12,0,4.5,1.9,car,1")
    return "\n".join(rows) + "\n"


@pytest.mark.parametrize(("angle", "origin"), [(0.0, 0.0), (2.5, 4e5), (-math.pi / 2, 4e5)])
def test_tgsim_is_measured_along_the_drive(tmp_path, angle, origin):
    path = tmp_path / "I395.csv"
    path.write_text(tgsim(angle, origin))
    tracks = sg.read(path)
    assert tracks.leader.values()[::100].tolist() == ["2", None, "4", None]
    np.testing.assert_allclose(np.diff(tracks.s_m.reshape(4, 100)), 1.2, atol=2e-3)
    np.testing.assert_allclose(gaps(tracks)[:100], 25.5, atol=2e-3)


def test_positions_that_contradict_the_speeds_are_refused_and_the_cure_works(sugiyama):
    """Local_X is along the road here: who sees the file knows which column holds positions along the road."""
    head = (
        "Vehicle_ID,Frame_ID,Total_Frames,Global_Time,Local_X,Local_Y,v_Length,v_Width,v_Class,v_Vel,Lane_ID,Preceding"
    )
    rows = [
        f"{v},{i},100,{1113433135300 + 100 * i},{40 * v + 3.9 * i:.2f},{12 + 0.01 * i},15,6,2,39,1,{(v + 1) % 4}"
        for v in (1, 2, 3)
        for i in range(100)
    ]
    Path("ngsim.csv").write_text("\n".join([head, *rows]) + "\n")
    code, out, err = sugiyama("info", "ngsim.csv")
    assert (code, out) == (2, "")
    assert "vehicles move at 0.0305 m/s by their positions, but at 11.9 m/s by the speeds in the file; check" in err
    cure = re.search(r"\((--format table --columns map.yaml)\)", err)
    assert cure
    Path("map.yaml").write_text(
        "time_s: {column: Frame_ID, factor: 0.1}\nvehicle: Vehicle_ID\ns_m: {column: Local_X, factor: 0.3048}\n"
        "length_m: {column: v_Length, factor: 0.3048}\nspeed: {column: v_Vel, factor: 0.3048}\nlane: Lane_ID\n"
    )
    code, _, err = sugiyama("convert", "ngsim.csv", "cured.parquet", *cure[1].split())
    assert (code, err) == (0, "")
    assert info(sugiyama, "cured.parquet")["Leaders"].startswith("66.7% in the table")
    place = {"column": "Local_X", "factor": 0.3048}
    columns = {"time_s": {"column": "Frame_ID", "factor": 0.1}, "vehicle": "Vehicle_ID", "s_m": place, "speed": "v_Vel"}
    with pytest.raises(InputError, match=r"but at 39 m/s by the speeds"):
        sg.read("ngsim.csv", columns=columns)


# ---- pairs


def test_pairs_without_names(sugiyama):
    """The message says what rows with a follower and the leader need, and that works."""
    pairs = pd.DataFrame(
        {"t": np.arange(100) / 10, "lead": 60 + 1.2 * np.arange(100), "follow": 30 + 1.2 * np.arange(100)}
    )
    pairs.to_csv("pairs.csv", index=False)
    code, _, err = sugiyama("info", "pairs.csv")
    assert code == 2
    assert "where a row has a follower and the leader, give time_s, s_m and leader_s_m" in err
    Path("map.yaml").write_text("time_s: t\ns_m: follow\nleader_s_m: lead\n")
    code, _, err = sugiyama("convert", "pairs.csv", "pairs.parquet", "--columns", "map.yaml")
    assert (code, err) == (0, "")
    tracks = sg.read("pairs.parquet")
    assert tracks.vehicle.used() == ("follower", "leader")
    np.testing.assert_allclose(gaps(tracks)[:100], 30.0 - 4.33)
    frame = sg.read(pairs.rename(columns={"t": "time_s", "lead": "leader_s_m", "follow": "s_m"}))
    np.testing.assert_array_equal(frame.s_m, tracks.s_m)


# ---- SUMO


def fcd(rows: Iterable[tuple[int, int]], attributes: str, clocks: bool = False, before: str = "") -> str:
    """Cars at 10 m/s on one edge."""
    steps: dict[int, str] = {}
    for step, car in rows:
        place = f'x="0" y="0" angle="90" type="car" speed="10.00" pos="{100 + 40 * car + 10 * step:.2f}" slope="0"'
        steps[step] = steps.get(step, "") + f'<vehicle id="flow.{car}" {place} {attributes}/>'
    times = {step: clock(step).replace(".0", ".00") if clocks else f"{step:.2f}" for step in steps}
    body = "".join(f'<timestep time="{times[step]}">{cars}</timestep>' for step, cars in steps.items())
    return f'<?xml version="1.0" encoding="UTF-8"?>\n{before}<fcd-export>{body}</fcd-export>\n'


SUMO_ROWS = [(step, car) for step in range(61) for car in range(3)]


def test_sumo_says_times_as_clocks(sugiyama):
    # the options of SUMO stand in a comment before the data
    Path("fcd.xml").write_text(fcd(SUMO_ROWS, 'lane="E0_0"', True, f"<!-- {'option ' * 2000} -->\n"))
    said = info(sugiyama, "fcd.xml")
    assert (said["Format"], said["Time"], said["Period"]) == ("sumo", "0 to 60 s", "1 s")
    assert said["Leaders"].startswith("66.7% in the table")
    text = ["timestep_time;vehicle_id;vehicle_pos;vehicle_lane;vehicle_speed"]
    text += [f"{clock(step)};flow.{car};{100 + 40 * car + 10 * step};E0_0;10" for step, car in SUMO_ROWS]
    Path("fcd.csv").write_text("\n".join(text) + "\n")
    assert info(sugiyama, "fcd.csv")["Time"] == "0 to 60 s"


@pytest.mark.parametrize("separator", ["xml", ";"])
def test_sumo_without_lanes_has_no_leaders(sugiyama, separator):
    if separator == "xml":
        Path("meso.fcd").write_text(fcd(SUMO_ROWS, 'edge="E0"'))
    else:
        text = ["timestep_time;vehicle_id;vehicle_pos;vehicle_edge;vehicle_speed"]
        text += [f"{step};flow.{car};{100 + 40 * car + 10 * step};E0;10" for step, car in SUMO_ROWS]
        Path("meso.fcd").write_text("\n".join(text) + "\n")
    code, out, _ = sugiyama("info", "meso.fcd")
    assert code == 0
    assert "Leaders:     0.0% in the table, 0.0% free road, 100.0% unknown" in out
    assert "warning: edges have no lanes in the file, as in SUMO's mesoscopic model, so that no leader is known" in out
    code, _, err = sugiyama("calibrate", "meso.fcd")
    assert code == 2
    assert err.count("error: ") == 1


# ---- CommonRoad


@pytest.mark.parametrize("separator", [";", ","])
def test_sumo_writes_plain_headers(sugiyama, separator):
    """The same file with `--output.column-header plain`; with a map, the message says that it needs none."""
    names = {"timestep_time": "time", "vehicle_id": "id", "vehicle_pos": "pos", "vehicle_speed": "speed"}
    rows = [
        {
            "timestep_time": i,
            "vehicle_id": f"f.{k}",
            "vehicle_pos": s % 300,
            "vehicle_speed": 10.0,
            "vehicle_lane": lane,
        }
        for i in range(40)
        for k in range(3)
        for s in [60.0 * k + 10.0 * i]
        for lane in [f"E{1 + int(s // 300)}_0"]
    ]
    tagged = pd.DataFrame(rows)
    tagged.to_csv("tag.csv", index=False, sep=separator)
    tagged.rename(columns=names | {"vehicle_lane": "lane"}).to_csv("plain.csv", index=False, sep=separator)
    said = info(sugiyama, "plain.csv")
    assert said["Format"] == "sumo"
    assert said["Leaders"] == info(sugiyama, "tag.csv")["Leaders"]
    Path("map.yaml").write_text("{vehicle: id, time_s: time, s_m: pos, lane: lane, speed: speed}")
    code, _, err = sugiyama("convert", "plain.csv", "o.csv", "--columns", "map.yaml")
    assert (code, err.rstrip()[-55:]) == (2, "; or leave out --columns: the file has the form of sumo")
    assert sugiyama("convert", "plain.csv", "o.csv")[0] == 0


def test_plain_names_alone_are_not_those_of_sumo(sugiyama):
    table = CARS.rename(columns={"time_s": "time", "vehicle": "id", "position_m": "pos"}).assign(
        speed=12.0, lane="left_a"
    )
    table.to_csv("own.csv", index=False)
    code, _, err = sugiyama("info", "own.csv")
    assert (code, "no column vehicle" in err) == (2, True)


@pytest.mark.parametrize("cut", [0, 9, 40])
def test_a_file_that_ends_early_is_read_once_it_is_ended_as_said(sugiyama, cut):
    text = fcd(((i, k) for i in range(40) for k in range(3)), 'lane="E0_0"')
    whole = text[: text.index("</fcd-export>")]
    Path("cut.xml").write_text(whole[: len(whole) - cut])
    code, _, err = sugiyama("info", "cut.xml")
    assert code == 2
    last, end = re.search(r"ends early; .* cut it behind its last (\S+) and add (\S+)$", err.strip()).groups()
    Path("cut.xml").write_text(whole[: whole.rindex(last, 0, len(whole) - cut) + len(last)] + end)
    assert info(sugiyama, "cut.xml")["Vehicles"] == "3"


def test_positions_follow_from_speeds_as_the_message_says(sugiyama):
    drive = pd.DataFrame({"time": CARS.time_s.unique(), "ego_speed": 12.0, "range": 25.0})
    drive.to_csv("drive.csv", index=False)
    code, _, err = sugiyama("info", "drive.csv")
    assert (code, "s_m is the sum of speed times step, and leader_s_m is s_m + gap" in err) == (2, True)
    s_m = (drive.ego_speed * 0.1).cumsum()
    cured = pd.DataFrame({"time_s": drive.time, "s_m": s_m, "leader_s_m": s_m + drive.range + 4.5})
    cured.to_csv("cured.csv", index=False)
    assert info(sugiyama, "cured.csv")["Leaders"].startswith("50.0% in the table")


def test_recordings_that_are_too_short_are_named(sugiyama):
    CARS[CARS.time_s < 4.0].assign(lane=1).to_csv("short.csv", index=False)
    code, _, err = sugiyama("calibrate", "short.csv")
    assert (code, "nobody is seen for more than 3.9 s, but drivers must be seen to follow for 5 s; give" in err) == (
        2,
        True,
    )


def bound(points: list[tuple[float, float]], off: float) -> str:
    text = ""
    for k, (x, y) in enumerate(points):
        (ax, ay), (bx, by) = points[max(k - 1, 0)], points[min(k + 1, len(points) - 1)]
        angle = math.atan2(by - ay, bx - ax)
        text += f"<point><x>{x - off * math.sin(angle):.4f}</x><y>{y + off * math.cos(angle):.4f}</y></point>"
    return text


def lanelet(name: int, points: list[tuple[float, float]], more: str = "") -> str:
    left, right = bound(points, 1.75), bound(points, -1.75)
    return f'<lanelet id="{name}"><leftBound>{left}</leftBound><rightBound>{right}</rightBound>{more}</lanelet>'


def after(*names: int) -> str:
    return "".join(f'<successor ref="{name}"/>' for name in names)


def line(x: float, y: float, length: int, angle: float = 0.0) -> list[tuple[float, float]]:
    return [(x + s * math.cos(angle), y + s * math.sin(angle)) for s in range(0, length + 1, 10)]


def point(x: float, y: float) -> str:
    return f"<point><x>{x:.4f}</x><y>{y:.4f}</y></point>"


def obstacle(name: int, way: list[tuple[float, float, float]], place=point) -> str:
    states = [
        f"<{'state' if k else 'initialState'}><position>{place(x, y)}</position><orientation><exact>{h:.4f}</exact>"
        f"</orientation><time><exact>{k}</exact></time><velocity><exact>10</exact></velocity>"
        f"</{'state' if k else 'initialState'}>"
        for k, (x, y, h) in enumerate(way)
    ]
    return (
        f'<dynamicObstacle id="{name}"><type>car</type><shape><rectangle><length>4.5</length><width>1.8</width>'
        f"</rectangle></shape>{states[0]}<trajectory>{''.join(states[1:])}</trajectory></dynamicObstacle>"
    )


def drive(x: float, y: float, angle: float = 0.0, samples: int = 60) -> list[tuple[float, float, float]]:
    return [(x + k * math.cos(angle), y + k * math.sin(angle), angle) for k in range(samples)]


def scenario(*parts: str, quote: str = '"', step: str = "0.1") -> str:
    return f'<?xml version="1.0"?>\n<commonRoad  timeStepSize = {quote}{step}{quote}>{"".join(parts)}</commonRoad>'


STREET = lanelet(1, line(0.0, 0.0, 300))


@pytest.mark.parametrize(
    ("place", "known"),
    [
        (
            lambda x, y: (
                f"<rectangle><length>2</length><width>1</width><center><x>{x}</x><y>{y}</y></center></rectangle>"
            ),
            60,
        ),
        (lambda x, y: f"<circle><radius>1</radius><center><x>{x}</x><y>{y}</y></center></circle>", 60),
        (lambda x, y: f"<polygon>{point(x - 1, y)}{point(x + 1, y - 1)}{point(x, y + 1)}</polygon>", 60),
        (lambda x, y: '<lanelet ref="1"/>', 0),
    ],
)
def test_uncertain_places_give_their_middles_or_are_counted(tmp_path, place, known):
    path = tmp_path / "area.xml"
    path.write_text(scenario(STREET, obstacle(11, drive(20, 0)), obstacle(12, drive(50, 0), place)))
    tracks = sg.read(path)
    assert len(tracks) == 60 + known
    if known:
        np.testing.assert_allclose(gaps(tracks)[:60], 25.5, atol=1e-9)
        assert "places of 60 states are areas in the file; their middles count" in tracks.about.notes
    else:
        assert dict(tracks.about.dropped) == {"a state without an exact time or a place": 60}


@pytest.mark.parametrize("kind", ["constructionZone", "car"])
@pytest.mark.parametrize("is_old", [False, True])
def test_what_stands_is_no_driver_and_may_be_in_the_way(tmp_path, kind, is_old):
    """Of two obstacles that stand, one is on the lane, across it, and the other is in a garden."""
    tag, role = ("obstacle", "<role>static</role>") if is_old else ("staticObstacle", "")
    standing = (
        f'<{tag} id="{name}">{role}<type>{kind}</type><shape><rectangle><length>3</length><width>2</width></rectangle>'
        f"</shape><initialState><position>{point(x, y)}</position><orientation><exact>2.0</exact></orientation><time>"
        f"<exact>0</exact></time></initialState></{tag}>"
        for name, x, y in ((21, 150.0, 0.2), (22, 150.0, 30.0))
    )
    path = tmp_path / "still.xml"
    path.write_text(scenario(STREET, obstacle(11, drive(20, 0)), obstacle(12, drive(50, 0)), *standing))
    tracks = sg.read(path)
    assert tracks.vehicle.used() == ("11", "12")
    assert [tracks.leader.at(row) for row in (0, 60)] == ["12", ""]
    name = "construction_zone" if kind != "car" else "static_obstacle"
    assert any(f"left out: 1 {name}; the leader" in note for note in tracks.about.notes)
    assert "static obstacles beside all lanes, which were left out: 1" in tracks.about.notes
    path.write_text(path.read_text().replace(point(150.0, 0.2), point(60.0, 0.2)))
    ahead = sg.read(path).leader_row[:60]
    assert (ahead[:11] >= 0).all()
    assert (ahead[11:40] == UNKNOWN).all()
    assert (ahead[41:] >= 0).all()


def turned(s: float, radius: float = 40.0) -> tuple[float, float, float]:
    """A way of 100 m, a quarter of a circle to the right, and on."""
    if s < 100.0:
        return s, 0.0, 0.0
    angle = min((s - 100.0) / radius, math.pi / 2)
    rest = max(s - 100.0 - radius * math.pi / 2, 0.0)
    return 100 + radius * math.sin(angle), -radius + radius * math.cos(angle) - rest, -angle


def test_every_successor_counts_at_a_fork(tmp_path):
    """Who turns follows who turns, and positions go on without a jump."""
    path = tmp_path / "fork.xml"
    bend = [turned(100 + k * math.pi)[:2] for k in range(21)]
    streets = lanelet(1, line(0, 0, 100), after(2, 3)), lanelet(2, line(100, 0, 100)), lanelet(3, bend, after(4))
    cars = [(11, 30, turned), (12, 55, turned), (13, 45, None), (14, 70, None)]
    text = [
        obstacle(name, [turned(start + k) for k in range(120)] if way else drive(start, 0, 0, 120))
        for name, start, way in cars
    ]
    path.write_text(scenario(*streets, lanelet(4, line(140, -40, 100, -math.pi / 2)), *text))
    tracks = sg.read(path)
    np.testing.assert_allclose(np.diff(tracks.s_m.reshape(4, 120)), 1.0, atol=0.02)
    leader = tracks.leader.values().reshape(4, 120)
    assert leader[0, 0] == "13"  # in front of the fork, the next one ahead
    assert leader[0, 60] == "12"  # 13 went straight on
    assert leader[2, 60] == "14"
    assert not any("warning" in note for note in tracks.about.notes)


def test_numbers_that_overflow_give_no_warning_of_numpy(tmp_path):
    """One such value is left out, or the file is refused in one line."""
    number = "1e308"
    pair = "timestamp,xLeaderReal,xFollowerReal,spacing\n" + "".join(
        f"{t / 10},{50 + t},{20 + t},25\n" for t in range(50)
    )
    files = {
        "cars.csv": CARS.to_csv(index=False).replace("260.0", number, 1),
        "pairs.csv": pair.replace(",25\n", f",{number}\n", 1),
        "street.xml": scenario(STREET, obstacle(11, drive(20, 0)).replace("<x>25.0000", f"<x>{number}")),
        "tgsim.csv": tgsim(0.4).replace(",12,0,4.5", f",{number},0,4.5", 1),
    }
    for name, text in files.items():
        (tmp_path / name).write_text(text)
        with contextlib.suppress(InputError):
            assert len(sg.read(tmp_path / name)) > 50


# ---- from a feed to an estimate in Python


def test_python_calibrates_tracks_and_simulations():
    simulated = sg.simulate(4, ring_m=45.0, duration_s=60.0, seed=1)
    found = sg.calibrate(simulated, "paper").to_frame()
    np.testing.assert_array_equal(found, sg.calibrate(simulated.measured, "paper").to_frame())
    for function in (sg.diagnose, sg.compare):
        with pytest.raises(InputError, match=r"tracks: .* is not possible; give Tracks or Simulation"):
            function(CARS)
    rng = np.random.default_rng(0)
    noisy = CARS.assign(position_m=CARS.position_m + rng.normal(0.0, 0.1, len(CARS)))
    longer = pd.concat(
        [noisy.assign(time_s=noisy.time_s + 10 * k, position_m=noisy.position_m + 120 * k) for k in range(3)]
    )
    drivers = sg.calibrate(sg.read(longer), parameters=["v_star"]).to_frame()
    assert drivers["vehicle"].tolist() == [0, 1, 2]
    assert (drivers["v_star"] > 10.0).all()


def _ring(path: Path, ring_m: float) -> None:
    """Ten cars that drive round at 6 m/s, 20 s a lap."""
    rows = ["time_s,vehicle,position_m"]
    for k in range(241):
        rows += [f"{k / 3:.4f},{i},{(ring_m / 10 * i + 2.0 * k + 0.03 * (i % 3)) % ring_m:.3f}" for i in range(10)]
    path.write_text("\n".join(rows) + "\n")


def test_a_ring_that_is_not_named_is_not_turned_round(sugiyama, tmp_path):
    """Its vehicles go forward, although each jumps back at the end of a lap; the cure is followed."""
    _ring(tmp_path / "ring.csv", 120.0)
    code, out, _ = sugiyama("info", "ring.csv")
    assert code == 0
    assert "turned round" not in out
    assert "--ring METRES" in out
    code, out, _ = sugiyama("info", "ring.csv", "--ring", "120")
    assert code == 0
    assert "Leaders:     100.0% in the table" in out
    assert "warning" not in out


def test_a_part_of_the_ring_where_nobody_was_is_told(sugiyama, tmp_path):
    _ring(tmp_path / "ring.csv", 120.0)
    assert "is a circumference of 130 m right?" in sugiyama("calibrate", "ring.csv", "--ring", "130")[2]
    assert "circumference" not in sugiyama("calibrate", "ring.csv", "--ring", "120")[2]
