"""A small valid file of each format: three vehicles on one lane and one beside them, 20 m apart, at 10 m/s."""

import io
from collections.abc import Callable, Iterator
from pathlib import Path
from tempfile import TemporaryDirectory

import diagnoses
import maps
import numpy as np

from sugiyama_ros.driver.parameters import PARAMETERS
from sugiyama_ros.formats.convert import write_bag
from sugiyama_ros.formats.registry import read_tracks
from sugiyama_ros.road import Road
from sugiyama_ros.trajectories.dense import DenseTracks
from sugiyama_ros.trajectories.exchange import write_parquet

SAMPLES, PERIOD_S, SPEED, AHEAD_M = 70, 0.1, 10.0, 20.0
#: Number, lane and leader of each vehicle.
_VEHICLES = ((1, 1, 0), (2, 1, 1), (3, 1, 2), (4, 2, 0))


def _samples() -> Iterator[tuple[int, int, int, int, float]]:
    """Number, lane, leader, index of the sample, and position [m]."""
    for number, lane, leader in _VEHICLES:
        for i in range(SAMPLES):
            yield number, lane, leader, i, 100.0 - AHEAD_M * number + SPEED * PERIOD_S * i


def _table(header: str, row: Callable[[int, int, int, int, float], str], rows: int | None = None) -> str:
    return "\n".join([header, *[row(*one) for one in _samples()][:rows]]) + "\n"


def _mstf() -> str:
    car = "\n".join(f"{3.0 * i:.3f} {i / 3:.3f}" for i in range(20))
    other = "\n".join(f"{50 + 2.0 * i:.3f} {i / 3:.3f}" for i in range(20))
    return f"#   Total number of car is 2 and circuit length is 100m.\n#\n{car}\n\n{other}\n"


def _highd() -> str:
    names = (
        "frame,id,x,y,width,height,xVelocity,yVelocity,xAcceleration,yAcceleration,frontSightDistance,"
        "backSightDistance,dhw,thw,ttc,precedingXVelocity,precedingId,followingId,leftPrecedingId,leftAlongsideId,"
        "leftFollowingId,rightPrecedingId,rightAlongsideId,rightFollowingId,laneId"
    )
    rest = "0,0,0,0,0,0,0,0,0"
    return _table(names, lambda n, lane, p, i, s: f"{i + 1},{n},{s:.2f},8,4,2,10,{rest},{p},0,0,0,0,0,0,0,{lane}")


def _ngsim() -> str:
    return "".join(
        f"{n} {i + 10} {SAMPLES} {1118846979700 + 100 * i} 18.0 {s / 0.3048:.3f} 6042842.1 2133117.6 15 6.0 2 32.8 0.0"
        f" {lane} {p} 0 65.6 2.0\n"
        for n, lane, p, i, s in _samples()
    )


def _sumo() -> str:
    lines = ["<?xml version='1.0'?>", "<fcd-export>"]
    for i in range(SAMPLES):
        lines.append(f'<timestep time="{PERIOD_S * i:.2f}">')
        for n, lane, p, k, s in _samples():
            if k == i:
                lines.append(
                    f'<vehicle id="v{n}" x="{s}" y="0" angle="90" type="car" speed="10" pos="{s}" lane="in_{lane}"'
                    f' leaderID="v{p}"/>'
                )
        lines.append("</timestep>")
    return "\n".join([*lines, "</fcd-export>"]) + "\n"


def _commonroad() -> str:
    def bound(y: float) -> str:
        return "".join(f"<point><x>{x}</x><y>{y}</y></point>" for x in (0, 100, 300))

    def state(tag: str, i: int, s: float) -> str:
        return (
            f"<{tag}><position><point><x>{s}</x><y>0</y></point></position><orientation><exact>0</exact></orientation>"
            f"<time><exact>{i}</exact></time></{tag}>"
        )

    obstacles = []
    for number in (1, 2):
        states = [state("state" if i else "initialState", i, s) for n, _, _, i, s in _samples() if n == number]
        obstacles.append(
            f'<dynamicObstacle id="{number}"><type>car</type><shape><rectangle><length>4</length><width>2</width>'
            f"</rectangle></shape>{states[0]}<trajectory>{''.join(states[1:])}</trajectory></dynamicObstacle>"
        )
    lanelet = (
        f'<lanelet id="9"><leftBound>{bound(2)}</leftBound><rightBound>{bound(-2)}</rightBound>'
        '<successor ref="9"/></lanelet>'
    )
    return f'<?xml version="1.0"?><commonRoad timeStepSize="0.1">{lanelet}{"".join(obstacles)}</commonRoad>'


def _pneuma() -> str:
    lines = ["track_id; type; traveled_d; avg_speed; lat; lon; speed; lon_acc; lat_acc; time"]
    for number in (1, 2):
        groups = [
            f"{37.98 + s * 9e-6:.8f}; 23.73; 36.0; 0.0; 0.0; {PERIOD_S * i:.6f}"
            for n, _, _, i, s in _samples()
            if n == number
        ]
        lines.append(f"{number}; Car; 70.0; 36.0; " + "; ".join(groups) + "; ")
    return "\n".join(lines) + "\n"


def _openacc() -> str:
    head = "Date,1,2,2019\nVehicle_order,AUDI_A6,BMW_X5\nNumber_of_vehicles,2\nACC,1\nDistance_setting,min\n"
    rows = [
        f"{PERIOD_S * i:.1f},10,{40 + i:.2f},{0.5 * i:.2f},10,{20 + i:.2f},{0.5 * i:.2f},15.4" for i in range(SAMPLES)
    ]
    return head + "\n".join(["Time,Speed1,N1,E1,Speed2,N2,E2,IVS1", *rows]) + "\n"


