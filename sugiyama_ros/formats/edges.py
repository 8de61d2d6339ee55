"""Positions along a road that is made of edges, from positions on each edge and the vehicles that change edges."""

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from sugiyama_ros.arrays import Array, Ints
from sugiyama_ros.trajectories.labels import Labels, labels

# A vehicle that stays away for longer [s] says nothing about how long an edge is.
_LONGEST_STEP_S = 2.0
# Share of the vehicles that leave an edge for the edge that counts as its next.
_MOST = 0.5


class Edges(NamedTuple):
    """What is known of each row, (R,) each: edge, number of the vehicle, time [s], position on the edge [m], speed."""

    edge: Labels
    vehicle: Ints | NDArray[np.int32]
    time_s: Array
    position_m: Array
    speed: Array


class Placed(NamedTuple):
    """Positions along roads of edges.

    s_m: positions [m], (R,); road: the first edge of the road of each row, (R,), or None if there is one road; ring_m:
    circumference [m] of this road if it is a ring, else 0; note: how many edges and roads there are.
    """

    s_m: Array
    road: Labels | None
    ring_m: float
    note: str


def along_edges(rows: Edges) -> Placed:
    """Put the edges of a road one behind the other.

    The length of an edge is what vehicles say that leave it for the next edge: where they were last, how far they came
    in between, and where they are now.
    """
    count = len(rows.edge.text)
    if count == 1:
        return Placed(rows.position_m, None, 0.0, "")
    straight, nexts, lengths = _nexts(rows, count)
    offset, root, ring_m = _chained(nexts, lengths)
    # Edges inside a crossing, which few vehicles are seen on, end where the next edge begins.
    for edge, name in enumerate(rows.edge.text):
        if name.startswith(":") and (target := int(straight[edge])) >= 0 and root[edge] != root[target]:
            offset[edge], root[edge] = offset[target] - lengths[edge], root[target]
    s = rows.position_m + offset[rows.edge.code]
    roads = len(set(root.tolist()))
    note = f"{count} edges make {roads} road{'s' * (roads > 1)}"
    if roads == 1:
        return Placed(s, None, ring_m, note)
    return Placed(s, labels(root[rows.edge.code].astype(np.int32), rows.edge.text), 0.0, note)


def _chained(nexts: Ints, lengths: Array) -> tuple[Array, Ints, float]:
    """Where each edge begins on its road [m], the first edge of this road, and the length of the last ring [m]."""
    count = len(nexts)
    offset, root, ring_m = np.zeros(count), np.arange(count), 0.0
    led_to = np.zeros(count, dtype=bool)
    led_to[nexts[nexts >= 0]] = True
    placed = np.zeros(count, dtype=bool)
    # Roads begin where no edge leads in; what is left then are rings, which begin at their first edge.
    for first in [*np.flatnonzero(~led_to).tolist(), *range(count)]:
        edge, place = int(first), 0.0
        while edge >= 0 and not placed[edge]:
            placed[edge], offset[edge], root[edge] = True, place, first
            place += lengths[edge]
            edge = int(nexts[edge])
        if edge == first and place > 0.0:
            ring_m = float(place)
    return offset, root, ring_m


def _nexts(rows: Edges, count: int) -> tuple[Ints, Ints, Array]:
    """The edge that most vehicles go to from each edge (-1 for none), the same where it leads on, and lengths [m]."""
    order = np.lexsort((rows.time_s, rows.vehicle))
    here, there = order[:-1], order[1:]
    step = rows.time_s[there] - rows.time_s[here]
    edge = rows.edge.code
    changed = (rows.vehicle[here] == rows.vehicle[there]) & (edge[here] != edge[there]) & (step <= _LONGEST_STEP_S)
    here, there, step = here[changed], there[changed], step[changed]
    way = 0.5 * (rows.speed[here] + rows.speed[there]) * step
    length = rows.position_m[here] + way - rows.position_m[there]
    nexts, lengths = np.full(count, -1, dtype=np.int64), np.zeros(count)
    for one in range(count):
        from_here = np.flatnonzero(edge[here] == one)
        if len(from_here) == 0:
            continue
        target, times = np.unique(edge[there[from_here]], return_counts=True)
        if times.max() >= _MOST * len(from_here):
            nexts[one] = target[np.argmax(times)]
            to_next = from_here[edge[there[from_here]] == nexts[one]]
            lengths[one] = float(np.median(length[to_next]))
    straight = nexts.copy()
    # Of several edges that lead into one, the one with the most vehicles goes on; the others end there.
    for target in np.unique(nexts[nexts >= 0]).tolist():
        into = np.flatnonzero(nexts == target)
        if len(into) > 1:
            busiest = max(into.tolist(), key=lambda one: int(np.sum((edge[here] == one) & (edge[there] == target))))
            nexts[into[into != busiest]] = -1
    return straight, nexts, lengths
