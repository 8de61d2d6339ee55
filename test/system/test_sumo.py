"""Traffic of SUMO on three lanes: the importer finds the leaders and the lengths that SUMO knows.

`pip install eclipse-sumo` (extra `sumo`) makes these tests run.
"""

import re
import subprocess
import sysconfig
from pathlib import Path
from xml.etree import ElementTree

import numpy as np
import pytest

from sugiyama_ros.formats.registry import read_tracks
from sugiyama_ros.trajectories.leaders import gaps
from sugiyama_ros.trajectories.tracks import Tracks

pytest.importorskip("sumo", reason="SUMO is not installed: pip install eclipse-sumo")
pytestmark = pytest.mark.system

CAR_M, TRUCK_M = 4.5, 12.0
NODES = '<nodes><node id="a" x="0" y="0"/><node id="b" x="2000" y="0"/><node id="c" x="6000" y="200"/></nodes>'
EDGES = """<edges>
  <edge id="in" from="a" to="b" numLanes="3" speed="30"/><edge id="out" from="b" to="c" numLanes="3" speed="30"/>
</edges>"""
TYPES = f"""<routes>
  <vType id="car" length="{CAR_M}"/><vType id="truck" length="{TRUCK_M}" vClass="truck" maxSpeed="22"/>
  <route id="all" edges="in out"/>"""
LATE = '<flow id="late" type="car" route="all" begin="1" end="60" number="60" departLane="free" departSpeed="15"/>'
#: Vehicles on each edge and lane at the start, every eighth of them a truck, so many metres apart.
AT_START, APART_M = (("in", 0, 54), ("out", 1, 108)), 36
LEADERS = "id,x,y,angle,type,speed,pos,lane,slope,leaderID,leaderGap,leaderSpeed"


def routes() -> str:
    """Vehicles on both edges at the start, and more that come in."""
    lines = [TYPES]
    for edge, number, count in AT_START:
        for k in range(count):
            for lane in range(3):
                kind = "truck" if (k + 3 * lane) % 8 == 0 and lane < 2 else "car"
                place = f'departEdge="{number}" departLane="{lane}" departPos="{20 + APART_M * k}"'
                lines.append(
                    f'<vehicle id="{edge}.{lane}.{k}" type="{kind}" route="all" depart="0" departSpeed="8" {place}/>'
                )
    return "\n".join([*lines, LATE, "</routes>"])


def program(name: str, *arguments: str, folder: Path) -> None:
    path = Path(sysconfig.get_path("scripts")) / name
    subprocess.run([path, *arguments], cwd=folder, check=True, capture_output=True, text=True)


@pytest.fixture(scope="module")
def recorded(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Floating car data of a minute, with SUMO's own leaders and gaps."""
    folder = tmp_path_factory.mktemp("sumo")
    for name, text in (("a.nod.xml", NODES), ("a.edg.xml", EDGES), ("a.rou.xml", routes())):
        (folder / name).write_text(text)
    program("netconvert", "-n", "a.nod.xml", "-e", "a.edg.xml", "-o", "net.xml", folder=folder)
    more = ("--end", "60", "--step-length", "0.5", "--seed", "1", "--no-step-log", "--fcd-output", "fcd.xml")
    leaders = ("--fcd-output.attributes", LEADERS, "--fcd-output.max-leader-distance", "7000")
    program("sumo", "-n", "net.xml", "-r", "a.rou.xml", *more, *leaders, folder=folder)
    return folder / "fcd.xml"


def given(path: Path) -> dict[tuple[int, str], tuple[str, float]]:
    """SUMO's leader and gap [m] of each vehicle at each tenth of a second."""
    return {
        (round(10.0 * float(step.attrib["time"])), one.attrib["id"]): (
            one.attrib["leaderID"],
            float(one.attrib["leaderGap"]),
        )
        for step in ElementTree.parse(path).getroot()
        for one in step
    }


def of_rows(tracks: Tracks, path: Path) -> list[tuple[str, float]]:
    known = given(path)
    tick = np.round(10.0 * tracks.time_s).astype(int).tolist()
    return [known[key] for key in zip(tick, tracks.vehicle.values().tolist(), strict=True)]


def test_leaders_are_those_of_sumo(recorded: Path, tmp_path: Path) -> None:
    bare = tmp_path / "bare.xml"
    bare.write_text(re.sub(r' leader\w+="[^"]*"', "", recorded.read_text()))
    program("sugiyama", "convert", "bare.xml", "tracks.parquet", folder=tmp_path)
    tracks = read_tracks(tmp_path / "tracks.parquet")
    assert tracks.lane is not None
    assert tracks.lane.used() == ("0", "1", "2")
    assert len(tracks.vehicle.used()) >= 500
    changes = (np.diff(tracks.lane.code) != 0) & (np.diff(tracks.run) == 0)
    assert changes.sum() > 50, "vehicles should change lanes"
    names = [*tracks.vehicle.values().tolist(), ""]
    truth = [leader for leader, _ in of_rows(tracks, recorded)]
    found = [names[max(row, -1)] for row in tracks.leader_row.tolist()]
    right = np.mean([one == other for one, other in zip(found, truth, strict=True)])
    assert right >= 0.995


def test_lengths_follow_from_gaps(recorded: Path) -> None:
    tracks = read_tracks(recorded)
    assert "the next vehicle ahead is the given leader in 100 %" in tracks.about.notes
    assert tracks.vehicle_class is not None
    is_truck = np.array([one == "truck" for one in tracks.vehicle_class.values()])
    followed = np.unique(tracks.leader_row[tracks.leader_row >= 0])
    np.testing.assert_allclose(tracks.length_m[followed], np.where(is_truck, TRUCK_M, CAR_M)[followed], atol=0.05)
    error_m = np.abs(gaps(tracks) - [gap for _, gap in of_rows(tracks, recorded)])[tracks.leader_row >= 0]
    # SUMO rounds to 0.01 m; the length of the junction is the median of what vehicles show that cross it
    assert np.quantile(error_m, 0.999) < 0.05
    assert error_m.max() < 0.2
