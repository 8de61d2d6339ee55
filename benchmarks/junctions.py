"""Traffic of SUMO at junctions: made here, and how often the routes are right that are found in it.

    python -m benchmarks.junctions make roundabout FOLDER --seed 1 --minutes 10
    python -m benchmarks.junctions routes FOLDER [--noise 0.3]

``make`` writes ``FOLDER/road.net.xml``, ``FOLDER/fcd.xml`` (floating car data) and ``FOLDER/road.csv``. The scenes are
``roundabout``, ``signals`` (a crossing), ``priority`` (a crossing), ``ramp`` (one lane) and ``lanes`` (a ramp onto two
lanes, with changes of lanes). The drivers follow SUMO's own laws and rules at junctions. SUMO is not part of this
package: ``pip install eclipse-sumo`` in any environment, and name its folder of programs with ``--sumo``, or have it in
the path.
"""

import argparse
import shlex
import shutil
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path

import numpy as np

from sugiyama_ros.arrays import Array, Ints, Mask
from sugiyama_ros.errors import InputError
from sugiyama_ros.formats.reading import attribute, elements
from sugiyama_ros.formats.road_csv import write_road
from sugiyama_ros.formats.roads import read_road
from sugiyama_ros.roads.network import Network
from sugiyama_ros.roads.routes import Routes, SeenRows, places_near, routes_of

# Drivers that SUMO draws: how their speeds differ, and the laws they follow.
_LAWS = {
    "Krauss": 'carFollowModel="Krauss" sigma="0.3"',
    "IDM": 'carFollowModel="IDM" tau="1.2"',
}
# Time [s] for which a vehicle is beside the middle.
_ASIDE_S = 5.0
# Distance [m] within which a lane may be the nearest one.
_NEAR_M = 3.5
# Speed limits [m/s]: in towns, on a roundabout, and on a motorway.
_TOWN, _RING, _FAST = 13.9, 8.3, 27.8


