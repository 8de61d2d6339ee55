"""Vehicles in the plane become vehicles on the lanes of a road."""

from dataclasses import replace

import numpy as np

from sugiyama_ros.formats.columns import Rows, text_of
from sugiyama_ros.formats.off_road import off_road
from sugiyama_ros.roads.network import Network
from sugiyama_ros.roads.routes import routes_of
from sugiyama_ros.roads.scene import scene
from sugiyama_ros.roads.view import OnNetwork, sides, widths
from sugiyama_ros.trajectories.about import About, Reference
from sugiyama_ros.trajectories.assemble import TO_CENTRE, check_possible, lengths_of
from sugiyama_ros.trajectories.labels import Labels, joined, labels
from sugiyama_ros.trajectories.tracks import FREE, NOBODY


def on_road(
    columns: Rows, network: Network, about: About, reference: Reference = "centre", cure: str = ""
) -> tuple[Rows, About]:
    """Put vehicles on the lanes of a road: columns of tracks with what drivers see, and where they come from.

    columns: (R,), among them ``x_m``, ``y_m`` [m] and perhaps ``heading_m`` [rad], ``x_speed`` and ``y_speed`` [m/s];
    the road of a row is its route, and its lane is the lane; reference: what the places are of; cure: what helps if the
    places are of another frame than the road.
    """
    # beside all lanes, a vehicle would be left out without a word
    check_possible({name: columns[name] for name in ("x_m", "y_m") if name in columns}, about.source)  # type: ignore[misc]
    vehicle = text_of(columns, "vehicle")
    recording = columns.get("recording")
    each = joined(recording, vehicle, "/") if isinstance(recording, Labels) else vehicle
    unknown = np.full(len(vehicle), np.nan)
    x, y, heading = (np.asarray(columns.pop(name, unknown)) for name in ("x_m", "y_m", "heading_m"))
    if "x_speed" in columns and "y_speed" in columns:
        columns["speed"] = np.hypot(np.asarray(columns.pop("x_speed")), np.asarray(columns.pop("y_speed")))
    vehicles, time = each.code.astype(np.int64), np.asarray(columns["time_s"])
    length = lengths_of(vehicles, np.asarray(columns.setdefault("length_m", unknown)))
    width, kind = columns.get("width_m"), columns.get("class")
    width = widths(*(None if width is None else np.asarray(width), kind if isinstance(kind, Labels) else None, length))
    found = routes_of(network, vehicles, time, x, y, heading, width)
    if (found.route < 0).all():
        raise off_road(np.stack((x, y), axis=1), network, about.source, cure)
    names = [lane.name for lane in network.lanes]
    ways = [" ".join(names[k] for k in path.lanes) for path in found.paths]
    columns |= {"road": labels(found.route.astype(np.int32), ways), "lane": labels(found.lane.astype(np.int32), names)}
    ahead, seen = scene(
        network,
        found.onward(network),
        OnNetwork(
            vehicle=vehicles,
            route=found.route,
            time_s=time,
            place=found.s_m + TO_CENTRE[reference] * length,
            length=length,
            recording=recording.code.astype(np.int64) if isinstance(recording, Labels) else np.zeros(len(length), int),
            sides=sides(vehicles, found.route, time, found.d_m, width),
        ),
    )
    leader = np.where(ahead >= 0, vehicle.code[ahead], np.where(ahead == FREE, len(vehicle.text), -1))
    columns["leader"] = labels(leader.astype(np.int32), [*vehicle.text, NOBODY])
    about = replace(about, leaders="given").noting(*found.notes)
    return columns | {"s_m": found.s_m, "d_m": found.d_m, **seen}, about


def moved(columns: Rows, east_m: float, north_m: float, network: Network) -> Rows:
    """Places that count from an origin, as places of the road, if it lies nearer to them then."""
    place = np.stack((np.asarray(columns["x_m"]), np.asarray(columns["y_m"])))
    road = np.mean([[lane.x_m.mean(), lane.y_m.mean()] for lane in network.lanes], axis=0)
    away = road - np.nanmedian(place, axis=1)
    origin = np.array([east_m, north_m])
    if np.hypot(*(away - origin)) < np.hypot(*away):
        columns = columns | {"x_m": place[0] + east_m, "y_m": place[1] + north_m}
    return columns
