"""What a recording can show of an effect, and why it cannot."""

import numpy as np

from sugiyama_ros.effects.effect import Effect, Extent
from sugiyama_ros.effects.registry import EFFECTS
from sugiyama_ros.fit.recording import Recorded


def not_searched(data: Recorded) -> dict[str, str]:
    """Return the effects that this recording cannot show, with the reason, by name.

    On a road without lines and curves, effects that act only there are no question.
    """
    own = recording_of(data)
    asked = [e for e in EFFECTS.values() if e.is_searched and (own.has_lines or own.has_curves or not _at_junctions(e))]
    return {e.name: why for e in asked if (why := why_not(e, data))}


def _at_junctions(e: Effect) -> bool:
    """Whether an effect acts only at lines or in curves."""
    return not e.starts(Extent(0.0, 100.0, 100.0, 0.0, 100.0))


def why_not(e: Effect, data: Recorded) -> str:
    """Return why a search for an effect makes no sense for a recording; empty if it does."""
    around, axes = data.vicinity, {p.axis for p in e.parameters}
    if not e.starts(recording_of(data)):
        return "there are no lines or no curves" if _at_junctions(e) else "the road is no ring"
    if around.is_whole_road:
        return "too few vehicles" if data.drivers <= e.reach else ""
    ahead = np.median([chain.position_m.shape[1] - 1 for chain in data.chains])
    reasons = {
        "each stretch of a track counts time from its own start": "time" in axes,
        "recordings have no places in common": "place" in axes and not around.has_places,
        "nothing is assumed of the vehicle behind": e.sees_rear,
        "the leader's leader is not known": e.reach > ahead,
    }
    return next((reason for reason, holds in reasons.items() if holds), "")


def recording_of(data: Recorded) -> Extent:
    """Return what a search may know about a recording."""
    around = data.vicinity
    first, last = float(np.nanmin(around.position_m)), float(np.nanmax(around.position_m))
    place, _, _, curvature = np.moveaxis(data.lines, -1, 0)
    lines, curves = bool(np.isfinite(place).any()), bool((np.nan_to_num(curvature) > 0.0).any())
    return Extent(*around.first_last_s, around.road.circumference_m, first, last, lines, curves)
