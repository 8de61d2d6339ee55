"""Where in a map of the bias something was found: places, times and ranges of what was added."""

from collections.abc import Mapping
from typing import Any, NamedTuple

import numpy as np

from sugiyama_ros.page.names import form_of, title_of


class Found(NamedTuple):
    """A range of a covariate in which something acts, with its name; a time at which it happens has no width."""

    title: str
    covariate: str
    low: float
    high: float


def found_in(axes: tuple[str, str], diagnosis: Mapping[str, Any], ring_m: float) -> list[Found]:
    """Return what to draw into a map over two covariates.

    ring_m: circumference [m] of the ring, on which a place comes again; 0 for an open road.
    """
    found = []
    for effect in diagnosis["verdict"]["effects"]:
        title = title_of(diagnosis, form_of(effect))
        declared = diagnosis.get("about", {}).get(form_of(effect), {}).get("parameters", {})
        values = effect.get("parameters", {})
        for name, value in values.items():
            axis = declared.get(name, {}).get("axis")
            if axis == "time" and "time" in axes:
                found.append(Found(title, "time", float(value), float(value)))
            elif axis == "place" and "place" in axes:
                half = 0.5 * float(values.get("width", 0.0))
                for shift in (-ring_m, 0.0, ring_m) if ring_m else (0.0,):
                    found.append(Found(title, "place", value + shift - half, value + shift + half))
        if effect.get("covariate") in axes:
            found += _force(title, effect)
    return found


def _force(title: str, effect: Mapping[str, Any]) -> list[Found]:
    """Where a force is at least half as large as at its largest; nothing for a force of no size."""
    values = effect["parameters"]
    size = np.abs([float(value) for name, value in values.items() if name.startswith("force_")])
    knots = np.linspace(float(values["first"]), float(values["last"]), len(size))
    if not size.any():
        return []
    strong = knots[size >= 0.5 * size.max()]
    return [Found(title, str(effect["covariate"]), float(strong.min()), float(strong.max()))]
