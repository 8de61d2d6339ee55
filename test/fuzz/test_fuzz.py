"""Damaged files and messages: a reader uses them or refuses them with one line, in bounded time.

`make fuzz` tries many more than the suite does. What breaks a reader becomes a case of the reader's own tests.
"""

import io
import json
import time
from collections.abc import Callable
from contextlib import suppress
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import pytest
import yaml
from hypothesis import given
from hypothesis import strategies as st
from rclpy.serialization import serialize_message
from sugiyama_msgs.msg import (
    DriverArray,
    DriverParameters,
    Innovation,
    MeasuredPositions,
    Progress,
    VehicleState,
    Verdict,
)
from sugiyama_msgs.msg import Road as RoadMessage

from fuzz import files, mutations
from sugiyama_ros.errors import InputError
from sugiyama_ros.filters.extract import drives
from sugiyama_ros.fit.model_file import read_model
from sugiyama_ros.formats.choices import read_choices
from sugiyama_ros.formats.mcap_reader import Bag
from sugiyama_ros.formats.recover import recover
from sugiyama_ros.formats.registry import read_tracks
from sugiyama_ros.formats.roads import read_road
from sugiyama_ros.nodes.base import incoming
from sugiyama_ros.nodes.keeper import read_learnt
from sugiyama_ros.page.diagnosis import read_diagnosis
from sugiyama_ros.page.recording import read_recording
from sugiyama_ros.trajectories.exchange import KEY

#: Longest time [s of the processor] for a file of some kilobytes.
LONGEST_S = 10.0


def handled(act: Callable[[Path], object], path: Path, source: str = "") -> None:
    """Fails unless the act ends in bounded time, perhaps with an InputError of one line that names the file."""
    start = time.process_time()
    try:
        act(path)
    except InputError as error:
        text = str(error)
        assert "\n" not in text
        assert path.name in text or (source and source in text)
        assert len(text) < 2000
    assert time.process_time() - start < LONGEST_S


def all_drives(path: Path) -> None:
    """Read tracks and everything that a calibration makes of them."""
    tracks = read_tracks(path)
    assert np.isfinite(tracks.s_m).all()
    assert np.isfinite(tracks.time_s).all()
    for drive in drives(tracks):
        assert drive is not None


def contents(path: Path) -> None:
    """Read every message of a bag."""
    with Bag(path) as bag:
        for _ in bag.messages():
            pass


def positions(path: Path) -> None:
    trajectories = read_tracks(path).dense()
    assert not np.isinf(trajectories.position_m).any()
    assert trajectories.period_s > 0.0


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return tmp_path_factory.mktemp("fuzz")


@pytest.mark.parametrize("name", files.TEXTS)
@given(data=st.data())
def test_texts(folder: Path, name: str, data: st.DataObject) -> None:
    path = folder / name
    path.write_bytes(data.draw(mutations.texts(files.TEXTS[name])))
    handled(all_drives, path)
    handled(positions, path)


@pytest.mark.parametrize("name", files.ROADS)
@given(data=st.data())
def test_roads(folder: Path, name: str, data: st.DataObject) -> None:
    path = folder / name
    path.write_bytes(data.draw(mutations.texts(files.ROADS[name])))
    handled(read_road, path)


BAG = files.bag()


@given(mutations.bags(BAG))
def test_bags(folder: Path, content: bytes) -> None:
    path = folder / "a.mcap"
    path.write_bytes(content)
    for act in (contents, positions, all_drives, read_recording):
        handled(act, path)
    target = folder / "b.mcap"
    handled(lambda source: recover(source, target), path)
    target.unlink(missing_ok=True)


PARQUET = files.parquet()
ABOUT = json.loads(pq.read_schema(io.BytesIO(PARQUET)).metadata[KEY])
#: What becomes of a column.
COLUMNS: dict[str, Callable[[pa.Array], pa.Array]] = {
    "nulls": lambda column: pa.nulls(len(column), column.type),
    "texts": lambda column: pa.array([str(one) for one in column.to_pylist()]),
    "integers": lambda column: pa.array(range(len(column)), pa.int64()),
    "huge": lambda column: pa.array([1e308] * len(column)),
    "not numbers": lambda column: pa.array([float("nan")] * len(column)),
    "infinite": lambda column: pa.array([float("inf")] * len(column)),
    "lists": lambda column: pa.array([[1.0]] * len(column)),
    "bytes": lambda column: pa.array([b"\xff"] * len(column)),
    "times": lambda column: pa.array(range(len(column)), pa.timestamp("ns")),
    "bools": lambda column: pa.array([True] * len(column)),
    "backward": lambda column: column[::-1],
    "none of some": lambda column: pa.array([None if k % 7 == 0 else v for k, v in enumerate(column.to_pylist())]),
}


