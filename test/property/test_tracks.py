"""Any tracks come back from Parquet, every leader is ahead, and no bytes end in anything but one line."""

from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np
from hypothesis import given, settings
from hypothesis import strategies as st

from sugiyama_ros.errors import InputError
from sugiyama_ros.formats.registry import read_tracks
from sugiyama_ros.formats.tracks_parquet import write_tracks
from sugiyama_ros.trajectories.about import About
from sugiyama_ros.trajectories.assemble import assemble
from sugiyama_ros.trajectories.labels import Labels
from sugiyama_ros.trajectories.leaders import gaps
from sugiyama_ros.trajectories.stretches import stretches
from sugiyama_ros.trajectories.tracks import NOBODY, Tracks


@st.composite
def some_tracks(draw: st.DrawFn) -> Tracks:
    """Vehicles with any names that come and go on a few lanes."""
    random = np.random.default_rng(draw(st.integers(0, 1 << 32)))
    rows, vehicles = draw(st.integers(1, 60)), draw(st.integers(1, 6))
    names = draw(st.lists(st.text(max_size=8).filter(_is_a_name), min_size=vehicles, max_size=vehicles))
    columns = {
        "vehicle": np.array(names, dtype=object)[random.integers(0, vehicles, rows)],
        "time_s": random.choice(200, rows, replace=False) * 0.1,
        "s_m": random.uniform(0.0, 1000.0, rows),
        "length_m": np.full(rows, 4.0),
    }
    if draw(st.booleans()):
        columns["lane"] = random.choice(np.array(["a", "b", None], dtype=object), rows)
    if draw(st.booleans()):
        columns["time_s"] = np.round(random.integers(0, 5, rows) * 0.1, 1)
        columns["vehicle"] = np.arange(rows)
    about = About(ring_m=draw(st.sampled_from([0.0, 1000.0])), view=draw(st.sampled_from(["end", "whole"])))
    return assemble(columns, about, checked=False)


def _is_a_name(text: str) -> bool:
    try:
        text.encode()
    except UnicodeEncodeError:
        return False
    return text.strip() == text and text not in ("", NOBODY) and not text.endswith(".0")


@settings(deadline=None, max_examples=100)
@given(some_tracks())
def test_tracks_come_back_from_parquet(tracks: Tracks) -> None:
    with TemporaryDirectory() as folder:
        path = Path(folder, "a.parquet")
        write_tracks(tracks, path)
        back = read_tracks(path)
        assert list(Path(folder).iterdir()) == [path]
    assert back.about == tracks.about
    for name in tracks.columns:
        one, two = tracks.column(name), back.column(name)
        if isinstance(one, Labels):
            assert isinstance(two, Labels)
            assert one.values().tolist() == two.values().tolist()
        else:
            np.testing.assert_array_equal(one, two)
    np.testing.assert_array_equal(back.leader_row, tracks.leader_row)


@settings(deadline=None, max_examples=100)
@given(some_tracks())
def test_leaders_are_ahead_at_the_same_time_in_the_same_lane(tracks: Tracks) -> None:
    row = np.flatnonzero(tracks.leader_row >= 0)
    ahead = tracks.leader_row[row]
    np.testing.assert_array_equal(tracks.time_s[ahead], tracks.time_s[row])
    np.testing.assert_array_equal(tracks.recording.code[ahead], tracks.recording.code[row])
    # On a ring, a vehicle less than a length behind counts as one that overlaps, not as one almost a round ahead.
    assert (gaps(tracks)[row] >= (-8.0 if tracks.about.ring_m else -4.0)).all()
    assert len(set(ahead.tolist())) == len(ahead)
    if tracks.lane is not None:
        np.testing.assert_array_equal(tracks.lane.code[ahead], tracks.lane.code[row])


@settings(deadline=None, max_examples=100)
@given(some_tracks(), st.sampled_from([0.3, 1.0]))
def test_any_tracks_can_be_cut_into_stretches(tracks: Tracks, shortest_s: float) -> None:
    told = ""
    try:
        for one in stretches(tracks, shortest_s):
            assert one.duration_s >= shortest_s - 1e-9
            assert one.position_m.shape == one.identity.shape == one.length_m.shape
            assert (one.identity[:, 0] >= 0).all()
    except InputError as error:
        told = str(error)
    assert "\n" not in told
