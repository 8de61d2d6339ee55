"""Who is ahead in traffic of SUMO: leaders found on the road beside SUMO's own, seen whole and in parts.

    python -m benchmarks.junctions make signals FOLDER --minutes 10
    python -m benchmarks.ahead FOLDER [FOLDER ...]

Each folder is read whole, through a window of 150 m, and cut to pieces of 4 s. A leader is wrong if it is not SUMO's
own; SUMO's leaders who come from another way do not count (it also names those who cross). A free road is invented if
SUMO has a leader within 200 m.
"""

import argparse
from collections import Counter
from collections.abc import Iterator
from pathlib import Path
from tempfile import TemporaryDirectory
from xml.etree.ElementTree import Element

import numpy as np

import sugiyama_ros as sg
from sugiyama_ros.arrays import Array
from sugiyama_ros.formats.reading import elements
from sugiyama_ros.trajectories.tracks import FREE, UNKNOWN, Tracks

#: Side [m] of the window around the middle, length [s] of the pieces, and way [m] within which a leader matters.
WINDOW_M, PIECE_S, WITHIN_M = 150.0, 4.0, 200.0
_KEPT = ("id", "x", "y", "angle", "speed", "pos", "lane", "type")


def main() -> None:
    """Print a line for each folder and each way to see it."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("folders", type=Path, nargs="+")
    arguments = parser.parse_args()
    print(f"{'folder':20}{'seen':>8}{'rows':>9}{'named':>9}{'wrong':>7}{'free':>8}{'invented':>9}{'unknown':>9}")
    for folder in arguments.folders:
        truth = Truth(folder / "fcd.xml")
        for seen in ("whole", "window", "pieces"):
            counts: Counter[str] = Counter()
            for tracks in read(folder, truth, seen):
                counts += truth.judged(tracks)
            print(
                f"{folder.name:20}{seen:>8}"
                + "".join(
                    f"{counts[name]:{width}}"
                    for name, width in (
                        ("rows", 9),
                        ("named", 9),
                        ("wrong", 7),
                        ("free", 8),
                        ("invented", 9),
                        ("unknown", 9),
                    )
                )
            )


class Truth:
    """What SUMO says: the samples by time, the leader and the gap [m] of each, and the lanes that vehicles are on."""

    def __init__(self, path: Path) -> None:
        self.steps: list[tuple[float, list[dict[str, str]]]] = []
        self.at: dict[tuple[str, int], dict[str, str]] = {}
        self.lanes: dict[str, set[str]] = {}
        for step in elements(path, "timestep"):
            time = float(step.attrib["time"])
            rows = [dict(one.attrib) for one in step.iter("vehicle")]
            self.steps.append((time, rows))
            for one in rows:
                self.at[one["id"], round(1e3 * time)] = one
                self.lanes.setdefault(one["id"], set()).add(one["lane"])

    def judged(self, tracks: Tracks) -> Counter[str]:
        """Count rows, leaders named and wrong, free roads and those invented, and unknown leaders."""
        names, counts = tracks.vehicle.values(), Counter(rows=len(tracks))
        for row, leader in enumerate(tracks.leader_row.tolist()):
            said = self.at[names[row], round(1e3 * float(tracks.time_s[row]))]
            ahead = said.get("leaderID", "")
            if leader == UNKNOWN:
                counts["unknown"] += 1
            elif leader == FREE:
                counts["free"] += 1
                counts["invented"] += bool(ahead) and float(said["leaderGap"]) < WITHIN_M
            else:
                counts["named"] += 1
                counts["wrong"] += self._is_wrong(said, str(names[leader]), round(1e3 * float(tracks.time_s[row])))
        return counts

    def _is_wrong(self, said: dict[str, str], leader: str, time_ms: int) -> bool:
        ahead = said.get("leaderID", "")
        if ahead == leader or not ahead:
            # SUMO does not look farther than the end of the drive
            return False
        return self.at[ahead, time_ms]["lane"] in self.lanes[said["id"]]


def read(folder: Path, truth: Truth, seen: str) -> Iterator[Tracks]:
    """The tracks of what is seen of the traffic."""
    network = sg.read_road(folder / "road.net.xml")
    ends = np.array(
        [[edge(axis) for axis in (lane.x_m, lane.y_m)] for lane in network.lanes for edge in (np.min, np.max)]
    )
    middle = 0.5 * (ends.min(axis=0) + ends.max(axis=0))
    cut: dict[int, list[str]] = {}
    for time, rows in truth.steps:
        kept = [one for one in rows if seen != "window" or _is_near(one, middle)]
        said = "".join(_written(one) for one in kept)
        piece = int(time / PIECE_S) if seen == "pieces" else 0
        cut.setdefault(piece, []).append(f'<timestep time="{time:.2f}">{said}</timestep>' if kept else "")
    with TemporaryDirectory() as temporary:
        path = Path(temporary) / "fcd.xml"
        for steps in cut.values():
            if any(steps):
                path.write_text(f"<fcd-export>{''.join(steps)}</fcd-export>")
                yield sg.read(path, road=network)


def _is_near(one: dict[str, str], middle: Array) -> bool:
    return bool(max(abs(float(one[axis]) - at) for axis, at in zip("xy", middle, strict=True)) < 0.5 * WINDOW_M)


def _written(one: dict[str, str]) -> str:
    element = Element("vehicle", {name: one[name] for name in _KEPT})
    return "<vehicle " + " ".join(f'{name}="{value}"' for name, value in element.attrib.items()) + "/>"


if __name__ == "__main__":
    main()
