"""Positions that are written to CSV files and bags come back unchanged."""

from dataclasses import replace
from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np
from hypothesis import given, settings
from hypothesis import strategies as st

from sugiyama_ros.formats.choices import Choices
from sugiyama_ros.formats.convert import write_bag
from sugiyama_ros.formats.registry import read_tracks
from sugiyama_ros.formats.table import write_csv
from sugiyama_ros.road import Road
from sugiyama_ros.trajectories.dense import DenseTracks


@st.composite
def some_trajectories(draw: st.DrawFn) -> DenseTracks:
    """A few vehicles that come and go at up to 42 m/s, with samples missing in between."""
    steps, vehicles = draw(st.integers(2, 12)), draw(st.integers(1, 4))
    random = np.random.default_rng(draw(st.integers(0, 1 << 32)))
    road = Road(draw(st.sampled_from([0.0, 230.0, 1000.1])))
    period_s = draw(st.sampled_from([1.0 / 3.0, 0.1, 0.04, 1.0]) | st.floats(0.01, 2.0))
    start = random.uniform(-50.0, 2000.0, vehicles)
    position = road.wrap(start + period_s * np.cumsum(random.uniform(-15.0, 42.0, (steps, vehicles)), axis=0))
    position[random.random((steps, vehicles)) < draw(st.sampled_from([0.0, 0.3]))] = np.nan
    # Each vehicle is seen at least once, and the first vehicle always: a time without any sample is not written.
    position[:, 0] = road.wrap(start[0] + period_s * np.arange(steps))
    position[0, :] = road.wrap(start)
    return DenseTracks(
        position_m=position,
        length_m=random.uniform(3.0, 20.0, vehicles),
        vehicle=random.permutation(50)[:vehicles],
        road=road,
        period_s=period_s,
        start_s=draw(st.sampled_from([0.0, 12.5]) | st.floats(0.0, 1000.0)),
        source="some.csv",
        sha256="0" * 64,
    )


def same(back: DenseTracks, given: DenseTracks) -> None:
    order = np.argsort(given.vehicle)
    np.testing.assert_array_equal(back.vehicle, given.vehicle[order])
    np.testing.assert_array_equal(back.length_m, given.length_m[order])
    np.testing.assert_array_equal(back.position_m, given.position_m[:, order])
    np.testing.assert_allclose(back.time_s, given.time_s, rtol=0.0, atol=1e-9)
    assert back.road == given.road


@settings(deadline=None, max_examples=50)
@given(some_trajectories())
def test_bag(trajectories: DenseTracks) -> None:
    given = replace(trajectories, position_m=trajectories.position_m.copy())
    with TemporaryDirectory() as folder:
        path = Path(folder, "a.mcap")
        write_bag(trajectories, path)
        back = read_tracks(path).dense()
        assert list(Path(folder).iterdir()) == [path]
    same(back, given)
    assert back.period_s == trajectories.period_s
    assert (back.source, back.sha256) == (trajectories.source, trajectories.sha256)


@settings(deadline=None, max_examples=50)
@given(some_trajectories())
def test_csv(trajectories: DenseTracks) -> None:
    with TemporaryDirectory() as folder:
        path = Path(folder, "a.csv")
        write_csv(trajectories, path)
        back = read_tracks(path, Choices(ring_m=trajectories.road.circumference_m)).dense()
        assert list(Path(folder).iterdir()) == [path]
    same(back, trajectories)
