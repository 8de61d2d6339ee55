"""CommonRoad scenarios: obstacles on lanelets that follow one another."""

from pathlib import Path

import numpy as np
import pytest

from sugiyama_ros.errors import InputError
from sugiyama_ros.formats.registry import format_of, read_tracks
from sugiyama_ros.trajectories.leaders import gaps


def bound(y: float, first: float, last: float) -> str:
    return "".join(f"<point><x>{x}</x><y>{y}</y></point>" for x in (first, 0.5 * (first + last), last))


def lanelet(name: int, y: float, first: float, last: float, successor: int = 0) -> str:
    after = f'<successor ref="{successor}"/>' if successor else ""
    return (
        f'<lanelet id="{name}"><leftBound>{bound(y + 1.75, first, last)}</leftBound>'
        f"<rightBound>{bound(y - 1.75, first, last)}</rightBound>{after}</lanelet>"
    )


def state(tag: str, i: int, x: float, y: float) -> str:
    return (
        f"<{tag}><position><point><x>{x}</x><y>{y}</y></point></position><orientation><exact>0</exact></orientation>"
        f"<time><exact>{i}</exact></time></{tag}>"
    )


def obstacle(name: int, x: float, y: float, samples: int = 60) -> str:
    states = [state("initialState" if i == 0 else "state", i, x + 2.0 * i, y) for i in range(samples)]
    return (
        f'<dynamicObstacle id="{name}"><type>car</type><shape><rectangle><length>4.5</length><width>1.8</width>'
        f"</rectangle></shape>{states[0]}<trajectory>{''.join(states[1:])}</trajectory></dynamicObstacle>"
    )


def scenario(*obstacles: str) -> str:
    lanelets = [lanelet(1, 0.0, 0.0, 100.0, 2), lanelet(2, 0.0, 100.0, 300.0), lanelet(3, 3.5, 0.0, 300.0)]
    return f'<?xml version="1.0"?><commonRoad timeStepSize="0.1">{"".join(lanelets)}{"".join(obstacles)}</commonRoad>'


def test_positions_are_measured_along_the_lane(tmp_path: Path) -> None:
    path = tmp_path / "USA_US101-1.xml"
    path.write_text(
        scenario(obstacle(11, 80.0, 0.2), obstacle(12, 50.0, 0.0), obstacle(13, 60.0, 3.4), obstacle(14, 5.0, 40.0))
    )
    assert format_of(path).name == "commonroad"
    tracks = read_tracks(path)
    assert tracks.vehicle.used() == ("11", "12", "13")
    assert dict(tracks.about.dropped) == {"no position": 60}
    assert tracks.lane.values()[::60].tolist() == ["1", "1", "3"]
    assert tracks.leader.values()[::60].tolist() == [None, "11", None]
    np.testing.assert_allclose(np.diff(tracks.s_m.reshape(3, 60)), 2.0, atol=1e-9)
    np.testing.assert_allclose(gaps(tracks)[60:120], 25.5)
    np.testing.assert_allclose(tracks.d_m[::60], [0.2, 0.0, -0.1])


def test_damaged_scenarios_are_refused(tmp_path: Path) -> None:
    path = tmp_path / "a.xml"
    path.write_text(scenario(obstacle(11, 80.0, 0.2)).replace("<x>80.0</x>", "<x>far</x>"))
    with pytest.raises(InputError, match=r"a.xml: obstacle 11: position point x 'far' is not a finite number"):
        read_tracks(path)
    path.write_text(scenario())
    with pytest.raises(InputError, match=r"a.xml: no lanelets, or no obstacles with a trajectory"):
        read_tracks(path)
    path.write_text(scenario(obstacle(11, 80.0, 0.2))[:-20])
    with pytest.raises(InputError, match=r"a.xml:1: ends early; get the file again, or let"):
        read_tracks(path)
