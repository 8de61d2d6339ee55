"""Tables that are damaged or incomplete: a reader refuses them with one line, and nothing is guessed."""

import re
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pandas as pd
import pyarrow as pa
import pyarrow.parquet as pq
import pytest

import sugiyama_ros as sg
from sugiyama_ros.errors import InputError
from sugiyama_ros.formats.tracks_parquet import write_tracks
from sugiyama_ros.trajectories.tracks import Tracks


@pytest.fixture(scope="module")
def tracks() -> Tracks:
    return sg.simulate(vehicles=4, ring_m=0.0, duration_s=60.0, seed=1).measured


def refused(act: Callable[[], object], *said: str) -> None:
    """Fails unless the act ends with an InputError of one line that says all of this."""
    with pytest.raises(InputError) as caught:
        act()
    text = str(caught.value)
    assert "\n" not in text
    for part in said:
        assert re.search(part, text), text


def test_a_changed_byte_of_the_data_is_found(tracks: Tracks, tmp_path: Path) -> None:
    file = tmp_path / "a.parquet"
    tracks.save(file)
    content = file.read_bytes()
    column = pq.ParquetFile(file).metadata.row_group(0).column(3)
    assert column.path_in_schema == "s_m"
    # the positions themselves, behind the head of their page
    for place in range(column.dictionary_page_offset + 64, column.data_page_offset, 97):
        file.write_bytes(content[:place] + bytes([content[place] ^ 0x10]) + content[place + 1 :])
        refused(lambda: sg.read(file), "a.parquet: cut or damaged")


def test_a_cut_file_is_called_cut(tracks: Tracks, tmp_path: Path) -> None:
    file = tmp_path / "a.parquet"
    tracks.save(file)
    file.write_bytes(file.read_bytes()[:-100])
    refused(lambda: sg.read(file), "a.parquet: cut or damaged", "get the file again")


@pytest.mark.parametrize(
    ("column", "value", "said"),
    [
        ("s_m", 3.6e131, r"s_m is impossible in 1 of 724 rows, first 3.6e\+131 m, farther than"),
        ("time_s", -1e200, r"time_s is impossible .* -1e\+200 s, beyond the year 2106"),
        ("length_m", 1e10, r"length_m is impossible .* 1e\+10 m"),
        ("speed_m_s", 1e9, r"speed is impossible .* 1e\+09 m/s, faster than light"),
        ("d_m", -1e9, r"d_m is impossible"),
    ],
)
def test_a_number_that_nothing_can_have_is_named(tracks: Tracks, column: str, value: float, said: str) -> None:
    frame = tracks.to_frame().assign(d_m=0.0, speed_m_s=np.nan)
    frame.loc[17, column] = value
    refused(lambda: sg.read(frame), said)


def test_a_bag_is_judged_by_the_same_limits(tmp_path: Path) -> None:
    simulated = sg.simulate(vehicles=2, ring_m=0.0, duration_s=10.0)
    simulated.dense.position_m[5, 1] = 4e12
    simulated.save(tmp_path / "a.mcap")
    refused(lambda: sg.read(tmp_path / "a.mcap"), r"s_m is impossible in 1 of 62 rows, first 4e\+12 m")


@pytest.mark.parametrize("name", ["vehicle", "recording"])
def test_rows_without_a_name_are_refused_in_every_table(tracks: Tracks, name: str, tmp_path: Path) -> None:
    frame = tracks.to_frame().assign(leader=None)
    frame[name] = frame[name].astype(object)
    frame.loc[5:9, name] = None
    said = f"5 of 724 rows have a time and a position, but no {name}, first at", f"give each row its {name}"
    refused(lambda: sg.read(frame), *said)
    for file, write in (("a.csv", frame.to_csv), ("a.tsv", lambda p: frame.to_csv(p, sep="\t")), ("a.parquet", None)):
        path = tmp_path / file
        if write is None:
            pq.write_table(pa.Table.from_pandas(frame), path)
        else:
            write(path)
        refused(lambda path=path: sg.read(path), file, *said)


