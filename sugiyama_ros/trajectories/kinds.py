"""Who is a vehicle: names of classes in one spelling, and which classes drive nothing."""

import re
from collections import Counter
from dataclasses import replace

import numpy as np

from sugiyama_ros.arrays import Ints, Mask
from sugiyama_ros.errors import InputError
from sugiyama_ros.trajectories.about import About
from sugiyama_ros.trajectories.labels import Labels, labels
from sugiyama_ros.trajectories.tracks import Tracks

# Where a word of a name ends.
_ENDS = re.compile(r"(?<=[a-z])(?=[A-Z])|[\s_-]+")
# Classes of people on foot, animals and things that stand. They may be in the way, but they drive nothing.
_NO_DRIVERS = {
    *("pedestrian", "pedestrians", "pedestrian/bicycle", "person", "people", "walker", "animal", "hazard"),
    *("barrier", "sign", "traffic_sign", "traffic_cone", "cone", "debris", "over_drivable", "under_drivable"),
    *("static", "static_obstacle", "parked_vehicle", "construction_zone", "road_boundary", "building", "pillar"),
    "median_strip",
}


def class_name(text: str) -> str:
    """The name of a class in one spelling: car for Car, parked_vehicle for parkedVehicle.

    SUMO calls a class truck@f.1 that is changed for one vehicle.
    """
    return _ENDS.sub("_", (text.partition("@")[0] or text).strip()).lower()


def spelled(column: Labels) -> Labels:
    """Names of classes (R,) in one spelling."""
    return labels(column.code, map(class_name, column.text))


def is_driver(text: str) -> bool:
    """Whether somebody of this class drives a vehicle; a class that is not known does."""
    return class_name(text) not in _NO_DRIVERS


def others(kind: Labels, who: Ints, about: About, behind: str = "") -> tuple[Mask, About]:
    """The rows (R,) of those who drive nothing, and where tracks without them come from.

    kind: class of each row; who: number (R,) of each row's vehicle; behind: what else the note says. Of classes that
    change, the most frequent counts. Raises InputError if nobody drives.
    """
    named = kind.code >= 0
    no_driver = np.append([not is_driver(text) for text in kind.text], False).astype(bool)[kind.code]
    if not no_driver.any():
        return no_driver, about
    _, number = np.unique(who, return_inverse=True)
    gone = (np.bincount(number, no_driver) > 0.5 * np.bincount(number, named))[number]
    _, first = np.unique(number[gone & no_driver], return_index=True)
    counts = Counter(class_name(kind.at(row)) for row in np.flatnonzero(gone & no_driver)[first].tolist())
    said = ", ".join(f"{count} {name}" for name, count in sorted(counts.items()))
    if gone.all():
        raise InputError(f"{about.source or 'tracks'}: nobody drives a vehicle: {said}; give a file with vehicles")
    note = f"no drivers, and left out: {said}{behind}" * bool(counts)
    return gone, about.without("no driver", int(gone.sum())).noting(note)


def drivers_only(tracks: Tracks) -> Tracks:
    """The tracks without those who drive nothing. Raises InputError if nobody drives."""
    if tracks.vehicle_class is None:
        return tracks
    behind = "; the leader of whoever is behind them is unknown"
    gone, about = others(tracks.vehicle_class, tracks.run, tracks.about, behind)
    if not gone.any():
        return tracks
    kept = tracks.select(~gone)
    return replace(kept, about=replace(about, view=kept.about.view))