@st.composite
def tables(draw: st.DrawFn) -> bytes:
    """A table whose columns have other types or values, other names, or are missing or doubled."""
    table = pq.read_table(io.BytesIO(PARQUET))
    for _ in range(draw(st.integers(1, 3))):
        if table.num_columns == 0:
            break
        k = draw(st.integers(0, table.num_columns - 1))
        name, column = table.column_names[k], table.column(k).combine_chunks()
        act = draw(st.sampled_from([*COLUMNS, "away", "twice", "renamed", "fewer rows", "metadata"]))
        if act in COLUMNS:
            table = table.set_column(k, name, COLUMNS[act](column))
        elif act == "away":
            table = table.remove_column(k)
        elif act == "twice":
            table = table.append_column(name, column)
        elif act == "renamed":
            table = table.rename_columns(["" if j == k else one for j, one in enumerate(table.column_names)])
        elif act == "fewer rows":
            table = table.slice(0, draw(st.integers(0, 5)))
        else:
            said = draw(mutations.documents(ABOUT, json.dumps) | st.binary(max_size=20))
            table = table.replace_schema_metadata({KEY: said})
    stream = io.BytesIO()
    pq.write_table(table, stream)
    return stream.getvalue()


@given(tables() | mutations.binaries(PARQUET))
def test_parquet(folder: Path, content: bytes) -> None:
    path = folder / "a.parquet"
    path.write_bytes(content)
    handled(all_drives, path, source="tracks.csv")


DOCUMENTS: dict[str, tuple[Callable[[Path], object], Any]] = {
    "model.yaml": (read_model, files.model()),
    "columns.yaml": (read_choices, files.columns()),
    "vehicle_01.json": (read_learnt, files.learnt()),
    "diagnosis.json": (read_diagnosis, files.diagnosis()),
}


@pytest.mark.parametrize("name", DOCUMENTS)
@given(data=st.data())
def test_documents(folder: Path, name: str, data: st.DataObject) -> None:
    read, document = DOCUMENTS[name]
    path = folder / name
    dump = json.dumps if path.suffix == ".json" else yaml.safe_dump
    path.write_bytes(data.draw(mutations.documents(document, dump)))
    handled(read, path)


MESSAGES = {
    "road": RoadMessage(period_s=0.1, circumference_m=230.0, steps=100, source="a.csv", sha256="0" * 64),
    "sample": MeasuredPositions(vehicle=[1, 2], leader=[2, -1], position_m=[1.0, 20.0], length_m=[4.0, 4.0]),
    "progress": Progress(node="/a", steps=1, published=2),
    "parameters": DriverParameters(
        name=["v_star"], value=[10.0], estimated=[True], covariance=[1.0], identified=[True]
    ),
    "verdict": Verdict(
        best="base",
        model=["base", "drag"],
        weight=[0.5, 0.5],
        log_likelihood=[0.0, 1.0],
        strength=[0.0, 1.0],
        parameter=["drag.c0"],
        value=[1.0],
    ),
    "state": VehicleState(vehicle=1, position_m=1.0),
    "innovation": Innovation(vehicle=1, innovation_m=0.1, innovation_var=0.2),
    "drivers": DriverArray(vehicle=[1], scored=[True], innovation_m=[0.1], nis=[1.0], name=["v_star"], value=[10.0]),
}


@pytest.mark.parametrize("name", MESSAGES)
@given(data=st.data())
def test_messages(name: str, data: st.DataObject) -> None:
    """Each message is taken or refused; a message that is taken holds what the nodes count on."""
    raw = data.draw(mutations.binaries(bytes(serialize_message(MESSAGES[name]))))
    start = time.process_time()
    with suppress(incoming.RefusedError):
        taken = incoming.decoder(type(MESSAGES[name]))(raw)
        if name == "road":
            assert 0.0 < taken.period_s <= 1e3
        if name == "sample":
            assert len(taken.position_m) == len(taken.leader) == len(taken.length_m)
    assert time.process_time() - start < LONGEST_S