def _fhwa() -> str:
    names = (
        "run_no,timestamp,xLeaderReal,vLeaderReal,aLeaderReal,xFollowerReal,vFollowerReal,aFollowerReal,"
        "xLeaderReal_next,vLeaderReal_next,aLeaderReal_next,xFollowerReal_next,vFollowerReal_next,aFollowerReal_next,"
        "spacing,speed_difference,follower_id,leader_id"
    )
    rest = "20,0,0,0,0,0,0,0,15.0,0,2,1"
    return _table(names, lambda n, lane, p, i, s: f"7,{0.1 * i:.1f},{s + 20},20,0,{s},{rest}", SAMPLES)


def _tgsim() -> str:
    names = (
        "id,time,xloc_kf,yloc_kf,lane_kf,speed_kf,acceleration_kf,length_smoothed,width_smoothed,type_most_common,"
        "run_index"
    )
    return _table(names, lambda n, lane, p, i, s: f"{n},{0.1 * i:.1f},{s:.2f},{3.6 * lane},{lane},20,0,4.5,1.9,car,1")


#: Name and content of each file of text.
TEXTS = {
    "plain.csv": _table("time_s,vehicle,position_m,length_m", lambda n, _, p, i, s: f"{0.1 * i:.1f},{n},{s:.2f},4.5"),
    "tracks.csv": _table(
        "recording,vehicle,time_s,s_m,lane,length_m,class,leader",
        lambda n, lane, p, i, s: f"a,v{n},{0.1 * i:.1f},{s:.2f},{lane},4.5,car,{f'v{p}' if p else ''}",
    ),
    "ring.data": _mstf(),
    "01_tracks.csv": _highd(),
    "trajectories-0400.txt": _ngsim(),
    "fcd.xml": _sumo(),
    "scenario.xml": _commonroad(),
    "20181024_d1.csv": _pneuma(),
    "openacc.csv": _openacc(),
    "pairs.csv": _fhwa(),
    "platoon-2.txt": "".join(f"{i}\t{60 + i}\t{40 + i}\t10\t10\t4.5\n" for i in range(SAMPLES)),
    "tgsim.csv": _tgsim(),
}


def bag() -> bytes:
    """A bag with the positions of three vehicles on a ring."""
    position = np.array([[100.0 - AHEAD_M * k + i for k in range(3)] for i in range(30)]) % 230.0
    given = DenseTracks(
        position_m=position,
        length_m=np.full(3, 4.5),
        vehicle=np.arange(3),
        road=Road(230.0),
        period_s=PERIOD_S,
        start_s=0.0,
        source="some.csv",
        sha256="0" * 64,
    )
    with TemporaryDirectory() as folder:
        path = Path(folder, "a.mcap")
        write_bag(given, path)
        return path.read_bytes()


#: Roads in each form.
ROADS = {
    "road.csv": (
        "lane,x_m,y_m,successors,left,right,speed_limit,width_m,priority,yields_to,stop_m,signal,signal_m\n"
        "a,-30,0,c,,,13.9,3.5,1,,,,\na,0,0,,,,,,,,,,\nc,0,0,,,,,,,b,,,\nc,30,0,,,,,,,,,,\n"
        "b,10,-30,,,,,,,,20,0:red 30.5:green /60,55\nb,10,30,,,,,,,,,,\n"
    ),
    "map.osm": maps.crossing_osm(),
    "scenario.xml": maps.scenario('<trafficSignRef ref="21"/>', '<trafficLightRef ref="30"/>'),
    "road.net.xml": maps.sumo_net("Gr ry rG"),
}


def parquet() -> bytes:
    """The tracks of the table as Parquet."""
    with TemporaryDirectory() as folder:
        path = Path(folder, "tracks.csv")
        path.write_text(TEXTS["tracks.csv"])
        stream = io.BytesIO()
        write_parquet(read_tracks(path), stream)
    return stream.getvalue()


def columns() -> dict[str, object]:
    """A map of columns."""
    position = {"column": "position_m", "factor": 1.0}
    return {"s_m": position, "vehicle": "vehicle", "time_s": "time_s", "ring_m": 230.0, "reference": "front"}


def model() -> dict[str, object]:
    """A model of two drivers with one effect, and classes."""
    parameters = {p.name: p.default for p in PARAMETERS}
    driver = {"parameters": parameters, "std": {"v_star": 0.1}, "effects": {"drag": {"c0": 0.1, "c2": 0.0}}}
    return {
        "sugiyama_model": 1,
        "version": "0.1.0",
        "data": {"source": "a.csv", "sha256": "0" * 64, "log_likelihood": 10.0},
        "effects": ["drag"],
        "shared_std": {"drag.c0": 0.1},
        "drivers": {1: driver, 2: driver},
        "classes": [{"share": 0.5, "parameters": parameters}, {"share": 0.5, "parameters": parameters}],
    }


def learnt() -> dict[str, object]:
    """What an estimator has learnt."""
    return {
        "names": ["v_star", "kappa_v"],
        "mean": [2.3, -1.0],
        "covariance": [[0.01, 0.0], [0.0, 0.1]],
        "until_ns": 10,
    }


def diagnosis() -> dict[str, object]:
    """A diagnosis, with something of everything that the report shows."""
    d = diagnoses.document("not_explained", [diagnoses.addition(), diagnoses.force()], [diagnoses.fails("wave_speed")])
    del d["where"], d["free_run"], d["about"]
    return {**d, "drivers": d["drivers"][:2], "checks": d["checks"][-2:], "candidates": d["candidates"][:2]}
