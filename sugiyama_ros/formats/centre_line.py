"""Centre lines of lanes from a CSV file with the columns ``x, y[, lane, width]``."""

import csv
from pathlib import Path

import numpy as np

from sugiyama_ros.errors import InputError
from sugiyama_ros.formats.reading import lines, number, open_input
from sugiyama_ros.trajectories.centre_line import CentreLine, RoadLanes

# Width [m] of a lane, where the file does not give it.
_WIDTH_M = 3.5
_NEEDED, _OPTIONAL = ("x", "y"), ("lane", "width")


def read_lanes(path: Path) -> RoadLanes:
    """Read the centre lines of lanes.

    path: CSV file with the columns ``x`` and ``y`` [m], in the direction of driving, and perhaps ``lane``, the name of
    the lane, and ``width`` [m] of the lane. Raises InputError.
    """
    points: dict[str, list[tuple[float, float]]] = {}
    width: dict[str, float] = {}
    with open_input(path) as stream:
        text = lines(path, stream)
        head = [name.strip() for name in next(csv.reader([next(text, "")]), [])]
        if not set(_NEEDED) <= set(head) <= {*_NEEDED, *_OPTIONAL}:
            raise InputError(f"{path}: its first line is not x,y[,lane,width]; give the points of a centre line")
        for k, line in enumerate(text, 2):
            if not line.strip():
                continue
            cells = dict(zip(head, next(csv.reader([line])), strict=False))
            where = f"{path}:{k}"
            if len(cells) < len(head):
                raise InputError(f"{where}: {len(cells)} of {len(head)} fields; correct or remove the line")
            lane = cells.get("lane", "0").strip()
            points.setdefault(lane, []).append((number(cells["x"], "x", where), number(cells["y"], "y", where)))
            width[lane] = number(cells["width"], "width", where) if "width" in cells else _WIDTH_M
            if not 0.5 <= width[lane] <= 50.0:
                raise InputError(f"{where}: width {width[lane]:g} m is not that of a lane; give 0.5 to 50")
    if not points:
        raise InputError(f"{path}: no points; give the points of a centre line")
    try:
        found = [CentreLine(*np.array(of).T) for of in points.values()]
    except InputError as error:
        raise InputError(f"{path}: {error}") from None
    if len({line.road.is_ring for line in found}) > 1:
        raise InputError(f"{path}: some lanes are closed and some are not; close all of them, or none")
    return RoadLanes(list(points), found, [width[lane] for lane in points])
