"""The road of a CommonRoad scenario: lanelets, traffic signs, stop lines, traffic lights and intersections."""

from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from xml.etree.ElementTree import Element

import numpy as np

from sugiyama_ros.errors import InputError
from sugiyama_ros.formats.reading import number
from sugiyama_ros.roads.network import Lanelet

#: Points of all lanelets of a file, at most.
MAX_POINTS = 200_000
# Widths [m] of lanelets, at least and at most: some begin or end with no width at all.
_WIDTHS_M = (0.5, 50.0)


def value_of(element: Element, name: str, where: str, of: str = "") -> float:
    """A number below an element. Raises InputError."""
    return number(element.findtext(name, "").strip(), of + name.replace("/", " "), where)


def lanelet_of(element: Element, path: Path) -> Lanelet:
    """A lanelet, which names others that may not be there. Raises InputError."""
    where = f"{path}: lanelet {element.get('id', '')[:40]}"
    left, right = (
        np.array([[value_of(p, "x", where), value_of(p, "y", where)] for p in element.iterfind(f"{side}Bound/point")])
        for side in ("left", "right")
    )
    if len(left) != len(right) or len(left) < 2:
        raise InputError(
            f"{where}: {len(left)} points on the left and {len(right)} on the right; give two or more of each"
        )
    middle = 0.5 * (left + right)
    kept = np.concatenate(([True], np.hypot(*np.diff(middle, axis=0).T) > 0.0))
    beside_left, beside_right = (
        next((one.get("ref", "") for one in element.iterfind(side) if one.get("drivingDir", "same") == "same"), "")
        for side in ("adjacentLeft", "adjacentRight")
    )
    width = float(np.clip(np.hypot(*(left - right).T).mean(), *_WIDTHS_M))
    after = tuple(one.get("ref", "") for one in element.iterfind("successor"))
    try:
        x, y = middle[kept].T
        return Lanelet(element.get("id", ""), x, y, after, beside_left, beside_right, width_m=width)
    except InputError as error:
        raise InputError(f"{path}: {error}") from None


def linked(lanelets: Mapping[str, Lanelet]) -> tuple[Lanelet, ...]:
    """Lanelets that name only those that are there."""
    return tuple(
        replace(
            one,
            successors=tuple(name for name in one.successors if name in lanelets),
            left=one.left if one.left in lanelets else "",
            right=one.right if one.right in lanelets else "",
        )
        for one in lanelets.values()
    )