def test_empty_rows_are_left_out(tracks: Tracks) -> None:
    frame = tracks.to_frame()
    empty = pd.DataFrame(np.nan, index=range(3), columns=["time_s", "s_m"])
    read = sg.read(pd.concat([frame.astype({"vehicle": object}), empty], ignore_index=True))
    assert len(read) == len(frame)
    assert dict(read.about.dropped) == {"no time": 3}


def test_a_table_without_columns_is_refused(tmp_path: Path) -> None:
    pq.write_table(pa.table({}), tmp_path / "a.parquet")
    refused(lambda: sg.read(tmp_path / "a.parquet"), "no column vehicle .*; the columns are none")
    refused(lambda: sg.read(pd.DataFrame()), "no column vehicle .*; the columns are none")


def test_every_recording_has_a_checksum_which_goes_with_it(tracks: Tracks, tmp_path: Path) -> None:
    assert re.fullmatch("[0-9a-f]{64}", tracks.about.sha256)
    again = sg.simulate(vehicles=4, ring_m=0.0, duration_s=60.0, seed=1)
    other = sg.simulate(vehicles=4, ring_m=0.0, duration_s=60.0, seed=2).measured
    assert again.dense.sha256 == again.measured.about.sha256 == tracks.about.sha256 != other.about.sha256
    for name in ("a.parquet", "a.mcap"):
        (again if name == "a.mcap" else tracks).save(tmp_path / name)
        assert sg.read(tmp_path / name).about.sha256 == tracks.about.sha256
    frame = tracks.to_frame()
    assert sg.read(frame).about.sha256 == sg.read(frame).about.sha256 != sg.read(frame[:-1]).about.sha256
    other.save(tmp_path / "b.parquet")
    both = [tmp_path / "a.parquet", tmp_path / "b.parquet"]
    assert sg.read(both).about.sha256 == sg.read(both[::-1]).about.sha256 != tracks.about.sha256


def test_a_model_is_in_sample_on_what_it_was_fitted_to(tracks: Tracks, tmp_path: Path) -> None:
    tracks.save(tmp_path / "a.parquet")
    read = sg.read(tmp_path / "a.parquet")
    sg.calibrate(read).save(tmp_path / "model.yaml")
    kinds = {one.name: one.kind for one in sg.compare(read, model=tmp_path / "model.yaml").models}
    assert kinds["file: base"] == "in_sample"


def test_flags_are_read_back_from_every_table(tracks: Tracks, tmp_path: Path) -> None:
    frame = tracks.to_frame().assign(measured=lambda f: f.index % 7 != 3, controlled=lambda f: f["vehicle"] == "2")
    marked = sg.read(frame)
    assert marked.measured is not None
    for name in ("a.csv", "a.parquet"):
        write_tracks(marked, tmp_path / name)
        back = sg.read(tmp_path / name)
        assert back.measured is not None
        assert np.array_equal(back.measured, marked.measured)
        assert back.controlled_names == marked.controlled_names == ["2"]
    silent = frame.assign(measured=pd.array([None, *[0] * (len(frame) - 1)], "Int64"))
    read = sg.read(silent)
    assert read.measured is not None
    assert int(read.measured.sum()) == 1
    refused(lambda: sg.read(frame.assign(measured="maybe")), "column measured: 'maybe' says neither yes nor no")


def test_a_map_of_columns_may_say_position_m_as_a_table_does(tracks: Tracks) -> None:
    frame = tracks.to_frame()[["time_s", "vehicle", "s_m", "length_m"]]
    plain = sg.read(frame.rename(columns={"s_m": "position_m"}))
    renamed = frame.rename(columns={"s_m": "where", "vehicle": "who"})
    names = {"time_s": "time_s", "vehicle": "who", "length_m": "length_m"}
    mapped = sg.read(renamed, columns={**names, "position_m": {"column": "where", "factor": 1.0}})
    assert mapped.about.view == plain.about.view == "whole"
    assert np.array_equal(mapped.leader_row, plain.leader_row)
    assert sg.read(renamed, columns={**names, "s_m": "where"}).about.view == "end"
    refused(lambda: sg.read(renamed, columns={**names, "s_m": "where", "position_m": "where"}), "give one of them")
