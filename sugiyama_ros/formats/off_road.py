"""Why no vehicle of a file is on a road: how far they are apart, and the likely cause."""

import numpy as np

from sugiyama_ros.arrays import Array
from sugiyama_ros.errors import InputError
from sugiyama_ros.roads.network import Network

# Places within this square are degrees: nobody records vehicles on two metres of road.
_DEGREES = 2.0
# Places farther than this [m] from the origin count from one that is not near, as those of UTM do.
_FAR_M = 1e5


def off_road(place_m: Array, network: Network, source: str, cure: str = "") -> InputError:
    """The error to raise where no row is on a lane.

    place_m: (R, 2), places of the rows; source: name of the file; cure: what helps if the places are of another frame
    than the road, if the format knows it.
    """
    place = place_m[np.isfinite(place_m).all(axis=1)]
    if not len(place):
        return InputError(f"{source}: no row has a place x, y; give the places of the vehicles")
    road = np.concatenate([np.stack((lane.x_m, lane.y_m), axis=1) for lane in network.lanes])
    low, high = place.min(axis=0), place.max(axis=0)
    apart_m = float(np.hypot(*np.maximum(np.maximum(road.min(axis=0) - high, low - road.max(axis=0)), 0.0)))
    says = f"{source}: no vehicle is on the road: "
    if (high - low < _DEGREES).all() and (np.abs(place) <= [180.0, 90.0]).all():
        cure = cure or "write them in metres, with the origin of the road"
        return InputError(f"{says}places such as {low[0]:.6g}, {low[1]:.6g} are degrees; {cure}")
    if not apart_m:
        return InputError(
            f"{says}they are among its lanes, but not on a lane that points their way; check that x goes to the east,"
            " y to the north and headings from x to y, and that the road is of the same place"
        )
    far, road_is_far = (np.abs(np.median(one, axis=0)).max() > _FAR_M for one in (place, road))
    why = "the road is of another place"
    if far != road_is_far:
        why = "the vehicles likely count from an origin of their own, and the road as in UTM"
        if far:
            why = "the road likely counts from an origin of its own, and the vehicles as in UTM"
    away = f"{apart_m / 1e3:,.0f} km" if apart_m >= 1e4 else f"{apart_m:,.0f} m"
    cure = cure or "give both with one origin (the road: local_x and local_y of all nodes, or netOffset 0,0)"
    return InputError(f"{says}they are {away} beside it; {why}; {cure}")