def main() -> None:
    """Make traffic, or say how many routes are right."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parts = parser.add_subparsers(dest="part", required=True)
    made = parts.add_parser("make")
    made.add_argument("scene", choices=sorted(_SCENES))
    made.add_argument("folder", type=Path)
    made.add_argument("--seed", type=int, default=1)
    made.add_argument("--minutes", type=float, default=10.0)
    made.add_argument("--step", type=float, default=0.1, help="time between two samples [s]")
    made.add_argument("--law", choices=sorted(_LAWS), default="Krauss")
    made.add_argument(
        "--flow", type=float, default=0.0, help="vehicles an hour on each way in, if not the usual number"
    )
    made.add_argument("--change", type=float, default=3.0, help="how long a change of lanes takes [s]; 0: no time")
    made.add_argument("--sumo", type=Path, default=None, help="folder of SUMO's programs")
    found = parts.add_parser("routes")
    found.add_argument("folders", type=Path, nargs="+")
    found.add_argument(
        "--noise", type=float, default=0.0, help="noise of positions [m], whose headings are not known then"
    )
    found.add_argument("--aside", type=float, default=0.0, help="how far vehicles are beside the middle [m], for 5 s")
    arguments = parser.parse_args()
    try:
        if arguments.part == "make":
            make(arguments)
        else:
            print(f"{'folder':26}{'vehicles':>9}{'route':>9}{'nearest':>9}{'rows':>9}{'on route':>10}{'on lane':>9}")
            for folder in arguments.folders:
                vehicles, rows, *counts = compared(folder, arguments.noise, arguments.aside)
                right, nearest, on_way, on_lane = (
                    f"{100.0 * count / of:.2f}%"
                    for count, of in zip(counts, (vehicles, vehicles, rows, rows), strict=True)
                )
                print(f"{folder.name[-26:]:26}{vehicles:9}{right:>9}{nearest:>9}{rows:9}{on_way:>10}{on_lane:>9}")
    except InputError as error:
        sys.exit(f"error: {error}")


def make(arguments: argparse.Namespace) -> None:
    """Write a network and the traffic on it. Raises InputError without SUMO."""
    netconvert, sumo = (_program(name, arguments.sumo) for name in ("netconvert", "sumo"))
    folder: Path = arguments.folder
    folder.mkdir(parents=True, exist_ok=True)
    nodes, edges, ways, usual = _SCENES[arguments.scene]()
    (folder / "road.nod.xml").write_text(f"<nodes>{''.join(nodes)}</nodes>")
    (folder / "road.edg.xml").write_text(f"<edges>{''.join(edges)}</edges>")
    flow = arguments.flow or usual
    flows = [
        f'<flow id="{k}" type="car" from="{begin}" to="{end}" begin="0" end="{60.0 * arguments.minutes}"'
        f' period="exp({flow * share / 3600.0:.6f})" departSpeed="max" departLane="best"/>'
        for k, (begin, end, share) in enumerate(ways)
    ]
    drivers = f'<vType id="car" length="5.0" width="1.8" speedFactor="normc(1,0.1,0.7,1.3)" {_LAWS[arguments.law]}/>'
    (folder / "traffic.rou.xml").write_text(f"<routes>{drivers}{''.join(flows)}</routes>")
    _run(
        f"{netconvert} -n road.nod.xml -e road.edg.xml -o road.net.xml --no-turnarounds true"
        " --junctions.internal-link-detail 20 --junctions.corner-detail 10",
        folder,
    )
    _run(
        f"{sumo} -n road.net.xml -r traffic.rou.xml --seed {arguments.seed} --step-length {arguments.step}"
        f" --end {60.0 * arguments.minutes} --fcd-output fcd.xml"
        " --fcd-output.attributes id,x,y,angle,speed,pos,lane,type,leaderID,leaderGap"
        " --fcd-output.max-leader-distance 300 --precision 3"
        f" --collision.action warn --no-step-log true --lanechange.duration {arguments.change}",
        folder,
    )
    network = read_road(folder / "road.net.xml")
    write_road(network, folder / "road.csv")
    print(f"{folder}: {network.headline()}")


def compared(folder: Path, noise_m: float, aside_m: float) -> tuple[int, int, int, int, int, int]:
    """Count vehicles and rows, and what is right.

    These are vehicles whose route is right, and those whose sequence of nearest lanes is; rows on a route with the
    right lane, and rows on the right lane. A route is right if it names the lanes between junctions that SUMO names, in
    this order.
    """
    network = read_road(folder / "road.csv")
    vehicle, time, x, y, heading, lane = _samples(folder / "fcd.xml", network)
    rng = np.random.default_rng(1)
    if aside_m:
        keeps = np.exp(-float(np.min(np.diff(np.unique(time)))) / _ASIDE_S)
        shift = aside_m * np.sqrt(1.0 - keeps**2) * rng.normal(size=len(x))
        for k in range(1, len(x)):
            shift[k] += keeps * shift[k - 1]
        x, y = x - shift * np.sin(heading), y + shift * np.cos(heading)
    if noise_m:
        x, y = (axis + noise_m * rng.normal(size=len(axis)) for axis in (x, y))
    found = routes_of(network, vehicle, time, x, y, None if noise_m else heading)
    seen = SeenRows(vehicle, time, np.stack((x, y), axis=1), np.full(len(x), np.nan))
    near = places_near(network, seen, _NEAR_M)
    nearest = np.array([min(near[k], key=lambda one: one.distance).lane if k in near else -1 for k in range(len(x))])
    between = np.array([not one.name.startswith(":") for one in network.lanes])
    right = as_near = on_way = 0
    for rows in np.split(np.arange(len(vehicle)), np.flatnonzero(np.diff(vehicle)) + 1):
        truth = _sequence(lane[rows], between)
        right += _routes(found, rows, between) == truth
        as_near += _sequence(nearest[rows], between) == truth
        ways = [set(found.paths[k].lanes) if k >= 0 else set() for k in found.route[rows].tolist()]
        on_way += sum(one in way for one, way in zip(lane[rows].tolist(), ways, strict=True))
    return len(np.unique(vehicle)), len(lane), right, as_near, on_way, int((found.lane == lane).sum())


def _sequence(lane: Ints, between: Mask) -> list[int]:
    """The lanes between junctions, each once as long as a vehicle stays on it."""
    return [one for one in lane[np.diff(lane, prepend=-1) != 0].tolist() if one >= 0 and between[one]]


def _routes(found: Routes, rows: Ints, between: Mask) -> list[int]:
    """The lanes between junctions of all routes of a vehicle."""
    route = found.route[rows]
    numbers = [one for one in route[np.diff(route, prepend=-2) != 0].tolist() if one >= 0]
    return _sequence(np.array([k for one in numbers for k in found.paths[one].lanes], dtype=np.int64), between)


def _samples(path: Path, network: Network) -> tuple[Ints, Array, Array, Array, Array, Ints]:
    """Vehicle, time [s], x, y [m], heading [rad] and number of the lane of each row, by vehicle and time."""
    rows, vehicles = [], dict[str, int]()
    for step in elements(path, "timestep"):
        time = attribute(step.attrib, "time", str(path))
        for one in step.iter("vehicle"):
            x, y, angle = (attribute(one.attrib, name, str(path)) for name in ("x", "y", "angle"))
            number = vehicles.setdefault(one.get("id", ""), len(vehicles))
            rows.append((number, time, x, y, np.radians(90.0 - angle), network.number(one.get("lane", ""))))
    vehicle, time, x, y, heading, lane = np.array(sorted(rows)).T
    return vehicle.astype(np.int64), time, x, y, heading, lane.astype(np.int64)


def _program(name: str, folder: Path | None) -> str:
    found = shutil.which(name, path=None if folder is None else str(folder))
    if found is None:
        raise InputError(f"{name} of SUMO is not there; pip install eclipse-sumo, and name its folder with --sumo")
    return shlex.quote(found)


def _run(command: str, folder: Path) -> None:
    done = subprocess.run(shlex.split(command), cwd=folder, capture_output=True, text=True, check=False)
    if done.returncode:
        raise InputError(f"{command.split()[0]}: {done.stderr.strip()[:300]}")
    if done.stderr.strip():
        print(done.stderr.strip()[:2000], file=sys.stderr)


# Nodes, edges, ways through them with their shares of the traffic of a way in, and vehicles an hour on a way in.
_Scene = tuple[list[str], list[str], list[tuple[str, str, float]], float]


def _node(name: str, x: float, y: float, kind: str = "priority") -> str:
    return f'<node id="{name}" x="{x:.2f}" y="{y:.2f}" type="{kind}"/>'


def _edge(name: str, begin: str, end: str, speed: float, priority: int = 1, lanes: int = 1, shape: str = "") -> str:
    bends = f' shape="{shape}"' if shape else ""
    return (
        f'<edge id="{name}" from="{begin}" to="{end}" speed="{speed}" priority="{priority}" numLanes="{lanes}"{bends}/>'
    )


def _turns(share: float) -> list[tuple[str, str, float]]:
    """Ways across four arms: a share turns right, as many turn left, and the others drive straight on."""
    shares = {1: share, 2: 1.0 - 2.0 * share, 3: share}
    return [(f"in{k}", f"out{(k + turn) % 4}", part) for k in range(4) for turn, part in shares.items()]


def _roundabout() -> _Scene:
    """Four arms of 120 m around a ring of 20 m radius."""
    nodes, edges = [], []
    for k in range(4):
        angle = 0.5 * np.pi * k
        nodes += [_node(f"far{k}", 140.0 * np.cos(angle), 140.0 * np.sin(angle))]
        nodes += [_node(f"ring{k}", 20.0 * np.cos(angle), 20.0 * np.sin(angle))]
        arc = angle + np.linspace(0.0, 0.5 * np.pi, 16)
        shape = " ".join(f"{20.0 * np.cos(one):.2f},{20.0 * np.sin(one):.2f}" for one in arc)
        edges += [_edge(f"in{k}", f"far{k}", f"ring{k}", _TOWN), _edge(f"out{k}", f"ring{k}", f"far{k}", _TOWN)]
        edges += [_edge(f"ring{k}", f"ring{k}", f"ring{(k + 1) % 4}", _RING, 10, 1, shape)]
    return nodes, edges, _turns(0.3), 350.0


def _crossing(kind: str) -> _Scene:
    """Four arms of 150 m; with priority, the road of arms 0 and 2 has it."""
    nodes, edges = [_node("middle", 0.0, 0.0, kind)], []
    for k in range(4):
        angle, priority = 0.5 * np.pi * k, 10 - 5 * (k % 2)
        nodes += [_node(f"far{k}", 150.0 * np.cos(angle), 150.0 * np.sin(angle))]
        edges += [
            _edge(f"in{k}", f"far{k}", "middle", _TOWN, priority),
            _edge(f"out{k}", "middle", f"far{k}", _TOWN, priority),
        ]
    return nodes, edges, _turns(0.2), 350.0 if kind == "traffic_light" else 250.0


def _signals() -> _Scene:
    return _crossing("traffic_light")


def _priority() -> _Scene:
    return _crossing("priority")


def _ramp() -> _Scene:
    """A main road of one lane, and a ramp that yields."""
    nodes = [
        _node("west", -400.0, 0.0),
        _node("merge", 0.0, 0.0),
        _node("east", 400.0, 0.0),
        _node("ramp", -250.0, -60.0),
    ]
    edges = [_edge("main", "west", "merge", _FAST, 10), _edge("after", "merge", "east", _FAST, 10)]
    edges += [_edge("ramp", "ramp", "merge", _TOWN, 1, 1, "-250,-60 -120,-30 -40,-4 0,0")]
    return nodes, edges, [("main", "after", 1.0), ("ramp", "after", 0.5)], 500.0


def _lanes() -> _Scene:
    """A main road of two lanes, and a ramp whose lane goes on beside it for 200 m."""
    places = {"west": -500.0, "begin": 0.0, "end": 200.0, "east": 700.0}
    nodes = [_node(name, x, 0.0) for name, x in places.items()] + [_node("ramp", -250.0, -60.0)]
    edges = [
        _edge("main", "west", "begin", _FAST, 10, 2),
        _edge("beside", "begin", "end", _FAST, 10, 3),
        _edge("after", "end", "east", _FAST, 10, 2),
        _edge("ramp", "ramp", "begin", _TOWN, 1, 1, "-250,-60 -120,-30 -40,-12 0,-8"),
    ]
    return nodes, edges, [("main", "after", 1.0), ("ramp", "after", 0.3)], 1200.0


_SCENES: dict[str, Callable[[], _Scene]] = {
    "roundabout": _roundabout,
    "signals": _signals,
    "priority": _priority,
    "ramp": _ramp,
    "lanes": _lanes,
}


if __name__ == "__main__":
    main()
