"""Files as strangers have them: other column orders, upper case, quotes, BOM, CRLF, other encodings, compressed."""

import gzip
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from sugiyama_ros.errors import InputError
from sugiyama_ros.formats.registry import format_of, read_tracks

#: Vehicle, position [m] at the start, lane, and the vehicle ahead.
VEHICLES = (("1", 100.0, 1, "0"), ("2", 70.0, 1, "1"), ("3", 40.0, 1, "2"), ("4", 90.0, 2, "0"), ("5", 60.0, 2, "4"))
SAMPLES, SPEED, FOOT_M = 60, 8.0, 0.3048
Table = dict[str, list[object]]


def table(period_s: float, columns: Callable[[str, int, float, float, int, str], dict[str, object]]) -> Table:
    """Columns of a file, from vehicle, number of the sample, time [s], position [m], lane and leader."""
    rows = [
        columns(name, k, k * period_s, start + SPEED * k * period_s, lane, ahead)
        for name, start, lane, ahead in VEHICLES
        for k in range(SAMPLES)
    ]
    return {name: [row[name] for row in rows] for name in rows[0]}


def ngsim() -> Table:
    return table(
        0.1,
        lambda name, k, t, s, lane, ahead: {
            **{"Vehicle_ID": name, "Frame_ID": k, "Total_Frames": SAMPLES, "Global_Time": 1113433135300 + 100 * k},
            **{"Local_X": 12.0 * lane, "Local_Y": round((s + 2.25) / FOOT_M, 4), "v_length": round(4.5 / FOOT_M, 4)},
            **{"v_Class": 2, "v_Vel": 26.2, "Lane_ID": lane, "Preceding": ahead, "Location": "i-80"},
        },
    )


def highd() -> Table:
    return table(
        0.04,
        lambda name, k, t, s, lane, ahead: {
            **{"frame": k, "id": name, "x": round(500.0 - s - 2.25, 4), "y": 4.0 * lane, "width": 4.5, "height": 1.9},
            **{"xVelocity": -SPEED, "precedingId": ahead, "laneId": lane},
        },
    )


def sumo() -> Table:
    return table(
        0.5,
        lambda name, k, t, s, lane, ahead: {
            **{"timestep_time": t, "vehicle_id": name, "vehicle_pos": s + 2.5, "vehicle_speed": SPEED},
            **{"vehicle_lane": f"E0_{lane}"},
        },
    )


def tgsim() -> Table:
    return table(
        0.1,
        lambda name, k, t, s, lane, ahead: {
            **{"id": name, "time": round(t, 1), "xloc-kf": s, "yloc-kf": 3.0, "lane-kf": lane},
            **{"length-smoothed": 4.5, "type-most-common": "small-vehicle", "run-index": 1},
        },
    )


def plain() -> Table:
    return table(
        0.1, lambda name, k, t, s, lane, ahead: {"time_s": round(t, 1), "vehicle": name, "position_m": s, "lane": lane}
    )


KNOWN = {"ngsim": ngsim, "highd": highd, "sumo": sumo, "tgsim": tgsim, "table": plain}


def text_of(columns: Table, separator: str = ",", end: str = "\n", quoted: bool = False) -> str:
    quote = '"' if quoted else ""
    rows = [list(columns), *zip(*columns.values(), strict=True)]
    return "".join(separator.join(f"{quote}{one}{quote}" for one in row) + end for row in rows)


VARIANTS: dict[str, Callable[[Table], str]] = {
    "as published": text_of,
    "BOM and CRLF": lambda c: "\ufeff" + text_of(c, end="\r\n"),
    "upper case, other order": lambda c: text_of({name.upper(): c[name] for name in reversed(c)}),
    "quoted": lambda c: text_of(c, quoted=True),
    "semicolons": lambda c: text_of(c, ";"),
    "semicolons and decimal commas": lambda c: text_of(
        {name: [str(one).replace(".", ",") for one in column] for name, column in c.items()}, ";"
    ),
    "an index and a remark": lambda c: text_of({"": list(range(SAMPLES * len(VEHICLES))), **c, "remark": ["x"] * 300}),
    "blank lines at the end": lambda c: text_of(c) + "\n\n",
}


@pytest.mark.parametrize("variant", VARIANTS)
@pytest.mark.parametrize("name", KNOWN)
def test_the_same_vehicles_are_read_from_every_variant(name: str, variant: str, tmp_path: Path) -> None:
    path = tmp_path / "01_tracks.csv"
    path.write_bytes(VARIANTS[variant](KNOWN[name]()).encode())
    assert format_of(path).name == name
    tracks = read_tracks(path)
    # the names of columns do not say whose data they are
    assert (tracks.about.licence, tracks.about.smoothing) == ("", "")
    first = tracks.start[:-1]
    assert tracks.vehicle.values()[first].tolist() == ["1", "2", "3", "4", "5"]
    names = np.array([*tracks.vehicle.values().tolist(), "nobody"], dtype=object)
    ahead = [str(one) for one in names[np.where(tracks.leader_row >= 0, tracks.leader_row, -1)][first]]
    assert ahead == ["nobody", "1", "2", "nobody", "4"]
    np.testing.assert_allclose(np.diff(tracks.s_m[first]), [-30.0, -30.0, 50.0, -30.0], atol=0.01)
    moved = np.diff(tracks.s_m)[np.diff(tracks.run) == 0]
    np.testing.assert_allclose(moved, moved[0], atol=0.01)
    assert moved[0] > 0.0


@pytest.mark.parametrize(
    ("content", "said"),
    [
        (lambda text: gzip.compress(text.encode()), "compressed by gzip; unpack it with gunzip"),
        (lambda text: b"PK\x03\x04" + text.encode(), "a zip archive or a spreadsheet; unpack it with unzip, or save"),
        (lambda text: text.encode("utf-16"), "text in UTF-16; save it as UTF-8"),
        (lambda text: text.replace("i-80", "Straße").encode("latin-1"), "not UTF-8 text; save it as UTF-8"),
    ],
)
@pytest.mark.parametrize("ending", [".csv", ".gz"])
def test_files_that_are_no_text_are_one_line_with_the_cure(content, said: str, ending: str, tmp_path: Path) -> None:
    path = tmp_path / f"file{ending}"
    path.write_bytes(content(text_of(ngsim())))
    with pytest.raises(InputError) as caught:
        read_tracks(path)
    assert str(caught.value).startswith(f"{path}: {said}")
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize(("factor", "unit"), [(1e3, "milli"), (1e6, "micro"), (1e9, "nano")])
def test_times_since_1970_may_be_in_parts_of_a_second(factor: float, unit: str, tmp_path: Path) -> None:
    columns = plain()
    columns["time_s"] = [round((1_700_000_000 + t) * factor) for t in columns["time_s"]]
    path = tmp_path / "file.csv"
    path.write_text(text_of(columns))
    tracks = read_tracks(path)
    assert f"times are {unit}seconds in the file; they were made seconds" in tracks.about.notes
    assert tracks.time_s.max() - tracks.time_s.min() == pytest.approx(0.1 * (SAMPLES - 1), abs=1e-5)
